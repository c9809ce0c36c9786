"""Raw recordings of the usual tests on the simulated rig: what `points` reads, `identify` survives, and it is right."""

import numpy as np
import pytest

from mckibben import ExponentialLaw, catalog
from mckibben.dataset import IsobaricDataset, Recording, read_dataset
from mckibben.dataset.preprocessing import preprocess, sample_rate
from mckibben.errors import IdentificationError, RangeError
from mckibben.identification import identify_with_friction
from mckibben.rig.document import RigTest
from mckibben.rig.running import check, gather_recording, run_test
from mckibben.units import bar, percent

LAW, FRICTION = catalog.law("lei-mas-10-180n"), 12.0
HEAD = """name: a test
muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
rig: {simulated: {seed: 1, friction: {half_width: 12 N, presliding_length: 0.5 mm}}}
limits: {pressure: 6.5 bar, force: 630 N, stretch: 8 mm, shorten: 50 mm}
recording: {cycle: 20 ms, between: 50 Hz}
protocol:
"""
POINT = "acquisition: 200 ms, samples: 20"
PRESSURES = "pressures: [2 bar, 3 bar, 4 bar, 5 bar]"
STOP_AND_GO = f"""  isobaric: {{{PRESSURES}, contraction_min: 0 %, contraction_max: 12 %, repeats: 1, step: 2 mm,
    speed: 4 mm/s, dwell: 1200 ms, {POINT}}}
"""
STEPS_OF_PRESSURE = f"""  isometric: {{{PRESSURES}, contractions: [0 %, 4 %, 8 %, 12 %, 6 %, 2 %], speed: 4 mm/s,
    dwell: 1200 ms, {POINT}}}
"""
WEIGHTS = f"""  isotonic: {{forces: [50 N, 120 N, 200 N], speed: 4 mm/s, dwell: 500 ms, rate: 0.3 bar/s, {POINT},
    pressures: [2.5 bar, 3 bar, 3.5 bar, 4 bar, 4.5 bar, 5 bar, 5.5 bar, 6 bar]}}
"""


def moves(*steps: str) -> str:
    return "\n    - ".join(["  steps:", *steps, "acquire: {samples: 20, duration: 200 ms}\n"])


def strokes(*speeds: float) -> str:
    """Strokes at four pressures."""
    once = [f"move: {{to: {end} %, speed: {speed} mm/s}}" for speed in speeds for end in (12, 0)]
    return moves(*(step for level in (2, 3, 4, 5) for step in (f"pressurise: {level} bar", "move: 0 %", *once)))


def sweeps() -> str:
    """Pressures up and down at four lengths."""
    once = [f"pressurise: {{pressure: {level} bar, rate: 0.4 bar/s}}" for level in (1.5, 5, 1.5)]
    return moves(*(step for end in (0, 4, 8, 12) for step in ("vent: {}", f"move: {end} %", *once)))


def recorded(protocol: str, folder) -> tuple[IsobaricDataset, Recording]:
    dataset = run_test(check(RigTest.parse(HEAD + protocol)), folder)
    return dataset, gather_recording(folder)


def assert_right(points: IsobaricDataset, *, friction: bool, tolerance: float) -> None:
    """A law within a tolerance [N], and the friction within four standard errors and a tenth."""
    fit = identify_with_friction(ExponentialLaw, points)
    contraction, pressure = np.array([2, 6, 10]) * percent, np.array([3, 4, 4.5]) * bar
    np.testing.assert_allclose(fit.predict(contraction, pressure), LAW.force(contraction, pressure), atol=tolerance)
    assert (fit.hysteresis is not None) == friction
    if fit.hysteresis:
        error = 4 * fit.hysteresis.standard_errors["half_width"]
        assert fit.hysteresis.friction.half_width == pytest.approx(FRICTION, abs=min(max(error, 0.1), 1.2))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("protocol", "friction"),
    [(STOP_AND_GO, True), (STEPS_OF_PRESSURE, False), (strokes(2, 4), True), (sweeps(), False)],
)
def test_what_the_rig_records_is_identified(protocol, friction, tmp_path):
    """As the plateaus of the recording and as its samples, of which some are lost."""
    _, recording = recorded(protocol, tmp_path)
    rests = protocol in (STOP_AND_GO, STEPS_OF_PRESSURE)
    if rests:
        assert_right(recording.plateaus().dataset, friction=friction, tolerance=0.1 if friction else 1.0)
    else:
        with pytest.raises((IdentificationError, RangeError)):
            identify_with_friction(ExponentialLaw, recording.plateaus().dataset)
    lost = np.abs(recording.time - recording.time[-1] / 3) < 2
    Recording(recording.table.isel(sample=~lost)).to_netcdf(tmp_path / "lost.nc")
    points = read_dataset(tmp_path / "lost.nc")
    assert len(points) < 4000 and ("mckibben points" in points.table.attrs.get("preprocessing", "")) == rests
    if not rests:  # of others, the plateaus are the points
        assert_right(points, friction=friction, tolerance=1.0)
    else:
        identify_with_friction(ExponentialLaw, points)


@pytest.mark.slow
def test_the_isotonic_test_of_the_rig_agrees_with_the_law(tmp_path):
    dataset, recording = recorded(WEIGHTS, tmp_path)
    assert_right(dataset, friction=True, tolerance=1.0)
    identify_with_friction(ExponentialLaw, recording.plateaus().dataset)


@pytest.mark.parametrize("ramp", [1, 8])
@pytest.mark.slow
def test_samples_between_held_pressures_are_left_out_and_long_strokes_averaged(ramp):
    """Of four pressures with ramps in between, sampled faster at the end."""
    time = np.concatenate([np.arange(0, 76, 0.02), np.arange(76, 80, 0.001)])
    level = np.interp(time % 20, [0, ramp], [0, 1]) + time // 20
    eps = np.interp(time % 20, [0, ramp, 14, 20], [0, 0, 0.1, 0])
    pressure = (1 + level) * bar + np.random.default_rng(0).normal(0, 300, len(time))
    data = IsobaricDataset.of(time=time, pressure=pressure, contraction=eps, force=1e-3 * pressure * (1 - 3 * eps))
    assert sample_rate(data.table) == pytest.approx(50)
    table, rows = preprocess(data.table, slack_known=True, files=np.zeros(len(data), int))
    assert np.unique(table["set_pressure"]).tolist() == [2 * bar, 3 * bar, 4 * bar, 5 * bar]
    np.testing.assert_allclose(table["time"], time[rows], atol=0.5)
    strokes = np.column_stack([table["set_pressure"], table["direction"] == "loading"])
    counts = np.unique(strokes, axis=0, return_counts=True)[1]
    assert 50 < counts.max() <= 100 and len(counts) >= 8
    held, averaged = table.attrs["preprocessing"].splitlines()[0], table.attrs["preprocessing"].splitlines()[-1]
    left_out = int(held.split()[0])
    assert averaged.startswith(f"{len(data) - left_out} samples are averaged to {len(rows)} points")
