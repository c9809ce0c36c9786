"""Control-limited differential dynamic programming for a joint's tracking error over a receding horizon.

State x: errors of angle, velocity, acceleration and stiffness. Input u: the pressures at the end of a stage. All are
dimensionless. The limits of the input depend on the state.

Matrices are tuples of rows of scalars, which XLA compiles to straight-line code; a structural zero is the integer 0,
whose products are left out.

Y. Tassa, N. Mansard and E. Todorov, Control-limited differential dynamic programming, ICRA 2014.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator.base import Attainable
from mckibben.joint.geometry import Pair
from mckibben.numerics.calculus import value_and_derivative

Scalar = Float[Array, ""]
State = tuple[Scalar, Scalar, Scalar, Scalar]
"""Angle, velocity, acceleration and stiffness; of a reference, jerk in place of the stiffness."""
Vector = PyTree
Matrix = PyTree

_SINGULAR = 1e-6  # least determinant of a 2x2 matrix over the product of its diagonal, for solving


# Tuple algebra


def add(a: Vector, b: Vector) -> Vector:
    """Sum of two vectors or matrices."""
    return jax.tree.map(lambda x, y: x + y, a, b)


def subtract(a: Vector, b: Vector) -> Vector:
    """Difference of two vectors or matrices."""
    return jax.tree.map(lambda x, y: x - y, a, b)


def where(condition: Array, a: Vector, b: Vector) -> Vector:
    """One of two vectors or matrices."""
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)


def scale(factor: ArrayLike, a: Vector) -> Vector:
    """A vector or matrix times a scalar."""
    return jax.tree.map(lambda x: x if isinstance(x, int) else factor * x, a)


def dot(a: Vector, b: Vector) -> Scalar:
    """Scalar product."""
    pairs = zip(a, b, strict=True)
    return sum(x * y for x, y in pairs if not (isinstance(x, int) or isinstance(y, int)))  # type: ignore


def transpose(a: Matrix) -> Matrix:
    """Rows to columns."""
    return tuple(zip(*a, strict=True))


def matvec(a: Matrix, b: Vector) -> Vector:
    """Matrix times vector."""
    return tuple(dot(row, b) for row in a)


def matmul(a: Matrix, b: Matrix) -> Matrix:
    """Matrix times matrix."""
    return tuple(tuple(dot(row, column) for column in transpose(b)) for row in a)


def symmetric(size: int, entry: Callable[[int, int], Scalar]) -> Matrix:
    """Symmetric matrix from its upper triangle, which saves a fifth of the time of a full product."""
    upper = {(i, j): entry(i, j) for i in range(size) for j in range(i, size)}
    return tuple(tuple(upper[min(i, j), max(i, j)] for j in range(size)) for i in range(size))


def quadratic_form(a: Matrix, m: Matrix) -> Matrix:
    """Product a' m a of a symmetric m."""
    columns, products = transpose(a), transpose(matmul(m, a))
    return symmetric(len(columns), lambda i, j: dot(columns[i], products[j]))


def diagonal(*entries: ArrayLike) -> Matrix:
    """Diagonal matrix."""
    return tuple(tuple(entry if i == j else 0 for j in range(len(entries))) for i, entry in enumerate(entries))


def solve_2x2(m: Matrix, b: Matrix) -> Matrix:
    """m^-1 b, of a symmetric positive definite m; regularised where it is nearly singular."""
    (m11, m12), (_, m22) = m
    inverse = 1 / jnp.maximum(m11 * m22 - m12**2, _SINGULAR * m11 * m22)  # of the determinant
    return scale(inverse, matmul(((m22, -m12), (-m12, m11)), b))


# Problem


class Quadratic(NamedTuple):
    """Second-order expansion of a quantity in the angle."""

    value: ArrayLike
    slope: ArrayLike = 0.0
    curvature: ArrayLike = 0.0

    def __call__(self, angle: ArrayLike) -> Scalar:
        """Value at an angle from the expansion point."""
        return jnp.asarray(self.value + angle * (self.slope + angle * self.curvature / 2))


