"""Kinds of messy files as the programs and people of laboratories write them; importing this adds them to `KINDS`."""

from __future__ import annotations

import io
from dataclasses import replace

import h5py
import numpy as np
from messy_kinds import HEADER, File, cells, csv, kind, numbers, text, third, workbook
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

NAMES = ("pressure_bar", "contraction_percent", "force_N")

# Programs that write text


@kind
def numpy_savetxt(p, rng):
    """Its header is a comment."""
    rows = [[f"{v:.18e}" for v in row] for row in numbers(p)]
    return csv(p, text(rows, ("# " + NAMES[0], *NAMES[1:]), delimiter=" "), "rig.txt")


@kind
def matlab_writetable(p, rng):
    """Names as MATLAB makes them valid: Pressure [bar] becomes Pressure_bar_."""
    return csv(p, text(cells(p), ("Pressure_bar_", "Contraction___", "Force_N_"), delimiter=","))


@kind
def matlab_ascii(p, rng):
    """`save -ascii` writes no header; the columns are given by position."""
    rows = ["".join(f"{v:16.7e}" for v in row) for row in numbers(p)]
    return csv(p, "\n".join(rows) + "\n", "rig.txt", columns={str(i): name for i, name in enumerate(NAMES, 1)})


@kind
def excel_csv_with_separator_line(p, rng):
    return csv(p, "sep=;\n" + text(cells(p, ","), HEADER))


@kind
def excel_unicode_text(p, rng):
    return csv(p, text(cells(p, ","), delimiter="\t", end="\r\n"), "rig.txt", "utf-16")


@kind
def excel_line_break_in_the_header(p, rng):
    return csv(p, text(cells(p), ('"Pressure\n[bar]"', '"Contraction\n[%]"', '"Force\n[N]"'), delimiter=","))


@kind
def origin_with_three_rows_of_header(p, rng):
    head = [["bar", "%", "N"], ["gauge", "of the length", "U9C"]]
    return csv(p, text([*head, *cells(p)], ("Pressure", "Contraction", "Force"), delimiter="\t"), "rig.dat")


@kind
def gnuplot_blocks(p, rng):
    """A block for each pressure, after a comment and two blank lines."""
    rows, lines = cells(p), ["# " + " ".join(NAMES)]
    for level in np.unique(p.pressure.round()):
        lines += ["", "", f"# {level:g} bar"] if len(lines) > 1 else []
        lines += [" ".join(row) for row, value in zip(rows, p.pressure, strict=True) if value.round() == level]
    order = np.concatenate([np.flatnonzero(p.pressure.round() == level) for level in np.unique(p.pressure.round())])
    p = replace(p, pressure=p.pressure[order], contraction=p.contraction[order], force=p.force[order])
    return csv(p, "\n".join(lines) + "\n", "rig.dat")


@kind
def arduino_plotter(p, rng):
    """A label before each number."""
    return csv(p, "".join(f"P:{a},C:{b},F:{c}\n" for a, b, c in cells(p)), "rig.txt")


@kind
def terminal_with_times(p, rng):
    """A terminal's time stamp before each line, as one more column."""
    rows = [[f"14:33:{i:02d}.250", *row] for i, row in enumerate(cells(p))]
    return csv(p, text(rows, ("Received", *HEADER), delimiter="\t"), "rig.log")


@kind
def dates_and_times(p, rng):
    rows = [["12.03.2024", f"14:33:{i:02d},250", *row] for i, row in enumerate(cells(p, ","))]
    return csv(p, text(rows, ("Datum", "Uhrzeit", "Druck [bar]", "Kontraktion [%]", "Kraft [N]")), encoding="cp1252")


@kind
def times_of_iso_8601(p, rng):
    rows = [[f"2024-03-12T14:33:{i:02d}.250+01:00", *row] for i, row in enumerate(cells(p))]
    return csv(p, text(rows, ("timestamp", *NAMES), delimiter=","))


@kind
def all_cells_quoted(p, rng):
    rows = [[f'"{one}"' for one in row] for row in [HEADER, *cells(p, ",")]]
    return csv(p, text(rows[1:], rows[0], delimiter=","))


@kind
def fixed_columns_with_signs(p, rng):
    rows = ["".join(f"{v:+012.4f}  " for v in row) for row in numbers(p)]
    return csv(p, "Pressure [bar]  Contraction [%]  Force [N]\n" + "\n".join(rows) + "\n", "rig.txt")


@kind
def old_macintosh_line_ends(p, rng):
    return csv(p, text(cells(p), delimiter="\t", end="\r"), "rig.txt")


