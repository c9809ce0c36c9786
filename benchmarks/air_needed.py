"""Air that exact following takes in the runs of examples/comparison/valves.yaml, and errors at no more air than that.

    python benchmarks/air_needed.py [--comparison DIR]

Exact following: valves of 2 ms without delay or limit of their flow, hardly any noise, and a fast decoupling controller
with the plant of each run as its model. The air is what pressures and volumes of the references require, without dead
volumes, so that real valves need more. With the folder of a comparison, of each controller's trials those with at most
this air in the training runs, and at most 1.1 times the stiffness error of the best, are taken. Of these, the one with
the fewest failed runs and then the least angle error runs on the evaluation runs. The table has its median
angle error, with failed runs as infinite, the number of these, and its air.
"""

import argparse
from pathlib import Path

import numpy as np
import yaml

from mckibben.simulation import Outcome
from mckibben.simulation.outcome import OUTCOMES
from mckibben.storage.store import STUDY
from mckibben.study.compare import Suite, draw, evaluate
from mckibben.study.compare.checks import filename
from mckibben.study.compare.statistics import trial_at_air
from mckibben.study.compare.tuning import ControllerTuning
from mckibben.study.tune import SearchSpace, read_trials
from mckibben.units import deg, litre

SUITE = Path(__file__).parents[1] / "examples" / "comparison" / "valves.yaml"
GAINS = {"feedback": 100, "observer": 400, "pressure_observer": 600}  # rad/s


def ideal_suite():
    """The suite with ideal valves and sensors, and a fast controller that knows the plants."""
    suite = yaml.safe_load(SUITE.read_text(encoding="utf-8"))
    control = suite["controllers"]["oracle"]
    for name, bandwidth in GAINS.items():
        control[name]["bandwidth"] = f"{bandwidth} rad/s"
    for setup in suite["setups"].values():
        setup |= {"valve": {"time_constant": "2 ms"}, "command_delay": "0 ms", "conditions": []}
    suite |= {
        "sensors": {"encoder": "0.001 deg", "pressure_noise": "1 Pa"},
        "conditions": [each for each in suite["conditions"] if not each.startswith(("valve.", "sensors."))],
        "controllers": {"exact": control},
        "true_model": ["exact"],
        "tuning": {"seed": suite["tuning"]["seed"]},
    }
    return Suite.parse(yaml.safe_dump(suite, sort_keys=False))


def exact_air(suite):
    """Medians of angle error [deg] and air [L] of exact following in the evaluation runs of the suite of a setup."""
    runs = draw(suite, suite.evaluation.runs, suite.evaluation.seed)
    batch = evaluate(runs, "exact", {}, metrics=["angle_rmse", "air"])
    return tuple(
        float(np.median(batch.metrics[name][batch.usable])) / unit
        for name, unit in (("angle_rmse", deg), ("air", litre))
    )


def row(suite, name, folder, air):
    """Cells of a controller of the comparison of a setup with at most an air [L], and its angle errors in the runs."""
    task = ControllerTuning(suite, name, SearchSpace(suite.tuned_over(name)), draw(suite, 1, suite.tuning.seed))
    trials = read_trials(folder / STUDY, name)
    trial = trial_at_air(trials, air * litre)
    if trial is None:
        return "none", None
    batch = evaluate(draw(suite, suite.evaluation.runs, suite.evaluation.seed), name, task.values(trial))
    started = np.asarray(batch["outcome"]) != OUTCOMES.index(Outcome.NO_START)
    errors = np.where(batch.usable, batch.metrics["angle_rmse"], np.inf)[started] / deg
    used = np.median(batch.metrics["air"][batch.usable]) / litre
    return f"{np.median(errors):.2f} deg ({np.isinf(errors).sum()}), {used:.2f} L", errors


def main():
    """Print the air of exact following, and the table of a comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--comparison", type=Path, metavar="DIR")
    given = parser.parse_args()
    whole, ideal, airs, errors = Suite.read(SUITE), ideal_suite(), {}, {}
    for setup in ideal.setups:
        error, airs[setup] = exact_air(ideal.of_setup(setup))
        print(f"{setup}: exact following takes {airs[setup]:.3f} L, at an angle error of {error:.3f} deg", flush=True)
    if given.comparison is None:
        return
    for name in whole.controllers:
        each = []
        for setup, air in airs.items():
            folder = given.comparison / filename(setup)
            each.append(row(Suite.read(folder / "suite.yaml"), name, folder, air))
        texts, errors[name] = zip(*each, strict=True)
        line = f"| {name} | {' | '.join(texts)} |"
        first = next(iter(errors.values()))
        if all(one is not None for one in (*errors[name], *first)):
            ratio = np.median(np.concatenate(errors[name])) / np.median(np.concatenate(first))
            line += f" {np.median(np.concatenate(errors[name])):.2f} deg | {ratio:.2f} |"
        print(line, flush=True)


if __name__ == "__main__":
    main()