class HorizonProblem(NamedTuple):
    """Optimal control problem over the horizon, dimensionless: time in 1/omega_c, errors over their scales."""

    # With x at the beginning and y at the end of stage k, the cost is the sum of
    #   h/2 (y0^2 + d (d - 2) (y1^2 + y2^2) + y3^2) + 1/(2h) ((y2 - x2)^2 + rho (y3 - x3)^2)
    # and x' P x / 2 after the last stage, P being the cost of the unconstrained loop after the horizon.

    stage: ArrayLike  # h, its duration
    hold_weights: tuple[ArrayLike, ArrayLike]  # of a change of acceleration in velocity and angle: ramp (1/2, 1/3)
    damping: ArrayLike  # d, 2 to 3
    bandwidth_ratio_sq: ArrayLike  # rho = (omega_c / omega_K)^2
    acceleration: tuple[Quadratic, Quadratic, Quadratic]  # coefficients (offset, p1, p2)
    stiffness: tuple[Quadratic, Quadratic, Quadratic]  # the same, for the stiffness minus the setpoint
    drag: ArrayLike  # deceleration per velocity
    reference: State  # from now to the end of each stage, (stages + 1,); angles count from the measured one
    setpoints: Array  # of the stiffness then, minus that of now
    pressure_lower: tuple[Quadratic, Quadratic]  # at the end of a stage
    pressure_upper: tuple[Quadratic, Quadratic]
    attainable: tuple[Attainable, Attainable]  # after a stage
    residuals: Callable[[State, Pair, State, Scalar], tuple[Scalar, ...]] | None = None
    # of y, the pressures, reference and setpoint at the end of a stage; h/2 times their squares add to the cost

    def outputs(self, angle: Scalar, velocity: Scalar, pressures: Pair) -> Pair:
        """Acceleration of the joint, and its stiffness minus the setpoint."""
        (a0, a1, a2), (s0, s1, s2) = (
            [coefficient(angle) for coefficient in coefficients] for coefficients in (self.acceleration, self.stiffness)
        )
        p1, p2 = pressures
        return a0 + a1 * p1 + a2 * p2 - self.drag * velocity, s0 + s1 * p1 + s2 * p2

    def limits(self, angle: Scalar, previous: Pair) -> tuple[Pair, Pair]:
        """Lower and upper limits of the pressures after a stage; the speed of the valves takes precedence."""

        def of_muscle(i: int) -> Pair:
            slowest, fastest = self.attainable[i](previous[i])
            upper = _larger(_smaller(self.pressure_upper[i](angle), fastest), slowest)
            return _smaller(_larger(self.pressure_lower[i](angle), slowest), upper), upper

        return transpose((of_muscle(0), of_muscle(1)))

    def limits_previous(self, angle: Scalar, previous: Pair) -> tuple[Pair, Pair]:
        """Derivative of each limit with respect to the same pressure a stage before."""
        directions = tuple(map(jnp.ones_like, previous))
        return jax.jvp(lambda p: self.limits(angle, p), (previous,), (directions,))[1]

    def terminal_hessian(self) -> Matrix:
        """P, of a triple integrator and an integrator."""
        unity = jnp.ones_like(self.reference[0][0])
        zero, d, root = 0 * unity, self.damping * unity, jnp.sqrt(self.bandwidth_ratio_sq * unity)
        return (d, d, unity, zero), (d, d**2 - 1, d, zero), (unity, d, d, zero), (zero, zero, zero, root)


def _smaller(a: Scalar, b: Scalar) -> Scalar:
    return jnp.where(a < b, a, b)  # differentiates to one of both, unlike `jnp.minimum`


def _larger(a: Scalar, b: Scalar) -> Scalar:
    return jnp.where(a > b, a, b)


class Policy(NamedTuple):
    """u = offset + gain x at each stage; leaves have shape (stages,)."""

    offset: Pair
    gain: tuple[State, State]


def constant(pressures: Pair, stages: int) -> Policy:
    """The policy that keeps constant pressures."""
    zero = jnp.zeros(stages, pressures[0].dtype)
    row = zero, zero, zero, zero
    return Policy((zero + pressures[0], zero + pressures[1]), (row, row))


def shift(policy: Policy, fraction: ArrayLike) -> Policy:
    """Warm start: the policy after a fraction of a stage has passed."""
    return jax.tree.map(lambda leaf: leaf + fraction * (jnp.append(leaf[1:], leaf[-1:]) - leaf), policy)


def extrapolate(reference: State, stage: Scalar, frequency_sq: Scalar, stages: int) -> State:
    """Reference from now to the end of each stage, (stages + 1,), with a frequency of its acceleration; 0 for none."""
    h, q = stage, frequency_sq * stage**2  # series of sine and cosine in the phase of a stage
    sine, twice = 1 - q / 6 * (1 - q / 20), 1 / 2 - q / 24 * (1 - q / 30)
    thrice = 1 / 6 - q / 120 * (1 - q / 42)

    def after(reference: State, _: None) -> tuple[State, State]:
        angle, velocity, acceleration, jerk = reference
        following = (
            angle + h * (velocity + h * (acceleration * twice + h * jerk * thrice)),
            velocity + h * (acceleration * sine + h * jerk * twice),
            acceleration * (1 - q * twice) + h * jerk * sine,
            jerk * (1 - q * twice) - frequency_sq * h * sine * acceleration,
        )
        return following, following

    later = lax.scan(after, reference, length=stages)[1]
    return jax.tree.map(lambda first, following: jnp.append(first, following), reference, later)


