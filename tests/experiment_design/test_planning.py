"""The plan of the next test: its algebra against brute force, what it refuses, and whether its points do better."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset, read_dataset
from mckibben.errors import IdentificationError, ParameterError, RangeError
from mckibben.experiment_design import (
    Coefficients,
    Force,
    JointStiffness,
    JointTorque,
    parse_quantity_of_interest,
    plan,
)
from mckibben.experiment_design.candidates import DesignRegion, StateGrid
from mckibben.experiment_design.information import (
    DesignCriterion,
    ExchangeProblem,
    IdentifiableSubspace,
    NoiseModel,
    estimate_noise,
    exchange,
    information_matrix,
)
from mckibben.identification import Grouping, design_matrix, identify
from mckibben.muscle import ChouLaw, Domain, ExponentialLaw, SarosiLaw
from mckibben.units import bar, deg, percent

MARTENS = "dmsp-10-250-martens2017"
NAMES = [p.name for p in ExponentialLaw.parameters()]


@pytest.fixture(scope="module")
def martens():
    return catalog.dataset(MARTENS)


@pytest.fixture(scope="module")
def fit(martens):
    return identify(ExponentialLaw, martens)


def made(law, directions, *, noise=1.0, half_width=3.0, seed=0, specimen="MAS-10-180N-AA-MC-O"):
    """Data of a poor test: three pressures, up to 12 %."""
    grid = itertools.product(np.array([2.0, 3.0, 4.0]) * bar, np.arange(0, 0.121, 0.02), directions)
    pressure, contraction, direction = map(np.array, zip(*grid, strict=True))
    force = np.asarray(law.force(contraction, pressure)) + half_width * np.where(direction == "loading", 1, -1)
    force = np.maximum(force + noise * np.random.default_rng(seed).normal(size=force.size), 0.0)
    return IsobaricDataset.of(
        pressure=pressure,
        contraction=contraction,
        force=force,
        direction=direction,
        specimen=specimen,
        slack_force=8.0,
    )


# The algebra.


def candidates(joint: bool, stroke: float, seed: int = 1) -> ExchangeProblem:
    rng = np.random.default_rng(seed)
    return ExchangeProblem(
        rows=rng.normal(size=(30, 4)),
        strokes=np.repeat(np.arange(10), 3),
        information=information_matrix(rng.normal(size=(6, 4)), np.arange(6), NoiseModel(0.7)),
        noise=NoiseModel(0.7, stroke),
        criterion=DesignCriterion.of(rng.normal(size=(3, 4)), joint),
    )


def brute(problem: ExchangeProblem, chosen) -> float:
    """The same by inverting the whole covariance of the points."""
    rows, strokes = problem.rows[list(chosen)], problem.strokes[list(chosen)]
    covariance = 0.7**2 * np.eye(len(rows)) + problem.noise.stroke**2 * (strokes[:, None] == strokes)
    known = problem.information + rows.T @ np.linalg.inv(covariance) @ rows
    left = problem.criterion.gradients @ np.linalg.inv(known) @ problem.criterion.gradients.T
    return np.log(np.linalg.det(left)) / 3 if problem.criterion.d_optimal else np.log(np.trace(left) / 3)


@pytest.mark.parametrize("joint", [False, True])
@pytest.mark.parametrize("stroke", [0.0, 1.3])
def test_one_more_point_is_an_update_of_rank_one(joint, stroke):
    problem = candidates(joint, stroke)
    chosen = [0, 1, 7]
    costs = {one: brute(problem, [*chosen, one]) for one in range(30) if one not in chosen}
    found, cost = problem.best(chosen)
    assert found == min(costs, key=costs.get)
    assert cost == pytest.approx(costs[found], rel=1e-9)
    for one in (2, 8, 29):  # on a stroke with two points, with one, and with none
        assert problem.best(chosen, np.array([one]))[1] == pytest.approx(costs[one], rel=1e-9)
        assert problem.cost([*chosen, one]) == pytest.approx(costs[one], rel=1e-9)


@pytest.mark.parametrize("joint", [False, True])
def test_the_search_finds_the_best_of_all_pairs_and_no_exchange_improves_more_points(joint):
    problem = candidates(joint, 1.3)
    best = min(itertools.combinations(range(30), 2), key=lambda pair: brute(problem, pair))
    assert sorted(exchange(problem, 2)) == list(best)
    five = exchange(problem, 5)
    least = brute(problem, five)
    for place, other in itertools.product(range(5), set(range(30)) - set(five)):
        assert brute(problem, [*five[:place], other, *five[place + 1 :]]) > least - 1e-9
    greedy: list[int] = []
    for _ in range(5):
        greedy.append(problem.best(greedy)[0])
    assert least <= brute(problem, greedy) + 1e-12


def test_a_region_costs_what_all_its_places_cost():
    rng = np.random.default_rng(3)
    many, known = rng.normal(size=(400, 4)), np.diag([1.0, 2.0, 3.0, 4.0])
    whole = DesignCriterion(many, d_optimal=False)
    assert DesignCriterion.of(many, d_optimal=False).gradients.shape == (4, 4)
    assert DesignCriterion.of(many, d_optimal=False).cost(known) == pytest.approx(whole.cost(known), rel=1e-12)


def test_coordinates_leave_out_what_no_force_tells():
    rows = np.random.default_rng(0).normal(size=(40, 3))
    rows = np.column_stack([rows, rows[:, 0] - 2 * rows[:, 2]]) * [1, 1e-5, 1, 1e4]
    found = IdentifiableSubspace.of(rows)
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
        found = estimate_noise(rows, residuals, strokes)
        squares.append((found.point**2, found.stroke**2))
    point, stroke = np.mean(squares, axis=0)
    assert point == pytest.approx(1.5**2, rel=0.03)
    assert stroke == pytest.approx(2.0**2, rel=0.08)


# The plan.


def test_the_errors_now_are_those_of_the_fit_and_after_those_of_all_points_together(martens, fit):
    found = plan(martens, Coefficients(("c1",)), ExponentialLaw, stroke_error=0.0, points=6)
    now = {name: errors[0] for name, errors in found.parameter_errors.items()}
    assert now == pytest.approx(fit.standard_errors, rel=1e-6)
    assert found.error_now == pytest.approx(now["c1"], rel=1e-9)
    pressure = [*martens.taut.pressure, *(p.pressure for p in found.points)]
    contraction = [*martens.taut.contraction, *(p.contraction for p in found.points)]
    rows = design_matrix(fit.law, NAMES, contraction, pressure)
    size = np.linalg.norm(rows, axis=0)
    inverse = np.linalg.pinv(rows / size)
    errors = found.noise.point * np.sqrt(np.sum(inverse**2, axis=1)) / size
    assert {name: e[1] for name, e in found.parameter_errors.items()} == pytest.approx(
        dict(zip(NAMES, errors, strict=True)), rel=1e-5
    )
    assert found.points[-1].standard_error == found.error_after == pytest.approx(errors[4], rel=1e-5)
    there = np.argmin(abs(found.map.states.pressures - 4 * bar)), np.argmin(abs(found.map.states.contractions - 0.052))
    band = fit.force_intervals(0.052, 4 * bar, by=Grouping.POINT).confidence
    assert float(band.standard_error) == pytest.approx(found.map.now[there], rel=1e-5)
    assert found.map.after[there] < found.map.now[there]


def test_its_points_can_be_measured(martens, fit, specimen):
    found = plan(martens, Force(), ExponentialLaw, points=12, repeats=1)
    force = [float(fit.law.force(p.contraction, p.pressure)) for p in found.points]
    assert [p.force for p in found.points] == pytest.approx(force)
    assert min(force) > 2 * found.noise.point and max(force) <= 0.95 * 630
    for point in found.points:
        assert point.pressure / (0.25 * bar) == pytest.approx(round(point.pressure / (0.25 * bar)), abs=1e-9)
        length = point.contraction * 250  # mm
        assert length == pytest.approx(round(length), abs=1e-6)
        assert -0.03 <= point.contraction <= 0.25 and 0 <= point.pressure <= 8 * bar
    assert len({(p.pressure, p.contraction) for p in found.points}) == 12
    errors = [found.error_now, *(p.standard_error for p in found.points)]
    assert errors == sorted(errors, reverse=True)
    limited = plan(fit, Force(), specimen=specimen, limits=Domain(0.0, 0.1, 3 * bar, 5 * bar), pressure_step=1 * bar)
    assert {p.pressure / bar for p in limited.points} <= {3.0, 4.0, 5.0}
    assert all(0 <= p.contraction <= 0.1 for p in limited.points)


def test_one_direction_alone_does_not_tell_friction_from_force(law, as_printed):
    data = identify(ExponentialLaw, made(law, ["loading"]))
    for quantity in (Coefficients(("a1",)), JointStiffness(as_printed, 5 * deg), Coefficients(), Force()):
        found = plan(data, quantity)
        assert np.isinf(found.error_now) and np.isfinite(found.error_after)
        assert "unloading" in {p.direction for p in found.points[:2]}
    assert np.isinf(found.parameter_errors["a1"][0]) and np.isfinite(found.parameter_errors["decay"][0])
    text = found.report()
    assert "friction is not distinguished from force; measure unloading too" in text
    assert "not identifiable: 1 combination of a1, friction" in text
    for quantity in (Coefficients(("decay",)), JointStiffness(as_printed, 0.0)):
        assert np.isfinite(
            plan(data, quantity).error_now
        )  # an offset changes no shape, and no stiffness of a straight joint
    with pytest.raises(IdentificationError, match="measure in the direction opposite to loading too") as caught:
        plan(data, Force(), directions=["loading"])
    assert "friction" in str(caught.value)
    without = plan(data, Force(), directions=["loading"], friction=False)
    assert np.isfinite(without.error_now) and {p.direction for p in without.points} == {""}


def test_both_directions_tell_the_half_width_and_clean_the_noise_of_it(law):
    data = made(law, ["loading", "unloading"], half_width=4.0, noise=0.5)
    found = plan(data, Force(), ExponentialLaw, points=4)
    assert found.half_width == pytest.approx(4.0, abs=0.4)
    assert np.hypot(found.noise.point, found.noise.stroke) == pytest.approx(0.5, rel=0.35)
    assert plan(data, Force(), ExponentialLaw, points=4, friction=False).noise.point > 3.0


def test_where_strokes_err_as_a_whole_the_points_are_chosen_for_that(law):
    data = identify(ExponentialLaw, made(law, ["loading", "unloading"]))
    quantity, shared = Coefficients(("a2",)), 6.0
    blind, found = (plan(data, quantity, points=10, stroke_error=error) for error in (0.0, shared))
    taut = data.require_regression().points

    def brute(points):
        """The standard error of a2 with the whole covariance of all points, those at hand included."""
        place = np.array([(p.contraction, p.pressure) for p in points])
        contraction, pressure = np.append(taut.contraction, place[:, 0]), np.append(taut.pressure, place[:, 1])
        ways = np.append(taut.table["direction"].to_numpy(), [p.direction for p in points])
        tests = np.append(np.full(len(taut), -1), [p.repeat for p in points])
        sign = np.where(ways == "loading", 1.0, -1.0)
        rows = np.column_stack([design_matrix(data.law, NAMES, contraction, pressure), sign])
        rows = rows / (size := np.linalg.norm(rows, axis=0))
        same = [a[:, None] == a for a in (pressure, ways, tests)]
        covariance = found.noise.point**2 * np.eye(len(rows)) + shared**2 * np.logical_and.reduce(same)
        return np.sqrt(np.linalg.inv(rows.T @ np.linalg.solve(covariance, rows))[1, 1]) / size[1]

    assert found.error_after == pytest.approx(brute(found.points), rel=1e-5)
    assert found.error_after < 0.98 * brute(blind.points)


def test_without_a_fit_it_begins_with_a_guess_and_says_so(law):
    data = made(law, ["loading", "unloading"])
    few = data.select(np.arange(len(data)) < 4)
    found = plan(few, Force(), ExponentialLaw, points=12, noise=1.0)
    assert np.isinf(found.error_now) and np.isfinite(found.error_after)
    assert any("a guess, ExponentialLaw fitted to the chart" in note for note in found.notes)
    given = plan(few, Force(), ExponentialLaw, points=12, noise=1.0, guess=law)
    assert any("the given guess" in note for note in given.notes)
    assert given.law.decay == law.decay and given.law.a2 != law.a2
    assert np.isfinite(given.error_after)
    with pytest.raises(ParameterError, match="the guess is a ExponentialLaw"):
        plan(few, Force(), SarosiLaw, guess=law)
    too_few = plan(few, Force(), ExponentialLaw, points=2, guess=law)
    assert any("remains undetermined" in note for note in too_few.notes)


def test_what_the_points_at_hand_cannot_see(martens, law):
    said = "\n".join(plan(martens, Force(), ExponentialLaw, points=2).diagnostics)
    for part in (
        "at 0.5 bar all points are slack",
        "no point below 0 % contraction, where -2.8 % is allowed (the muscle stretched beyond its length)",
        "no point above 6.5 bar, where 8 bar is allowed",
        "directions are not recorded",
        "no repeated points",
        "times are not recorded",
        "the standard error of the force exceeds 2 times",
    ):
        assert part in said
    data = made(law, ["loading", "unloading"])
    table = data.table.assign(time=("point", np.arange(len(data), dtype=float)))
    twice = IsobaricDataset.of(
        **{
            name: np.tile(table[name].to_numpy(), 2)
            for name in ("pressure", "contraction", "force", "direction", "time")
        },
        specimen="MAS-10-180N-AA-MC-O",
    )
    said = "\n".join(plan(twice, Force(), ExponentialLaw, points=2, noise=1.0).diagnostics)
    for part in ("directions are not", "no repeated points", "times are not", "all points are"):
        assert part not in said
    assert "no taut point above 12 % contraction" in said


def test_what_cannot_be_planned(martens, fit, as_printed):
    def fails(quantity, error=RangeError, **options):
        with pytest.raises(error) as caught:
            plan(fit, quantity, **options)
        return str(caught.value)

    assert "-12.8 % is outside -3..25 %" in fails(JointStiffness(as_printed, 50 * deg))
    assert "9 bar is outside 0..8 bar" in fails(JointStiffness(as_printed, 0.0, (9 * bar, 3 * bar)))
    assert "both muscles slack, or their errors cancel" in fails(
        JointTorque(as_printed, 0.0, (3 * bar, 3 * bar)), error=IdentificationError
    )
    assert "nothing to gain" in fails(JointStiffness(as_printed, 0.0, (0.0, 0.0)), error=IdentificationError)
    assert "has no coefficient 'mu'" in fails(Coefficients(("mu",)), error=ParameterError)
    assert "the law has no force" in fails(Force(Domain(0.2, 0.25, 0.0, 1 * bar)))
    assert "no state within" in fails(Force(), limits=Domain(0.2, 0.25, 0.0, 1 * bar))
    assert "candidates for 8 points" in fails(
        Force(), limits=Domain(0.052, 0.052, 3 * bar, 4 * bar), pressure_step=1 * bar
    )
    assert "too many candidates" in fails(Force(), pressure_step=10.0)
    assert "0 points" in fails(Force(), points=0)
    assert "'up' is not a direction" in fails(Force(), directions=["up"], error=ParameterError)
    assert "a noise of 0 N" in fails(Force(), noise=0.0)
    with pytest.raises(ParameterError, match="kind of law"):
        plan(martens, Force())
    exact = made(catalog.law("lei-mas-10-180n"), ["loading", "unloading"], noise=0.0, half_width=0.0)
    with pytest.raises(IdentificationError, match="no uncertainty to reduce"):
        plan(exact, Force(), ExponentialLaw)


def test_the_file_of_a_plan_becomes_data_with_a_column_of_forces(law, tmp_path):
    found = plan(made(law, ["loading", "unloading"]), Force(), ExponentialLaw)
    found.to_csv(tmp_path / "plan.csv")
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
        ("decay", Coefficients(("decay",))),
        ("a1, c2", Coefficients(("a1", "c2"))),
        ("coefficients", Coefficients()),
        ("force", Force()),
        ("force at 0..10 %, 3..6 bar", Force(Domain(0.0, 10 * percent, 3 * bar, 6 * bar))),
        ("force at -1 % .. 10 %, 300 kPa..6 bar", Force(Domain(-0.01, 0.1, 3 * bar, 6 * bar))),
        ("stiffness", JointStiffness(as_printed)),
        ("torque at 5 deg, 2 bar", JointTorque(as_printed, 5 * deg, (2 * bar, 2 * bar))),
        ("stiffness at 0.1 rad, 2 bar, 4 bar", JointStiffness(as_printed, 0.1, (2 * bar, 4 * bar))),
    ):
        assert str(parse_quantity_of_interest(text, ExponentialLaw, lambda: as_printed)) == str(same)
    several = parse_quantity_of_interest("stiffness at -4..4 deg, 3 bar", ExponentialLaw, lambda: as_printed)
    assert np.asarray(several.angle) / deg == pytest.approx([-4, -2, 0, 2, 4])
    assert str(several) == "stiffness at -4..4 deg, 3 bar, 3 bar"
    with pytest.raises(ParameterError, match="has braid_angle"):
        parse_quantity_of_interest("decay", ChouLaw, lambda: as_printed)


def test_states_are_multiples_of_the_steps(law):
    found = StateGrid.of(law, DesignRegion(Domain(-0.03, 0.25, 0, 6 * bar), 1 / 180, 0.5 * bar, 5.0, 600.0))
    assert len(found.pressures) == 13
    assert found.contractions[0] == pytest.approx(-5 / 180) and found.contractions[-1] == pytest.approx(45 / 180)
    force = np.asarray(law.force(found.contractions, found.pressures[:, None]))
    np.testing.assert_array_equal(found.allowed, (force > 5) & (force <= 600))


# Whether it is of use: many tests are simulated and fitted, in NumPy alone.


class Family:
    """Eq. 2, or Sarosi's law as Eq. 2 without b1; the last two parameters are the decay and the friction."""

    def __init__(self, law) -> None:
        self.sarosi = isinstance(law, SarosiLaw)
        if self.sarosi:
            self.truth = np.array([law.a6, law.a5, law.a4, law.a2, law.a1, -law.a3])
        else:
            self.truth = np.array([law.a1, law.a2, law.b1, law.b2, law.c1, law.c2, law.decay])
        self.decay, self.spring = ("a3", -1.0) if self.sarosi else ("decay", 1.0), len(self.truth) - 3

    def columns(self, c, p, falling):
        line = [p * c] if self.sarosi else [c, p * c]
        return [np.ones_like(c), p, *line, falling, p * falling]

    def force(self, theta, c, p):
        """Shape (sets, points)."""
        theta = theta[..., None]
        columns = self.columns(c, p, np.exp(-theta[..., -1, :] * c))
        return sum(theta[..., i, :] * column for i, column in enumerate(columns))

    def slope(self, theta, c, p):
        """With respect to the contraction, by a central difference."""
        c, h = np.atleast_1d(c), 1e-5
        return (self.force(theta, c + h, p) - self.force(theta, c - h, p)) / (2 * h)

    def fit(self, force, c, p, sign):
        """Least squares of many data sets at once, shape (sets, points): Gauss-Newton from the truth."""
        sets = len(force)
        theta, half = np.tile(self.truth, (sets, 1)), np.zeros((sets, 1))
        for _ in range(7):
            falling = np.exp(-theta[:, -1:] * c)
            steep = -c * falling * (theta[:, -3:-2] + theta[:, -2:-1] * p)
            rows = [*self.columns(np.broadcast_to(c, falling.shape), p, falling), steep, sign]
            rows = np.stack([np.broadcast_to(row, falling.shape) for row in rows], axis=-1)
            size = np.linalg.norm(rows, axis=1, keepdims=True)
            left = force - self.force(theta, c, p) - half * sign
            q, r = np.linalg.qr(rows / size)
            step = np.linalg.solve(r, np.einsum("sni,sn->si", q, left)[..., None])[..., 0] / size[:, 0]
            theta, half = theta + step[:, :-1], half + step[:, -1:]
            theta[:, -1] = np.clip(theta[:, -1], 0.4 * self.truth[-1], 2.5 * self.truth[-1])
        return theta