@kind
def padded_with_nuls(p, rng):
    """A logger had allocated the file before it wrote."""
    return csv(p, text(cells(p)) + "\0" * 512)


@kind
def comments_at_the_end(p, rng):
    return csv(p, text(cells(p)) + "# end of test, 14:40\n")


@kind
def words_at_the_end(p, rng):
    return csv(p, text(cells(p)) + "Test ended by operator\n")


@kind
def mean_at_the_end(p, rng):
    return csv(p, text(cells(p)) + f"Mean;;{p.force.mean():.1f}\n")


@kind
def unquoted_comma_in_a_last_note(p, rng):
    rows = [[*row, ""] for row in cells(p)]
    rows[2][3] = "valve stuck, repeated"
    return csv(p, text(rows, (*NAMES, "note"), delimiter=","))


@kind
def not_a_number_as_words(p, rng):
    rows = cells(p)
    at = int(rng.integers(len(rows)))
    rows[at][2] = rng.choice(["NaN", "n/a", "#N/A", "---", "OVER"])
    return replace(csv(p, text(rows)), truth=p.without([at]))


# Languages


@kind
def german_preamble(p, rng):
    head = "Prüfstand: Schlauchmuskel\nTemperatur: 21,5 °C\nPrüfer: Müller\n\n"
    header = ("Zeit [s]", "Druck [bar]", "Kontraktion [%]", "Kraft [N]")
    rows = [[f"{i / 2:.1f}".replace(".", ","), *row] for i, row in enumerate(cells(p, ","))]
    return csv(p, head + text(rows, header), encoding="cp1252")


@kind
def french(p, rng):
    return csv(p, text(cells(p, ","), ("Pression (bar)", "Contraction (%)", "Force (N)")), encoding="cp1252")


@kind
def italian(p, rng):
    return csv(p, text(cells(p, ","), ("Pressione [bar]", "Contrazione [%]", "Forza [N]")))


@kind
def spanish(p, rng):
    return csv(p, text(cells(p, ","), ("Presión (bar)", "Contracción (%)", "Fuerza (N)")), encoding="cp1252")


@kind
def portuguese(p, rng):
    return csv(p, text(cells(p, ","), ("Pressão (bar)", "Contração (%)", "Força (N)")))


@kind
def chinese(p, rng):
    return csv(p, text(cells(p), ("压力(bar)", "收缩率(%)", "拉力(N)"), delimiter=","))


@kind
def chinese_of_windows(p, rng):
    return csv(p, text(cells(p), ("压力(bar)", "收缩率(%)", "拉力(N)"), delimiter=","), encoding="gb18030")


@kind
def japanese_of_windows(p, rng):
    return csv(p, text(cells(p), ("圧力[bar]", "収縮率[%]", "張力[N]"), delimiter=","), encoding="shift_jis")


# Headers


@kind
def units_after_a_blank(p, rng):
    return csv(p, text(cells(p), ("Pressure bar", "Contraction %", "Force N")))


@kind
def symbols_and_underscores(p, rng):
    return csv(p, text(cells(p), ("p_bar", "eps_percent", "F_N"), delimiter=","))


@kind
def symbols_in_brackets(p, rng):
    return csv(p, text(cells(p), ("p[bar]", "ε[%]", "F[N]")))


@kind
def names_of_amplifier_channels(p, rng):
    return csv(p, text(cells(p), ("U9C [N]", "MX440 CH1 [bar]", "WA100 [mm]")))


@kind
def no_units(p, rng):
    return csv(p, text(cells(p), ("Pressure", "Contraction", "Force")))


@kind
def megapascals_and_decanewtons(p, rng):
    rows = [[f"{a / 10:.3f}", f"{b:g}", f"{c / 10:.2f}"] for a, b, c in numbers(p)]
    return csv(p, text(rows, ("Pressure [MPa]", "Contraction [%]", "Force [daN]")))


@kind
def force_of_a_kilogram(p, rng):
    rows = third(cells(p), [repr(float(v) / 9.80665) for v in p.force])
    return csv(p, text(rows, ("Pressure [bar]", "Contraction [%]", "Force [kgf]")))


@kind
def pounds_and_inches(p, rng):
    rows = [[repr(a / 0.0689475729), repr(10 * (1 - b / 100)), repr(c / 4.4482216153)] for a, b, c in numbers(p)]
    header = ("Pressure (psi)", "Length (in)", "Force (lbf)")
    return csv(p, text(rows, header, delimiter=","), initial_length=0.254)


