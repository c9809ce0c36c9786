"""What works for which joint and robot: each command is tried on each, and a refusal keeps its reason.

    python benchmarks/capabilities.py [NAME ...] [--out docs/results/capabilities.md]

Runs are cut to a few control periods, as it is asked what works, not how well. Robots without a controller in their
file are held at 0 deg by computed torque.
"""

import argparse
import re
import signal
import subprocess
import sys
import tempfile
from datetime import date
from pathlib import Path

import mckibben as mk
from mckibben.component.schema import read_component
from mckibben.muscle import Muscle
from mckibben.scenario.reading import read_mjcf

EXAMPLES = Path(__file__).parents[1] / "examples"
VALVE = "valve: {time_constant: 20 ms, supply: 7 bar}\n"
HOLDING = """
controller: {class: computed_torque, feedback: {bandwidth: 20 rad/s}, observer: {bandwidth: 30 rad/s}}
duration: 100 ms
control_period: 2 ms
"""
HEAD = """# What works for which robot

Made on {date} by `python benchmarks/capabilities.py --out docs/results/capabilities.md`: each command is tried on the
knee of the paper, a muscle with mass and spring, the leg of the paper, the [arm that is read from
MJCF](../robot-files.md), a neck whose muscles pass over both joints, and UMArm with 12 joints and 24 muscles. Runs are
cut to a few control periods: it is asked what works, not how well. Blank: not tried, as it takes long.

"""
LONGEST = 400
"""Processor time of a command [s]."""


def held(text, folder, **stiffness):
    """The scenario of a robot that is held at 0 deg, each joint with its stiffness [N*m/rad]."""
    joints = ", ".join(f"{name}: {{angle: 0 deg, stiffness: {value} N*m/rad}}" for name, value in stiffness.items())
    text = re.sub("^valve:.*\n", "", text, flags=re.MULTILINE) + VALVE + HOLDING + f"reference: {{{joints}}}\n"
    return mk.Scenario.parse(text, folder=folder)


def arm():
    """The arm of a file of MJCF."""
    folder = Path(tempfile.mkdtemp())
    read = read_mjcf(EXAMPLES / "robot/arm.xml", read_component(Muscle, EXAMPLES / "robot/arm-muscle.yaml"))
    read.scenario().to_yaml(folder / "robot.yaml")
    stiffness = {"shoulder side": 6, "shoulder": 14, "elbow": 7.4, "wrist": 4}
    return held("name: arm\nrobot: robot.yaml\n", folder, **stiffness)


def example(name, duration):
    """An example, for a shorter time [s]."""
    return mk.Scenario.read(EXAMPLES / name).replace(duration=duration)


def robot(name, **stiffness):
    """A robot of the examples without a controller."""
    return held((EXAMPLES / "robot" / name).read_text(encoding="utf-8"), EXAMPLES / "robot", **stiffness)


SCENARIOS = {
    "knee": lambda: example("pre-contracted-step-pid.yaml", 0.2),
    "linear axis": lambda: example("linear-axis.yaml", 0.2),
    "leg": lambda: example("robot/lei-leg-control.yaml", 0.1),
    "arm": arm,
    "neck": lambda: robot("neck.yaml", side=25, nod=25),
    "UMArm": lambda: robot("umarm.yaml", **{f"u{i}{axis}": 10 for i in range(1, 7) for axis in "xy"}),
}
HOST = str(EXAMPLES / "hardware/host.yaml")
COMMANDS = {
    "simulate": ["simulate"],
    "envelope": ["envelope"],
    "stiffness: what a push feels": ["stiffness", "--push", "PUSH"],
    "margins": ["margins"],
    "tune": ["tune", "--iterations", "1", "--out", "OUT"],
    "sweep": ["sweep", "--over", "command_delay=0..4 ms", "--samples", "4", "--out", "OUT"],
    "rig control": ["rig", "control", "--unpaced", "--out", "OUT"],
    "calibrate": ["calibrate", "--duration", "30 s", "--angles", "ANGLES", "--limb", "weighed", "--out", "OUT"],
    **{f"export --to {target}": ["export", "--to", target, "--out", "OUT"] for target in ("c", "js", "mjcf")},
    "export --to firmware": ["export", "--to", "firmware", "--hardware", HOST, "--out", "OUT"],
    **{f"export --to {target}": ["export", "--to", target, "--out", "OUT"] for target in ("fmu", "fmu-controller")},
}
PYTHON = {
    "CasADi": "from mckibben.export.casadi import casadi_plant; casadi_plant(scenario, substeps=1)",
    "Gymnasium": "from mckibben.export.gym import JointEnv; env = JointEnv(scenario); env.reset(seed=0); "
    "env.step(env.action_space.sample())",
    "page Run": "from pathlib import Path; from mckibben.web.workbench import compute; compute(scenario, Path())",
}


HINGED = {"ANGLES": "-5..5 deg", "PUSH": "0.3 N*m"}
"""Angles of the calibration, and the push, of all but these."""
SLIDING = {"linear axis": {"ANGLES": "-5..5 mm", "PUSH": "3 N"}}


def tried(words, folder):
    """What a command says: "yes", or why not."""
    limited = ["sh", "-c", f'ulimit -t {LONGEST}; exec "$@"', "sh", *words]
    done = subprocess.run(limited, capture_output=True, text=True, cwd=folder, check=False)
    if -done.returncode in (signal.SIGXCPU, signal.SIGKILL):
        return f"not within {LONGEST} s of processor time"
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    failed = "Traceback" in done.stderr or any(line.startswith("failed:") for line in lines)
    if done.returncode in (0, 1) and not failed:  # 1: a result that is not good
        return "yes"
    return lines[-1] if "Traceback" in done.stderr else " ".join(done.stderr.split())


def answers(robot, names=(*COMMANDS, *PYTHON)):
    """The answers of capabilities of a name for a robot, tried in a folder of its own."""
    folder = Path(tempfile.mkdtemp())
    SCENARIOS[robot]().to_yaml(folder / "scenario.yaml")
    found = {}
    for number, name in enumerate(names):
        if name in PYTHON:
            code = f"import mckibben as mk; scenario = mk.Scenario.read('scenario.yaml'); {PYTHON[name]}"
            found[name] = tried([sys.executable, "-c", code], folder)
        else:
            filled = {"OUT": f"out{number}", **SLIDING.get(robot, HINGED)}
            words = [filled.get(word, word) for word in COMMANDS[name]]
            place = 2 if words[0] == "rig" else 1
            command = [sys.executable, "-m", "mckibben", *words[:place], "scenario.yaml", *words[place:]]
            found[name] = tried(command, folder)
        print(f"{robot}: {name}: {found[name]}", file=sys.stderr)
    return found


def page(table):
    """The table as Markdown, with the refusals below it; blank where a capability was not tried."""
    header = ["", *table]
    names = list(next(iter(table.values())))
    shown = {"yes": "yes", "": ""}
    rows = [[name, *(shown.get(of.get(name, ""), "no") for of in table.values())] for name in names]
    lines = [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)]
    refused = [f"- {name}, {key}: {text}" for key, of in table.items() for name, text in of.items() if text != "yes"]
    return "\n".join([*lines, "", "## What is refused, and why", "", *refused]) + "\n"


def main():
    """Try all, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[[], *SCENARIOS], help="joints and robots; default: all")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    text = page({name: answers(name) for name in asked.names or SCENARIOS})
    head = HEAD.format(date=date.today())
    if asked.out:
        asked.out.write_text(head + text, encoding="utf-8")
    else:
        print(head + text)


if __name__ == "__main__":
    main()
