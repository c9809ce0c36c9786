"""Rows that are not measurements (summaries, rows marked as invalid), and what other columns say of a test."""

from __future__ import annotations

import functools
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset.sheet import RawColumn

Floats = NDArray[np.float64]

MOST_POINTS = 20_000
"""Rows of a file, beyond which they are samples, not points."""
_STATISTICS: Mapping[str, Callable[..., Floats]] = {
    "mean": np.mean,
    "median": np.median,
    "standard deviation": functools.partial(np.std, ddof=1),
    "sum": np.sum,
    "maximum": np.max,
    "range": np.ptp,
}
_FEWEST = 4  # rows that a summary summarises
_JUMP = 1.5  # usual steps from row to row, beyond which a summary is from its neighbors
_ENDS = 8  # rows at either end of a file that may be a summary
_COARSE = 0.02  # of the range of a column: largest rounding of a summary
_SAME = 1e-6  # of the range of a column: rounding of a repeated value
_LEVEL = 0.05  # of the largest value: rows of one level
_DECIMALS = 9  # of a number in a file
_BY_CHANCE = 0.2  # expected rows of whole numbers alone, below which one is no measurement

_GOOD = frozenset("valid ok good gültig valide válido valido".split())
_NUMBER = re.compile(r"[-+]?[\d.,]+")
_NEGATIONS = frozenset("not no non free without kein keine nicht ohne sans".split())
_BAD = frozenset(
    "invalid error fault alarm overload overrange overflow saturated outlier excluded exclude bad reject rejected "
    "discard discarded ignore ignored skip skipped ungültig fehler erreur errore".split()
)
_TRUTH = {
    **dict.fromkeys(("1", "true", "yes", "y", "ja", "x", "*"), True),
    **dict.fromkeys(("0", "false", "no", "n", "nein", ""), False),
}
_STATUS = frozenset(
    "status state validity flag flags quality errors err warning outliers use used mask masked code zustand qualität "
    "état estado stato".split()
)
_STATUS |= _GOOD | _BAD
_INVALID = frozenset(
    "fault error err invalid bad fail failed failure nok overload overrange overflow underrange ol saturated clipped "
    "outlier discard discarded ignore ignored reject rejected exclude excluded leak slipped stuck burst wrong "
    "ungültig fehler fehlerhaft défaut erreur inválido errore invalide".split()
)
_SUMMARY = frozenset(
    "mean average avg median std stdev sum total mittelwert mittel summe moyenne promedio media min minimum max "
    "maximum range offset scale gain factor sensitivity tare calibration unit units channel".split()
)
_SPECIMEN = frozenset("specimen muscle actuator dut prüfling muskel probe muestra éprouvette provino".split())
_NAME = frozenset("specimen muscle name id no nr number num type serial sn".split())
_WORD = re.compile(r"[^\W\d_]+")
_NO_VALUE = frozenset(("n/a", "na", "#n/a", "null", "none", "missing"))
_WARMING = 5.0  # K
_TEMPERATURE = re.compile(
    r"temp[eé]ratur.*?(?:(?<![a-z])(?:deg|°)?\s*([ckf])(?![a-z])|(celsius|kelvin|fahrenheit))", re.IGNORECASE
)
_VALUES = 100  # different numbers in a column of states
_LONGEST = 40  # characters of a value
_SHOWN = 4  # values in a warning
_FEW = 0.1  # of the numbers of a column: words that mark rows

_Candidate = tuple[int, Floats, str]
"""Row, the values of a statistic, and its name."""


def summaries(columns: Mapping[str, tuple[Floats, float]]) -> dict[int, str]:
    """Rows that are a statistic of others: of a file, a level, or all rows before them; and the statistic.

    `columns` are values and the unit in which the file has them, of at most `MOST_POINTS` rows; all must agree to the
    decimals of the row.
    """
    rows = np.stack([values / factor for values, factor in columns.values()])
    if rows.shape[1] <= _FEWEST:
        return {}
    found: dict[int, str] = {}
    apart = _apart(rows)
    with np.errstate(over="ignore", invalid="ignore"):
        for at, values, what in (*_ends(rows), *_of_all_before(rows), *_of_levels(rows, [*columns])):
            if at not in found and apart[at] and _equal(rows, at, values) and not _repeated(rows, at):
                found[at] = what
    return found


def _apart(rows: Floats) -> NDArray[np.bool_]:
    """Rows far from the rows next to them; others may be points of a ramp."""
    steps = np.abs(np.diff(rows, axis=1))
    usual = np.median(steps, axis=1) + _COARSE * np.ptp(rows, axis=1)
    jumps = (steps > _JUMP * usual[:, None]).any(axis=0)
    return np.append(True, jumps) & np.append(jumps, True)


