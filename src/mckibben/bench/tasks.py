"""The tasks of the benchmark: published data with a licence, and simulated muscles of foreign equations."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from mckibben import catalog
from mckibben.bench.foreign import ForeignJoint, ForeignMuscle
from mckibben.bench.task import DataBlock, Floats, Task, Training
from mckibben.errors import ParameterError, suggest
from mckibben.units import bar, ms, percent

_PERIOD = 20 * ms
_JOINT_PERIOD = 10 * ms
_NOISE = 0.5  # N, of training data
_ANGLE_NOISE = 5e-4  # rad
_LEAST_LENGTHS = 6  # of a map of which one is left out
_SIMULATED = "mckibben.bench.foreign (simulated; equations and sources there); test data are without noise"
_MUSCLE = ForeignMuscle()
SOFT = ForeignMuscle(contact=1.2 * bar, contact_slope=4 * bar, contact_width=0.6 * bar, thread=2e-7)
"""The muscle of the tasks "map-wall" and "map-four-lengths": its threads stretch, and its bladder is stiff."""
JOINT = ForeignJoint()
"""The joint of the task "joint"."""


def _setup(muscle: ForeignMuscle) -> dict[str, float]:
    return {
        "initial_length": muscle.length,
        "initial_diameter": muscle.diameter,
        "braid_angle": muscle.braid_angle,
        "slack_force": 4 * _NOISE,
    }


def split_map(
    name: str, contraction: Floats, pressure: Floats, force: Floats, *, source: str, facts: dict[str, float]
) -> Task:
    """Split a static map: every fourth inner pressure is tested, and of six contractions every third inner one."""
    inputs = np.column_stack([contraction, pressure])
    level, length = np.round(pressure / 1e3).astype(int), np.round(contraction * 1e3).astype(int)
    levels, lengths = np.unique(level)[1:-1][1::4], np.unique(length)
    lengths = lengths[1:-1][1::3] if lengths.size >= _LEAST_LENGTHS else lengths[:0]
    rest = ~(np.isin(level, levels) | np.isin(length, lengths))
    places = {f"{one / 100:g} bar": level == one for one in levels.tolist()}
    places |= {f"contraction {one / 10:g} %": (length == one) & ~np.isin(level, levels) for one in lengths.tolist()}
    tests = tuple(DataBlock.of(label, inputs[own], force[own]) for label, own in places.items() if own.any())
    training = Training(name, "map", (DataBlock.of("map", inputs[rest], force[rest]),), facts=facts)
    return Task(training, tests, source)


def _published_map(name: str, entry: str) -> Task:
    data = catalog.dataset(entry)
    taut = data.force > 0  # zeros mean slack; they are not forces
    specimen = catalog.specimen(str(data.table.attrs["specimen"]))
    facts = {
        "initial_length": specimen.initial_length,
        "initial_diameter": specimen.initial_diameter,
        "braid_angle": specimen.braid_angle,
    }
    parts = (data.contraction[taut], data.pressure[taut], data.force[taut])
    return split_map(name, *parts, source=catalog.cite(entry).partition("\n")[0], facts=facts)  # pyrefly: ignore[bad-argument-type]


def _grid(contractions: ArrayLike, pressures: ArrayLike) -> tuple[Floats, Floats]:
    first, second = np.meshgrid(contractions, pressures, indexing="ij")
    return first.ravel(), second.ravel()


def _noisy_map(muscle: ForeignMuscle, contraction: Floats, pressure: Floats, seed: int) -> Floats:
    force = muscle.static_force(contraction, pressure)
    return force + np.random.default_rng(seed).normal(0, _NOISE, force.shape)


def _simulated_map() -> Task:
    """A dense map; the pressures begin below that of the contact between bladder and braid."""
    contraction, pressure = _grid(np.linspace(-0.02, 0.22, 9), np.linspace(0.25, 6, 12) * bar)
    training = _noisy_map(SOFT, contraction, pressure, 1)
    task = split_map("map-wall", contraction, pressure, training, source=_SIMULATED, facts=_setup(SOFT))
    return Task(task.training, tuple(_exact(SOFT, one) for one in task.tests), _SIMULATED)


def _exact(muscle: ForeignMuscle, block: DataBlock) -> DataBlock:
    return DataBlock.of(block.name, block.inputs, muscle.static_force(*block.inputs.T))


def _four_lengths() -> Task:
    """Four fixed lengths, as in most laboratories, with one typing error of 12 %; the lengths between are tested."""
    lengths, between, pressures = np.array([0.0, 0.06, 0.12, 0.18]), (0.03, 0.09, 0.15), np.arange(1, 7) * bar
    contraction, pressure = _grid(lengths, pressures)
    force = _noisy_map(SOFT, contraction, pressure, 2)
    force[np.flatnonzero((contraction == 0.06) & (pressure == 4 * bar))] *= 1.12
    block = DataBlock.of("four lengths", np.column_stack([contraction, pressure]), force)
    training = Training("map-four-lengths", "map", (block,), facts=_setup(SOFT))
    tests = []
    for one in between:
        inputs = np.column_stack(_grid(np.array([one]), np.linspace(1, 6, 21) * bar))
        tests.append(DataBlock.of(f"contraction {one / percent:g} %", inputs, SOFT.static_force(*inputs.T)))
    return Task(training, tuple(tests), _SIMULATED)


def _recorded(name: str, contraction: Floats, pressure: Floats, seed: int | None) -> DataBlock:
    force = _MUSCLE.force(_PERIOD, contraction, pressure)
    if seed is not None:
        force = force + np.random.default_rng(seed).normal(0, _NOISE, force.shape)
    return DataBlock.of(name, np.column_stack([contraction, pressure]), force)


def _sine(middle: float, amplitude: float, frequency: float, cycles: float) -> Floats:
    time = np.arange(0, cycles / frequency, _PERIOD)
    return middle + amplitude * np.sin(2 * np.pi * frequency * time)


def _hysteresis() -> Task:
    """Slow full cycles are known; other pressures, small loops, other rates and varying amplitudes are asked."""
    slow = _sine(0.08, 0.06, 0.1, 3)
    training = tuple(_recorded(f"0.1 Hz, {p} bar", slow, np.full(slow.size, p * bar), 10 + p) for p in (2, 4, 6))
    asked = {
        "0.1 Hz, 3 bar": (slow, 3),
        "0.1 Hz, 5 bar": (slow, 5),
        "small loops, 4 bar": (_sine(0.09, 0.01, 0.1, 3), 4),
        "small loops, 5 bar": (_sine(0.06, 0.02, 0.1, 3), 5),
        "1 Hz, 4 bar": (_sine(0.08, 0.05, 1.0, 10), 4),
        "0.02 Hz, 4 bar": (_sine(0.08, 0.05, 0.02, 1), 4),
        "two sines, 4 bar": (_sine(0.08, 0.03, 0.1, 3) + _sine(0, 0.025, 0.37, 11.1)[: slow.size], 4),
        "decaying, 3 bar": (0.08 + (slow - 0.08) * np.linspace(1, 0.1, slow.size), 3),
    }
    tests = tuple(
        _recorded(name, lengths, np.full(lengths.size, p * bar), None) for name, (lengths, p) in asked.items()
    )
    facts = _setup(_MUSCLE)
    return Task(Training("hysteresis", "hysteresis", training, _PERIOD, facts), tests, _SIMULATED)


def _stairs(levels: Sequence[float], hold: float, lag: float = 0.1) -> Floats:
    """Pressures [Pa] that approach levels [bar] with a lag, each for a time [s]."""
    wanted = np.repeat(np.asarray(levels, float) * bar, round(hold / _PERIOD))
    found, now = np.empty(wanted.size), wanted[0]
    for i, one in enumerate(wanted):
        now += (one - now) * (1 - np.exp(-_PERIOD / lag))
        found[i] = now
    return found


def _isometric() -> Task:
    """Staircases at four lengths are known; other lengths, large steps, short and long holds are asked."""
    stairs = _stairs((0.5, 2, 3.5, 5, 6, 4.5, 3, 1.5), 5)
    training = tuple(
        _recorded(f"staircase, {e / percent:g} %", np.full(stairs.size, e), stairs, 20 + i)
        for i, e in enumerate((0.02, 0.07, 0.12, 0.16))
    )
    asked = {
        "staircase, 4.5 %": (0.045, stairs),
        "staircase, 9.5 %": (0.095, stairs),
        "one step, 7 %": (0.07, _stairs((1, 6), 20)),
        "release, 7 %": (0.07, _stairs((6, 1.5), 20)),
        "short holds, 2 %": (0.02, _stairs((1, 4, 2, 6, 3, 5, 1), 0.6)),
        "short holds, 12 %": (0.12, _stairs((3, 5, 4, 6, 3), 0.6)),
        "slow ramp, 10 %": (0.10, np.linspace(1, 6, 2000) * bar),
    }
    tests = tuple(_recorded(name, np.full(p.size, e), p, None) for name, (e, p) in asked.items())
    facts = _setup(_MUSCLE)
    return Task(Training("isometric", "isometric", training, _PERIOD, facts), tests, _SIMULATED)


def _transfer() -> Task:
    """Maps of four specimens are known, and six points of a fifth, of which the rest is asked."""
    rng = np.random.default_rng(30)
    contraction, pressure = _grid(np.linspace(0, 0.18, 7), np.arange(1, 7) * bar)
    blocks, tests = [], []
    for number in range(5):
        spread = rng.normal(1, 0.06, 6)
        muscle = ForeignMuscle(
            diameter=0.010 * spread[0] ** 0.5,
            braid_angle=0.436 * spread[1] ** 0.5,
            wall=7.2e-6 * spread[2],
            first=1.3e5 * spread[3],
            contact=4.5e4 * spread[4] ** 3,
            ends=1.12 * spread[5] ** 0.5,
        )
        inputs = np.column_stack([contraction, pressure, np.full(contraction.size, float(number))])
        force = _noisy_map(muscle, contraction, pressure, 31 + number)
        if number < 4:
            blocks.append(DataBlock.of(f"specimen {number}", inputs, force))
            continue
        known = np.isin(contraction, contraction[[0, 21, 36]]) & np.isin(pressure, (2 * bar, 5 * bar))
        blocks.append(DataBlock.of("specimen 4, six points", inputs[known], force[known]))
        for one in np.unique(pressure):
            own = ~known & (pressure == one)
            exact = muscle.static_force(contraction[own], pressure[own])
            tests.append(DataBlock.of(f"specimen 4, {one / bar:g} bar", inputs[own], exact))
    return Task(Training("transfer", "transfer", tuple(blocks), facts=_setup(_MUSCLE)), tuple(tests), _SIMULATED)


def _joint() -> Task:
    """Steps and multisines of the commands are known; other steps, rates and mean pressures are asked."""
    size = round(12 / _JOINT_PERIOD)
    time = _JOINT_PERIOD * np.arange(size)

    def steps(seed: int, hold: float, low: float, high: float) -> Floats:
        rng = np.random.default_rng(seed)
        count = round(12 / hold)
        levels = rng.uniform(low, high, (2, count)) * bar
        levels[:, 0] = 2.5 * bar
        return np.repeat(levels, size // count, axis=1)[:, :size]

    def sines(middle: float, amplitude: float, frequencies: Sequence[float]) -> Floats:
        total = sum(np.sin(2 * np.pi * one * time + i) for i, one in enumerate(frequencies))
        moves = amplitude * np.sin(np.pi * time / time[-1]) ** 0.5 * total / len(frequencies)
        return np.stack([middle + moves, middle - moves]) * bar

    def block(name: str, commands: Floats, seed: int | None) -> DataBlock:
        angle = JOINT.angles(_JOINT_PERIOD, *commands)
        if seed is not None:
            angle = angle + np.random.default_rng(seed).normal(0, _ANGLE_NOISE, angle.shape)
        return DataBlock.of(name, commands.T, angle)

    training = (
        block("steps of 1.2 s", steps(40, 1.2, 1, 5), 50),
        block("steps of 1.2 s, again", steps(41, 1.2, 1, 5), 51),
        block("steps of 0.4 s", steps(42, 0.4, 1.5, 4), 52),
        block("multisine about 2.5 bar", sines(2.5, 2.5, (0.2, 0.5, 1.1, 2.3)), 53),
    )
    tests = (
        block("steps of 2 s", steps(60, 2.0, 1, 5), None),
        block("steps of 0.6 s", steps(61, 0.6, 1, 4.5), None),
        block("multisine about 3.5 bar", sines(3.5, 2.5, (0.3, 0.7, 1.7)), None),
        block("multisine about 1.8 bar", sines(1.8, 1.2, (0.3, 0.7, 1.7)), None),
        block("sine of 0.1 Hz", sines(2.5, 1.5, (0.1,)), None),
        block("sine of 3 Hz", sines(2.5, 1.0, (3.0,)), None),
    )
    facts = _setup(_MUSCLE) | {
        "pulley_radius": JOINT.radius,
        "contraction_at_zero": JOINT.contraction,
        "inertia": 1.1 * JOINT.inertia,  # as drawn, not as built
        "gravity_torque": 0.95 * JOINT.gravity_torque,
    }
    return Task(Training("joint", "joint", training, _JOINT_PERIOD, facts), tests, _SIMULATED)


TASKS: dict[str, Callable[[], Task]] = {
    "map-dmsp-10": functools.partial(_published_map, "map-dmsp-10", "dmsp-10-250-martens2017"),
    "map-dmsp-20": functools.partial(_published_map, "map-dmsp-20", "dmsp-20-300-martens2017"),
    "map-wall": _simulated_map,
    "map-four-lengths": _four_lengths,
    "hysteresis": _hysteresis,
    "isometric": _isometric,
    "transfer": _transfer,
    "joint": _joint,
}
"""Functions that make the tasks, by name; each call makes the same data, which takes seconds for recordings."""


@functools.cache
def task_named(name: str) -> Task:
    """Return a task of `TASKS`; raises a `ParameterError` if there is none of that name."""
    if name not in TASKS:
        raise ParameterError(f"there is no task {name!r}", value=name, remedy=suggest(name, list(TASKS)))
    return TASKS[name]()
