"""What every figure has to have, and what the drawing functions promise."""

import re

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import RangeError
from mckibben.identification import fit_law
from mckibben.muscle import ExponentialLaw
from mckibben.paper.settings import SETTINGS, StiffnessReference
from mckibben.report import isobaric, measured_muscles, save, tracking
from mckibben.report.style import CONTROLLERS, robust_limits

pytestmark = pytest.mark.slow


NAMES = """
    fig2-test-rig fig3-isobaric-curves fig4-law-comparison measured-muscles fig1-leg fig6-knee attainable-stiffness
    torque-stiffness-map fig5-control-loop fig7-control-results-as-printed fig8-errors-as-printed
    fig7-control-results-pre-contracted fig8-errors-pre-contracted controller-comparison bp-gains
""".split()


def panels(figure):
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


def texts(figure):
    legends = figure.legends + [axes.get_legend() for axes in figure.axes if axes.get_legend()]
    return [text.get_text() for legend in legends for text in legend.get_texts()]


def check(figure):
    """Every panel shows something, every axis that has numbers has a name with its unit, names of lines are given."""
    assert isinstance(figure, Figure)
    labels = []
    for axes in panels(figure):
        assert axes.lines or axes.collections or axes.images, "an empty panel"
        labels += [axes.get_xlabel(), axes.get_ylabel()]
        if len({line.get_color() for line in axes.lines if line.get_label()[0] != "_"}) > 1:
            assert texts(figure), "lines without a legend"
    labels = [label for label in labels if label]
    assert labels
    assert all(re.search(r"\[.+\]$", label) for label in labels), labels
    for axes in figure.axes:
        if axes.get_label() == "<colorbar>":
            assert re.search(r"\[.+\]$", axes.get_ylabel())


@pytest.mark.parametrize("name", NAMES)
def test_a_figure_is_complete(drawn, name):
    found = drawn[name]
    assert found.caption and found.alternative
    (number,) = re.findall(r"^Fig. (A?\d): ", found.title)
    assert [other.title.split(":")[0] for other in drawn.values()].count(f"Fig. {number}") == 1
    if found.figure is not None:
        assert found.figure.get_figwidth() <= 7.5
        if name != "fig6-knee":  # a drawing without scales
            check(found.figure)


def test_a_users_settings_do_not_change_the_house_style(reproduction, tmp_path):
    result = next(iter(reproduction.tracking.runs.values())).result
    plain = save(tracking({"PID": result}), tmp_path / "a", "same")
    with mpl.rc_context({"font.size": 30, "axes.grid": False, "svg.hashsalt": "mine"}):
        other = save(tracking({"PID": result}), tmp_path / "b", "same")
    assert [p.read_bytes() for p in plain] == [p.read_bytes() for p in other]


def test_svg_files_are_self_contained_and_have_no_date(drawn, tmp_path):
    _, svg = save(drawn["bp-gains"].figure, tmp_path, "gains")
    text = svg.read_text()
    assert "<dc:date>" not in text
    assert "<text" not in text  # letters are outlines
    assert not re.search(r"(?:xlink:)?href=\"(?!#)", text)


def test_any_number_of_results_of_one_reference_can_be_drawn(reproduction):
    runs = reproduction.tracking.runs
    key = SETTINGS[1].key
    one = tracking({"mine": runs[key, StiffnessReference.STEP, "PID"].result})
    check(one)
    assert "pressure [bar]" in [axes.get_ylabel() for axes in one.axes]
    many = tracking({name: runs[key, StiffnessReference.STEP, name].result for name in CONTROLLERS})
    check(many)
    assert set(texts(many)) >= {"desired", "attainable at the desired angle", *CONTROLLERS}


def test_results_of_different_references_are_refused(reproduction):
    runs = reproduction.tracking.runs
    first, second = (runs[SETTINGS[0].key, wish, "PID"].result for wish in StiffnessReference)
    with pytest.raises(RangeError, match="desired stiffness"):
        tracking({"a": first, "b": second})
    with pytest.raises(RangeError, match="no result"):
        tracking({})


@pytest.mark.parametrize("name", ["dmsp-10-250-martens2017", "festo-tool-10mm"])
def test_a_dataset_is_drawn_with_and_without_a_fit(name):
    data = catalog.dataset(name)
    alone, fitted = isobaric(data), isobaric(data, fit_law(ExponentialLaw, data))
    check(alone)
    check(fitted)
    assert len(panels(fitted)) == len(panels(alone)) + 1
    assert "fitted Eq. 2" in texts(fitted)


def test_a_dataset_of_one_pressure_or_of_many_measured_ones_is_drawn():
    rng = np.random.default_rng(1)
    eps = np.linspace(0, 0.2, 60)
    for pressure in (np.full(60, 3e5), rng.uniform(1e5, 5e5, 60)):
        force = np.asarray(catalog.law("lei-mas-10-180n").force(eps, pressure)).clip(0)
        check(isobaric(IsobaricDataset.of(pressure=pressure, contraction=eps, force=force)))


def test_a_spike_does_not_set_the_limits_but_is_said(reproduction):
    low, high = robust_limits([np.append(np.sin(np.linspace(0, 6, 999)), 50.0)])
    assert -1.5 < low < -1 < 1 < high < 1.5
    assert robust_limits([np.array([np.nan])]) == (0.0, 1.0)


def test_off_scale_values_are_written_into_the_panel(drawn):
    axes = drawn["fig8-errors-pre-contracted"].figure.axes
    notes = [text.get_text() for a in axes for text in a.texts if text.get_text().startswith("off scale")]
    assert any("at 5.00 s" in note for note in notes)


def test_names_are_text_and_not_mathematics(reproduction, tmp_path):
    names = r"gain $\kp$", "$", "_hidden", "50 $ and 60 $", "\N{GRINNING FACE}", "^_{", "a\nb"
    result = next(iter(reproduction.tracking.runs.values())).result
    figure = tracking(dict.fromkeys(names, result))
    assert set(names) <= set(texts(figure))
    data, name = catalog.dataset("festo-tool-10mm"), " ".join(names)
    titled = isobaric(IsobaricDataset(data.table.assign_attrs(specimen=name)))
    assert titled.axes[0].get_title(loc="left") == name
    fits = measured_muscles(dict.fromkeys(names, (data, None)))
    for drawn in (figure, titled, fits):
        assert save(drawn, tmp_path, "odd", preview=True)[0].stat().st_size > 5000
