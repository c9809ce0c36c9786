"""Display in notebooks: progress bar, figures and components."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread

from mckibben import IdealValve, JointPlant, catalog, rank, report
from mckibben.dataset import Recording
from mckibben.export import Exported
from mckibben.muscle import ExponentialLaw, ReynoldsLaw
from mckibben.notebook import notebook_progress
from mckibben.simulation import Batch, Feasibility, Margins
from mckibben.simulation.result import UnknownMetricError
from mckibben.units import deg


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


def test_a_figure_is_an_image_without_pyplot(tmp_path):
    figure = report.isobaric(catalog.dataset("dmsp-10-250-martens2017"))
    path = tmp_path / "figure.png"
    path.write_bytes(figure._repr_png_())
    assert imread(path).shape[:2] == tuple(round(float(each) * figure.dpi) for each in figure.get_size_inches()[::-1])


def test_components_show_their_fields_in_the_units_of_files():
    joint = catalog.joint("knee-table-2")
    plant = JointPlant(joint, catalog.load("knee-table-2"), IdealValve())
    assert "<td>joint_radius</td><td>30 mm</td>" in joint.geometry._repr_html_()
    assert "<td>hanging_angle</td><td>30 deg</td>" in plant.load._repr_html_()
    assert "<td>initial_diameter</td><td>10 mm</td>" in joint.muscle1.specimen._repr_html_()
    assert "<td>decay</td><td>0.3 1/percent</td>" in joint.muscle1.law._repr_html_()
    assert "<td>muscle1.law.a2</td><td>109 N/bar</td>" in joint._repr_html_()
    assert "<td>valve</td><td>IdealValve</td>" in plant._repr_html_()


def test_a_recording_shows_what_it_has_over_time():
    time = np.arange(0.0, 4.0, 0.1)
    still = Recording.of(time=time, pressure=1e5 + 1e4 * time, force=10 * time)
    moved = Recording.of(time=time, pressure=1e5 + 1e4 * time, force=10 * time, contraction=time / 40, set_pressure=2e5)
    labels = [[axes.get_ylabel() for axes in one.plot().axes] for one in (still, moved)]
    assert labels == [["pressure [bar]", "force [N]"], ["pressure [bar]", "force [N]", "contraction [%]"]]


def test_feasibility_margins_and_exported_files_have_a_view():
    """Margins and files are made up; the reference asks for more than 12 N*m/rad at its end."""
    times = np.linspace(0.0, 1.0, 11)
    reach = Feasibility(times, 10 * deg * times, 11 + 2 * times, np.full(11, 9.0), np.full(11, 12.0))
    html = reach._repr_html_()
    assert "<td>desired stiffness</td><td>11</td><td>13</td><td>N*m/rad</td>" in html
    (missed,) = [line for line in reach.plot().axes[1].lines if line.get_label() == "not attainable"]
    np.testing.assert_array_equal(np.isfinite(missed.get_ydata()), times > 0.5)

    ones = np.ones((2, 3))
    loci = np.full((2, 3, 2), -0.5 + 0.1j)
    numbers = {"radius": [0.9, 1.1], "gain": [3.0, 0.0], "phase": [0.5, 0.0], "delay": [0.02, 0.0], "disk": [0.7, 0.0]}
    found = Margins(times[:2], *map(np.array, numbers.values()), np.array([1.0, 10.0, 100.0]), ones, loci)
    assert "<td>delay</td><td>0</td><td>10</td><td>ms</td><td>0.1 s</td>" in found._repr_html_()
    assert "unstable at 1 of 2 points, first at 0.1 s" in found._repr_html_()
    assert len(found.plot().axes) == 2

    files = Exported({"a.c": "int a;", "<b>.bin": bytes(2000)}, ("friction",))._repr_html_()
    assert "<td>a.c</td><td>6</td>" in files and "<td>&lt;b&gt;.bin</td><td>2,000</td>" in files
    assert "<p>left out: friction</p>" in files


def test_an_unknown_metric_of_a_batch_is_the_error_of_metrics():
    batch = Batch(xr.Dataset({"angle_rmse": ("run", [0.1, 0.2])}))
    assert batch["angle_rmse"].tolist() == [0.1, 0.2]
    assert "angle_rmse" in batch and "rmse" not in batch and list(batch) == ["angle_rmse"]
    for wrong in (batch, batch.metrics):
        with pytest.raises(UnknownMetricError) as caught:
            wrong["rmse"]
        assert caught.value.value == "rmse" and "angle_rmse" in caught.value.remedy
