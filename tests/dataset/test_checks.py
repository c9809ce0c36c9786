# ruff: noqa: E501 - tables of cases
"""Sound points raise no question; each kind of mistake raises one, of its topic."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.dataset.checks import Points, questions_of, questions_of_points
from mckibben.errors import McKibbenWarning
from mckibben.muscle import ChouLaw, Domain, ExponentialLaw, forces
from mckibben.units import bar

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray]


def muscle(friction: float = 0.0, noise: float = 0.0, slack: bool = False, seed: int = 0) -> Arrays:
    """Points of four pressures [Pa], contractions [-] and forces [N], stretched and released where there is friction."""
    rng = np.random.default_rng(seed)
    eps = np.linspace(0, 0.28 if slack else 0.14, 15)
    eps, side = (np.r_[eps, eps[::-1]], np.r_[-np.ones(15), np.ones(15)]) if friction else (eps, np.zeros(15))
    pressure, contraction = (grid.ravel() for grid in np.meshgrid([1e5, 2e5, 3.5e5, 5e5], eps, indexing="ij"))
    pressure = pressure + rng.normal(0, 1e3, pressure.size)
    force = 2.6e-3 * pressure * (1 - contraction / 0.26) ** 2 * (contraction < 0.26)
    force = force + friction * np.tile(side, 4) * (force > 0) + noise * rng.normal(size=force.size)
    return pressure.round(-2), contraction.round(4), force.round(1)


def topics(pressure: np.ndarray, contraction: np.ndarray, force: np.ndarray, slack_force: float = 0.0) -> set[str]:
    points = Points(pressure, contraction, force, np.arange(2, len(force) + 2), slack_force)
    return {question.topic for question in questions_of_points(points)}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "options", [{}, {"friction": 15.0}, {"noise": 2.0}, {"friction": 20.0, "noise": 3.0}, {"slack": True, "noise": 1.5}]
)
def test_sound_points_raise_no_question(options, seed):
    assert not topics(*muscle(**options, seed=seed), slack_force=6.0 if "slack" in options else 0.0)


def test_a_force_that_is_steep_at_full_length_raises_no_question():
    """Eq. 2 with terms of both kinds that decay within 4 % of contraction, one proportional to the pressure."""
    law = ExponentialLaw(-20.0, 8e-4, 0.0, -3e-3, -10.0, 1.3e-3, decay=27.0, domain=Domain())
    pressure, contraction = (
        grid.ravel() for grid in np.meshgrid(np.r_[0.5:6.1:0.9] * bar, np.r_[0:0.245:0.01], indexing="ij")
    )
    force = forces(law, contraction, pressure)
    assert not topics(pressure, contraction, np.maximum(force, 0.0).round(1), slack_force=5.0)


@pytest.mark.parametrize("factor", [4.448, 9.807, 1 / 4.448])
def test_a_force_of_another_unit_than_the_specimen_allows_is_asked_about(factor):
    data = catalog.dataset("dmsp-10-250-martens2017")
    points = Points(data.pressure, data.contraction, data.force / factor, np.arange(len(data)))
    specimen = catalog.specimen("DMSP-10-250")
    assert not questions_of_points(replace(points, force=data.force), specimen)
    (asked,) = questions_of_points(points, specimen)
    assert asked.topic == "range" and asked.problem.field == "force" and "force_UNIT" in asked.problem.remedy


@pytest.mark.parametrize("name", catalog.names("datasets"))
def test_published_points_raise_no_question(name):
    data = catalog.dataset(name)  # read, and checked
    assert len(data) and "preprocessing" not in data.table.attrs and data.table.attrs["slack_force"] == 0


@pytest.mark.parametrize("seed", range(3))
def test_an_isotonic_test_raises_no_question(seed):
    """Four loads, at each of which the pressure is raised and lowered."""
    rng, law = np.random.default_rng(seed), ChouLaw(0.41, 0.02)
    eps, load = np.tile(np.linspace(0.0, 0.18, 10), 4), np.repeat([50.0, 100.0, 150.0, 200.0], 10)
    pressure = np.array([law.pressure_for(f, e) for f, e in zip(load, eps, strict=True)], float)
    keep = pressure < 7e5
    assert not topics(pressure[keep], eps[keep], (load + rng.normal(0, 0.3, load.size))[keep]) - {"saturation"}


@pytest.mark.parametrize("loads", [(30.0, 60.0, 120.0, 200.0), (50.0, 100.0, 200.0, 300.0)])
def test_weights_at_the_same_pressures_raise_no_question(loads):
    law, eps = ChouLaw(0.41, 0.02), np.linspace(-0.1, 0.37, 4000)
    pressure = np.tile(np.linspace(1e5, 6e5, 10), 4)
    load = np.repeat(loads, 10)
    contraction = [np.interp(-f, -forces(law, eps, p), eps) for f, p in zip(load, pressure, strict=True)]
    assert not topics(pressure, np.array(contraction), load)


@pytest.mark.parametrize("unit", [4.4482216, 9.80665])
@pytest.mark.parametrize("statistics", [(np.mean,), (np.mean, np.std), (np.mean, partial(np.std, ddof=1))])
def test_averages_of_lengths_and_forces_in_other_units_are_asked_about(statistics, unit):
    pressure, contraction, force = muscle()
    written = np.column_stack([pressure / 1e5, 195.85 * contraction, force / unit])
    rows = np.vstack([written, *(statistic(written, axis=0) for statistic in statistics)]).round(2)
    arrays = rows[:, 0] * 1e5, rows[:, 1] / 195.85, rows[:, 2] * unit
    assert "rows" in topics(*arrays) and "rows" not in topics(*(values[: len(written)] for values in arrays))


@pytest.mark.parametrize("seed", range(4))
def test_repeats_that_a_ruler_reads_alike_are_no_copies(seed):
    rng, law, eps = np.random.default_rng(seed), ChouLaw(0.41, 0.02), np.linspace(-0.1, 0.37, 4000)
    once = np.r_[np.linspace(1, 6, 14), np.linspace(5.6, 1, 13)] * bar
    pressure, load = np.tile(once, 6), np.repeat([50.0, 100.0, 150.0], 54)
    contraction = np.array([np.interp(-f, -forces(law, eps, p), eps) for f, p in zip(load, pressure, strict=True)])
    read = (pressure + rng.normal(0, 500, 162)).round(-3), (contraction / 2.5e-3).round() * 2.5e-3
    assert "rows" not in topics(*read, load)


def row(at: int, pressure: float, contraction: float, force: float) -> Callable[[Arrays], Arrays]:
    """A row put among the points, in bar, percent and newtons."""
    return lambda arrays: tuple(  # type: ignore[return-value]
        np.insert(values, at, value)
        for values, value in zip(arrays, (pressure * 1e5, contraction / 100, force), strict=True)
    )


def changed(**factors: Callable[[np.ndarray], np.ndarray]) -> Callable[[Arrays], Arrays]:
    """Columns that a function changes."""
    names = ("pressure", "contraction", "force")
    return lambda arrays: tuple(
        factors.get(name, np.asarray)(values) for name, values in zip(names, arrays, strict=True)
    )  # type: ignore[return-value]


def summary(statistic: Callable[..., np.ndarray], count: int = 60) -> Callable[[Arrays], Arrays]:
    """Means, say, of the first rows below them."""

    def added(arrays: Arrays) -> Arrays:
        rows = np.column_stack([arrays[0][:count] / 1e5, 100 * arrays[1][:count], arrays[2][:count]])
        pressure, contraction, force = statistic(rows, axis=0)
        return row(count, pressure.round(3), contraction.round(2), force.round(1))(arrays)

    return added


def summaries(
    *statistics: Callable[..., np.ndarray], digits: tuple[int, ...] = (3, 2, 1)
) -> Callable[[Arrays], Arrays]:
    """Rows of statistics below all others."""

    def added(arrays: Arrays) -> Arrays:
        rows = np.column_stack([arrays[0] / 1e5, 100 * arrays[1], arrays[2]])
        for statistic in statistics:
            values = [round(value, digit) for value, digit in zip(statistic(rows, axis=0), digits, strict=True)]
            arrays = row(len(arrays[0]), *values)(arrays)
        return arrays

    return added


MISTAKES: dict[str, tuple[Callable[[Arrays], Arrays], str]] = {
    "a pull that is negative": (changed(force=lambda f: -f), "sign"),
    "an offset below zero": (changed(force=lambda f: f - 200), "sign"),
    "kPa named bar": (changed(pressure=lambda p: 100 * p), "range"),
    "psi named bar": (changed(pressure=lambda p: p / 14.5), "range"),
    "ratios named percent": (changed(contraction=lambda c: c / 100), "range"),
    "a contraction that is negative": (changed(contraction=lambda c: -c), "range"),
    "kilonewtons named newtons": (changed(force=lambda f: f / 1000), "range"),
    "a wrong initial length": (changed(contraction=lambda c: 1 - 1.3 * (1 - c)), "range"),
    "a contraction of lengthening": (changed(contraction=lambda c: 0.14 - c), "order"),
    "millimetres named percent": (changed(contraction=lambda c: 2.9 * c), "range"),
    "absolute pressures": (changed(pressure=lambda p: p + 101300), "gauge"),
    "an offset of the load cell": (changed(force=lambda f: f + 150), "zero"),
    "a saturated load cell": (changed(force=lambda f: np.minimum(f, 700.3)), "saturation"),
    "a saturated pressure sensor": (changed(pressure=lambda p: np.minimum(p, 4.9e5)), "saturation"),
    "an amplifier at its end": (changed(force=lambda f: np.where(f > 700, 700 + 0.01 * f, f).round(2)), "saturation"),
    "a mean below the table": (summary(np.mean), "rows"),
    "a median below the table": (summary(np.median), "rows"),
    "a mean of each pressure": (summary(np.mean, 15), "rows"),
    "mean and deviation below the table": (summaries(np.mean, np.std), "rows"),
    "deviation above the mean": (summaries(partial(np.std, ddof=1), np.mean), "rows"),
    "least, largest, mean and deviation": (summaries(np.min, np.max, np.mean, np.std), "rows"),
    "rounded mean and deviation": (summaries(np.mean, np.std, digits=(1, 0, 0)), "rows"),
    "mean and deviation to ten newtons": (summaries(np.mean, np.std, digits=(1, 0, -1)), "rows"),
    "a rounded mean": (summaries(np.mean, digits=(1, 1, 0)), "rows"),
    "numbers of channels": (row(0, 1, 2, 3), "rows"),
    "full scales": (row(0, 10, 30, 5000), "rows"),
    "zeros after a restart": (row(20, 0, 0, 0), "rows"),
    "a force of a lost sample": (changed(force=lambda f: np.where(np.arange(len(f)) == 31, 0.0, f)), "order"),
    "a force that stands still": (changed(force=lambda f: np.where((np.arange(len(f)) > 31) & (np.arange(len(f)) < 37), f[31], f)), "rows"),
    "a digit lost": (changed(force=lambda f: np.where(np.arange(len(f)) == 47, f - 300, f)), "order"),
    "rows of two muscles": (changed(force=lambda f: f * np.where(np.arange(len(f)) % 2, 0.5, 1.0)), "order"),
    "sorted forces": (changed(force=np.sort), "order"),
    "pressures counted up": (changed(pressure=lambda p: 1e5 + 7e3 * np.arange(len(p))), "rows"),
    "a block pasted twice": (lambda arrays: tuple(np.r_[values, values[:9]] for values in arrays), "rows"),  # type: ignore[return-value]
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("seed", range(2))
def test_a_mistake_raises_a_question_of_its_topic(mistake, seed):
    change, topic = MISTAKES[mistake]
    assert topic in topics(*change(muscle(seed=seed))) or (
        topic == "sign" and topics(*change(muscle(seed=seed))) == {""}
    )


def test_a_load_that_hangs_from_the_start_is_a_force_under_pressure():
    pressure = np.linspace(0, 6e5, 13)
    assert "range" not in topics(pressure, 0.2 * pressure / 6e5, np.full(13, 250.0))


def hanging(loads: tuple[float, ...], half_width: Callable[[float, float], float], lowest: float, seed: int) -> Arrays:
    """Loads [N] that hang from a braid, stiff when stretched, while the pressure rises and falls; friction by place."""
    rng, law, rows = np.random.default_rng(seed), ChouLaw(0.4, 0.01), []
    eps = np.linspace(-0.03, 0.34, 5000)
    pressures = np.r_[np.linspace(lowest, 6, 14), np.linspace(5.7, lowest, 13)] * bar
    widths = np.array([[half_width(p / bar, x) for x in eps] for p in pressures])
    for load in loads:
        for i, (pressure, width) in enumerate(zip(pressures, widths, strict=True)):
            side = -1 if i < 14 else 1
            pull = forces(law, eps, pressure) - 60 * eps + 9000 * np.maximum(-eps, 0) + side * width
            rows.append((pressure + rng.normal(0, 700), eps[np.argmin(np.abs(pull - load))], load))
    pressure, contraction, force = np.array(rows).T
    return pressure, contraction.round(4), force


def asked_of(arrays: Arrays) -> set[str]:
    """Topics of the questions that loads, which hang, raise."""
    pressure, contraction, force = arrays
    side = np.tile(np.arange(27) < 14, 4)[: len(force)]
    data = IsobaricDataset.of(
        pressure=pressure,
        contraction=contraction,
        force=force,
        set_force=force,
        direction=np.where(side, "unloading", "loading"),
        slack_force=0.0,
    )
    return {question.topic for question in questions_of(data, np.arange(len(data)))}


FRICTIONS = {
    "constant": lambda p, x: 6.0,
    "falls with contraction": lambda p, x: 4 + 10 * np.exp(-max(x, 0) / 0.05),
    "falls with pressure": lambda p, x: 11 - 1.4 * p,
    "rises with pressure": lambda p, x: 3 + 1.6 * p,
}


@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("lowest", [0.5, 1.0])
@pytest.mark.parametrize("loads", [(20.0, 50.0, 100.0, 150.0), (20.0, 80.0, 160.0, 240.0), (30.0, 60.0, 90.0)])
def test_small_weights_and_the_lowest_pressure_of_venting_raise_no_question(loads, lowest, friction):
    assert asked_of(hanging(loads, FRICTIONS[friction], lowest, seed=1)) == set()


@pytest.mark.parametrize(
    "change",
    [
        changed(contraction=lambda c: np.where(np.arange(len(c)) == 41, c / 10, c)),
        changed(contraction=lambda c: np.where(np.arange(len(c)) == 70, 0.0, c)),
        changed(pressure=lambda p: np.where(np.arange(len(p)) == 41, p / 10, p)),
        changed(force=lambda f: np.where(np.arange(len(f)) // 4 == 12, 3 * f, f)),
        changed(contraction=lambda c: 0.25 - c),
    ],
    ids=["a digit lost", "a length not written", "a decimal of the pressure", "a load not changed", "lengthening"],
)
def test_a_wrong_row_of_hanging_weights_is_asked_about(change):
    arrays = hanging((50.0, 100.0, 150.0, 200.0), FRICTIONS["constant"], 1.0, seed=2)
    assert "order" in asked_of(change(arrays))


def strokes(damper: tuple[float, float], speeds: tuple[float, ...] = (4.0, 12.0, 40.0, 90.0)) -> IsobaricDataset:
    """Strokes of 30 mm at several speeds [mm/s] and four pressures, with dampers [N*s/m] of shortening and stretching.

    The muscle has 200 mm; the readings do not reach the reversals.
    """
    rng, law, time, rows = np.random.default_rng(3), ChouLaw(0.45, 0.016), 0.0, []
    for pressure in np.array([1.5, 3.0, 4.5, 6.0]) * bar:
        for speed in speeds:
            for side, damping in zip((1, -1), damper, strict=True):
                place = np.linspace(0.03, 0.18, 40)[::side]
                times = time + np.arange(40) * 30 / speed / 40
                pull = forces(law, place, pressure) - side * (5.0 + damping * speed / 1e3)
                rows += zip(
                    times, np.full(40, pressure), place, pull + rng.normal(0, 0.2, 40), [side] * 40, strict=True
                )
                time = times[-1] + 5 * 30 / speed / 40
    time, pressure, contraction, force, side = np.array(rows).T
    return IsobaricDataset.of(
        pressure=pressure + rng.normal(0, 300, len(time)),
        contraction=contraction,
        force=force,
        time=time,
        direction=np.where(side > 0, "unloading", "loading"),
        set_pressure=pressure,
        slack_force=0.0,
    )


@pytest.mark.parametrize("damper", [(90.0, 310.0), (400.0, 400.0), (600.0, 50.0)])
def test_strokes_at_several_speeds_are_not_off_the_surface(damper):
    data = strokes(damper)
    assert questions_of(data, np.arange(len(data))) == []


def test_a_wrong_reading_of_a_fast_stroke_is_asked_about():
    data = strokes((90.0, 310.0))
    force = data.force.copy()
    force[260] /= 10
    wrong = IsobaricDataset(data.table.assign(force=("point", force)))
    (question,) = questions_of(wrong, np.arange(len(wrong)))
    assert (question.topic, question.problem.line) == ("order", 260)


def test_published_points_and_those_of_the_rig_show_no_shift():
    for name in catalog.names("datasets"):
        data = catalog.dataset(name)
        assert questions_of(data, np.arange(len(data))) == []


@pytest.mark.parametrize("friction", [0.0, 12.0])
@pytest.mark.parametrize("row", [23, 30, 41])
@pytest.mark.parametrize(
    ("quantity", "size"),
    [("pressure", 1.013e5), ("pressure", -1.013e5), ("contraction", 0.02), ("force", 100.0), ("force", 30.0)],
)
def test_a_shift_from_some_row_on_is_asked_about_with_the_row(quantity, size, row, friction):
    names = ("pressure", "contraction", "force")
    arrays = dict(zip(names, muscle(noise=0.4, friction=friction, seed=4), strict=True))
    row *= 1 + (friction > 0)
    arrays[quantity] = arrays[quantity] + np.where(np.arange(len(arrays["force"])) >= row, size, 0.0)
    data = IsobaricDataset.of(
        **arrays,
        direction=np.tile(np.repeat(["unloading", "loading"], 15), 4) if friction else None,
        slack_force=0.0,
    )
    asked = questions_of(data, np.arange(len(data)))
    (question,) = (question for question in asked if question.problem.field == quantity and question.topic == "order")
    assert abs(question.problem.line - row) <= 2, asked


def test_a_small_shift_of_the_pressure_is_a_warning_as_first_strokes_do_the_same():
    """A load cell's shift of 2 % of the largest force is a question, as no muscle changes alike at all pressures."""
    pressure, contraction, force = muscle(noise=0.4, friction=12.0, seed=4)
    pressure = pressure + np.where(np.arange(len(force)) >= 70, 0.2e5, 0.0)
    direction = np.tile(np.repeat(["unloading", "loading"], 15), 4)
    data = IsobaricDataset.of(
        pressure=pressure, contraction=contraction, force=force, direction=direction, slack_force=0.0
    )
    with pytest.warns(McKibbenWarning, match=r"line (69|70|71): pressures .* \+0\.(19|2|21)"):
        assert questions_of(data, np.arange(len(data))) == []


@pytest.mark.parametrize("loads", [(167.0, 176.0), (59.0, 98.0), (98.0, 157.0, 167.0)])
def test_loads_between_which_a_law_is_not_determined_are_not_shifted(loads):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert asked_of(hanging(loads, lambda p, eps: 5.0, 0.8, seed=0)) == set()
