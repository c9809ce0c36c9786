"""The YAML of the documentation is read, and its marked numbers are made.

A block whose keys are those of a scenario replaces these sections of the first scenario of docs/scenarios.md, as do the
keys below `joint`. Other blocks, those with an ellipsis (``...``), and those with classes of the page itself are YAML.
"""

import ast
import contextlib
import importlib
import io
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import mckibben as mk
from mckibben import units
from mckibben.config.document import plain, read_document, to_text
from mckibben.scenario import Scenario

DOCS = Path(__file__).parents[1] / "docs"
KEYS = {info.alias or name for name, info in Scenario.model_fields.items()}


def blocks(page: Path) -> list[tuple[int, str]]:
    """Line and text of the YAML blocks of a page."""
    text = page.read_text(encoding="utf-8")
    found = re.finditer(r"^```yaml\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return [(text[: block.start()].count("\n") + 2, block[1]) for block in found]


BLOCKS = {
    f"{page.relative_to(DOCS)}:{line}": text for page in sorted(DOCS.rglob("*.md")) for line, text in blocks(page)
}
WHOLE = plain(read_document(blocks(DOCS / "scenarios.md")[0][1]).data)


AXIS = plain(read_document((DOCS.parent / "examples" / "linear-axis.yaml").read_text(encoding="utf-8")).data)


def in_whole(data: dict) -> Scenario:
    """The whole scenario with other sections, or that of an axis."""
    whole = AXIS if "class: slide" in to_text(data) else WHOLE
    joint = {**whole["joint"], **data.get("joint", {})}
    if "muscle1" in joint:
        joint.pop("muscle", None)
    return Scenario.parse(to_text({**whole, **data, "joint": joint}), folder=DOCS.parent / "examples" / "your-muscle")


@pytest.mark.parametrize("place", BLOCKS)
def test_yaml_of_the_documentation_can_be_read(place):
    text = BLOCKS[place]
    written = re.sub(r"#.*", "", text)
    data = plain(read_document(text).data)
    if "..." in written or not isinstance(data, dict) or not set(data) <= KEYS or place.startswith("extending"):
        return
    scenario = in_whole(data)
    assert scenario.plant() and scenario.control()


def test_force_laws_of_the_documentation_pull_more_at_a_higher_pressure_and_less_when_shorter():
    laws = [text for text in BLOCKS.values() if "class: reynolds" in text]
    assert laws
    for text in laws:
        law = in_whole(plain(read_document(text).data)).joint.muscle2.law
        assert law.force(0.1, 3e5) < law.force(0.0, 3e5) < law.force(0.0, 4e5)


PAGES = [DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as on GitHub and in the site."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    slugs = {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}
    return slugs | set(re.findall(r"^\((.*)\)=$", text, re.MULTILINE))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS.parent)))
def test_links_of_the_documentation_lead_somewhere(page):
    text = re.sub(r"^```.*?^```|`[^`]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for link in re.findall(r"\]\(<?([^)>\s]+)", text):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if ":" in link or "api/" in link or "gallery/" in link:  # elsewhere, or made with the site
            continue
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


# Numbers of a run in the text of a page are marked behind their paragraph or table by a comment,
#     <!-- made: EXPRESSION -->    or    <!-- made within 5 %: EXPRESSION -->
# The text has the numbers that it returns, and the rows that it prints, to its last digit or within the tolerance.
# "made slowly" runs with the slow tests. Expressions know `mk`, `np`, the units, and modules of benchmarks.
MARK = re.compile(r"<!-- made( slowly)?(?: within ([\d.]+) %)?: (.*?) -->", re.DOTALL)
BENCHMARKS = DOCS.parent / "benchmarks"


class Marked(NamedTuple):
    """A text with the expression that makes its numbers, and a relative tolerance."""

    text: str
    expression: str
    tolerance: float


