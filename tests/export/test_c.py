"""Controllers as C99: all of the comparison compile without warnings, and repeat the recorded run."""

import importlib
import re
import shutil
import subprocess
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.codegen import write_c
from mckibben.codegen.c import comment_text
from mckibben.codegen.native import compiler
from mckibben.errors import ExportError, ParameterError
from mckibben.export import export
from mckibben.export.containment.limits import Limits
from mckibben.export.controller import controller_functions, controller_program
from mckibben.export.hardware import Hardware
from mckibben.serial_protocol import FaultCode, FirmwareState

pytestmark = pytest.mark.skipif(compiler() is None or shutil.which("make") is None, reason="there is no cc or make")
REPLAYED = {
    "PID": Hardware(),
    "decoupling, friction fed forward": Hardware(),
    "predictive": Hardware(),
    "sliding mode": Hardware(single=True),
}
NO_FAULTS = ("predictive",)
"""Its program takes longest to compile, and contains faults by the same functions."""


@pytest.fixture(scope="module")
def board():
    """The benchmark of microcontrollers."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend("benchmarks")
        return importlib.import_module("microcontroller")


@pytest.fixture(scope="module")
def scenarios(board):
    """A short run of each controller of the comparison."""
    return board.scenarios(0.3)


FAULTS = Path(__file__).with_name("faults.c").read_text(encoding="utf-8")
BAD = (np.nan, np.inf, -np.inf, 1.7e308, -1e7, 1e7)
INPUTS = """
    setpoint.angle setpoint.stiffness measurement.angle measurement.pressures_0 measurement.pressures_1