def _ends(rows: Floats) -> Iterator[_Candidate]:
    """The rows at the beginning and the end of a file, and statistics of the rows between."""
    count = rows.shape[1]
    for ends in range(1, min(_ENDS, count - _FEWEST) + 1):
        for body, places, side in (
            (rows[:, ends:], range(ends), "after"),
            (rows[:, : count - ends], range(count - ends, count), "before"),
        ):
            if np.count_nonzero(np.ptp(body, axis=1)) < 2:
                continue  # repetitions of one point
            for name, statistic in _STATISTICS.items():
                if statistic is np.max and not np.ptp(body, axis=1).all():
                    continue  # at a fixed length, a muscle has its largest force at its largest pressure
                values = statistic(body, axis=1)
                for at in places:
                    yield at, values, f"the {name} of the rows {side} it"


def _of_all_before(rows: Floats) -> Iterator[_Candidate]:
    """Rows that may be the mean of all rows before them."""
    means = np.cumsum(rows, axis=1)[:, :-1] / np.arange(1, rows.shape[1])
    near = np.abs(rows[:, 1:] - means) <= _COARSE * np.ptp(rows, axis=1, keepdims=True)
    for at in np.flatnonzero(near.all(axis=0)):
        if at + 1 >= _FEWEST:
            yield int(at) + 1, means[:, at], "the mean of the rows before it"


def _of_levels(rows: Floats, names: Sequence[str]) -> Iterator[_Candidate]:
    """The first and last row at each pressure or length, and the mean of the others."""
    for name in ("pressure", "contraction", "length", "displacement"):
        if name not in names:
            continue
        values = rows[names.index(name)]
        steps = np.abs(np.diff(values)) > _LEVEL * np.abs(values).max()
        for run in np.split(np.arange(len(values)), np.flatnonzero(steps) + 1):
            if len(run) > _FEWEST:
                text = f"the mean of the other rows of its {name}"
                yield int(run[0]), rows[:, run[1:]].mean(axis=1), text
                yield int(run[-1]), rows[:, run[:-1]].mean(axis=1), text


def _repeated(rows: Floats, at: int) -> bool:
    """True if another row is the same: a repeated point is no summary."""
    near = np.abs(rows - rows[:, [at]]) <= _SAME * np.ptp(rows, axis=1, keepdims=True) + 10.0**-_DECIMALS
    return int(np.count_nonzero(near.all(axis=0))) > 1


def _equal(rows: Floats, at: int, values: Floats) -> bool:
    """True if a row has these values, rounded to its own decimals; constant columns say nothing."""
    varied = 0
    for column, value in zip(rows, values, strict=True):
        spread, number = float(np.ptp(column)), float(column[at])
        decimals = len(f"{number:.{_DECIMALS}f}".rstrip("0").partition(".")[2])
        rounding = min(0.5001 * 10.0**-decimals, _COARSE * spread) + 10.0**-_DECIMALS
        if not abs(number - value) <= rounding:
            return False
        varied += spread > 10 * rounding
    return varied > 1


def integer_rows(columns: Mapping[str, tuple[Floats, float]]) -> Iterator[tuple[int, bool]]:
    """Rows of integers that may be no points, far from those next to them; and whether they certainly are none.

    Certain are channel numbers 1, 2, 3 in the first row; and full scales, the largest of all columns before the first
    point or after the last, as a muscle pulls least where it is shortest. Others are a single 0, 0, 0 between points
    under pressure, and one or two rows in a file of decimals. `columns` as for `summaries`.
    """
    rows = np.stack([values / factor for values, factor in columns.values()]).round(_DECIMALS)
    count = rows.shape[1]
    if count <= _FEWEST:
        return
    whole, outermost = rows % 1 == 0, np.arange(count) % (count - 1) == 0
    rest = (rows == 0).all(axis=0)
    integers = whole.all(axis=0) & ~(outermost & rest)
    shares = (whole.sum(axis=1) - integers.sum() + 1) / (count + 2)
    rare = integers & (0 < integers.sum() <= 2) & (count * np.prod(shares) < _BY_CHANCE)
    numbers = (np.diff(rows, axis=0) == 1).all(axis=0) & (rows[0] == 1) & (np.arange(count) == 0)
    scales = integers & outermost & (rows == rows.max(axis=1, keepdims=True)).all(axis=0) & ("contraction" in columns)
    restart = rest & ~outermost & (np.count_nonzero(rows[0] == 0) == 1)
    found = _apart(rows) & (rare | numbers | scales | restart)
    yield from ((int(row), bool((numbers | scales)[row])) for row in np.flatnonzero(found))


def _words_among_numbers(counts: Mapping[str, int]) -> set[str]:
    """Words in a few rows of a column of numbers."""
    words = {text for text in counts if _is_word(text)}
    numbers = {text for text in counts.keys() - words if text.strip()}
    few = sum(map(counts.__getitem__, words)) <= _FEW * sum(map(counts.__getitem__, numbers))
    return words if few and len(numbers) >= _FEWEST else set()


def _is_word(text: str) -> bool:
    try:
        float(text.replace(",", "."))  # also of nan and inf
    except ValueError:
        return bool(_WORD.search(text)) and text.strip().lower() not in _NO_VALUE
    return False


