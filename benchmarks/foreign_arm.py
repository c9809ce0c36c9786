"""The worked arm of docs/robot.md in a foreign plant: its exported C moves MuJoCo's model of examples/robot/arm.xml.

    python benchmarks/foreign_arm.py

Forces of the muscles, their friction, valves, delays and sensors are written here anew and share no code with the
toolkit: Eq. 3 of the paper, a bristle that yields within 0.2 mm (Dahl), lags, and late, coarse and noisy samples. Of
the toolkit are the C and what a builder knows of the arm: lengths of the connectors, and the references. Prints the
RMS error of each joint [deg] by case; the controller has the model of the file in all of them.
"""

from __future__ import annotations

import ctypes
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.codegen.native import compiler
from mckibben.component.schema import read_component
from mckibben.export import export
from mckibben.muscle import Muscle
from mckibben.robot import RobotScenario
from mckibben.scenario.reading import read_mjcf

ROOT = Path(__file__).parents[1]
ARM = ROOT / "examples" / "robot" / "arm.xml"
STEP = 0.1e-3  # s
BRISTLE = 0.2e-3  # m
BAR = 1e5
SUPPLY, LENGTH = 7.0, 0.3  # bar, m
CASES: dict[str, dict[str, float]] = {
    "as in the file": {},
    "friction 10 N": {"friction": 10.0},
    "20 % more mass": {"mass": 1.2},
    "111 g in the hand": {"hand": 0.111},
    "3 periods later": {"delay": 3},
    "muscles 10 % weaker": {"strength": 0.9},
    "noise": {"noise": 4e3, "encoder": 2 * np.pi / 2**14},
}
CASES["all at once"] = {name: number for case in CASES.values() for name, number in case.items()}
SHIM = """#include "arm.h"
static arm self;
void begin(double period, const double *x)
{ arm_measurement m = {0}; arm_defaults(&self); MEASURED arm_init(&self, period, &m); }
void advance(const double *r, const double *x, double *u)
{ arm_measurement m = {0}; arm_setpoint s = {0}; arm_commands c = {0}; arm_telemetry t = {0};
  MEASURED SET arm_step(&self, &s, &m, &c, &t); COMMANDED }
"""


def force(contraction: NDArray, pressure: NDArray) -> NDArray:
    """Eq. 3 of the paper [N] of a contraction and a pressure [bar]; a muscle does not push."""
    e = 100 * contraction
    decayed = np.exp(-0.3 * e)
    value = -245.8 + 109 * pressure + (3.216 - 3.442 * pressure) * e + (255.6 - 13.18 * pressure) * decayed
    return np.maximum(value, 0.0)


def arm_scenario(folder: Path) -> RobotScenario:
    """The arm of the documentation, read from its files."""
    read_mjcf(ARM, read_component(Muscle, ARM.with_name("arm-muscle.yaml"))).scenario().to_yaml(folder / "robot.yaml")
    page = (ROOT / "docs" / "robot.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```yaml\n(name: reach.*?)^```", page, re.DOTALL | re.MULTILINE)
    return RobotScenario.parse(text, folder=folder)


class Program:
    """The exported C, compiled, with the columns of its recorded run."""

    def __init__(self, scenario: RobotScenario, folder: Path) -> None:
        export(scenario, "c", folder, name="arm")
        head, *_ = (folder / "replay.csv").read_text(encoding="utf-8").splitlines()
        table = np.genfromtxt(folder / "replay.csv", delimiter=",", skip_header=1)
        names = [column.split(".", 1) for column in head.split(",")]
        places = {owner: [k for k, name in enumerate(names) if name[0] == owner] for owner, _ in names}
        self.setpoints, self.first = table[1:, places["setpoint"]], table[0, places["measurement"]]
        self.measured = [names[k][1] for k in places["measurement"]]
        self._commands = np.zeros(len(places["commands"]))
        lines = {"MEASURED": ("m", "x", "measurement"), "SET": ("s", "r", "setpoint")}
        shim = SHIM
        for mark, (target, source, owner) in lines.items():
            text = " ".join(f"{target}.{names[k][1]} = {source}[{i}];" for i, k in enumerate(places[owner]))
            shim = shim.replace(mark, text)
        commanded = (f"u[{i}] = c.{names[k][1]};" for i, k in enumerate(places["commands"]))
        (folder / "shim.c").write_text(shim.replace("COMMANDED", " ".join(commanded)), encoding="utf-8")
        sources = [
            folder / "shim.c",
            next(path for path in folder.glob("*.c") if path.name in ("arm.c", "controller.c")),
        ]
        library = folder / "arm.so"
        command = [str(compiler()), "-O1", "-shared", "-fPIC", f"-I{folder}", "-o", library, *sources, "-lm"]
        subprocess.run(command, check=True)
        self._library = ctypes.CDLL(str(library))
        self._library.begin.argtypes = [ctypes.c_double, ctypes.c_void_p]

    def begin(self, period: float, measurement: NDArray) -> None:
        """Start at a first sample."""
        self._library.begin(period, measurement.ctypes.data)

    def step(self, setpoint: NDArray, measurement: NDArray) -> NDArray:
        """Return the commands [Pa]."""
        setpoint, measurement = np.ascontiguousarray(setpoint), np.ascontiguousarray(measurement)
        pointers = (ctypes.c_void_p(array.ctypes.data) for array in (setpoint, measurement, self._commands))
        self._library.advance(*pointers)
        return self._commands.copy()


