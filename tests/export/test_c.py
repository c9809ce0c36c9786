"""Controllers as C99: all of the comparison compile without warnings, and repeat the recorded run."""

import importlib
import shutil
import subprocess

import pytest

from mckibben.codegen import write_c
from mckibben.codegen.c import comment_text
from mckibben.codegen.native import compiler
from mckibben.errors import ExportError, FileError, ParameterError
from mckibben.export import export
from mckibben.export.controller import controller_functions, controller_program

pytestmark = pytest.mark.skipif(compiler() is None or shutil.which("make") is None, reason="there is no cc or make")
REPLAYED = {
    "PID": {},
    "BP": {},
    "decoupling, adapted": {},
    "decoupling, valve lag adapted": {},
    "predictive": {},
    "sliding mode": {"single": True},
}


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


FAULTS = r"""
#include "knee.h"
#include <math.h>
#include <stdio.h>
static knee with, without; /* bad samples */
static knee_setpoint setpoint = {0.1f, 15.0f};
static knee_measurement measurement = {0.05f, 2e5f, 3e5f};
static knee_telemetry telemetry;
static knee_commands step(knee *self)
{
    knee_commands commands;
    knee_step(self, &setpoint, &measurement, &commands, &telemetry);
    return commands;
}
static int same(knee_commands x, knee_commands y)
{
    return isfinite(x.pressure1 + x.pressure2) && !(x.pressure1 < y.pressure1 || x.pressure1 > y.pressure1) &&
           !(x.pressure2 < y.pressure2 || x.pressure2 > y.pressure2);
}
#define FAULT(input, number) \
    do { \
        const knee_setpoint right = setpoint; \
        const knee_measurement good = measurement; \
        const knee_commands last = step(&with); \
        step(&without); \
        input = number; \
        bad += !same(step(&with), last) || !telemetry.held; \
        setpoint = right, measurement = good; \
        bad += !same(step(&with), step(&without)) || telemetry.held; \
    } while (0)
#define FAULTS(input) FAULT(input, NAN); FAULT(input, INFINITY); FAULT(input, -INFINITY)
int main(void)
{
    int bad = 0;
    knee_defaults(&with);
    measurement.angle = NAN;
    bad += knee_init(&with, &measurement) || !isfinite(step(&with).pressure1);
    measurement.angle = 0.05f;
    bad += !knee_init(&with, &measurement);
    without = with;
    FAULTS(setpoint.angle);
    FAULTS(setpoint.stiffness);
    FAULTS(measurement.angle);
    FAULTS(measurement.pressures_0);
    FAULTS(measurement.pressures_1);
    return bad;
}
"""


def check_faults(folder, options):
    """After a sample that is not finite, the exported controller goes on as if the period had not been."""
    (folder / "faults.c").write_text(FAULTS)
    command = [compiler(), *options, "-fsanitize=undefined", "-o", "faults", "faults.c", "knee.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    assert subprocess.run(["./faults"], cwd=folder).returncode == 0


@pytest.mark.parametrize("name", REPLAYED)
@pytest.mark.slow
def test_it_repeats_the_recorded_run_and_passes_over_bad_samples(board, scenarios, name, tmp_path):
    export(scenarios[name], "c", tmp_path, name="knee", **REPLAYED[name])
    subprocess.run(["make", "-s", "replay"], cwd=tmp_path, check=True)
    done = subprocess.run(["./replay", "replay.csv", "0"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert float(done.stdout.split(",")[1].split()[0]) < (1e-4 if REPLAYED[name] else 1e-11)
    check_faults(tmp_path, board.STRICT)


@pytest.mark.slow
def test_all_compile_without_warnings(board, scenarios, tmp_path):
    for name, scenario in scenarios.items():
        module, _ = controller_program(controller_functions(scenario), "knee")
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
    export(scenarios["PID"], "c", tmp_path, name="knee")
    size = board.footprint(tmp_path, "knee")
    assert 1000 < size.code < 16_000
    assert 8 < size.stack < 1024
    if shutil.which(board.EMULATOR):
        assert board.replayed(tmp_path, "knee", steps=20_000).deviation < 1e-12


HOSTILE = ("a /* b", "a */ b", "/*/", "a \\", "a ??/", "???/", "a\\\nb", 'a" \\', "a // b", "%s $name `x`", "** /")


@pytest.mark.parametrize("title", HOSTILE)
def test_no_name_changes_the_program(scenarios, title, tmp_path):
    """As C and as the C++ of the sketch, with all warnings as errors; trigraphs are read in C99."""
    module, _ = controller_program(controller_functions(scenarios["PID"]), "knee")
    header, source = write_c(module, f"{title}\n{title!r}\n{title}", units={"setpoint.angle": title.split("\n")[0]})
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


@pytest.mark.slow
def test_nothing_is_overwritten_without_force(scenarios, tmp_path):
    (tmp_path / "knee.c").write_text("mine")
    with pytest.raises(FileError):
        export(scenarios["PID"], "c", tmp_path, name="knee")
    assert [path.name for path in tmp_path.iterdir()] == ["knee.c"]
    export(scenarios["PID"], "c", tmp_path, name="knee", overwrite=True)
    assert (tmp_path / "knee.c").read_text() != "mine"


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
    import jax.numpy as jnp

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
