"""Words beside a table, in every format: those after which its numbers may not be what its headers say."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence

from mckibben.dataset.vocabulary import VOCABULARY, canonical_unit, dimension_of

_CHANGES = re.compile(VOCABULARY["patterns"]["changes"], re.IGNORECASE | re.VERBOSE)
_QUANTITY = re.compile(
    r"(?<![a-z])(?:forces?|loads?|pressures?|contractions?|lengths?|displacements?|units?|readings?|muscles?|kr[äa]fte?|dr[uü]cke?|"
    r"kontraktion|verk[uü]rzung|l[äa]ngen?|weg|einheiten?|muskel[n]?|[Fp](?=_| ?[=\[(]))(?![a-z])",
    re.IGNORECASE,
)
_AFTER_UNIT = re.compile(r"(?:units?|einheit(?:en)?)[\s:;,=]*$", re.IGNORECASE)
_UNIT = re.compile(r"(?<![\w.])([A-Za-z%][A-Za-z0-9/^²%]{0,8})(?![\w])")
_WORDS = ("p", "P", "m", "g", "in", "at")  # which are units too
_LOADED = re.compile(r"(?<![\w.,-])\d[\d.,]* ?(?:k?g|k?N|lbs?)\b")
_SENSOR = re.compile(r"sensor|cell|range|bereich|aufnehmer|capacity|nennlast|\bmax|typ", re.IGNORECASE)
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
        dated = re.match(r"(?:last )?(?:calib|kalib)\w* ?(?:date|datum|due)", short, re.IGNORECASE)
        loaded = _LOADED.search(short) and not _SENSOR.search(short)
        if (_CHANGES.search(short) and not dated) or loaded or any(other_units(short, units)):
            yield line, short


def other_units(text: str, units: Collection[str]) -> Iterator[tuple[str, str]]:
    """Quantities and units of pressure, force, length or contraction in a text of which no column is.

    >>> list(other_units("all forces in daN, lengths in mm", ["N", "mm"]))
    [('force', 'daN')]
    """
    for match in _UNIT.finditer(text):
        before, quantity = text[: match.start()], dimension_of(match[1])
        if quantity in ("", "time") or (match[1] in _WORDS and not _AFTER_UNIT.search(before)):
            continue
        unit = canonical_unit(match[1], quantity)
        if unit not in units and (not re.search(r"\d\s*$", before) or _QUANTITY.search(text)):
            yield quantity, unit