# Solution


class Stage(NamedTuple):
    """Stage of the nominal trajectory, from x to y, with derivatives of its outputs and limits."""

    x: State
    u: Pair
    y: State
    previous_x: Matrix  # derivative of the pressures at the beginning
    outputs_angle: Pair  # of acceleration and stiffness at the end
    outputs_u: Matrix
    lower: Pair  # of u
    upper: Pair
    lower_angle: Pair  # with respect to the angle at the end
    upper_angle: Pair
    lower_previous: Pair  # with respect to the same pressure at the beginning
    upper_previous: Pair
    residuals: tuple[tuple[Scalar, ...], Matrix, Matrix] = ((), (), ())  # with derivatives by y and u


class StageExpansion(NamedTuple):
    """First-order expansion of a stage's dynamics y = f(x, u) and limits, second-order of its cost l(x, y)."""

    f_x: Matrix
    f_u: Matrix
    l_x: Vector
    l_y: Vector
    l_xx: Matrix
    l_yx: Matrix
    l_yy: Matrix
    lower_x: Matrix
    upper_x: Matrix


class ValueExpansion(NamedTuple):
    """Second-order expansion of the cost to go."""

    gradient: Vector
    hessian: Matrix


def rollout(problem: HorizonProblem, state: State, pressures: Pair, policy: Policy) -> Stage:
    """Nominal trajectory under a policy; leaves have shape (stages,)."""
    h, (mu1, mu2) = jnp.asarray(problem.stage), problem.hold_weights

    def stage(carry: tuple[PyTree, ...], at: tuple[Policy, PyTree, PyTree]) -> tuple[tuple[PyTree, ...], Stage]:
        (x, previous, previous_x), (policy, (*reference, setpoint), (*following, setpoint_after)) = carry, at
        x = *x[:3], x[3] + (setpoint - setpoint_after)  # its rate is that of the stiffness
        angle, velocity = x[0] + h * (x[1] + h / 2 * x[2]), x[1] + h * x[2]  # at constant acceleration
        # The acceleration of the joint changes by the hold weights, that of the reference as it does, or by a jump.
        change = following[2] - reference[2]
        drift = reference[0] + h * (reference[1] + h / 2 * (reference[2] + mu2 * change)) - following[0]
        drift_rate = reference[1] + h * (reference[2] + mu1 * change) - following[1]
        end, speed = following[0] + angle + drift, following[1] + velocity + drift_rate

        asked = add(policy.offset, matvec(policy.gain, x))
        limit, limit_angle = value_and_derivative(lambda at: problem.limits(at, previous), end)
        limit_previous = problem.limits_previous(end, previous)
        u = jax.tree.map(jnp.clip, asked, *limit)

        (acceleration, stiffness), outputs_angle = value_and_derivative(lambda at: problem.outputs(at, speed, u), end)
        outputs_u = tuple(tuple(c(end) for c in row[1:]) for row in (problem.acceleration, problem.stiffness))
        acceleration, stiffness = acceleration - following[2], stiffness - setpoint_after
        jump = acceleration - x[2]
        y = angle + h**2 / 2 * mu2 * jump + drift, velocity + h * mu1 * jump + drift_rate, acceleration, stiffness

        expanded = Stage(x, u, y, previous_x, outputs_angle, outputs_u, *limit, *limit_angle, *limit_previous)
        if (residuals := problem.residuals) is not None:
            later: Any = tuple(following)
            of_both = lambda y, u: residuals(y, u, later, setpoint_after)  # noqa: E731
            expanded = expanded._replace(residuals=_with_slopes(of_both, y, u))
        return (y, u, _pressures_x(problem, outputs_angle, outputs_u)), expanded

    zero = jnp.zeros_like(state[0])
    fixed, signals = (zero, zero, zero, zero), (*problem.reference, problem.setpoints)
    here, later = (tuple(signal[part] for signal in signals) for part in (slice(-1), slice(1, None)))
    return lax.scan(stage, (state, pressures, (fixed, fixed)), (policy, here, later))[1]


