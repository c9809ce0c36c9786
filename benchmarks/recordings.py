"""How well public recordings are predicted, by the tasks and baselines of `mckibben bench`.

    git clone https://github.com/Agile-and-Adaptive-Robotics/Muscle_Sensory
    python benchmarks/recordings.py muscle-sensory Muscle_Sensory [--tasks map,isometric,transfer] [--methods eq2,gp]
    git clone https://github.com/gkharish/pneumaticarm_dentification
    python benchmarks/recordings.py elbow pneumaticarm_dentification
    git clone https://github.com/jonreal/pneu-sim && git -C pneu-sim checkout 06c6b0c
    python benchmarks/recordings.py pneu-sim pneu-sim

The data stay where they are; those without a licence are not part of this repository. Prints a row of the table in
docs/bench.md per task and method: RMSE, NRMSE with its interval, and the RMSE relative to the first method; then the
median NRMSE of each kind of task.

muscle-sensory: six Festo muscles of 10 mm (folder BPA_Static_Characterization_Test/10mmData_Nov2022: force [N],
pressure [kPa], time [s], 1 while filling and 2 while venting; no licence), each at four fixed lengths, filled and
vented three times by pulses of a valve. Lengths are those of the authors' LoadAll10mmData_New.m; the files *_Offset.csv
give the zeros of the sensors. "map": plateaus of 0.2 s while filling; those about 2, 3.5 and 5 bar are tested.
"isometric": samples of 50 Hz, Test10 from Test8 and Test9. "transfer": the map of each muscle from six of its points
and the maps of the others. `--tasks phases` compares the phases of plateaus with the authors' column; `--tasks
left-out` prints the table of left_out.py for the six maps, of Eq. 2, the smooth law and a plain Gaussian process.

elbow: joint motion, see elbow.py; every third file is fitted, the others are tested.

pneu-sim: force of a pair of muscles from displacement and both pressures (data/data.mat, 28,027 samples; the commit has
the licence Apache-2.0). Blocks of 500 samples; every other one is tested. Eq. 2 of both muscles is fitted by nonlinear
least squares, with the contraction at displacement 0 and the length as further parameters.
"""

import argparse
import functools
import itertools
import warnings
from pathlib import Path

import elbow
import left_out
import numpy as np
from scipy.io import loadmat
from scipy.optimize import least_squares

from mckibben.bench import BASELINES, DataBlock, Task, Training
from mckibben.bench.baselines import GaussianProcess
from mckibben.bench.submission import predictions
from mckibben.calibration import calibrate_from_commands
from mckibben.dataset import IsobaricDataset, Recording
from mckibben.errors import DatasetError, IdentificationError, McKibbenWarning, RangeError
from mckibben.units import bar, cm, kPa, ms

LENGTHS = {  # cut length [cm]: lengths in the test [cm], the first is the initial one
    10: (8.3, 7.975, 7.65, 7.325),
    15: (13.2, 12.675, 12.15, 11.625),
    20: (18.2, 17.45, 16.7, 15.95),
    25: (23.3, 22.3, 21.3, 20.3),
    30: (28.1, 26.875, 25.65, 24.425),
    40: (38.2, 36.5, 34.8, 33.1),
}
FOLDER = "BPA_Static_Characterization_Test/10mmData_Nov2022"
KINKS = ("Unkink", "kinked25", "kinked50", "kinked75")
BAND = 0.5 * bar  # of the pressures of a block
LEFT_OUT = (2 * bar, 3.5 * bar, 5 * bar)
KNOWN = (1.5 * bar, 3.5 * bar, 5.5 * bar)  # of another muscle, at two lengths
DWELL, SLACK = 0.2, 5.0  # s; N
THIN = 10  # samples of 2 ms
STATIC = ("eq2", "chou", "smooth", "gp")


def rows(folder, cut, kink, test):
    """Contraction, and time [s], pressure [Pa], force [N] and phase of a file, without the zeros of the sensors."""
    name, lengths = f"10mm_{cut}cm_{kink}", LENGTHS[cut]
    force, pressure, time, phase = np.loadtxt(folder / FOLDER / f"{name}_{test}.csv", delimiter=",").T
    offset = folder / FOLDER / f"{name}_Offset.csv"
    zeros = np.loadtxt(offset, delimiter=",")[:, :2].mean(axis=0) if offset.exists() else (0.0, 0.0)
    contraction = 1 - lengths[KINKS.index(kink)] / lengths[0]
    return contraction, time, (pressure - zeros[1]) * kPa, force - zeros[0], phase


def map_of(folder, cut):
    """Contraction, pressure [Pa] and force [N] while filling, of a muscle."""
    found = []
    for kink in KINKS:
        for test in ("Test8", "Test9", "Test10"):
            contraction, time, pressure, force, _ = rows(folder, cut, kink, test)
            record = Recording.of(time=time, pressure=pressure, force=force, contraction=contraction)
            data = record.plateaus(dwell=DWELL).dataset
            own = (data.table["phase"].to_numpy() == "filling") & (data.force > SLACK)
            found.append(np.column_stack([data.contraction, data.pressure, data.force])[own])
    return np.concatenate(found)


