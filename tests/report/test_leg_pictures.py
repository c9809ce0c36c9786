"""Animation and player of a run of a leg."""

import copy
import dataclasses
import json
import re
import shutil
import subprocess
from pathlib import Path
from runpy import run_path

import equinox as eqx
import mujoco
import numpy as np
import pytest
from PIL import Image

from mckibben.errors import ExportError, ParameterError
from mckibben.export.leg_mjcf import coordinates, leg_scene
from mckibben.leg import PressureSchedule, simulate_leg
from mckibben.report.leg_animation import render_leg
from mckibben.report.leg_player import leg_player
from mckibben.report.leg_shapes import muscle_shapes, run_posture, skeleton, straight_paths

LEG = run_path(str(Path(__file__).parents[1] / "leg" / "test_mujoco.py"))


@pytest.fixture(scope="module")
def landing():
    """A leg with a hamstring, pulleys, a knee that bends backwards and a pitching trunk, and its landing."""
    return landing_of(LEG["plant_of"]("free"))


def landing_of(plant):
    start, commands = LEG["start_of"](plant, 0.0, -1.5)
    schedule = PressureSchedule(tuple((one,) for one in commands))
    return plant, simulate_leg(plant, schedule, start, duration=0.1, control_period=1e-3, substeps=4)


@pytest.mark.slow
@pytest.mark.parametrize("side", [False, True])
def test_what_is_drawn_is_where_mujoco_has_it(landing, side):
    plant, run = landing_of(LEG["plant_of"]("floating", side=True)) if side else landing
    at = run.to_dataset().isel(time=[0, 40, 99])
    points, paths = skeleton(plant, at), straight_paths(plant, at)
    scene = leg_scene(plant, plant.begin(LEG["start_of"](plant, 0.0, 0.0)[0]))
    expected = {"hip1", "hip2", "knee1", "knee2", "hamstring", *(("side1", "side2") if side else ())}
    assert set(paths) == set(scene.parts) == expected
    assert np.ptp(points[..., 1]) > 0.01 or not side
    model = mujoco.MjModel.from_xml_string(scene.xml)
    data = mujoco.MjData(model)
    for number, position in enumerate(np.stack(coordinates(plant, run_posture(plant, at)), -1)):
        data.qpos[:] = position
        mujoco.mj_forward(model, data)
        for name, parts in scene.parts.items():
            for sites, ends in zip(parts, paths[name], strict=True):
                for site, end in zip(sites, ends[number], strict=True):
                    np.testing.assert_allclose(data.site(site).xpos, end, atol=1e-12)
        np.testing.assert_allclose(data.geom("foot").xpos, points[number, -1], atol=1e-12)


@pytest.mark.slow
def test_muscles_have_the_volume_of_their_contraction(landing):
    plant, run = landing
    shapes = muscle_shapes(plant, run.to_dataset(), 5e5)
    for name, muscle in zip(plant.leg.muscle_names, plant.leg.muscles, strict=True):
        one, contraction = shapes[name], run["contraction"][run.muscles.index(name)]
        volume = np.asarray(muscle.specimen.volume(contraction))
        np.testing.assert_allclose(np.pi / 4 * one.diameter**2 * one.length, volume)
        np.testing.assert_allclose(one.length, 0.18 * (1 - contraction))


def test_a_muscle_of_unknown_volume_is_drawn_slender(landing):
    plant, run = landing
    unknown = dataclasses.replace(plant.leg.joints[0].muscles.muscle1.specimen, braid_angle=None, volume_terms=None)
    plant = eqx.tree_at(lambda x: x.leg.joints[0].muscles.muscle1.specimen, plant, unknown)
    one = muscle_shapes(plant, run.to_dataset(), 5e5)["hip1"]
    np.testing.assert_allclose(one.diameter, 0.07 * one.length)


@pytest.mark.parametrize("suffix", ["webp", "gif"])
@pytest.mark.slow
def test_an_animation_shows_leg_and_curves(suffix, landing, tmp_path):
    plant, run = landing
    try:
        path = render_leg(plant, run, tmp_path / f"landing.{suffix}", frames=3, seconds=0.3)
    except ExportError as error:
        assert error.field == "MUJOCO_GL"
        pytest.skip("no OpenGL without a display")
    image = Image.open(path)
    assert image.n_frames == 3
    pictures = []
    for number in range(3):
        image.seek(number)
        pictures.append(np.asarray(image.convert("RGB"), float))
    leg, curves = np.split(np.array(pictures), [400], axis=2)
    orange = (leg[..., 0] > 150) & (leg[..., 2] < 90)
    assert orange.sum(axis=(1, 2)).min() > 200  # the muscles
    assert np.abs(np.diff(leg, axis=0)).max() > 60  # which move
    assert np.abs(np.diff(curves, axis=0)).max() > 60  # as does the line in the curves