def numbers(text: str) -> list[tuple[float, float]]:
    """Numbers of a text, each with half a unit of its last digit."""
    digits = re.findall(r"(?<!\w)-?(?:\d+,)*\d+(?:\.\d+)?(?:e-?\d+)?", text)
    plain = [number.replace(",", "") for number in digits]
    decimals = [len(number.partition("e")[0].partition(".")[2]) for number in plain]
    powers = [10.0 ** float(number.partition("e")[2] or 0) for number in plain]
    return [(float(n), 0.5001 * 10.0**-d * power) for n, d, power in zip(plain, decimals, powers, strict=True)]


def marks(page: Path) -> list:
    """Parameters of a test: the marked texts of a page, each from the blank line or the mark before it."""
    text, begin, found = page.read_text(encoding="utf-8"), 0, []
    for mark in MARK.finditer(text):
        start = max(begin, text.rstrip().rfind("\n\n", 0, mark.start() - 1))
        slow, percent, expression = mark.groups()
        marked = Marked(text[start : mark.start()], " ".join(expression.split()), float(percent or 0) / 100)
        place = f"{page.relative_to(DOCS.parent)}:{text[: mark.start()].count(chr(10)) + 1}"
        found.append(pytest.param(marked, id=place, marks=[pytest.mark.slow] if slow else []))
        begin = mark.end()
    return found


def known(expression: str) -> dict[str, object]:
    """Names of an expression: `mk`, `np`, units, and modules of benchmarks."""
    names = {node.id for node in ast.walk(ast.parse(expression)) if isinstance(node, ast.Name)}
    benchmarks = {name for name in names if (BENCHMARKS / f"{name}.py").exists()}
    return vars(units) | {"mk": mk, "np": np} | {name: importlib.import_module(name) for name in benchmarks}


@pytest.mark.parametrize("marked", [mark for page in PAGES for mark in marks(page)])
def test_marked_numbers_of_the_documentation_are_made(marked, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        returned = eval(marked.expression, known(marked.expression))

    def agrees(made: float, number: float, digit: float) -> bool:
        return abs(made - number) <= digit + marked.tolerance * abs(made)

    made = [] if returned is None else np.ravel(returned).tolist()
    for value in made:
        assert any(agrees(value, *shown) for shown in numbers(marked.text)), value
    rows = [row for row in map(numbers, printed.getvalue().splitlines()) if row]
    lines = [numbers(line) for line in marked.text.splitlines()]
    for row in rows:
        same = (line for line in lines if len(line) == len(row))
        assert any(all(agrees(value, *shown) for (value, _), shown in zip(row, line, strict=True)) for line in same), (
            row
        )
    assert made or rows


def test_tables_of_results_are_made_or_say_when_they_were():
    for page in (DOCS / "results").glob("*.md"):
        text = page.read_text(encoding="utf-8")
        assert "python benchmarks/" in text or "mckibben compare" in text, page.name
        dated = "Made on 20" in text or "measured with an earlier version" in " ".join(text.split())
        kept = DOCS.parent / "benchmarks" / f"{page.stem}.json"  # answers of which the page is made
        assert marks(page) or dated or kept.exists(), page.name


def test_pages_have_at_most_three_numbers_per_hundred_words():
    """Without code, formulas, tables, years, headings, list items, and references to equations, figures and muscles."""
    for page in [DOCS.parent / "README.md", *DOCS.glob("*.md")]:
        whole = re.sub(r"<!--.*?-->", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        text = re.sub(r"^```.*?^```|\$\$.*?\$\$", "", whole, flags=re.DOTALL | re.MULTILINE)
        text = re.sub(r"^[#|].*$|^ {4}.*$|^\d+\.|`[^`]*`|\$[^$\n]*\$|\]\([^)]*\)", "", text, flags=re.MULTILINE)
        text = re.sub(r"\b(1[89]|20)\d\d\b|(Eqs?\.|Figs?\.|Table|decisions?|muscles?) \d+( (and|to) \d+)?", "", text)
        assert len(numbers(text)) <= 0.03 * len(whole.split()), page.name