def print_phases(folder):
    """Print how many plateaus of 0.5 s have another phase than the authors' column."""
    wrong = total = 0
    for cut, kink, test in itertools.product(LENGTHS, KINKS, ("Test8", "Test9", "Test10")):
        contraction, time, pressure, force, phase = rows(folder, cut, kink, test)
        record = Recording.of(time=time, pressure=pressure, force=force, contraction=contraction)
        try:
            table = record.plateaus(dwell=0.5).dataset.table
        except (RangeError, DatasetError):  # nothing is steady, or only a slack muscle is
            continue
        if "phase" in table:
            middles, found = table["time"].to_numpy(), table["phase"].to_numpy()
            known = np.where(phase[np.searchsorted(time, middles) - 1] == 2, "venting", "filling")
            wrong += np.count_nonzero((found != known) & (found != ""))
            total += np.count_nonzero(found != "")
    print(f"{wrong} of {total} plateaus have the wrong phase")


def muscle_sensory(folder, chosen):
    """Tasks of six muscles, with the methods that apply."""
    facts = {cut: {"initial_length": lengths[0] * cm, "slack_force": SLACK} for cut, lengths in LENGTHS.items()}
    maps = {cut: map_of(folder, cut) for cut in LENGTHS} if {"map", "transfer"} & set(chosen) else {}
    for cut in LENGTHS if "map" in chosen else ():
        points = maps[cut]
        levels = np.round(points[:, 1] / BAND) * BAND
        known = points[~np.isin(levels, LEFT_OUT)]
        tests = [(f"{one / bar:g} bar", points[levels == one]) for one in LEFT_OUT]
        training = Training(f"map, {cut} cm", "map", (block("filling", known),), facts=facts[cut])
        yield Task(training, tuple(block(*one) for one in tests)), STATIC
    for cut in LENGTHS if "isometric" in chosen else ():
        parts = {test: [recorded(folder, cut, kink, test) for kink in KINKS] for test in ("Test8", "Test9", "Test10")}
        training = (*parts["Test8"], *parts["Test9"])
        training = Training(f"isometric, {cut} cm", "isometric", training, THIN * 2 * ms, facts[cut])
        yield Task(training, tuple(parts["Test10"])), (*STATIC, "gru")
    for cut in LENGTHS if "transfer" in chosen else ():
        others = [np.insert(maps[one], 2, one, axis=1) for one in LENGTHS if one != cut]
        points = np.insert(maps[cut], 2, cut, axis=1)
        apart = [abs(points[:, 0] - one) + abs(points[:, 1] - p) / bar for one in points[[0, -1], 0] for p in KNOWN]
        known = np.isin(np.arange(len(points)), [int(np.argmin(one)) for one in apart])
        levels = np.round(points[:, 1] / BAND) * BAND
        blocks = [*(block(f"{one[0, 2]:g} cm", one) for one in others), block("six points", points[known])]
        tests = [block(f"{one / bar:g} bar", points[~known & (levels == one)]) for one in np.unique(levels[~known])]
        training = Training(f"transfer to {cut} cm", "transfer", tuple(blocks), facts=facts[cut])
        yield Task(training, tuple(tests)), STATIC


def block(name, table):
    """A block of a table whose last column is the output."""
    return DataBlock.of(name, table[:, :-1], table[:, -1])


def recorded(folder, cut, kink, test):
    """A recording, averaged to 50 Hz."""
    contraction, _, pressure, force, _ = rows(folder, cut, kink, test)
    size = pressure.size // THIN * THIN
    means = np.column_stack([pressure, force])[:size].reshape(-1, THIN, 2).mean(axis=1)
    return block(f"{kink}, {test}", np.column_stack([np.full(len(means), contraction), means]))


def elbow_task(folder):
    """Motion of the elbow from commands, as recorded every 10 ms."""
    files = sorted(one for one in (folder / "ident_data").glob("*.csv") if one.stem != "datainfo")
    blocks = []
    for file in files:
        one = elbow.recording(file)
        grid = np.arange(one.time[0], one.time[-1], elbow.PERIOD)
        last = np.searchsorted(one.time, grid + elbow.PERIOD / 2, side="right") - 1
        blocks.append(DataBlock.of(file.stem, one.pressures[last], np.interp(grid, one.time, one.angle)))
    known, asked = blocks[:: elbow.EVERY], [one for i, one in enumerate(blocks) if i % elbow.EVERY]
    return Task(Training("elbow", "joint", tuple(known), elbow.PERIOD), tuple(asked))


def calibrated_elbow(training):
    """The model of elbow.py, which starts at angle 0: the measured one is not an input."""
    period = training.period

    def recording(commands, angle):
        return elbow.JointRecording(period * np.arange(len(angle)), angle, commands, commanded=True)

    found = calibrate_from_commands(
        *elbow.elbow(), [recording(one.inputs, one.output) for one in training.blocks], elbow.PRIOR
    )

    def predict(commands):
        one = recording(commands, np.zeros(len(commands)))
        simulated = found.simulate(one)
        return np.interp(one.time, simulated.time, simulated.after)

    return predict


