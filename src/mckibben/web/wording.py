"""Texts of errors in terms of the pages: their fields and links in place of calls, options and commands."""

from __future__ import annotations

import re

from mckibben.errors import ON_COMMAND_LINE
from mckibben.identification.fitting import WITH_FRICTION
from mckibben.identification.summary import KEEP_OUTLIERS
from mckibben.scenario.parameters import LISTING

_ELSEWHERE = re.compile(ON_COMMAND_LINE)  # remedies name arguments, as fields do, and options
_ARGUMENTS = re.compile(r"\b(?:initial_length|zero_length|slack_force|largest_force|force_sign|from_name|ambient)\b")
_CHOICES = re.compile(r"\b(\w+)='(\w+)'")  # an argument, which the page has as a select
_PAIR = re.compile(r"'([^']*)': '([^']*)'")
_COLUMNS = re.compile(r"columns=\{('[^}]*')\}")  # an argument, which the page has as lines of a field
KEEP, FRICTION, SKIP = "keep outliers", "friction", "leave out damaged rows"  # labels of what stands for arguments
_INSTEAD = {
    KEEP_OUTLIERS: f"to keep such points, tick “{KEEP}”",
    "accept=['corrupt']": f"tick “{SKIP}”",
    WITH_FRICTION: f"to identify the friction, choose “{FRICTION}: with”",
    "(mk.rank, or --law all)": "(Rank all laws)",
    f"; {LISTING}": "",
    f" {LISTING}": "",
    LISTING: "",
}
"""Parts of texts that name calls and options, with those for the page."""
_READERS = {
    "which `mckibben simulate` reads": "which the page Run reads",
}


def on_page(text: str) -> str:
    """A remedy in terms of the fields of the page."""
    for ours, shown in _INSTEAD.items():
        text = text.replace(ours, shown)
    text = _COLUMNS.sub(lambda found: _PAIR.sub(r"\1 = \2", found[1]) + " (columns)", _ELSEWHERE.sub("", text))
    text = text.replace("columns={...}", "a line HEADER = NAME (columns)")
    text = _CHOICES.sub(r"\1: \2", text)
    return quotes(_ARGUMENTS.sub(lambda found: found[0].replace("_", " "), text))


def quotes(text: str) -> str:
    """A text with the pages in place of commands that read a file, and quotation marks around what is code."""
    for ours, shown in _READERS.items():
        text = text.replace(ours, shown)
    return re.sub("`([^`]*)`", r"“\1”", text)
