"""Draws of uncertain parameters inside a certified set, simulated: how many are unstable.

    python benchmarks/certified.py [--margin 0.3] [--certify 64] [--draws 10000] [--seconds 1]

The loop is examples/valves/regulator-decoupling.yaml; its uncertain parameters, and their ranges, are those
that examples/comparison/valves.yaml varies for this setup. The gains are multiplied by one factor, the
largest of a few at which the least disk margin over `--certify` draws is at least `--margin`
(`mckibben tune --disk-margin` searches all gains so). Other draws then run
on a small step, and those that diverge or end in a limit cycle are counted; a limit cycle has four periods or more, so
slow ones need more `--seconds`. Without any, the probability of one is below 3 over the number of draws (95 %, rule of
three). The same is printed for the gains of the file.
"""

import argparse
from pathlib import Path

import numpy as np

from mckibben.scenario import Scenario, batched, find_parameters, initial_state, run_many, valid_rows, with_values
from mckibben.simulation import Outcome, disk_margins
from mckibben.simulation.result import OUTCOMES
from mckibben.study.parameters import parse_sweeps, sample
from mckibben.study.tune import gain_ranges, on_small_step

FILE = Path("examples/valves/regulator-decoupling.yaml")
UNCERTAIN = (
    "joint.muscle1.strength=0.85..1.05",
    "joint.muscle2.strength=0.85..1.05",
    "load.mass2=+-30 %",
    "valve.conductance=+-30 %",
    "valve.polytropic_index=1.0..1.4",
    "valve.dead_volume=1..10 cm^3",
    "valve.time_constant=10..22 ms",
    "valve.band=0.3..0.8 bar",
    "command_delay=2..5 ms",
)
FACTORS = (1.0, 0.8, 0.64, 0.5, 0.4, 0.32)
CHUNK = 2000


def least_margin(scenario: Scenario, draws: dict) -> float:
    """Least disk margin over draws."""
    many = batched(scenario, draws)
    settings = {name: getattr(scenario, name) for name in ("duration", "control_period", "substeps")}
    found = disk_margins(many.plant(), many.control(), many.reference(), initial_state(many), **settings, points=2)
    return float(np.nanmin(found))


def unstable(scenario: Scenario, draws: dict) -> tuple[int, int]:
    """Numbers of runs that end unstable, and of runs that could start."""
    failed = started = 0
    count = len(next(iter(draws.values())))
    for first in range(0, count, CHUNK):
        batch = run_many(scenario, {name: column[first : first + CHUNK] for name, column in draws.items()})
        starts = batch["outcome"] != OUTCOMES.index(Outcome.NO_START)
        failed += int((starts & ~batch.usable).sum())
        started += int(starts.sum())
    return failed, started


def main() -> None:
    """Certify, draw, simulate and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--margin", type=float, default=0.3)
    parser.add_argument("--certify", type=int, default=64)
    parser.add_argument("--draws", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=0.6)
    options = parser.parse_args()
    tuned = Scenario.read(FILE)
    step = on_small_step(tuned.model_copy(update={"duration": options.seconds}))
    swept = parse_sweeps(UNCERTAIN, step)
    some, others = (
        sample(swept, samples=count, seed=seed) for count, seed in ((options.certify, 1), (options.draws, 2))
    )
    assert all(valid_rows(step, draws).all() for draws in (some, others))
    gains = find_parameters(step, list(gain_ranges(step)))
    for factor in FACTORS:
        scaled = with_values(step, {each.name: factor * float(each.nominal or 0.0) for each in gains})
        margin = least_margin(scaled, some)
        now = margin >= options.margin
        line = f"gains x {factor:g}: least disk margin over {options.certify} draws {margin:.3f}"
        if factor == 1 or now:
            failed, started = unstable(scaled, others)
            line += f"; {failed} of {started} draws unstable"
            line += f", probability below {3 / started:.2g} (95 %)" if not failed else ""
        print(line + (", certified" if now else ""), flush=True)
        if now:
            break


if __name__ == "__main__":
    main()