def pair_blocks(folder):
    """Blocks of displacement [m], pressures [Pa] and force [N]."""
    data = loadmat(folder / "data" / "data.mat")
    table = np.column_stack([data["x"], data["p1"] * kPa, data["p2"] * kPa, data["F"]])
    return [block(f"samples {i} to {i + 499}", table[i : i + 500]) for i in range(0, len(table) - 499, 500)]


def pair_force(values, inputs):
    """Difference of two forces of Eq. 2, of muscles that a displacement shortens and lengthens."""
    x, first, second = inputs.T
    *muscles, middle, length, decay = values
    total = 0.0
    for sign, pressure, own in ((-1, first, muscles[:5]), (1, second, muscles[5:])):
        contraction, p = middle + sign * x / length, pressure / bar
        linear = (own[0] * p + own[1]) * contraction + own[2] * p + own[3]
        total = total + sign * (linear + own[4] * np.exp(-decay * contraction))
    return total


def fit_pair(blocks):
    """Least squares of Eq. 2 for both muscles."""
    inputs = np.concatenate([one.inputs for one in blocks])
    output = np.concatenate([one.output for one in blocks])
    start = [*(2 * [-150.0, 50.0, 40.0, -20.0, 10.0]), 0.1, 0.2, 20.0]
    bounds = np.array([*(10 * [(-1e4, 1e4)]), (0.0, 0.3), (0.05, 1.0), (1.0, 200.0)]).T
    found = least_squares(lambda values: pair_force(values, inputs) - output, start, bounds=bounds, x_scale="jac")
    return functools.partial(pair_force, found.x)


def fit_pair_process(blocks):
    """A Gaussian process of displacement and both pressures."""
    inputs = np.concatenate([one.inputs for one in blocks])[::35]
    found = GaussianProcess.fitted(inputs, np.concatenate([one.output for one in blocks])[::35])
    return found.predict


def show(name, method, score, reference):
    """Print a row of the table."""
    error = score.nrmse
    relative = f"{score.relative_to(reference).value:.2f}" if reference else "-"
    spread = f"{error.value:.3f} ({error.lower:.3f}..{error.upper:.3f})"
    print(f"| {name} | {method} | {error.value * score.scale:.3g} | {spread} | {relative} |", flush=True)


def main():
    """Print the rows of the table."""
    parser = argparse.ArgumentParser(description="Prediction of public recordings.")
    parser.add_argument("data", choices=("muscle-sensory", "elbow", "pneu-sim"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--tasks", default="map,isometric,transfer", help="of muscle-sensory")
    parser.add_argument("--methods", default="", help="default: all that apply")
    options = parser.parse_args()
    warnings.simplefilter("ignore", McKibbenWarning)
    if options.tasks == "phases":
        print_phases(options.folder)
        return
    if options.tasks == "left-out":
        maps = {f"{cut} cm": map_of(options.folder, cut).T for cut in LENGTHS}
        sets = {
            name: IsobaricDataset.of(contraction=eps, pressure=p, force=force, slack_force=SLACK)
            for name, (eps, p, force) in maps.items()
        }
        left_out.print_table(sets, ["Exponential", "Smooth", left_out.PLAIN])
        return
    print("| task | method | RMSE [N or rad] | NRMSE | relative |\n|---|---|---|---|---|")
    if options.data == "pneu-sim":
        blocks = pair_blocks(options.folder)
        known, asked = blocks[::2], blocks[1::2]
        task = Task(Training("pair", "transfer", tuple(known)), tuple(asked))  # three inputs
        scores = {}
        for method, fit in (("Eq. 2", fit_pair), ("gp", fit_pair_process)):
            predict = fit(known)
            scores[method] = task.score({one.name: predict(one.inputs) for one in asked})
            show("force of a pair", method, scores[method], scores["Eq. 2"])
        return
    if options.data == "elbow":
        tasks = [(elbow_task(options.folder), ("calibrated", "gp", "gru"))]
    else:
        tasks = muscle_sensory(options.folder, options.tasks.split(","))
    methods, found = BASELINES | {"calibrated": calibrated_elbow}, {}
    for task, names in tasks:
        reference = None
        for method in [one for one in names if not options.methods or one in options.methods.split(",")]:
            try:
                score = task.score(predictions(methods[method], task))
            except IdentificationError as error:
                print(f"| {task.name} | {method} | - | {error.message.partition(' (')[0]} | - |")
                continue
            reference = score if method == names[0] else reference
            show(task.name, method, score, reference)
            found.setdefault((task.training.kind, method), []).append(score.nrmse.value)
    for (kind, method), errors in found.items():
        print(f"{kind}, {method}: median NRMSE of {len(errors)} {np.median(errors):.3f}")


if __name__ == "__main__":
    main()