""".split()
RUNNING, VENTED, FROZEN = FirmwareState.RUNNING, FirmwareState.VENTED, FaultCode.FROZEN


def faulty(samples, faults=2_500, seed=1):
    """Rows of samples with random faults at their inputs: bad numbers, stuck ones, or no sample (last column is 1)."""
    draw = np.random.default_rng(seed)
    lengths, gaps = draw.geometric(1 / 15, faults), draw.geometric(1 / 10, faults) + 300 * (draw.random(faults) < 0.05)
    starts = np.cumsum(gaps + lengths) - lengths
    total = starts[-1] + lengths[-1]
    rows = np.column_stack([np.resize(samples, (total, samples.shape[1])), np.zeros(total)])
    bad = np.zeros(total, bool)
    inputs, kinds = draw.integers(0, samples.shape[1], faults), draw.integers(0, len(BAD) + 2, faults)
    for start, length, which, kind in zip(starts, lengths, inputs, kinds, strict=True):
        during = slice(start, start + length)
        bad[during] = kind <= len(BAD)
        if kind < len(BAD):
            rows[during, which] = BAD[kind]
        elif kind == len(BAD):
            rows[during, -1] = 1
        else:
            rows[during, which] = rows[start - 1, which]
    return rows, bad


def program_in_c(folder, period, options, number):
    """Commands, status and fault of each row by the exported program."""
    assign = [f"{name} = ({'double' if 'setpoint' in name else number})row[{i}];" for i, name in enumerate(INPUTS)]
    words = {"ROW": str(len(INPUTS) + 1), "PERIOD": repr(period), "NUMBER": number, "ASSIGN": " ".join(assign)}
    program = re.sub(rf"\b({'|'.join(words)})\b", lambda match: words[match[1]], FAULTS)
    (folder / "faults.c").write_text(program)
    command = [compiler(), *options, "-O1", "-fsanitize=address,undefined", "-o", "faults", "faults.c", "knee.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True)

    def outputs(rows):
        done = subprocess.run(["./faults"], cwd=folder, input=rows.tobytes(), capture_output=True)
        assert (done.returncode, done.stderr) == (0, b"")
        return np.frombuffer(done.stdout).reshape(-1, 4)

    return outputs


def program_in_python(source):
    """The same by the functions from which the program was made."""

    def period(state, row):
        setpoint = source.setpoint._replace(angle=row[0], stiffness=row[1])
        measurement = source.measurement._replace(angle=row[2], pressures=(row[3], row[4]))
        done = lax.cond(
            row[5] > 0,
            lambda: source.hold(source.parameters, state),
            lambda: source.contained(source.parameters, state, setpoint, measurement),
        )
        told = done["telemetry"]
        return done["state"], jnp.stack([*done["commands"].values(), told["status"] * 1.0, told["fault"] * 1.0])

    @jax.jit
    def outputs(rows):
        first = source.measurement._replace(angle=rows[0, 2], pressures=(rows[0, 3], rows[0, 4]))
        return lax.scan(period, source.start(source.parameters, first), rows)[1]

    return outputs


def check_faults(folder, scenario, options, hardware):
    """No command is not finite or outside its limits, a lasting fault vents, and Python computes the same."""
    rows, bad = faulty(np.genfromtxt(folder / "replay.csv", delimiter=",", skip_header=2)[:, : len(INPUTS)])
    found = program_in_c(folder, scenario.control_period, options, "float" if hardware.single else "double")(rows)
    highest = max(muscle.specimen.domain.pressure_max for muscle in scenario.plant().muscles)
    assert np.all((found[:, :2] >= 0) & (found[:, :2] <= highest))
    periods = round(0.1 / scenario.control_period)
    lasting = np.convolve(bad, np.ones(periods))[: len(bad)] > periods - 0.5
    assert np.count_nonzero(lasting) > 5
    assert np.all(found[lasting, :2] == 0)
    assert set(found[:, 2]) == {1, 2, 3, 4} and set(found[:, 3]) >= {0, 1, 2, 4}
    if not hardware.single:
        expected = np.asarray(program_in_python(controller_functions(scenario, hardware.limits))(rows))
        assert np.array_equal(found[:, 2:], expected[:, 2:])
        assert np.max(np.abs(found - expected)) < 1e-6 * highest


@pytest.mark.parametrize("name", REPLAYED)
@pytest.mark.slow
def test_it_repeats_the_recorded_run_and_contains_faults(board, scenarios, name, tmp_path):
    export(scenarios[name], "c", tmp_path, name="knee", hardware=REPLAYED[name])
    subprocess.run(["make", "-s", "replay"], cwd=tmp_path, check=True)
    done = subprocess.run(["./replay", "replay.csv", "0"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert float(done.stdout.split(",")[1].split()[0]) < (1e-4 if REPLAYED[name].single else 1e-11)
    assert "not used" not in done.stdout
    if name not in NO_FAULTS:
        check_faults(tmp_path, scenarios[name], board.STRICT, REPLAYED[name])


@pytest.mark.slow
def test_a_frozen_sensor_vents_until_it_moves_again(scenarios):
    """Each sensor, while the commands move; then a ramp, at whose end the controller is as one that began there."""
    scenario = scenarios["PID"]
    outputs = program_in_python(controller_functions(scenario, Limits(moved=0.01, ramp=0.1)))
    draw, periods = np.random.default_rng(1), round(0.6 / scenario.control_period)
    rows = np.zeros((2 * periods, 6))
    rows[:, 0], rows[:, 1] = 0.1 * np.sin(np.arange(2 * periods) * scenario.control_period * 20), 15.0
    rows[:, 2:5] = [0.0, 2e5, 2e5] + draw.normal(size=(2 * periods, 3)) * [1e-4, 1e3, 1e3]
    for stuck in range(2, 5):
        frozen = rows.copy()
        frozen[:periods, stuck] = rows[0, stuck]
        found = np.asarray(outputs(frozen))
        assert found[periods - 1].tolist() == [0, 0, VENTED, FROZEN]
        assert found[periods + round(0.2 / scenario.control_period), 2] == RUNNING
        frozen[:periods, stuck] += draw.normal(size=periods) * 1e-6
        assert not np.any(outputs(frozen)[:, 3])


@pytest.mark.slow
def test_a_stuck_angle_vents_a_set_time_after_the_commands_moved(scenarios):
    """However long the controller takes to move them: longer where the error is small."""
    scenario, draw = scenarios["PID"], np.random.default_rng(1)
    period, limits = scenario.control_period, Limits()
    highest = min(muscle.specimen.domain.pressure_max for muscle in scenario.plant().muscles)
    outputs, count, delays = program_in_python(controller_functions(scenario)), round(8.0 / period), []
    for error in (0.1, 0.01):
        rows = np.zeros((count, 6))
        rows[:, 0], rows[:, 1] = error, 15.0
        rows[:, 3:5] = 2e5 + 1e3 * draw.normal(size=(count, 2))
        found = np.asarray(outputs(rows))
        vented = int(np.argmax(found[:, 2] == VENTED))
        assert found[vented, 3] == FROZEN
        apart = (found[:vented, 1] - found[:vented, 0]) / 2
        moved = int(np.argmax(np.abs(apart - apart[0]) > limits.moved * highest))
        assert (vented - moved) * period == pytest.approx(limits.frozen + limits.tolerated, abs=0.02)
        delays.append(vented * period)
    assert delays == pytest.approx([0.4, 1.3], abs=0.05)  # docs/serial-protocol.md


DUTY = {(48, 1): 0.06, (3, 1): 0.2, (1, 1): 0.12, (20, 20): 1.3, (1, 2): None, (2, 3): None, (1, 9): None}
"""Periods of bad and good samples in turn, and the time [s] within which they vent."""


@pytest.mark.slow
def test_a_fault_that_comes_and_goes_vents_if_it_takes_half_of_the_samples(board, scenarios, tmp_path):
    scenario = scenarios["PID"]
    export(scenario, "c", tmp_path, name="knee")
    samples = np.genfromtxt(tmp_path / "replay.csv", delimiter=",", skip_header=2)[:, : len(INPUTS)]
    period, outputs = scenario.control_period, program_in_python(controller_functions(scenario))
    in_c = program_in_c(tmp_path, period, board.STRICT, "double")
    times, draw = np.arange(round(2.0 / period)) * period, np.random.default_rng(1)
    faulty_rows = []
    for bad, good in DUTY:
        rows = np.column_stack([np.resize(samples, (len(times), samples.shape[1])), np.zeros(len(times))])
        wrong = np.flatnonzero((np.arange(len(times)) % (bad + good) < bad) & (times > 0) & (times < 1.5))
        for kinds in (wrong[::2], wrong[1::2]):  # any fault counts, also in turns
            which = draw.integers(2, 6)
            rows[kinds, which] = 1 if which == 5 else np.nan
        faulty_rows.append(rows)
    for rows, within in zip(faulty_rows, DUTY.values(), strict=True):
        status, commands = (found := in_c(rows))[:, 2], found[:, :2]
        assert np.array_equal(found[:, 2:], np.asarray(outputs(rows))[:, 2:])
        vented = times[status == VENTED]
        if within is None:
            assert not vented.size
            continue
        assert vented[0] < within and np.all(commands[status == VENTED] == 0)
        assert np.all(status[(times > vented[0]) & (times < 1.5)] == VENTED)  # no restart between two faults
        assert status[times > 1.6][0] != VENTED


@pytest.mark.slow
def test_a_run_outside_the_limits_is_not_exported(scenarios, tmp_path):
    with pytest.raises(ExportError) as caught:
        export(scenarios["PID"], "c", tmp_path / "out", hardware=Hardware(limits=Limits(highest_pressure=1e5)))
    assert caught.value.field.startswith("measurement.pressures") and caught.value.value > 1e5
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_all_compile_without_warnings(board, scenarios, tmp_path):
    for name in scenarios.keys() - (REPLAYED.keys() - NO_FAULTS) | {"PID"}:  # the others are compiled above
        module, _ = controller_program(controller_functions(scenarios[name]), "knee")
        for file, text in zip(("knee.h", "knee.c"), write_c(module), strict=True):
            (tmp_path / file).write_text(text)
        command = [compiler(), *board.STRICT, "-O0", "-c", "-o", "knee.o", "knee.c"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, ""), name
        symbols = subprocess.run(
            ["nm", "-u", "knee.o"], cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout
        assert not {"malloc", "calloc", "printf"} & set(symbols.split())


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("arm-none-eabi-gcc") is None, reason="there is no arm-none-eabi-gcc")
def test_it_fits_a_cortex_m7_and_runs_there(board, scenarios, tmp_path):
    linked = []
    for single in (True, False):
        hardware = Hardware(single=single)
        export(scenarios["PID"], "c", tmp_path, name="knee", hardware=hardware, overwrite=True)
        linked.append([board.linked(tmp_path, processor, "knee") for processor in ("M4F", "M0+")])
    assert (np.array(linked[0]) < 0.85 * np.array(linked[1])).all(), linked
    size = board.footprint(tmp_path, "knee")
    assert 1000 < size.code < 16_000
    assert 8 < size.stack < 1024
    if shutil.which(board.EMULATOR):
        assert board.replayed(tmp_path, "knee", steps=20_000).deviation < 1e-12


HOSTILE = ("a /* b", "a */ b", "/*/", "a \\", "a ??/", "???/", "a\\\nb", 'a" \\', "a // b", "%s $name `x`", "** /")


@pytest.fixture(scope="module")
def pid_program(scenarios):
    return controller_program(controller_functions(scenarios["PID"]), "knee")[0]


@pytest.mark.parametrize("title", HOSTILE)
def test_no_name_changes_the_program(pid_program, title, tmp_path):
    """With all warnings as errors; trigraphs are read in C99."""
    header, source = write_c(
        pid_program, f"{title}\n{title!r}\n{title}", units={"setpoint.angle": title.split("\n")[0]}
    )
    (tmp_path / "knee.h").write_text(header)
    (tmp_path / "knee.c").write_text(source)
    text = comment_text(" ".join(title.split()))
    line = f'// "{text}"'
    (tmp_path / "line.c").write_text(f"{line}\n// {text}\nint line(void);\n")
    command = [compiler(), "-std=c99", "-Wall", "-Wextra", "-Wcomment", "-Wtrigraphs", "-Werror", "-fsyntax-only"]
    done = subprocess.run([*command, "knee.c", "line.c"], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_a_changed_file_is_seen_by_the_replay(scenarios, tmp_path):
    export(scenarios["PID"], "c", tmp_path, name="knee")
    source = tmp_path / "knee.c"
    defaults = source.read_text()
    source.write_text(defaults.replace("self->parameters.position_kp = ", "self->parameters.position_kp = 1.001 * "))
    assert source.read_text() != defaults
    assert subprocess.run(["make", "-s", "check"], cwd=tmp_path, capture_output=True).returncode != 0


@pytest.mark.parametrize(
    ("target", "name", "field"),
    [("cobol", "knee", "to"), ("c", "my knee", "name"), ("c", "int", "name"), ("c", "sin", "name")],
)
def test_wrong_arguments_are_named(scenarios, target, name, field, tmp_path):
    with pytest.raises(ParameterError) as caught:
        export(scenarios["PID"], target, tmp_path / "out", name=name)
    assert caught.value.field == field
    assert not (tmp_path / "out").exists()


def test_what_c_cannot_hold_is_said_before_anything_is_written(scenarios, tmp_path, monkeypatch):
    from mckibben.control import PositionStiffnessControl

    step = PositionStiffnessControl.step

    def sorting(self, state, setpoint, measurement, period):
        state, commands = step(self, state, setpoint, measurement, period)
        return state, tuple(jnp.sort(jnp.stack(commands)))

    monkeypatch.setattr(PositionStiffnessControl, "step", sorting)
    with pytest.raises(ExportError) as caught:
        export(scenarios["PID"], "c", tmp_path / "out")
    assert caught.value.field == "sort"
    assert "test_c.py" in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_numbers_of_32_bits_are_converted_explicitly(scenarios, tmp_path):
    """The loops of the predictive controller begin with numbers of the setpoint, which keep 64 bits."""
    export(scenarios["predictive"], "c", tmp_path, name="knee", hardware=Hardware(single=True))
    warnings = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
    subprocess.run([compiler(), "-std=c99", *warnings, "-fsyntax-only", "knee.c"], cwd=tmp_path, check=True)
