"""Words beside a table, in every format: those after which its numbers may not be what its headers say."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence

from mckibben.dataset.vocabulary import canonical_unit, dimension_of

_CHANGES = re.compile(
    r"""(?<![a-z])(?:
    gains?\b | amplif | verst[äa]rk | multipl | divid | geteilt | scal(?:e|ing) | skal | factor | faktor
    | convers | convert | umrechn | umgerech | offset | bias | zero(?:ed|ing)? | null(?:punkt|abgleich|ung)
    | tar(?:e|ed|a|iert)\b | subtract | abgezogen | correct | korrig | calib | kalib | cal\b | sensitiv | empfind
    | (?:per|/)\ ?(?:digit|count|bit|lsb) | raw\b(?!\ data$) | counts?\b | digits?\b | lsb | excit | lever | hebel
    | slope | intercept | absolut | abs\b | atmosph | barom | vacuum | relative\ to | referred | instead | actually
    | swapped | exchanged | vertauscht | invert | revers | negative | wrong | falsch | fault | defekt | invalid
    | ung[üu]ltig | broken | slipp | replaced | changed | switched | gewechselt | in\ parallel | both\ muscles
    | (?:two|three|four|zwei|[2-9])\ (?:muscles|muskeln|actuators) | (?:two|zwei)\b | half\b | halb | twice | doppelt
    | fitting | stretch | nominal | preload | vorlast | not\ (?:tared|zeroed|calibrated) | untared | uncalib | estimat
    | satur | overload | ignore | exclude | discard | mv/v | v/n | n/v | true\b | real\b | unsure | check\b | todo
    | summe?\b | muscle\ (?:[b-h]|[2-9])\b | delay | lag\b | shift
    ) | (?:^|[\s=])[x×*]\ ?\d | \d\s[x×*]\s | \b(?:mean|average|mittel)\b""",
    re.IGNORECASE | re.VERBOSE,
)
_QUANTITY = re.compile(
    r"(?<![a-z])(?:forces?|loads?|pressures?|contractions?|lengths?|displacements?|units?|readings?|muscles?|kr[äa]fte?|dr[uü]cke?|"
    r"kontraktion|verk[uü]rzung|l[äa]ngen?|weg|einheiten?|muskel[n]?|[Fp](?=_| ?[=\[(]))(?![a-z])",
    re.IGNORECASE,
)
_OF_UNIT = re.compile(r"(?<![a-z])(?:units?|einheit(?:en)?)\b[\s:;,=]*(.+)", re.IGNORECASE)
_UNIT = re.compile(r"(?<![\w.])([A-Za-z%][A-Za-z0-9/^²%]{0,8})(?![\w])")
_NUMBER_BEFORE = re.compile(r"\d\s*$")
_LONGEST = 400  # characters


def doubtful_words(words: Sequence[tuple[int | None, str]], units: Collection[str]) -> Iterator[tuple[int | None, str]]:
    """Texts beside a table that may change the meaning of its numbers, each with its line.

    Parameters
    ----------
    words
        Line, or None, and text.
    units
        Units of the columns that are read: a text that names them alone says nothing new.

    Examples
    --------
    >>> list(doubtful_words([(1, "Tare force 15 N"), (2, "Rig 3"), (3, "all forces in daN")], ["N", "bar"]))
    [(1, 'Tare force 15 N'), (3, 'all forces in daN')]
    """
    for line, text in words:
        short = text[:_LONGEST]
        said = _OF_UNIT.search(short)
        changes = _CHANGES.search(short) and not _dated(short)
        other = (said and _contradicts(said[1], units)) or any(
            _is_other_unit(short, match, units) for match in _UNIT.finditer(short)
        )
        if changes or other:
            yield line, short


def _contradicts(text: str, units: Collection[str]) -> bool:
    """Whether a text names units, none of which is that of a column."""
    named = [canonical_unit(word, dimension_of(word)) for word in re.split(r"[\s,;]+", text) if dimension_of(word)]
    return bool(named) and not any(unit in units for unit in named)


def _dated(text: str) -> bool:
    """Whether a text is only the date of a calibration or correction."""
    return bool(re.match(r"(?:last )?(?:calib|kalib)\w* ?(?:date|datum|due)", text, re.IGNORECASE))


def _is_other_unit(text: str, match: re.Match[str], units: Collection[str]) -> bool:
    """Whether a word is a unit of pressure, force or length, has no number before it, and is of no column."""
    word = match[1]
    quantity = dimension_of(word)
    if quantity not in ("pressure", "force", "length", "contraction") or word in (
        "p",
        "P",
        "m",
        "g",
        "in",
        "at",
        "1",
        "-",
    ):
        return False
    if _NUMBER_BEFORE.search(text[: match.start()]) and not _QUANTITY.search(text):
        return False
    return canonical_unit(word, quantity) not in units