def invalid_rows(channels: Sequence[RawColumn], unit: str) -> tuple[dict[int, str], list[str]]:
    """Lines that a column which is not read marks as invalid, with the mark; and warnings of other states."""
    lines: dict[int, str] = {}
    warnings = []
    for channel in channels:
        status, cells = is_status(channel.label), channel.cells
        if isinstance(cells, np.ndarray):
            if not status or len(np.unique(cells)) > _VALUES:
                continue
            cells = [f"{value:g}" for value in cells]
        counts = Counter(cells)
        words = {text: _words(text) for text in counts}
        begin = {text: _words(re.split("[,;]", text, maxsplit=1)[0]) for text in counts}  # outlier, to be repeated
        invalid = {text for text, found in begin.items() if found and found <= _INVALID}
        summary = {text for text, found in begin.items() if found and found <= _SUMMARY}
        if all(not text.strip() or _NUMBER.fullmatch(text.strip()) for text in counts.keys() - invalid - summary):
            invalid |= summary  # in a column of numbers, such as of runs
        invalid |= _false(channel.label, [*counts])
        if invalid and 2 * sum(map(counts.__getitem__, invalid)) < len(cells):
            for line, text in zip(channel.lines, cells, strict=True):
                if text in invalid:
                    lines[line] = f"is marked as {text.strip()[:_LONGEST]!r} by {channel.name!r}"
            continue
        marked = invalid or {text for text, found in words.items() if not found.isdisjoint(_INVALID)}
        marked = marked or summary or _words_among_numbers(counts)
        if not marked and status and 1 < len(counts) < max(len(cells) / 2, _FEWEST):
            marked = {*counts} - {counts.most_common(1)[0][0]}
        if marked:
            first = next(line for line, text in zip(channel.lines, cells, strict=True) if text in marked)
            shown = [repr(text.strip()[:_LONGEST]) for text in counts if text in marked]
            warnings.append(
                f"{channel.name!r} is not read, and {sum(map(counts.__getitem__, marked))} of {len(cells)} rows have "
                f"{', '.join(shown[:_SHOWN])}{' ...' if len(shown) > _SHOWN else ''}, first {unit} {first}; leave out "
                "the rows that it marks as invalid"
            )
    return lines, warnings


def several_specimens(channels: Sequence[RawColumn]) -> Iterator[str]:
    """Warnings of columns that are not read and name more than one muscle."""
    for channel in channels:
        words = _words(channel.label)
        if words.isdisjoint(_SPECIMEN) or not words <= _SPECIMEN | _NAME:
            continue
        names = [name for name in Counter(str(cell).strip() for cell in channel.cells) if name]
        if 1 < len(names) <= len(channel.cells) / _FEWEST:
            shown = f"{', '.join(map(repr, names[:_SHOWN]))}{' ...' if len(names) > _SHOWN else ''}"
            yield f"{channel.name!r} is not read, and names {shown}: rows of several muscles are one; read them apart"


def drifting_temperatures(channels: Sequence[RawColumn]) -> Iterator[str]:
    """Warn of recorded temperatures that drift: the rubber and the zero of a load cell change with them."""
    for channel in channels:
        if (unit := _TEMPERATURE.search(f"{channel.label} {channel.unit}")) is None:
            continue
        try:
            values = np.asarray(channel.cells, float)
        except ValueError:
            continue
        low, high = np.nanquantile(values, (0.01, 0.99)) if np.isfinite(values).any() else (0.0, 0.0)
        drift = float(high - low) * (5 / 9 if (unit[1] or unit[2]).lower().startswith("f") else 1.0)
        if drift > _WARMING:
            yield (
                f"{channel.name!r} drifts by {drift:.2g} K, which changes the rubber and the zero of the load cell; "
                "let the muscle and the rig reach one temperature before the test"
            )


_OF_NUMBERS = frozenset("0123456789+-.,") | {""}


def labelled_summaries(channels: Sequence[RawColumn]) -> dict[int, str]:
    """Lines with a word such as mean in place of a number, and the word."""
    return {
        channel.lines[row]: f"has {cell.strip()[:_LONGEST]!r} in place of a number: it is not a measurement"
        for channel in channels
        if not isinstance(channel.cells, np.ndarray)
        for row, cell in enumerate(channel.cells)
        if cell[:1] not in _OF_NUMBERS and cell.strip().rstrip(":=").lower() in _SUMMARY
    }


def _false(name: str, texts: Sequence[str]) -> set[str]:
    """Value of invalid rows in a column of two truth values, by its name; empty in other columns."""
    truth = {_TRUTH.get(text.strip().lower()): text for text in texts}
    if len(texts) != 2 or truth.keys() != {True, False}:
        return set()
    words = _words(name)
    if not words.isdisjoint(_NEGATIONS):
        return set()  # which of both is valid is not certain: a warning
    if not words.isdisjoint(_GOOD):
        return {truth[False]}
    return set() if words.isdisjoint(_BAD) else {truth[True]}


def is_status(name: str) -> bool:
    """True for a name of a column of states, such as valid or error code."""
    return not _STATUS.isdisjoint(_words(name))


def _words(text: str) -> set[str]:
    return set(_WORD.findall(text[:_LONGEST].lower()))
