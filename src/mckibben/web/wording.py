"""Texts of errors in terms of the pages: their fields and links in place of calls, options and commands."""

from __future__ import annotations

import re

from mckibben.errors import ON_COMMAND_LINE
from mckibben.identification.fitting import WITH_FRICTION
from mckibben.identification.summary import KEEP_OUTLIERS
from mckibben.scenario.parameters import LISTING

_ELSEWHERE = re.compile(ON_COMMAND_LINE)  # remedies name arguments, as fields do, and options
_SETTING = re.compile(r"\b(\w+)=(?=\[?')")  # an argument, which the page has as a line of a recipe
_COLUMNS = re.compile(r"(name (it|them): )?(columns=\{[^}]*\}|--column '.*)")
KEEP, FRICTION = "keep outliers", "friction"  # labels of what stands for arguments
_INSTEAD = {
    KEEP_OUTLIERS: f"to keep such points, tick “{KEEP}”",
    WITH_FRICTION: f"to identify the friction, choose “{FRICTION}: with”",
    "(mk.rank, or --law all)": "(Rank all laws)",
    "--disk-margin": "a disk margin of",
    "--over wider": "wider",
    "--iterations": "iterations",
}
"""Parts of texts that name calls and options, with those for the page."""


def on_page(text: str) -> str:
    """A remedy in terms of the fields of the page.

    Python arguments become fields or lines of a recipe, options of the command line are left out.

    >>> on_page("name it: columns={'p': 'pressure_bar'} (command line: --column 'p=pressure_bar')")
    'choose it above a column'
    """
    for ours, shown in _INSTEAD.items():
        text = text.replace(ours, shown)
    text = re.sub(f"(;? )?{re.escape(LISTING)}", "", text)
    text = _COLUMNS.sub("choose it above a column", _ELSEWHERE.sub("", text))
    return quotes(_SETTING.sub(r"\1: ", text).replace("initial_length", "initial length"))


def quotes(text: str) -> str:
    """A text with the pages in place of commands that read a file, and quotation marks around what is code.

    >>> quotes("change `mass2`")
    'change “mass2”'
    """
    text = text.replace("which `mckibben simulate` reads", "which the page Run reads")
    return re.sub("`([^`]*)`", r"“\1”", text)
