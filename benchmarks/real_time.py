"""Control in real time: missed periods and latencies on this machine, see docs/joint-rig.md.

    python benchmarks/real_time.py [--duration 60] [--period 1] [--ordinary]

The knee of examples/, simulated in real time, under PID and under decoupling control, recorded to disk as `mckibben rig
control` does. It prints how many deadlines were missed, how late samples were taken and commands given, and what the
machine itself does to a loop of the same period that only sleeps: a deadline that this one misses, no program could
have met.
"""

import argparse
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from machine import sentence

from mckibben.rig import JointRig, prepare
from mckibben.rig import control_loop as module
from mckibben.rig.control_loop import realtime_process_settings
from mckibben.rig.joint_record import percentiles
from mckibben.scenario import Scenario

EXAMPLES = Path(__file__).parents[1] / "examples"
SCENARIOS = {"PID": "pre-contracted-step-pid.yaml", "decoupling": "valves/regulator-decoupling.yaml"}


def scenario(file, duration, period):
    """A scenario of the examples that moves along a sine, for a duration and with a control period [s]."""
    return Scenario.read(EXAMPLES / file).model_copy(update={"duration": duration, "control_period": period})


def asleep(duration, period):
    """How late a thread wakes that does nothing but sleep; `missed` are sleeps that took a whole period too long."""
    count = round(duration / period)
    late = np.empty(count)
    with realtime_process_settings():
        origin = time.perf_counter()
        for i in range(count):
            until = origin + i * period
            left = until - time.perf_counter()
            if left > 0:
                time.sleep(left)
            late[i] = time.perf_counter() - until
    return int((late > period).sum()), percentiles(late)


def spread(times):
    return " / ".join(f"{time * 1e6:.0f}" for time in times)


def main():
    parser = argparse.ArgumentParser(description="Control in real time, on a simulated joint.")
    parser.add_argument("--duration", type=float, default=60.0, help="of each run [s]")
    parser.add_argument("--period", type=float, default=1.0, help="of control [ms]")
    parser.add_argument("--ordinary", action="store_true", help="without real-time priority")
    asked = parser.parse_args()
    period = asked.period * 1e-3
    if asked.ordinary:
        module._set_real_time_priority = lambda: None
    print(sentence() + "\n")
    print_runs(asked.duration, period)


def print_runs(duration, period):
    """The table of runs."""
    print("| | missed | skipped | sample to loop [us] | loop to valves [us] | jitter [us] |")
    print("|---|---|---|---|---|---|", flush=True)
    for name, file in SCENARIOS.items():
        session = prepare(scenario(file, duration, period), JointRig.parse("rig: simulated"))
        with tempfile.TemporaryDirectory() as folder:
            ran = session.run(folder)
        timing = ran.timing
        ended = "" if ran.outcome.completed else f": {ran.outcome.text}"  # a machine that stood still is a result, too
        cells = (
            f"{name}, {ran.priority} priority{ended}",
            f"{timing.missed} of {timing.periods}",
            str(timing.skipped),
            spread(timing.lateness),
            spread(timing.work),
            spread(timing.jitter),
        )
        print("| " + " | ".join(cells) + " |", flush=True)
    missed, late = asleep(duration, period)
    count = round(duration / period)
    cells = ("sleep alone", f"{missed} of {count}", "", spread(late), "", "")
    print("| " + " | ".join(cells) + " |\n")
    print(f"Times are median / 95 % / 99.9 % / worst. {threading.active_count()} threads at the end.")


if __name__ == "__main__":
    main()
