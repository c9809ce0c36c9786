"""The page: complete, alone, and of the same numbers as results.json."""

import html
import re

import pytest

from mckibben.paper.page import SOURCES, typeset
from mckibben.paper.tables import NAMES, number, with_error

pytestmark = pytest.mark.slow  # they need the whole reproduction


@pytest.fixture(scope="module")
def text(page):
    return (page / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def parsed(text, page_of):
    return page_of(text)


def plain(text):
    return " ".join(html.unescape(re.sub(r"<[^>]+>", "", text)).split())


def test_the_page_is_whole_and_needs_nothing_else(parsed, text):
    assert parsed.open == []
    found = [attributes["id"] for _, attributes in parsed.tags if "id" in attributes]
    assert len(found) == len(set(found))
    assert {a["href"][1:] for tag, a in parsed.tags if tag == "a"} <= set(found)
    assert parsed.is_self_contained and "@import" not in text and "url(" not in text
    assert len(text.encode()) < 8e6


def test_pictures_have_a_text_and_a_file_and_tables_a_caption_and_heads(parsed, drawn, page, reproduction):
    pictures = [attributes for tag, attributes in parsed.tags if tag == "img"]
    count = [tag for tag, _ in parsed.tags].count
    assert len(pictures) == count("figcaption") == len(drawn)
    assert all(len(picture["alt"]) > 30 for picture in pictures)
    assert count("table") == count("caption") == count("thead") > 8
    assert reproduction.quick  # then there is no SVG; `save` has a test of its own
    for name, figure in drawn.items():
        kinds = ("svg", "png") if figure.figure is None else ("png", "svg")  # a schematic is kept as SVG
        assert (page / "figures" / f"{name}.{kinds[0]}").stat().st_size > 5000
        assert not (page / "figures" / f"{name}.{kinds[1]}").exists()
    assert [tag for tag, _ in parsed.tags].count("math") == 8  # Eqs. 1 to 8
    assert "command line" not in (page / "report.html").read_text(encoding="utf-8")
    assert not list(page.glob(".*"))


def test_every_claim_dataset_source_and_decision_is_there(text, reproduction):
    words = plain(text)
    for claim in reproduction.claims:
        assert plain(str(typeset(claim.claim))) in words
        assert plain(str(typeset(claim.evidence))) in words
    assert plain(reproduction.verdict()) in words
    assert words.count("✗ does not hold") == sum(not claim.holds for claim in reproduction.claims)
    for name in reproduction.identification.fits:
        assert NAMES[name] in words
    assert text.count("<div><dt>") - text.count('<dl class="facts">') * 4 == 12
    assert len(SOURCES) == 3


def test_the_numbers_are_those_of_the_results(parsed, reproduction):
    results, cells = reproduction.numbers(), set(parsed.cells)
    for fit in results["identification"].values():
        assert number(fit["rmse_N"]) in cells
        assert number(fit["decay_per_percent"], 4) in cells
        for found in fit["parameters"].values():
            assert with_error(found["estimate"], found["standard_error"]) in cells
    for laws in results["validation"]["measured_rmse_N"].values():
        assert {number(value["all"]) for value in laws.values()} <= cells
    for joint in results["joint"].values():
        assert {number(value) for value in joint["static_range_deg"]} <= cells
    for wishes in results["tracking"].values():
        for controllers in wishes.values():
            for run in controllers.values():
                worst = f" ({number(run['worst']['angle_rmse_deg'])})" if "worst" in run else ""
                assert number(run["angle_rmse_deg"]) + worst in cells
    for tuned in results["tuning"].values():
        assert number(tuned["position"]["ki"] / 1e5) in cells


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0, "0"), (-12.345, "−12.3"), (1659.0, "1659"), (3.3e-14, "3.30·10^-14"), (None, "–"), (float("nan"), "–"),
     (3182, "3,182"), (0.0043, "0.00430")],
)  # fmt: skip
def test_numbers_as_text(value, shown):
    assert number(value).replace("−14", "-14") == shown


def test_markup_in_texts_is_shown_and_not_obeyed():
    assert "<b>" not in typeset("<b>bold</b> 10^-3 +-12")
    assert typeset("10^-3") == "10<sup>−3</sup>"
    assert "±12" in typeset("+-12 N")