@pytest.mark.slow
def test_what_cannot_be_drawn_is_said(landing, tmp_path, monkeypatch):
    with pytest.raises(ParameterError) as caught:
        render_leg(*landing, tmp_path / "landing.mp4")
    assert caught.value.field == "path"
    monkeypatch.setenv("MUJOCO_GL", "none")
    with pytest.raises(ExportError) as caught:
        render_leg(*landing, tmp_path / "landing.webp", frames=2)
    assert (caught.value.field, caught.value.value) == ("MUJOCO_GL", "none")
    assert not list(tmp_path.iterdir())


def test_the_player_is_self_contained_and_has_the_run(landing):
    plant, run = landing
    half = copy.copy(run)
    half.columns = {name: column[..., :50] for name, column in run.columns.items()}
    html = str(leg_player({"one <b>": landing, "two": (plant, half)}))
    assert "<b>" not in html
    assert not re.search(r"(src|href)=|https?:", html)
    data = json.loads(re.search(r'"leg", (\{.*\})\);', html)[1])
    assert len(data["runs"]) == html.count("<canvas") == 2
    first, rows = data["runs"][0], np.array(data["runs"][0]["rows"]) / data["scale"]
    ends = 6 * sum(one["parts"] for one in first["muscles"])
    assert rows.shape == (100, 3 * first["points"] + ends + 3 * len(first["muscles"]) + 3)
    np.testing.assert_allclose(rows[:, 3:6], np.stack([run[name] for name in ("x", "y", "z")], -1), atol=6e-5)
    assert 'class="turn"' not in html
    force = rows[:, -1] * first["weights"] * float(plant.leg.total_mass * plant.gravity)
    np.testing.assert_allclose(force, run["ground_up"], atol=0.02)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs Chromium")
def test_the_player_draws_in_a_browser(landing, tmp_path):
    move = "const s = document.querySelector('input'); s.value = 500; s.dispatchEvent(new Event('input'));"
    count = (
        "const c = document.querySelector('canvas'), p = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        "let n = 0; for (let k = 0; k < p.length; k += 4) if (p[k] > 180 && p[k + 2] < 60) ++n;"
        "document.title = n + ' ' + s.getAttribute('aria-valuetext');"
    )
    page = tmp_path / "page.html"
    page.write_text(
        f"<!DOCTYPE html><meta charset=utf-8><body>{leg_player({'one': landing})}<script>{move}{count}</script>"
    )
    orange, time, unit = re.search(r"(\d+) (\d+) (ms)", titled(page, tmp_path)).groups()
    assert int(orange) > 200
    assert (time, unit) == ("50", "ms")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs Chromium")
def test_a_leg_in_space_can_be_turned(tmp_path):
    player = leg_player({"one": landing_of(LEG["plant_of"]("floating", side=True))})
    wide = (
        "const c = document.querySelector('canvas'), v = document.querySelector('.turn'), found = [];"
        "for (const angle of [0, 90, -90]) { v.value = angle; v.dispatchEvent(new Event('input'));"
        "const p = c.getContext('2d').getImageData(0, 0, c.width, c.height).data, at = [];"
        "for (let k = 0; k < p.length; k += 4) if (p[k] > 180 && p[k + 2] < 60) at.push(k / 4 % c.width);"
        "found.push(at.reduce((a, b) => a + b) / at.length - c.width / 2); }"
        "document.title = found.map(Math.round).join(' ');"
    )
    page = tmp_path / "page.html"
    page.write_text(f"<!DOCTYPE html><meta charset=utf-8><body>{player}<script>{wide}</script>")
    side, behind, front = map(int, titled(page, tmp_path).split())
    assert behind == pytest.approx(-front, abs=2)  # mirrored
    assert abs(side - behind) > 3


def titled(page, folder):
    """Title of a page after its scripts."""
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder}", "--dump-dom"]
    shown = subprocess.run([*command, page.as_uri()], capture_output=True, text=True, timeout=60).stdout
    return re.search(r"<title>(.*)</title>", shown)[1]