def slopes_of(model: Any, data: Any) -> NDArray:
    """Slopes of the tendons' lengths over the angles, shape (tendons, joints)."""
    import mujoco

    slopes = np.zeros((model.ntendon, model.nv))
    mujoco.mju_sparse2dense(slopes, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind)
    return slopes


def run(scenario: RobotScenario, program: Program, case: dict[str, float]) -> NDArray:
    """Return the RMS error [rad] of each joint in a case."""
    import mujoco

    model: Any = mujoco.MjModel.from_xml_path(str(ARM))
    model.opt.timestep = STEP
    model.body_mass[:] *= case.get("mass", 1.0)
    model.body_inertia[:] *= case.get("mass", 1.0)
    model.body_mass[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "hand")] += case.get("hand", 0.0)
    data = mujoco.MjData(model)
    joints, muscles = model.nq, model.ntendon
    kinds = np.array([name.rpartition("_")[0] for name in program.measured])
    sample = program.first.copy()
    data.qpos[:] = sample[kinds == "angles"]
    mujoco.mj_forward(model, data)
    pressures = sample[kinds == "pressures"] / BAR
    connectors = np.array([muscle.connector_length for muscle in scenario.robot.muscles])
    bristles, lengths = np.zeros(muscles), data.ten_length.copy()
    limit, strength = case.get("friction", 7.5), case.get("strength", 1.0)
    noise, encoder = np.random.default_rng(1), case.get("encoder", 0.0)
    late = [pressures.copy()] * int(case.get("delay", 0))
    lag = float(scenario.valve.time_constant)  # type: ignore[attr-defined]
    period, errors = scenario.control_period, []
    program.begin(period, sample)
    for setpoint in program.setpoints:
        angles = np.round(data.qpos / encoder) * encoder if encoder else data.qpos.copy()
        sample[kinds == "angles"] = angles
        sample[kinds == "pressures"] = BAR * pressures + noise.normal(0, case.get("noise", 0.0), muscles)
        errors.append(data.qpos - setpoint[:joints])
        late.append(np.clip(program.step(setpoint, sample) / BAR, 0, SUPPLY))
        commands = late.pop(0)
        for _ in range(round(period / STEP)):
            pressures += (commands - pressures) * (1 - np.exp(-STEP / lag))
            mujoco.mj_step1(model, data)
            moved, lengths = data.ten_length - lengths, data.ten_length.copy()
            bristles = np.clip(bristles + moved / BRISTLE - np.abs(moved) / BRISTLE * bristles, -1, 1)
            tension = strength * force(1 - (lengths - connectors) / LENGTH, pressures)
            pull = np.where(tension > 0, np.maximum(tension + limit * bristles, 0), 0)
            data.qfrc_applied[:] = -slopes_of(model, data).T @ pull
            mujoco.mj_step2(model, data)
    return np.sqrt(np.mean(np.square(errors), axis=0))


def errors_of(cases: dict[str, dict[str, float]], folder: Path) -> dict[str, NDArray]:
    """Return the RMS errors [rad] of the joints by case."""
    scenario = arm_scenario(folder)
    program = Program(scenario, folder / "c")
    return {name: run(scenario, program, case) for name, case in cases.items()}


def main() -> None:
    """Print the errors."""
    with tempfile.TemporaryDirectory() as folder:
        for name, found in errors_of(CASES, Path(folder)).items():
            print(f"{name:22}", *(f"{error:8.3f}" for error in np.degrees(found)), flush=True)


if __name__ == "__main__":
    main()
