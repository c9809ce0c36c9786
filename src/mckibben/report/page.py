"""What pages share: the template engine, the style, and figures as data addresses. They need no other file."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import jinja2
import markupsafe

from mckibben.report.figures import ReportFigure

_LARGEST_SVG = 400_000  # bytes; a larger drawing is embedded as PNG


@dataclass(frozen=True)
class EmbeddedFigure:
    """A figure of the page: its words, and the picture as a data address."""

    drawn: ReportFigure
    address: str


def template_of(name: str) -> jinja2.Template:
    """A template of this package; what it is given is escaped, and a name that it is not given is an error."""
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_resource),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = typeset
    return environment.get_template(name)


def style_sheet() -> markupsafe.Markup:
    """The style of all pages."""
    return markupsafe.Markup(_resource("report.css"))


def typeset(text: str) -> markupsafe.Markup:
    """Text with powers of ten as superscripts, +- as one sign, units with a dot, and files of figures as code."""
    safe = str(markupsafe.escape(text))
    safe = re.sub(r"\^([−-]?\d+)", r"<sup>\1</sup>", safe)
    safe = safe.replace("+-", "±").replace("N*m/rad", "N·m/rad").replace(" %", "\u00a0%")
    safe = re.sub(r"(\d)\.\.(−?\d|-)", r"\1 to \2", safe)
    safe = re.sub(r"(?<![\w.])-(?=\d)", "−", safe)
    return markupsafe.Markup(safe)


def address_of(png: Path, svg: Path) -> str:
    """A figure that was saved, as an address that holds all of it."""
    kind, path = ("svg+xml", svg) if svg.is_file() and svg.stat().st_size <= _LARGEST_SVG else ("png", png)
    return f"data:image/{kind};base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"


def _resource(name: str) -> str:
    return (resources.files("mckibben.report") / name).read_text(encoding="utf-8")
