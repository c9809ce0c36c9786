"""What works for which joint and robot: each command is tried on each, and a refusal keeps its reason.

    python benchmarks/capabilities.py [NAME ...] [--only CAPABILITY ...]

Runs are cut to a few control periods, as it is asked what works, not how well. Robots without a controller in their
file are held at 0 deg by computed torque. The answers are kept in capabilities.json, of which the page is made: what is
not tried now stays as it was.
"""

import argparse
import json
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

Made on {date} by `python benchmarks/capabilities.py [NAME ...]`: each command is tried on the knee of the paper, a
muscle with mass and spring, the leg of the paper, the [arm that is read from MJCF](../robot-files.md), a neck whose
muscles pass over both joints, and UMArm with 12 joints and 24 muscles. Runs are cut to a few control periods: it is
asked what works, not how well. "over {longest} s": of processor time, and then ended. Blank: not tried yet.

"""
LONGEST = 400
"""Processor time of a command [s]."""
TOO_LONG = f"over {LONGEST} s"
ANSWERS = Path(__file__).with_suffix(".json")
PAGE = EXAMPLES.parent / "docs/results/capabilities.md"


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
TRIED = "last tried"
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
        return TOO_LONG
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
    return found | {TRIED: str(date.today())}


def page(table):
    """The page of a table of answers; blank where a capability was never tried."""
    header, shown = ["", *table], ("", "yes", TOO_LONG)
    texts = {name: [of.get(name, "") for of in table.values()] for name in (*COMMANDS, *PYTHON)}
    rows = [[name, *(text if text in shown else "no" for text in row)] for name, row in texts.items()]
    rows.append([TRIED, *(of[TRIED] for of in table.values())])
    lines = [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)]
    refused = {}
    for name, row in texts.items():
        for robot, text in zip(table, row, strict=True):
            if text not in shown:
                refused.setdefault((name, text), []).append(robot)
    reasons = [f"- {name}, {', '.join(robots)}: {text}" for (name, text), robots in refused.items()]
    head = HEAD.format(longest=LONGEST, date=max(of[TRIED] for of in table.values()))
    return head + "\n".join([*lines, "", "## What is refused, and why", "", *reasons]) + "\n"


def main():
    """Try what is asked for, and write answers and page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[[], *SCENARIOS], help="joints and robots; default: all")
    parser.add_argument("--only", nargs="+", choices=[*COMMANDS, *PYTHON], help="capabilities; default: all")
    asked = parser.parse_args()
    table = json.loads(ANSWERS.read_text(encoding="utf-8"))
    for robot in asked.names or SCENARIOS:
        table[robot] = table.get(robot, {}) | answers(robot, asked.only or (*COMMANDS, *PYTHON))
        ANSWERS.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page(table), encoding="utf-8")


if __name__ == "__main__":
    main()