def _with_slopes(
    residuals: Callable[[State, Pair], tuple[Scalar, ...]], y: State, u: Pair
) -> tuple[tuple[Scalar, ...], Matrix, Matrix]:
    """Residuals, and their derivatives with respect to the state and the pressures, a row for each residual."""
    directions = jax.tree.map(lambda entry: entry * jnp.ones_like(y[0]), diagonal(*[1.0] * 6))
    values, columns = (), []
    for direction in directions:
        values, column = jax.jvp(residuals, (y, u), (direction[:4], direction[4:]))
        columns.append(column)
    rows = transpose(columns)
    return values, tuple(row[:4] for row in rows), tuple(row[4:] for row in rows)


def _pressures_x(problem: HorizonProblem, outputs_angle: Pair, outputs_u: Matrix) -> Matrix:
    """Derivative of the pressures with respect to the state at the same instant, by the implicit function theorem."""
    (a1, a2), (s1, s2) = outputs_u
    determinant = a1 * s2 - a2 * s1
    least = 1e-3 * (jnp.abs(a1 * s2) + jnp.abs(a2 * s1)) + 1e-12  # where pressures hardly change the stiffness
    determinant = jnp.where(determinant > 0, jnp.maximum(determinant, least), jnp.minimum(determinant, -least))
    inverse = scale(1 / determinant, ((s2, -a2), (-s1, a1)))
    return tuple((-dot(row, outputs_angle), row[0] * problem.drag, *row) for row in inverse)


def expand(problem: HorizonProblem, at: Stage) -> StageExpansion:
    """Expansion about a stage of the nominal trajectory."""
    h, d, rho, drag = map(jnp.asarray, (problem.stage, problem.damping, problem.bandwidth_ratio_sq, problem.drag))
    (mu1, mu2), (a_angle, s_angle) = problem.hold_weights, at.outputs_angle
    angle_x, velocity_x = (1.0, h, h**2 / 2, 0), (0, 1.0, h, 0)
    acceleration_x = a_angle, a_angle * h - drag, a_angle * h**2 / 2 - drag * h, 0
    jump_x = *acceleration_x[:2], acceleration_x[2] - 1, 0
    acceleration_u, stiffness_u = at.outputs_u
    between, rates = h * d * (d - 2), ((at.y[2] - at.x[2]) / h, rho * (at.y[3] - at.x[3]) / h)
    return StageExpansion(
        f_x=(
            add(angle_x, scale(h**2 / 2 * mu2, jump_x)),
            add(velocity_x, scale(h * mu1, jump_x)),
            acceleration_x,
            scale(s_angle, angle_x),
        ),
        f_u=(scale(h**2 / 2 * mu2, acceleration_u), scale(h * mu1, acceleration_u), acceleration_u, stiffness_u),
        l_x=(0, 0, -rates[0], -rates[1]),
        l_y=(h * at.y[0], between * at.y[1], between * at.y[2] + rates[0], h * at.y[3] + rates[1]),
        l_xx=diagonal(0, 0, 1 / h, rho / h),
        l_yx=diagonal(0, 0, -1 / h, -rho / h),
        l_yy=diagonal(h, between, between + 1 / h, h + rho / h),
        lower_x=_limits_x(angle_x, at.previous_x, at.lower_angle, at.lower_previous),
        upper_x=_limits_x(angle_x, at.previous_x, at.upper_angle, at.upper_previous),
    )


def _limits_x(angle_x: Vector, previous_x: Matrix, by_angle: Pair, by_previous: Pair) -> Matrix:
    """Derivative of both limits with respect to the state at the beginning."""
    return tuple(
        add(scale(slope, angle_x), scale(factor, row))
        for slope, factor, row in zip(by_angle, by_previous, previous_x, strict=True)
    )


