"""The plan of the next test: its algebra against brute force, what it refuses, and whether its points do better."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset, read_dataset
from mckibben.errors import IdentificationError, ParameterError, RangeError
from mckibben.experiment_design import Coefficient, Force, JointStiffness, information, parse_quantity_of_interest, plan
from mckibben.identification import design_matrix, fit_law
from mckibben.muscle import ChouLaw, Domain, ExponentialLaw
from mckibben.units import bar, deg, percent

MARTENS = "dmsp-10-250-martens2017"
NAMES = [p.name for p in ExponentialLaw.parameters()]


@pytest.fixture(scope="module")
def martens():
    return catalog.dataset(MARTENS)


@pytest.fixture(scope="module")
def fit(martens):
    return fit_law(ExponentialLaw, martens)


def made(law, directions, *, noise=1.0, half_width=3.0, seed=0, specimen="MAS-10-180N-AA-MC-O"):
    """Data of a poor test: three pressures, up to 12 %."""
    grid = itertools.product(np.array([2.0, 3.0, 4.0]) * bar, np.arange(0, 0.121, 0.02), directions)
    pressure, contraction, direction = map(np.array, zip(*grid, strict=True))
    force = np.asarray(law.force(contraction, pressure)) + half_width * np.where(direction == "loading", 1, -1)
    force = np.maximum(force + noise * np.random.default_rng(seed).normal(size=force.size), 0.0)
    return IsobaricDataset.of(
        pressure=pressure, contraction=contraction, force=force, direction=direction, specimen=specimen, slack_force=8.0
    )


def covariance(rows, noise, *labels):
    """Covariance of the parameters by inverting that of the points; those with the same labels share an error."""
    size = np.linalg.norm(rows, axis=0)
    same = np.logical_and.reduce([label[:, None] == label for label in labels])
    whole = noise.point**2 * np.eye(len(rows)) + noise.stroke**2 * same
    return np.linalg.inv((rows / size).T @ np.linalg.solve(whole, rows / size)) / np.outer(size, size)


# The algebra.


def candidates(stroke: float, seed: int = 1) -> information.ExchangeProblem:
    rng = np.random.default_rng(seed)
    return information.ExchangeProblem(
        rows=rng.normal(size=(30, 4)),
        strokes=np.repeat(np.arange(10), 3),
        information=information.information_matrix(rng.normal(size=(6, 4)), np.arange(6), information.NoiseModel(0.7)),
        noise=information.NoiseModel(0.7, stroke),
        gradients=rng.normal(size=(3, 4)),
    )


def brute(problem: information.ExchangeProblem, chosen) -> float:
    """The same by inverting the whole covariance of the points."""
    rows, strokes = problem.rows[list(chosen)], problem.strokes[list(chosen)]
    whole = 0.7**2 * np.eye(len(rows)) + problem.noise.stroke**2 * (strokes[:, None] == strokes)
    known = problem.information + rows.T @ np.linalg.inv(whole) @ rows
    return np.log(np.trace(problem.gradients @ np.linalg.inv(known) @ problem.gradients.T) / 3)


@pytest.mark.parametrize("stroke", [0.0, 1.3])
def test_one_more_point_is_an_update_of_rank_one(stroke):
    problem = candidates(stroke)
    chosen = [0, 1, 7]
    costs = {row: brute(problem, [*chosen, row]) for row in range(30) if row not in chosen}
    best, cost = problem.best(chosen)
    assert best == min(costs, key=costs.get)
    assert cost == pytest.approx(costs[best], rel=1e-9)
    for row in (2, 8, 29):  # on a stroke with two points, with one, and with none
        assert problem.best(chosen, np.array([row]))[1] == pytest.approx(costs[row], rel=1e-9)
        assert problem.cost([*chosen, row]) == pytest.approx(costs[row], rel=1e-9)


def test_the_search_finds_the_best_of_all_pairs_and_no_exchange_improves_more_points():
    problem = candidates(1.3)
    best = min(itertools.combinations(range(30), 2), key=lambda pair: brute(problem, pair))
    assert sorted(information.exchange(problem, 2)) == list(best)
    five = information.exchange(problem, 5)
    least = brute(problem, five)
    for place, other in itertools.product(range(5), set(range(30)) - set(five)):
        assert brute(problem, [*five[:place], other, *five[place + 1 :]]) > least - 1e-9


def test_a_region_costs_what_all_its_places_cost():
    many, known = np.random.default_rng(3).normal(size=(400, 4)), np.diag([1.0, 2.0, 3.0, 4.0])
    assert information.condensed(many).shape == (4, 4)
    assert information.mean_variance(information.condensed(many), known) == pytest.approx(
        information.mean_variance(many, known), rel=1e-12
    )


def test_coordinates_leave_out_what_no_force_tells():
    rows = np.random.default_rng(0).normal(size=(40, 3))
    rows = np.column_stack([rows, rows[:, 0] - 2 * rows[:, 2]]) * [1, 1e-5, 1, 1e4]
    found = information.IdentifiableSubspace.of(rows)
    assert found.basis.shape == (4, 3)
    np.testing.assert_allclose((rows @ found.basis).T @ rows @ found.basis / 40, np.eye(3), atol=1e-9)
    parts = found.unidentifiable_part(np.eye(4))
    assert parts[1] < 1e-9 and parts[[0, 2, 3]].min() > 0.1
    assert found.unidentifiable_part(rows[:1])[0] < 1e-9


def test_the_spread_of_points_and_strokes_is_found_without_bias():
    rng = np.random.default_rng(5)
    rows, strokes = rng.normal(size=(60, 5)), np.repeat(np.arange(15), 4)
    squares = []
    for _ in range(400):
        errors = 1.5 * rng.normal(size=60) + 2.0 * rng.normal(size=15)[strokes]
        residuals = errors - rows @ np.linalg.lstsq(rows, errors, rcond=None)[0]
        found = information.estimate_noise(rows, residuals, strokes)
        squares.append((found.point**2, found.stroke**2))
    point, stroke = np.mean(squares, axis=0)
    assert point == pytest.approx(1.5**2, rel=0.03)
    assert stroke == pytest.approx(2.0**2, rel=0.08)


# The plan.


def test_the_errors_now_are_those_of_the_points_with_their_strokes(martens, fit):
    found, taut = plan(martens, Coefficient("c1"), ExponentialLaw, points=6), martens.taut
    rows = design_matrix(fit.law, NAMES, taut.contraction, taut.pressure)
    inverse = covariance(rows, found.noise, taut.levels)
    now = dict(zip(NAMES, np.sqrt(np.diag(inverse)), strict=True))
    assert {name: errors[0] for name, errors in found.parameter_errors.items()} == pytest.approx(now, rel=1e-5)
    assert found.error_now == pytest.approx(now["c1"], rel=1e-5)
    there = np.argmin(abs(found.map.states.pressures - 4 * bar)), np.argmin(abs(found.map.states.contractions - 0.052))
    slope = design_matrix(fit.law, NAMES, np.array([0.052]), np.array([4 * bar]))[0]
    assert np.sqrt(slope @ inverse @ slope) == pytest.approx(found.map.now[there], rel=1e-5)
    assert found.map.after[there] < found.map.now[there]


def test_its_points_can_be_measured(martens, fit, specimen):
    found = plan(martens, Force(), ExponentialLaw, points=12)
    force = [float(fit.law.force(p.contraction, p.pressure)) for p in found.points]
    assert [p.force for p in found.points] == pytest.approx(force)
    assert min(force) > 2 * found.noise.point and max(force) <= 0.95 * 630
    for point in found.points:
        assert point.pressure / (0.25 * bar) == pytest.approx(round(point.pressure / (0.25 * bar)), abs=1e-9)
        length = point.contraction * 250  # mm
        assert length == pytest.approx(round(length), abs=1e-6)
        assert -0.03 <= point.contraction <= 0.25 and 0 <= point.pressure <= 8 * bar
    assert len({(p.pressure, p.contraction, p.repeat) for p in found.points}) == 12
    errors = [found.error_now, *(p.standard_error for p in found.points)]
    assert errors == sorted(errors, reverse=True)
    limited = plan(fit, Force(), specimen=specimen, limits=Domain(0.0, 0.1, 3 * bar, 5 * bar), pressure_step=1 * bar)
    assert {p.pressure / bar for p in limited.points} <= {3.0, 4.0, 5.0}
    assert all(0 <= p.contraction <= 0.1 for p in limited.points)


@pytest.mark.slow
def test_one_direction_alone_does_not_tell_friction_from_force(law, as_printed):
    data = fit_law(ExponentialLaw, made(law, ["loading"]))
    for quantity in (Coefficient("a1"), JointStiffness(as_printed, 5 * deg), Force()):
        found = plan(data, quantity)
        assert np.isinf(found.error_now) and np.isfinite(found.error_after)
        assert "unloading" in {p.direction for p in found.points[:2]}
    assert np.isinf(found.parameter_errors["a1"][0]) and np.isfinite(found.parameter_errors["decay"][0])
    text = found.to_text()
    assert "measure unloading too" in text and "a1, friction" in text
    for quantity in (Coefficient("decay"), JointStiffness(as_printed, 0.0)):  # an offset changes no shape
        assert np.isfinite(plan(data, quantity).error_now)


def test_both_directions_tell_the_half_width_and_clean_the_noise_of_it(law):
    data = made(law, ["loading", "unloading"], half_width=4.0, noise=0.5)
    found = plan(data, Force(), ExponentialLaw, points=4)
    assert found.half_width == pytest.approx(4.0, abs=0.4)
    assert np.hypot(found.noise.point, found.noise.stroke) == pytest.approx(0.5, rel=0.35)


def test_planned_points_are_better_than_as_many_evenly_spaced_ones(law, as_printed, specimen):
    """Standard errors with the whole covariance of all points, those at hand included."""
    data = fit_law(ExponentialLaw, made(law, ["loading", "unloading"]))
    taut = data.require_regression().points
    limits = Domain(0.0, 0.2, 2 * bar, 6 * bar)

    def brute(found, points):
        place = np.array([point[:2] for point in points])
        pressure, contraction = np.append(taut.pressure, place[:, 0]), np.append(taut.contraction, place[:, 1])
        ways = np.append(taut.table["direction"].to_numpy(), [point[2] for point in points])
        tests = np.append(np.full(len(taut), -1), [point[3] for point in points])
        sign = np.where(ways == "loading", 1.0, -1.0)
        rows = np.column_stack([design_matrix(data.law, NAMES, contraction, pressure), sign])
        return np.sqrt(np.diag(covariance(rows, found.noise, pressure, ways, tests)))

    even = [
        (p, c, way, 0)
        for p, (low, high) in ((2 * bar, (0.0, 0.05)), (4 * bar, (0.0, 0.1)), (6 * bar, (0.0, 0.2)))
        for c in np.linspace(low, high, 2)
        for way in ("loading", "unloading")
    ]
    for name in ("decay", "a2"):
        found = plan(data, Coefficient(name), specimen=specimen, limits=limits, points=len(even))
        planned = brute(found, [(p.pressure, p.contraction, p.direction, p.repeat) for p in found.points])
        assert found.error_after == pytest.approx(planned[NAMES.index(name)], rel=1e-5)
        assert found.error_after < 0.9 * brute(found, even)[NAMES.index(name)]


def test_what_cannot_be_planned(martens, fit, as_printed):
    def fails(quantity, error=RangeError, **options):
        with pytest.raises(error) as caught:
            plan(fit, quantity, **options)
        return str(caught.value)

    assert "-12.8 % is outside -3..25 %" in fails(JointStiffness(as_printed, 50 * deg))
    assert "9 bar is outside 0..8 bar" in fails(JointStiffness(as_printed, 0.0, (9 * bar, 3 * bar)))
    assert "nothing to gain" in fails(JointStiffness(as_printed, 0.0, (0.0, 0.0)), error=IdentificationError)
    assert "'mu' is not a quantity" in fails(Coefficient("mu"), error=ParameterError)
    assert "the law has no force" in fails(Force(Domain(0.2, 0.25, 0.0, 1 * bar)))
    assert "no state within" in fails(Force(), limits=Domain(0.2, 0.25, 0.0, 1 * bar))
    assert "candidates for 8 points" in fails(
        Force(), limits=Domain(0.052, 0.052, 3 * bar, 4 * bar), pressure_step=1 * bar
    )
    assert "too many candidates" in fails(Force(), pressure_step=10.0)
    assert "0 points" in fails(Force(), points=0)
    assert "noise is 0 N" in fails(Force(), noise=0.0)
    with pytest.raises(ParameterError, match="kind of law"):
        plan(martens, Force())
    with pytest.raises(IdentificationError):
        plan(martens.select(np.arange(len(martens)) < 4), Force(), ExponentialLaw)
    exact = made(catalog.law("lei-mas-10-180n"), ["loading", "unloading"], noise=0.0, half_width=0.0)
    with pytest.raises(IdentificationError, match="no uncertainty to reduce"):
        plan(exact, Force(), ExponentialLaw)


def test_the_file_of_a_plan_becomes_data_with_a_column_of_forces(law, tmp_path):
    found = plan(made(law, ["loading", "unloading"]), Force(), ExponentialLaw)
    found.write(tmp_path)
    head, *rows = (tmp_path / "plan.csv").read_text(encoding="utf-8").splitlines()
    values = [dict(zip(head.split(","), row.split(","), strict=True)) for row in rows]
    forces = [float(one["pressure_bar"]) * (30 - float(one["contraction_percent"])) for one in values]
    filled = [f"{head},force_N"] + [f"{row},{force:.3f}" for row, force in zip(rows, forces, strict=True)]
    (tmp_path / "done.csv").write_text("\n".join(filled) + "\n", encoding="utf-8")
    read = read_dataset(tmp_path / "done.csv")
    wanted = {(round(p.pressure), round(p.contraction, 7), p.direction, p.repeat) for p in found.points}
    columns = (read.table[name].to_numpy() for name in ("pressure", "contraction", "direction", "repeat"))
    assert {(round(p), round(c, 7), str(d), int(r)) for p, c, d, r in zip(*columns, strict=True)} == wanted
    for repeat in read.repeats:  # in a pass: pressures ascend, the muscle shortens and is stretched again
        one = read.select(read.table["repeat"].to_numpy() == repeat)
        assert np.all(np.diff(one.pressure) >= 0)
        for pressure, way in itertools.product(one.pressures, ("loading", "unloading")):
            move = np.diff(one.contraction[(one.pressure == pressure) & (one.table["direction"].to_numpy() == way)])
            assert np.all(move < 0) if way == "loading" else np.all(move > 0)


def test_quantities_are_read_from_text_and_print_back(as_printed):
    for text, same in (
        ("decay", Coefficient("decay")),
        ("force", Force()),
        ("force at 0..10 %, 3..6 bar", Force(Domain(0.0, 10 * percent, 3 * bar, 6 * bar))),
        ("force at -1 % .. 10 %, 300 kPa..6 bar", Force(Domain(-0.01, 0.1, 3 * bar, 6 * bar))),
        ("stiffness", JointStiffness(as_printed)),
        ("stiffness at 5 deg, 2 bar", JointStiffness(as_printed, 5 * deg, (2 * bar, 2 * bar))),
        ("stiffness at 0.1 rad, 2 bar, 4 bar", JointStiffness(as_printed, 0.1, (2 * bar, 4 * bar))),
    ):
        assert str(parse_quantity_of_interest(text, ExponentialLaw, lambda: as_printed)) == str(same)
    several = parse_quantity_of_interest("stiffness at -4..4 deg, 3 bar", ExponentialLaw, lambda: as_printed)
    assert np.asarray(several.angle) / deg == pytest.approx([-4, -2, 0, 2, 4])
    assert str(several) == "stiffness at -4..4 deg, 3 bar, 3 bar"
    with pytest.raises(ParameterError, match="has braid_angle"):
        parse_quantity_of_interest("decay", ChouLaw, lambda: as_printed)
