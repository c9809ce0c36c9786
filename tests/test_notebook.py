"""Display in notebooks: progress bar, figures and components."""

import sys
from types import SimpleNamespace

import pytest

from mckibben import IdealValve, JointPlant, catalog, rank
from mckibben.muscle import ExponentialLaw, ReynoldsLaw
from mckibben.notebook import notebook_progress


class Handle(list):
    """Output of a cell, updated in place."""

    def update(self, shown):
        self.append(shown)


@pytest.fixture
def cell(monkeypatch):
    """Output of a notebook's cell; there is no IPython here but this one."""
    handle = Handle()
    display = SimpleNamespace(HTML=str, display=lambda first, display_id: handle)
    python = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=None), display=display)
    monkeypatch.setitem(sys.modules, "IPython", python)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    return handle


def test_there_is_no_bar_outside_of_a_notebook(monkeypatch):
    assert notebook_progress() is None
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: None))
    assert notebook_progress() is None


def test_the_bar_shows_the_step_as_text_and_is_removed_at_the_end(cell):
    progress = notebook_progress()
    progress("half <b>", 0.5)
    assert "value='0.500'" in cell[0]
    assert "50% half &lt;b&gt;" in cell[0]
    progress("too soon after the last one", 0.6)
    assert len(cell) == 1
    progress("done", 1.0)
    assert cell[1:] == [""]


@pytest.mark.slow
def test_long_computations_show_it_unless_they_are_given_another(cell):
    data, laws = catalog.dataset("dmsp-10-250-martens2017"), (ReynoldsLaw, ExponentialLaw)
    rank(data, laws)
    assert "ReynoldsLaw" in cell[0]
    assert cell[-1] == ""
    cell.clear()
    parts = []
    rank(data, laws, progress=lambda step, part: parts.append(part))
    assert parts == [0.0, 0.5, 1.0]
    assert not cell


def test_components_show_their_fields_in_the_units_of_files():
    joint = catalog.joint("knee-table-2")
    plant = JointPlant(joint, catalog.load("knee-table-2"), IdealValve())
    assert "<td>joint_radius</td><td>30 mm</td>" in joint.geometry._repr_html_()
    assert "<td>hanging_angle</td><td>30 deg</td>" in plant.load._repr_html_()
    assert "<td>initial_diameter</td><td>10 mm</td>" in joint.muscle1.specimen._repr_html_()
    assert "<td>decay</td><td>0.3 1/percent</td>" in joint.muscle1.law._repr_html_()
    assert "<td>muscle1.law.a2</td><td>109 N/bar</td>" in joint._repr_html_()
    assert "<td>valve</td><td>IdealValve</td>" in plant._repr_html_()