def knee_of(paper, family, theta):
    """The knee of the paper with a law of many sets of parameters."""
    knee = type(paper)(paper.connectors)
    knee.eq3 = lambda c, p, xp=np: family.force(theta, np.atleast_1d(c), p)[:, 0]
    knee.eq3_slope = lambda c, p: family.slope(theta, c, p)[:, 0]
    return knee


SETS = 400


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lei-mas-10-180n", "sarosi-dmsp-10"])
def test_planned_points_beat_as_many_evenly_spaced_ones_in_fact(name, paper, as_printed, specimen):
    truth = catalog.law(name)
    family, noise, half_width = Family(truth), 1.5, 4.0
    data = made(truth, ["loading", "unloading"], noise=noise, half_width=half_width, seed=4)
    fit, taut, rng = identify(type(truth), data), data.taut, np.random.default_rng(11)
    c, p = np.meshgrid(np.linspace(0, 0.2, 21), np.linspace(3, 6, 7) * bar)
    pulls = np.asarray(truth.force(c, p)) > 0
    region = c[pulls], p[pulls]
    exact = family.truth[None]
    limits = Domain(-0.01, 0.25, 0.5 * bar, 6 * bar)

    def spread(theta, quantity):
        """The root of the mean squared error over data sets and, of a region, its places."""
        if quantity == "all":
            scaled = (theta - exact) / np.abs(exact)
            return np.exp(np.linalg.slogdet(scaled.T @ scaled / len(theta))[1] / (2 * theta.shape[1]))
        if quantity == "decay":
            return np.sqrt(np.mean((theta[:, -1] - exact[0, -1]) ** 2))
        if quantity == "force":
            return np.sqrt(np.mean((family.force(theta, *region) - family.force(exact, *region)) ** 2))
        where = (2 * deg, (3 * bar, 4 * bar))
        found, true = (getattr(knee_of(paper, family, t), quantity)(*where) for t in (theta, exact))
        return np.sqrt(np.mean((found - true) ** 2))

    for kind, quantity in {
        "decay": Coefficients((family.decay[0],)),
        "all": Coefficients(),
        "force": Force(Domain(0, 0.2, 3 * bar, 6 * bar)),
        "stiffness": JointStiffness(as_printed, 2 * deg, (3 * bar, 4 * bar)),
        "torque": JointTorque(as_printed, 2 * deg, (3 * bar, 4 * bar)),
    }.items():
        found = plan(fit, quantity, specimen=specimen, limits=limits, stroke_error=0.0)
        realised = {}
        points = [(p.pressure, p.contraction, p.direction) for p in found.points]
        for which, more in (("planned", points), ("even", [point[:3] for point in found.even_points])):
            pressure, contraction, way = map(np.array, zip(*more, strict=True))
            pressure, contraction = np.append(taut.pressure, pressure), np.append(taut.contraction, contraction)
            sign = np.where(np.append(taut.table["direction"].to_numpy(), way) == "loading", 1.0, -1.0)
            clean = np.asarray(truth.force(contraction, pressure)) + half_width * sign
            theta = family.fit(clean + noise * rng.normal(size=(SETS, len(clean))), contraction, pressure, sign)
            realised[which] = spread(theta, kind)
        assert realised["planned"] < 0.97 * realised["even"], kind
        # In fact as in theory, as far as the plan's own estimates of law and noise go.
        promised = (found.error_after / found.error_even) / (realised["planned"] / realised["even"])
        assert promised == pytest.approx(1, abs=0.25), kind


def test_without_a_point_that_pulls_the_noise_and_the_specimen_have_to_be_given(specimen):
    slack = IsobaricDataset.of(pressure=[1e5, 2e5], contraction=[0.2, 0.2], force=[0.0, 0.0])
    with pytest.raises(IdentificationError, match="all forces are zero"):
        plan(slack, Force(), ExponentialLaw)
    with pytest.raises(RangeError, match="name the specimen"):
        plan(slack, Force(), ExponentialLaw, noise=1.0)
    found = plan(slack, Force(), ExponentialLaw, noise=1.0, specimen=specimen, points=10)
    assert np.isinf(found.error_now) and np.isfinite(found.error_after)
    assert "no point is taut: the force is not determined anywhere" in found.diagnostics
