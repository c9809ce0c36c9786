import jax
import jax.numpy as jnp
import pytest

from mckibben.control import PID, BackpropPID, Loop, Measurement, PositionStiffnessControl, Setpoint
from mckibben.control.position_stiffness import Feedforward
from mckibben.errors import RangeError
from mckibben.numerics.compiled import numeric

PERIOD = 1e-3
POSITION, STIFFNESS = PID(1.5e5, 6e5, 1e4), PID(2e3, 2e5, 0.0)


class Spy(Loop):
    """Asks for a fixed output and remembers all that it is told."""

    output: float

    def init(self, setpoint, measured, output):
        return {"started": (setpoint, measured, output)}

    def step(self, state, setpoint, measured, period):
        return {"asked": (setpoint, measured, period)}, jnp.asarray(self.output)

    def track(self, state, output, achieved, period):
        return state | {"tracked": (output, achieved, period)}

    def telemetry(self, state):
        return {}


@pytest.fixture(scope="module")
def control(knee):
    return numeric(PositionStiffnessControl(POSITION, STIFFNESS, model=knee))


def seen(angle=0.1, p1=4e5, p2=4.4e5):
    return Measurement(jnp.asarray(angle), (jnp.asarray(p1), jnp.asarray(p2)))


def setpoint(angle=0.1, stiffness=15.0):
    return Setpoint(jnp.asarray(angle), jnp.asarray(stiffness))


@jax.jit
def once(control, setpoint, measurement):
    """State and commands of the first step."""
    return control.step(control.init(measurement), setpoint, measurement, PERIOD)


@pytest.fixture(scope="module")
def spied(knee):
    def run(differential, cocontraction, measurement):
        control = PositionStiffnessControl(Spy(differential), Spy(cocontraction), model=knee)
        return control.step(control.init(measurement), setpoint(0.2, 16.0), measurement, PERIOD), control.init(
            measurement
        )

    return run


@pytest.mark.slow
def test_it_takes_over_the_pressures_as_they_are(control, knee):
    measurement = seen()
    setpoint = Setpoint(measurement.angle, knee.stiffness(measurement.angle, measurement.pressures))
    _, commands = once(control, setpoint, measurement)
    assert [float(c) for c in commands] == pytest.approx([4e5, 4.4e5], rel=1e-12)


def test_the_first_muscle_gets_the_sum_less_the_difference(spied):
    (_, commands), _ = spied(0.5e5, 3e5, seen())
    assert [float(c) for c in commands] == [2.5e5, 3.5e5]


def test_each_loop_sees_its_own_quantity(spied, knee):
    measurement = seen()
    (state, _), start = spied(0.5e5, 3e5, measurement)
    estimate = float(knee.stiffness(0.1, (4e5, 4.4e5)))
    assert float(state.estimate) == pytest.approx(estimate)
    assert [float(x) for x in start.position["started"]] == pytest.approx([0.1, 0.1, 0.2e5])
    assert [float(x) for x in start.stiffness["started"]] == pytest.approx([estimate, estimate, 4.2e5])
    assert [float(x) for x in state.position["asked"]] == pytest.approx((0.2, 0.1, PERIOD))
    assert [float(x) for x in state.stiffness["asked"]] == pytest.approx((16.0, estimate, PERIOD))


def test_both_loops_are_told_what_was_realised(spied):
    (state, commands), _ = spied(4e5, 4e5, seen())  # wants 0 and 8 bar; there are 6
    assert [float(c) for c in commands] == [0.0, 6e5]
    assert [float(x) for x in state.position["tracked"]] == pytest.approx([4e5, 3e5, PERIOD])
    assert [float(x) for x in state.stiffness["tracked"]] == pytest.approx([4e5, 3e5, PERIOD])


@pytest.mark.parametrize("stiffness", [-1e6, 0.0, 15.0, 1e6])
@pytest.mark.parametrize("angle", [-50.0, 0.0, 50.0])
def test_commands_stay_within_the_limits_of_the_muscles(control, angle, stiffness):
    _, commands = once(control, setpoint(angle, stiffness), seen())
    assert all(0.0 <= float(c) <= 6e5 for c in commands)


def test_telemetry_names_the_estimate_and_the_gains_of_learning_loops(knee):
    learner = BackpropPID(POSITION, signal_scale=0.2, error_scale=0.02, output_scale=1e5)
    control = numeric(PositionStiffnessControl(learner, STIFFNESS, model=knee))
    state, _ = once(control, setpoint(), seen())
    telemetry = control.telemetry(state)
    assert set(telemetry) == {"stiffness_estimate", "saturated", "position_kp", "position_ki", "position_kd"}
    assert float(telemetry["position_kp"]) == pytest.approx(1.5e5)


def test_what_is_given_beside_the_loops_is_added_and_the_loops_are_told_of_their_own_part(knee):
    control = PositionStiffnessControl(Spy(0.5e5), Spy(1e5), model=knee)
    forward = Feedforward(*map(jnp.asarray, (0.25e5, 2e5, 0.04)))
    state, commands = control.step_with(forward, control.init(seen()), setpoint(0.2, 16.0), seen(), PERIOD)
    assert [float(c) for c in commands] == [2.25e5, 3.75e5]
    assert [float(x) for x in state.position["asked"][:2]] == pytest.approx([0.16, 0.06])
    assert [float(x) for x in state.position["tracked"][:2]] == [0.5e5, 0.5e5]
    assert [float(x) for x in state.stiffness["tracked"][:2]] == [1e5, 1e5]
    start = control.init_with(forward, seen())
    assert [float(x) for x in start.position["started"]] == pytest.approx([0.06, 0.06, -0.05e5])
    assert float(start.stiffness["started"][2]) == pytest.approx(2.2e5)


def test_the_differential_pressure_goes_before_the_cocontraction(knee):
    """At a minimum tension each muscle has a lowest pressure; the loops are told what came of it."""
    control = numeric(PositionStiffnessControl(Spy(0.3e5), Spy(1e5), model=knee, minimum_tension=8.0))
    state, (command1, command2) = once(control, setpoint(), seen())
    assert float(command2 - command1) / 2 == pytest.approx(0.3e5)
    tensions = [float(t) for t in knee.tensions(0.1, (command1, command2))]
    assert min(tensions) == pytest.approx(8.0, rel=1e-6) and bool(state.saturated)
    assert float(state.position["tracked"][1]) == pytest.approx(0.3e5)
    assert float(state.stiffness["tracked"][1]) == pytest.approx(float(command1 + command2) / 2)
    assert float(command1 + command2) / 2 > 1e5
    far = numeric(PositionStiffnessControl(Spy(9e5), Spy(3e5), model=knee, minimum_tension=8.0))
    _, commands = once(far, setpoint(), seen())
    taut = [float(t) for t in knee.tensions(0.1, commands)]
    assert taut[0] == pytest.approx(8.0, rel=1e-6) and taut[1] <= knee.muscle2.specimen.rated_force * (1 + 1e-9)
    with pytest.raises(RangeError, match="minimum_tension is 0 N"):
        PositionStiffnessControl(POSITION, STIFFNESS, model=knee, minimum_tension=0.0)