@kind
def wide_with_a_column_for_each_pressure(p, rng):
    """One row for each contraction."""
    per = len(np.unique(p.contraction))
    forces = p.force.reshape(-1, per)
    p = replace(p, pressure=np.repeat(p.pressure[::per], per))
    header = ("Contraction [%]", *(f"Force at {pressure:g} bar [N]" for pressure in p.pressure[::per]))
    rows = [[f"{p.contraction[i]:g}", *(f"{column[i]:g}" for column in forces)] for i in range(per)]
    return csv(p, text(rows, header))


@kind
def centimetres_with_lengths_in_words(p, rng):
    rows = [[a, f"{18 * (1 - float(b) / 100):.4f}", c] for a, b, c in cells(p)]
    return csv(p, text(rows, ("Pressure [bar]", "Muscle length [cm]", "Force [N]")), initial_length=0.18)


# Workbooks and binary files


@kind
def workbook_that_begins_at_c4(p, rng):
    def move(book):
        book.active.insert_cols(1, 2)
        book.active.insert_rows(1, 3)

    return File("rig.xlsx", workbook([HEADER, *numbers(p)], move), p)


@kind
def workbook_with_a_merged_title(p, rng):
    def merge(book):
        book.active.merge_cells("A1:C1")

    return File("rig.xlsx", workbook([["Test of 12 March", None, None], HEADER, *numbers(p)], merge), p)


@kind
def workbook_with_units_as_number_format(p, rng):
    """Cells that show 3.5 bar and contain 3.5, under names without units."""

    def show(book):
        for row in book.active.iter_rows(min_row=2):
            for cell, form in zip(row, ('0.00" bar"', '0.0" %"', '0.0" N"'), strict=True):
                cell.number_format = form

    return File("rig.xlsx", workbook([("Pressure", "Contraction", "Force"), *numbers(p)], show), p)


@kind
def workbook_with_dates(p, rng):
    import datetime

    start = datetime.datetime(2024, 3, 12, 14, 33)
    rows = [[start + datetime.timedelta(seconds=i), *row] for i, row in enumerate(numbers(p))]
    return File("rig.xlsx", workbook([("Date", *HEADER), *rows]), p)


@kind
def workbook_with_remarks_beside_the_table(p, rng):
    rows = [[*row, None, None] for row in numbers(p)]
    rows[1][4], rows[3][4] = "slope by eye", 12.5
    return File("rig.xlsx", workbook([(*HEADER, None, None), *rows]), p)


@kind
def matlab_struct(p, rng):
    stream = io.BytesIO()
    savemat(stream, {"rig": dict(zip(NAMES, np.array(numbers(p)).T, strict=True)), "operator": "A. B."})
    return File("rig.mat", stream.getvalue(), p)


@kind
def hdf5_rows_of_records(p, rng):
    """A compound type, as `pandas.to_hdf` in its format table and PyTables write."""
    stream = io.BytesIO()
    records = np.rec.fromarrays(np.array(numbers(p)).T, names=list(NAMES))
    with h5py.File(stream, "w") as file:
        file.create_group("rig").create_dataset("table", data=records)
    return File("rig.h5", stream.getvalue(), p)


@kind
def hdf5_matrix_with_names(p, rng):
    """A matrix with its columns' names in an attribute."""
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        file.create_dataset("data", data=np.array(numbers(p))).attrs["columns"] = ",".join(NAMES)
    return File("rig.h5", stream.getvalue(), p)


@kind
def tdms_with_waveforms_and_two_groups(p, rng):
    stream = io.BytesIO()
    form = {"wf_increment": 0.5, "wf_samples": 1}
    columns = (("Pressure", p.pressure, "bar"), ("Contraction", p.contraction, "%"), ("Force", p.force, "N"))
    with TdmsWriter(stream) as writer:
        made = [ChannelObject("rig", n, v, properties={"unit_string": u, **form}) for n, v, u in columns]
        writer.write_segment([*made, ChannelObject("events", "code", np.arange(4))])
    return File("rig.tdms", stream.getvalue(), p)


@kind
def labview_without_times(p, rng):
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\n"
        "X_Columns\tNo\nTime_Pref\tRelative\n***End_of_Header***\t\n\t\nChannels\t3\nSamples\t1\t1\t1\n"
        "Y_Unit_Label\tbar\t%\tN\nDelta_X\t0,5\t0,5\t0,5\n***End_of_Header***\t\n"
        "X_Value\tPressure\tContraction\tForce\tComment\n"
    )
    return csv(p, head + "".join("\t" + "\t".join(row) + "\n" for row in cells(p, ",")), "rig.lvm")
