# ruff: noqa: E501 - tables of cases
"""Drawings and animations have the coordinates of the geometry."""

import itertools
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import mckibben as mk
from mckibben.errors import FileError, ParameterError, RangeError, SimulationError
from mckibben.joint import Geometry
from mckibben.joint.linkage import Linkage, muscle_sizes
from mckibben.report import animate, draw_joint
from mckibben.robot import RobotScenario
from mckibben.scenario import run_scenario
from mckibben.units import bar, deg, mm

EXAMPLES = Path(__file__).parents[2] / "examples"
KNEE = mk.KneeGeometry(joint_length=370 * mm, joint_radius=30 * mm, connector_length=208 * mm)
BONES = mk.PairedPaths(
    mk.TwoBonePath(-30 * mm, 162 * mm, -35 * mm, 0.0, connector_length=20 * mm),
    mk.TwoBonePath(30 * mm, 170 * mm, 35 * mm, 0.0, connector_length=10 * mm),
)
PULLEYS = mk.PairedPaths(mk.Pulley(30 * mm, 162 * mm), mk.Pulley(25 * mm, 150 * mm))
CAMS = mk.PairedPaths(mk.Cam(30 * mm, 162 * mm, arm_slope=8 * mm), mk.Cam(30 * mm, 150 * mm, arm_slope=-8 * mm))
ANGLES = [angle * deg for angle in (-40, -20, 0, 20, 40)]
TABLE = mk.TabulatedPath(ANGLES, arms=[arm * mm for arm in (26, 29, 30, 29, 26.5)], rest_length=162 * mm)


class Own(Geometry):
    """A geometry of a user's own: nothing but its path lengths."""

    def path_lengths(self, angle):
        return 0.16 + 0.03 * jnp.sin(angle), 0.16 - 0.03 * jnp.sin(angle)


ALL = {"knee": KNEE, "bones": BONES, "pulleys": PULLEYS, "cams": CAMS, "table": mk.PairedPaths(TABLE, TABLE), "own": Own()}  # fmt: skip


@pytest.mark.parametrize("name", ALL)
def test_the_lines_of_action_are_at_the_moment_arms(name):
    linkage = Linkage(ALL[name])
    for angle in (-30 * deg, 0.0, 25 * deg):
        for strand, arm in zip(linkage.strands(angle), ALL[name].moment_arms(angle), strict=True):
            (x, y), (u, v) = strand.start, (strand.end - strand.start) / strand.length
            assert abs(x * v - y * u) == pytest.approx(float(arm), rel=1e-4)


@pytest.mark.parametrize(("geometry", "connectors"), [(KNEE, (208 * mm, 208 * mm)), (BONES, (20 * mm, 10 * mm))])
def test_straight_muscles_have_the_lengths_of_their_paths(geometry, connectors):
    linkage = Linkage(geometry)
    for angle in ANGLES:
        for strand, connector, path in zip(
            linkage.strands(angle), connectors, geometry.path_lengths(angle), strict=True
        ):
            assert strand.length - connector == pytest.approx(float(path), rel=1e-12)
            first, last = strand.body(float(path))
            assert np.linalg.norm(last - first) == pytest.approx(float(path), rel=1e-12)


def test_the_diameter_is_that_of_a_cylinder_with_the_volume(knee):
    lengths, diameters = muscle_sizes(knee, knee.contractions(0.1, (0.0, 0.0)))
    for length, diameter, path in zip(lengths, diameters, knee.geometry.path_lengths(0.1), strict=True):
        assert length == pytest.approx(float(path))
        volume = knee.muscle1.specimen.volume(1 - length / 0.18)
        assert np.pi / 4 * diameter**2 * length == pytest.approx(float(volume))
    unknown = mk.Muscle(mk.Specimen("own", 180 * mm), mk.catalog.law("lei-mas-10-180n"))
    assert muscle_sizes(mk.AntagonisticJoint(KNEE, unknown, unknown), (0.1, 0.1))[1] == [None, None]


@pytest.mark.parametrize("name", ALL)
def test_every_geometry_is_drawn_alone_and_with_muscles(name, knee):
    (axes,) = draw_joint(ALL[name], 20 * deg).axes
    arms = [float(arm) / mm for arm in ALL[name].moment_arms(20 * deg)]
    assert f"moment arms {arms[0]:.3g} and {arms[1]:.3g} mm" in axes.get_title()
    joint = mk.AntagonisticJoint(ALL[name], knee.muscle1, knee.muscle2)
    figure = draw_joint(joint, 20 * deg, (2 * bar, 4 * bar), labels=False)
    first, second = (patch for patch in figure.axes[0].patches if patch.get_linewidth() == 0.8)
    assert first.get_facecolor() != second.get_facecolor()


def test_a_spring_in_place_of_a_muscle_has_no_body(knee, load):
    joint = mk.AntagonisticJoint(PULLEYS, knee.muscle1, mk.return_spring(4e3, 130 * mm))
    figure = draw_joint(mk.JointPlant(joint, load, mk.IdealValve()), 0.1)
    bodies = [patch for patch in figure.axes[0].patches if patch.get_linewidth() == 0.8]
    assert [body.get_visible() for body in bodies] == [True, False]


def test_a_slide_is_drawn_without_pulleys():
    plant = mk.Scenario.read(EXAMPLES / "linear-axis.yaml").plant()
    (axes,) = draw_joint(plant, 4 * mm).axes
    low, high = axes.get_xlim()
    assert high - low < 0.5 and axes.get_title() == "4 mm"


def test_what_is_no_joint_is_refused():
    with pytest.raises(RangeError):
        draw_joint("knee")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    text = (EXAMPLES / "own-joint.yaml").read_text(encoding="utf-8").replace("duration: 4 s", "duration: 800 ms")
    (folder / "short.yaml").write_text(text, encoding="utf-8")
    return run_scenario(mk.Scenario.read(folder / "short.yaml"))


@pytest.mark.parametrize("suffix", ["webp", "gif"])
@pytest.mark.slow
def test_an_animation_has_a_frame_for_each_twelfth_of_a_second_and_loops(run, tmp_path, suffix):
    if suffix == "gif":  # of a robot
        text = RobotScenario.read(EXAMPLES / "robot" / "lei-leg-control.yaml").dumps()
        run = RobotScenario.parse(text.replace("duration: 4 s", "duration: 0.8 s")).run_once()
    path = animate(run, tmp_path / f"run.{suffix}")
    with Image.open(path) as image:
        assert (image.n_frames, image.size, image.info["loop"]) == (9, (640, 400), 0)
        frames = []
        for index in range(image.n_frames):
            image.seek(index)
            frames.append(np.asarray(image.convert("RGB"), int))
    assert all(np.abs(now - before).max() > 100 for before, now in itertools.pairwise(frames))
    assert path.stat().st_size < 1_000_000
    with pytest.raises(FileError):
        animate(run, path)


@pytest.mark.slow
def test_an_animation_needs_a_known_ending_and_a_joint(run, tmp_path):
    with pytest.raises(ParameterError) as found:
        animate(run, tmp_path / "run.mp4")
    assert (found.value.field, found.value.value) == ("path", ".mp4")
    bare = mk.SimulationResult(dict(run.columns), run.control_period)
    with pytest.raises(SimulationError) as missing:
        animate(bare, tmp_path / "run.gif")
    assert missing.value.field == "plant"
    assert not list(tmp_path.iterdir())