def backward_pass(problem: HorizonProblem, trajectory: Stage) -> tuple[Policy, tuple[Pair, Pair]]:
    """Improved policy about a trajectory; inputs of each stage at nominal states, and whether each is clamped."""

    def stage(value: ValueExpansion, at: Stage) -> tuple[ValueExpansion, tuple[Policy, tuple[Pair, Pair]]]:
        f_x, f_u, l_x, l_y, l_xx, l_yx, l_yy, lower_x, upper_x = expand(problem, at)
        v_y, v_yy = add(l_y, value.gradient), add(l_yy, value.hessian)
        v_yx = add(matmul(v_yy, f_x), l_yx)
        f_x_columns, f_u_columns, v_yx_columns = map(transpose, (f_x, f_u, v_yx))

        q_x = add(l_x, matvec(f_x_columns, v_y))
        q_u = matvec(f_u_columns, v_y)
        q_ux = matmul(f_u_columns, v_yx)
        q_uu = quadratic_form(f_u, v_yy)
        q_xx = symmetric(
            4, lambda i, j: l_xx[i][j] + dot(f_x_columns[i], v_yx_columns[j]) + dot(transpose(l_yx)[i], f_x_columns[j])
        )
        for residual, by_y, by_u in zip(*at.residuals, strict=True):  # Gauss-Newton
            r_x, r_u, h = matvec(f_x_columns, by_y), add(by_u, matvec(f_u_columns, by_y)), problem.stage
            q_x, q_u = add(q_x, scale(h * residual, r_x)), add(q_u, scale(h * residual, r_u))
            q_uu, q_ux, q_xx = (
                add(q, tuple(scale(h * x, b) for x in a))
                for q, a, b in ((q_uu, r_u, r_u), (q_ux, r_u, r_x), (q_xx, r_x, r_x))
            )

        lower, upper = subtract(at.lower, at.u), subtract(at.upper, at.u)
        step, free = box_qp(q_uu, q_u, lower, upper)
        limit_x = tuple(where(step[i] <= lower[i], lower_x[i], upper_x[i]) for i in range(2))
        gain = feedback_gain(q_uu, q_ux, free, limit_x)

        gain_columns, q_ux_columns = transpose(gain), transpose(q_ux)
        q_u_x_columns = transpose(add(matmul(q_uu, gain), q_ux))
        gradient = add(q_x, add(matvec(gain_columns, add(q_u, matvec(q_uu, step))), matvec(q_ux_columns, step)))
        hessian = symmetric(
            4, lambda i, j: q_xx[i][j] + dot(gain_columns[i], q_u_x_columns[j]) + dot(q_ux_columns[i], gain_columns[j])
        )
        u = add(at.u, step)
        offset = subtract(u, matvec(gain, at.x))
        return ValueExpansion(gradient, hessian), (Policy(offset, gain), (u, (~free[0], ~free[1])))

    terminal = problem.terminal_hessian()
    last = jax.tree.map(lambda values: values[-1], trajectory.y)
    return lax.scan(stage, ValueExpansion(matvec(terminal, last), terminal), trajectory, reverse=True)[1]


def box_qp(hessian: Matrix, gradient: Vector, lower: Pair, upper: Pair) -> tuple[Pair, tuple[Array, Array]]:
    """Minimum of gradient' u + u' hessian u / 2 over a box in two dimensions; and which inputs are free."""
    unconstrained = tuple(row[0] for row in solve_2x2(hessian, tuple((-g,) for g in gradient)))

    def clamped(i: int) -> tuple[Pair, tuple[Array, Array]]:
        """Input i clamped to its limits, and then the other."""
        j = 1 - i
        first = jnp.clip(unconstrained[i], lower[i], upper[i])
        best = -(gradient[j] + hessian[j][i] * first) / hessian[j][j]
        second = jnp.clip(best, lower[j], upper[j])
        free = first == unconstrained[i], second == best
        return ((first, second), free) if i == 0 else ((second, first), free[::-1])

    def cost(u: Pair) -> Scalar:
        return dot(gradient, u) + dot(u, matvec(hessian, u)) / 2

    a, b = clamped(0), clamped(1)
    return where(cost(a[0]) <= cost(b[0]), a, b)


def feedback_gain(hessian: Matrix, cross: Matrix, free: tuple[Array, Array], limit_x: Matrix) -> Matrix:
    """Derivative of the constrained minimum with respect to the state: that of the limit for a clamped input."""
    both = solve_2x2(hessian, tuple(tuple(-c for c in row) for row in cross))

    def row(i: int) -> Vector:
        j, inverse = 1 - i, 1 / hessian[i][i]
        alone = tuple(-inverse * (c + hessian[i][j] * x) for c, x in zip(cross[i], limit_x[j], strict=True))
        return where(free[i], where(free[j], both[i], alone), limit_x[i])

    return row(0), row(1)


class FirstCommand(NamedTuple):
    """Pressures at the end of the first stage, and whether each is clamped."""

    pressures: Pair
    limited: Pair


def solve(
    problem: HorizonProblem, state: State, pressures: Pair, policy: Policy, iterations: int
) -> tuple[Policy, FirstCommand]:
    """Policy that minimises the cost, by one Newton step or more from a guess, and its first input."""

    def iterate(_: ArrayLike, last: tuple[Policy, FirstCommand]) -> tuple[Policy, FirstCommand]:
        trajectory = rollout(problem, state, pressures, last[0])
        policy, (inputs, limited) = backward_pass(problem, trajectory)
        return policy, FirstCommand((inputs[0][0], inputs[1][0]), (limited[0][0], limited[1][0]))

    free = jnp.zeros_like(state[0], bool)
    initial = policy, FirstCommand(pressures, (free, free))
    return lax.fori_loop(0, iterations, iterate, initial)
