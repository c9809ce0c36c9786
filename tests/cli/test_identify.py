"""`mckibben identify` and `validate`: files of every kind, recordings over time, JSON, and what is kept."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from mckibben import catalog
from mckibben.component.schema import read_component
from mckibben.dataset import IsobaricDataset, Recipe
from mckibben.identification import Fit
from mckibben.muscle import Muscle
from mckibben.units import bar, percent

TABLES = Path(__file__).parents[2] / "src" / "mckibben" / "catalog" / "tables"
FESTO = str(TABLES / "festo-tool_10mm.csv")


@pytest.fixture
def german(tmp_path, paper) -> str:
    """Eq. 3 without noise, as a German spreadsheet writes it."""
    rows = ["Druck [bar];Kontraktion [%];Kraft [N]"]
    for p in (1.5, 3.0, 4.5, 6.0):
        for eps in np.arange(0, 20.1, 2.5):
            force = max(float(paper.eq3(eps / 100, p * 1e5)), 0.0)
            rows.append(f"{p};{eps};{force!r}".replace(".", ","))
    (tmp_path / "messung.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return "messung.csv"


def values(numbers, title, column):
    """A column of a table of a result, in its unit."""
    (table,) = [table for table in numbers["tables"] if table["title"] == title]
    return table["columns"][column]["values"]


def parameter(numbers, name, column="estimate"):
    """A number of a parameter, in published units."""
    return values(numbers, "parameters", column)[values(numbers, "parameters", "parameter").index(name)]


COLUMNS = (
    *("--column", "Druck [bar]=pressure_bar"),
    *("--column", "Kontraktion [%]=contraction_percent"),
    *("--column", "Kraft [N]=force_N"),
)


@pytest.mark.slow
def test_a_table_as_it_stands(cli):
    found = cli("identify", FESTO)
    assert found.code == 0
    assert re.search(r"^pressure_kPa +pressure +kPa +header +0\.\.800$", found.err, re.MULTILINE)
    assert found.out.startswith("ExponentialLaw describes 119 points")
    assert "to 2.76 N" in found.out and "3.42 N at pressures left out" in " ".join(found.out.split())
    assert re.search(r"^decay +0\.3398\d+ +0\.0067 .*1/percent", found.out, re.MULTILINE)


@pytest.mark.slow
def test_points_of_a_recording_are_drawn_in_the_terminal_and_their_figure_is_named_last(cli, tmp_path):
    steps = {"time_s": np.arange(90) * 0.1, "pressure_bar": np.full(90, 3.0)}
    steps |= {"contraction_percent": np.repeat([0.0, 5.0, 10.0], 30), "force_N": np.repeat([300.0, 100.0, 200.0], 30)}
    np.savetxt("steps.csv", np.transpose([*steps.values()]), delimiter=",", header=",".join(steps), comments="")
    found = cli("points", "steps.csv", "--dwell", "2 s", "--plot", "--out", "kept")
    assert found.code == 0
    assert found.out.splitlines()[-1].endswith("; figure: kept/points.png") and (tmp_path / "kept/points.png").exists()
    drawn = [line for line in found.out.splitlines() if re.search("[\u2800-\u28ff]", line)]
    dots = {(row, place) for row, line in enumerate(drawn) for place, sign in enumerate(line) if sign > "\u2800"}
    (highest, first), (middle, third), (lowest, second) = sorted(dots)
    assert (highest, lowest) == (0, len(drawn) - 1) and abs(2 * middle - lowest) <= 1
    assert first < second < third and abs(first + third - 2 * second) <= 1
    assert drawn[0].startswith("300 N ") and drawn[-1].startswith("100 N ")


@pytest.mark.slow
def test_out_keeps_everything(cli, tmp_path):
    found = cli("identify", FESTO, "--out", "deep/kept", "--json")
    assert found.code == 0
    out = tmp_path / "deep" / "kept"
    assert {"fit.yaml", "data.nc", "results.json", "fit.png"} <= {p.name for p in out.iterdir()}
    numbers = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert json.loads(found.out) == numbers  # and the note went elsewhere
    fit = Fit.from_yaml(out / "fit.yaml")
    assert fit.estimates["decay"] * percent == pytest.approx(parameter(numbers, "decay"), rel=1e-5)
    assert len(IsobaricDataset.from_netcdf(out / "data.nc")) == 120
    assert (out / "fit.png").read_bytes().startswith(b"\x89PNG")


def test_validate_a_law_of_the_catalog(cli, paper):
    found = cli("validate", "lei-mas-10-180n", "dmsp-10-250-martens2017", "--json")
    assert (found.code, found.err) == (0, "")
    numbers = json.loads(found.out)
    assert numbers["scalars"]["slack"]["value"] == 45
    overall = {name: values(numbers, "errors", name)[0] for name in ("rmse", "bias", "points")}
    data = catalog.dataset("dmsp-10-250-martens2017").taut
    error = paper.eq3(data.contraction, data.pressure) - data.force
    assert overall["rmse"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert overall["bias"] == pytest.approx(error.mean())
    assert overall["points"] == 40
    table = cli("validate", "lei-mas-10-180n", "dmsp-10-250-martens2017").out
    assert f"{overall['rmse']:.3g} N" in table


@pytest.mark.slow
def test_every_law_is_ranked_with_reasons_and_kept(cli, tmp_path):
    found, folder = cli("identify", "dmsp-10-250-martens2017", "--law", "all", "--out", "kept"), tmp_path / "kept"
    assert found.code == 0 and "best SarosiLaw" in found.out
    numbers = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    texts = [remark["text"] for remark in numbers["remarks"]]
    assert any(text.startswith("flagged TonduLopez: braid_angle at a bound") for text in texts)
    laws = numbers["columns"]["law"]["values"]
    assert numbers["result"] == "Ranking" and laws[:2] == ["Sarosi", "Hunt"]
    assert numbers["columns"]["pressure"]["values"][0] == pytest.approx(1.36, abs=0.01)
    assert type(Fit.from_yaml(folder / "fit.yaml").law).__name__ == "SarosiLaw"
    kept = {path.stem for path in (folder / "fits").iterdir()}
    assert kept == {f"{law}Law" for law in laws}
    assert Recipe.read(folder / "recipe.yaml") == Recipe()
    assert (folder / "ranking.png").stat().st_size > 20_000
    (folder / "fits" / "mine.yaml").write_text("mine")
    again = cli("identify", "dmsp-10-250-martens2017", "--out", "kept", "--force", "--json")
    left = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert left == {*json.loads(again.out)["files"], "fits/mine.yaml"}
    assert "bands.png" in left and "ranking.png" not in left and "ranking.png" not in again.err


@pytest.mark.slow
def test_outliers_can_be_kept(cli, tmp_path):
    table = catalog.dataset("dmsp-10-250-martens2017").table
    force = table["force"].to_numpy().copy()
    force[20] *= 1.3
    IsobaricDataset(table.assign(force=("point", force))).to_csv(tmp_path / "wrong.csv")
    named, kept = (
        list(json.loads(cli("identify", "wrong.csv", "--json", *more).out)["remarks"])
        for more in ((), ("--keep-outliers",))
    )
    lines = (tmp_path / "wrong.csv").read_text().splitlines()
    header = next(number for number, line in enumerate(lines, 1) if not line.startswith("#"))
    assert [f"line {header + 21}:" in remark["text"] for remark in named if "left out:" in remark["text"]] == [True]
    assert not any("left out:" in remark["text"] for remark in kept)
    text = cli("identify", "wrong.csv").out  # with the options of the command line in place of Python's
    assert "--keep-outliers" in text and "robust=False" not in text and "(command" not in text


@pytest.fixture
def measured(tmp_path, paper) -> dict[str, tuple[str, ...]]:
    """Arguments for files whose errors and remarks recommend options."""
    rows = [f"{p},{4 * eps},10,{w}" for p, eps in ((2, 1), (3, 2), (4, 3), (5, 4)) for w in ("loading", "unloading")]
    (tmp_path / "one-load.csv").write_text(
        "\n".join(["pressure_bar,contraction_percent,force_kgf,direction", *rows, ""])
    )
    rng, time, rows = np.random.default_rng(0), 0.0, ["time_s,pressure_bar,length_mm,force_N"]
    for level in (3.0, 4.0, 5.0, 6.0):
        for stop, side in [(eps, -1) for eps in range(9)] + [(eps, 1) for eps in range(7, -1, -1)]:
            force = float(paper.eq3(stop / 100, level * 1e5)) + 12 * side
            for _ in range(30):
                rows.append(f"{time:.2f},{level},{180 * (1 - stop / 100):.3f},{force + rng.normal(0, 0.1):.3f}")
                time += 0.05
    (tmp_path / "stops.csv").write_text("\n".join([*rows, ""]))
    rig = str(Path(__file__).parents[2] / "examples" / "rig.csv")
    return {
        "without friction": (rig, "--friction", "off"),
        "one load": ("one-load.csv",),
        "stop and go": ("stops.csv", "--initial-length", "180 mm"),
    }


@pytest.mark.slow
@pytest.mark.parametrize("case", ["without friction", "one load", "stop and go"])
def test_what_remarks_and_errors_recommend_is_accepted(cli, measured, case):
    """Each command in them as it stands, and each option beside the arguments."""
    given = measured[case]
    said = " ".join((first := cli("identify", *given)).err.split() + first.out.split())
    commands = [shlex.split(text)[1:] for text in re.findall(r"`(mckibben [^`]+)`", said)]
    options = [shlex.split(text) for text in re.findall(r"(?<!`)--(?:friction|law|of) [a-z]+", said)]
    assert len(commands) == 2 * (case == "stop and go") and (options or commands), said
    for command in (
        *commands,
        *(["identify", given[0], *given[1:] * (case == "stop and go"), *option] for option in options),
    ):
        assert cli(*command).code == 0, command


@pytest.mark.slow
def test_friction_is_identified_by_itself_and_goes_all_the_way(cli, tmp_path):
    """The muscle file has it; simulate and envelope use it, and mention small motion once."""
    rig = str(Path(__file__).parents[2] / "examples" / "rig.csv")
    found = cli("identify", rig, "--out", "fit", "--json")
    numbers = json.loads(found.out)
    assert values(numbers, "friction", "estimate")[0] == pytest.approx(12, rel=0.01)
    plain = json.loads(cli("identify", rig, "--friction", "off", "--json").out)
    with_friction, without = ({name: s["value"] for name, s in n["scalars"].items()} for n in (numbers, plain))
    assert numbers["result"] == "FitWithFriction" and without["rmse"] > 100 * with_friction["rmse"]
    assert with_friction["held_out_error"] == pytest.approx(with_friction["rmse"], rel=0.2)
    muscle = read_component(Muscle, tmp_path / "fit" / "muscle.yaml")
    assert float(muscle.friction.half_width) == pytest.approx(12, rel=0.01)
    scenario = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
    section = "muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}"
    assert section in scenario
    text = scenario.replace(section, "muscle: fit/muscle.yaml").replace("10 s", "0.2 s").replace("at: 5 s", "at: 0.1 s")
    (tmp_path / "joint.yaml").write_text(text)
    for command in (
        ("simulate", "joint.yaml"),
        ("envelope", "joint.yaml"),
    ):
        answer = cli(*command, "--details")
        assert answer.code == (command[0] == "simulate"), answer.err  # 0.2 s are too short to follow
        assert (answer.out + answer.err).count("muscle1 and muscle2 have friction, which") == 1


@pytest.mark.slow
def test_a_home_made_muscle_gets_a_volume_from_its_diameter_or_a_measured_fill(cli, german, tmp_path):
    for option, volume in (("20 mm", np.pi / 4 * 0.02**2 * 0.18), ("50 cm^3", 50e-6)):
        folder = option.split()[0]
        cli("identify", german, *COLUMNS, "--initial-length", "180 mm", "--inner", option, "--out", folder)
        muscle = read_component(Muscle, tmp_path / folder / "muscle.yaml")
        assert muscle.specimen.has_volume
        assert float(muscle.specimen.volume(0.0)) == pytest.approx(volume)
        contraction, pressure = np.linspace(0, 0.2, 5), 3.75 * bar
        grown = np.gradient(np.asarray(muscle.specimen.volume(np.linspace(0, 0.2, 401))), 0.2 / 400)[::100]
        gain = (muscle.law.force(contraction, pressure + 1) - muscle.law.force(contraction, pressure - 1)) / 2
        np.testing.assert_allclose(grown, 0.18 * np.asarray(gain), rtol=0.02, atol=2e-7)  # virtual work


@pytest.mark.parametrize(
    "options",
    [
        ("--inner", "0 cm^3", "--out", "new"),
        ("--inner", "200 mm", "--out", "new", "--law", "all"),
    ],
)
def test_an_impossible_diameter_or_fill_is_refused(cli, german, tmp_path, options):
    found = cli("identify", german, *COLUMNS, "--initial-length", "180 mm", *options)
    assert (found.code, found.out) == (2, "")
    assert not list((tmp_path / "new").glob("*"))  # the corrected command needs no --force


@pytest.mark.parametrize(("options", "named"), [(("creep", "--inner", "20 mm"), "--inner"), (("heat",), "heat")])
def test_mistakes_are_explained(cli, options, named):
    refused = cli("identify", "points.csv", "--of", *options)
    assert (refused.code, refused.out) == (2, "") and named in refused.err


@pytest.mark.slow
def test_torques_of_two_muscles_give_one_for_scenarios(cli, tmp_path):
    """On pulleys of 25 mm, each muscle vented in turn, the other at three pressures."""
    law, angle = catalog.law("lei-mas-10-180n"), np.tile(np.linspace(-0.4, 0.4, 15), 6)
    pressures = np.repeat([[0, 3, 0, 4, 0, 5], [3, 0, 4, 0, 5, 0]], 15, axis=1) * 1e5
    contraction = 0.1 + np.array([-1, 1])[:, None] * 0.025 * angle / 0.18
    first, second = np.maximum(np.asarray(law.force(contraction, pressures)), 0)
    rows = np.transpose([angle, 0.025 * (second - first), *pressures / 1e5])
    np.savetxt("torque.csv", rows, "%.9g", ",", header="angle_rad,torque_Nm,p1_bar,p2_bar", comments="")
    pulley = "{class: Pulley, radius: 25 mm, rest_length: 162 mm}"
    Path("pulleys.yaml").write_text(f"{{class: PairedPaths, path1: {pulley}, path2: {pulley}}}")
    options = ("--of", "torque", "--read", "joint=pulleys.yaml", "--initial-length", "180 mm", "--out", "fit")
    assert cli("identify", "torque.csv", *options).code == 0
    muscle = read_component(Muscle, Path("fit/muscle.yaml"))
    assert float(muscle.law.force(0.12, 4e5)) == pytest.approx(float(law.force(0.12, 4e5)), rel=1e-3)
