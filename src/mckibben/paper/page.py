"""HTML pages: templates, embedded figures, the report of the paper.

A page is one file, with figures as data URIs; it needs neither a network nor JavaScript.
"""

from __future__ import annotations

import base64
import os
import re
from importlib import resources
from pathlib import Path

import jinja2
import markupsafe

from mckibben import catalog
from mckibben.errors import printable
from mckibben.identification import Fit
from mckibben.paper import Reproduction, file_stem, tables
from mckibben.paper.figures import ReportFigure, figures
from mckibben.paper.settings import PRE_CONTRACTED, StiffnessReference
from mckibben.paper.tables import SECTIONS, name_of
from mckibben.paper.tracking import PID
from mckibben.report.style import save
from mckibben.result import Severity
from mckibben.storage.files import atomic_write, make_folder

_LARGEST_SVG = 400_000  # bytes; a larger drawing is embedded as PNG


EmbeddedFigure = tuple[ReportFigure, str]
"""Figure of a page, and its image as a data URI."""


def _template() -> jinja2.Template:
    """Template of the page, with autoescaping; an undefined name is an error.

    Control characters in texts, which may come from a user's files, are escaped.
    """
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_resource),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=lambda value: printable(value) if type(value) is str else value,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = typeset
    return environment.get_template("report.html.jinja")


def typeset(text: str) -> markupsafe.Markup:
    """HTML of a text, with typographic powers of ten, signs, ranges and units.

    Examples
    --------
    >>> print(typeset("-3.2 +- 0.1 N*m/rad, 1.5·10^-4 <b>"))
    −3.2 ± 0.1 N·m/rad, 1.5·10<sup>−4</sup> &lt;b&gt;
    """
    safe = str(markupsafe.escape(printable(text) if type(text) is str else text))
    safe = re.sub(r"\^([−-]?\d+)", r"<sup>\1</sup>", safe)
    safe = re.sub(r"\bK_(min|max)\b", r"<em>K</em><sub>\1</sub>", safe)
    safe = safe.replace("+-", "±").replace("N*m/rad", "N·m/rad").replace(" %", "\u00a0%")
    safe = re.sub(r"(\d)\.\.(−?\d|-)", r"\1 to \2", safe)
    safe = re.sub(r"(?<![\w.])-(?=\d)", "−", safe)
    return markupsafe.Markup(safe)


def address_of(png: Path, svg: Path) -> str:
    """Data URI of a saved figure: the SVG if it exists and has at most 400 kB, else the PNG."""
    kind, path = ("svg+xml", svg) if svg.is_file() and svg.stat().st_size <= _LARGEST_SVG else ("png", png)
    return f"data:image/{kind};base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"


def _resource(name: str) -> str:
    return (resources.files("mckibben.paper") / name).read_text(encoding="utf-8")


SOURCES = ("lei-mas-10-180n", "dmsp-10-250-martens2017", "festo-tool-10mm")
_PAGE = "report.html"


def write_report(reproduction: Reproduction, folder: str | os.PathLike[str]) -> Path:
    """Write the report of the paper and its figures.

    Parameters
    ----------
    reproduction
        Results of `mckibben.paper.reproduce`.
    folder
        Folder of `report.html`, and of `figures/` with PNG and SVG of each figure; existing files are replaced.

    Returns
    -------
    Path
        Path of the page, whose figures are embedded.
    """
    folder = Path(folder)
    drawn: dict[str, list[EmbeddedFigure]] = {section: [] for section in SECTIONS}
    for figure in figures(reproduction):
        drawn[figure.section].append(embedded(figure, folder, preview=reproduction.quick))
    with atomic_write(folder / _PAGE, overwrite=True) as temporary:
        temporary.write_text(render(reproduction, drawn), encoding="utf-8")
    return folder / _PAGE


def embedded(figure: ReportFigure, folder: Path, *, preview: bool = False) -> EmbeddedFigure:
    """A figure with its data URI, after saving it in `figures/` of a folder; a preview as PNG with 100 dpi only."""
    if figure.figure is None:
        schematic = make_folder(folder / "figures") / f"{figure.name}.svg"
        schematic.write_text(_resource(schematic.name), encoding="utf-8")
        return figure, address_of(schematic, schematic)
    return figure, address_of(*save(figure.figure, folder / "figures", figure.name, preview=preview))


def render(reproduction: Reproduction, drawn: dict[str, list[EmbeddedFigure]]) -> str:
    """HTML text of the report of the paper; `drawn` has the figures by section, a key of `SECTIONS`."""
    results = reproduction.numbers()
    example = reproduction.tracking.runs[PRE_CONTRACTED.key, StiffnessReference.STEP, PID].scenario
    return _template().render(
        style=markupsafe.Markup(_resource("report.css")),
        results=results,
        seconds=reproduction.seconds,
        claims=reproduction.paper_claims,
        questions=reproduction.questions,
        verdict=reproduction.verdict(),
        sections=SECTIONS,
        figures=drawn,
        fit=tables.fit_table(results),
        parameters=(parameters := tables.parameter_table(results)),
        published={row[0].split()[0]: row[1] for row in parameters.rows},
        hardware=tables.HARDWARE,
        warnings={name_of(n): _warnings(fit) for n, fit in reproduction.identification.fits.items()},
        validation=tables.validation_tables(results),
        joint=tables.joint_table(results),
        tracking=tables.tracking_tables(results),
        gains=tables.gains_table(reproduction, results),
        coupling=tables.coupling_table(results),
        settings=tables.settings_table(reproduction),
        decisions=tables.decision_context(reproduction),
        sources=[_source(name) for name in SOURCES],
        example=example.dumps(),
        scenarios=[f"scenarios/{file_stem(*key)}.yaml" for key in reproduction.tracking.runs],
    )


def _warnings(fit: Fit) -> list[str]:
    """Texts of the warnings of a fit, without their remedies."""
    return [note.text for note in fit.notes if note.severity is not Severity.NOTE]


def _source(name: str) -> tuple[str, str, list[str]]:
    """Reference, location and notes of a source."""
    reference, where, *notes = catalog.cite(name).splitlines()
    return reference, where.strip("()"), [note.removeprefix("- ") for note in notes]
