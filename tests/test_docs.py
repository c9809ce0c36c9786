"""The YAML of the documentation is read.

A block whose keys are those of a scenario replaces these sections of the first scenario of docs/scenarios.md, as do the
keys below `joint`. Other blocks, those with an ellipsis (``...``), and those with classes of the page itself are YAML.
"""

import re
from pathlib import Path

import pytest

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


def in_whole(data: dict) -> Scenario:
    """The whole scenario with other sections."""
    joint = {**WHOLE["joint"], **data.get("joint", {})}
    if "muscle1" in joint:
        del joint["muscle"]
    return Scenario.parse(to_text({**WHOLE, **data, "joint": joint}), folder=DOCS.parent / "examples" / "your-muscle")


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
