"""Tests with a shut valve: how often the 95 % intervals of `identify_air` hold the truth.

    python benchmarks/shut_valve.py [--runs 200]

A muscle of 10 mm at two contractions is filled to 5.5 bar and shut for 3 s, then vented to 1 bar and shut for 3 s. The
wall has 0.03 to 0.3 W/K between the contractions and grows with its area; there are a leak of 0 to 1e-5 L/(s*bar), a
dead volume of 0 to 6 cm^3, and noise of 0.1 to 2 kPa at 1 kHz. "As in the lab" adds a room of 15 to 30 degrees C, which
the identification takes for 20, and a zero of the sensor of up to 30 mbar.
"""

import argparse
import warnings

import numpy as np

from mckibben import catalog
from mckibben.calibration import identify_air
from mckibben.dataset import Recording
from mckibben.errors import IdentificationError, McKibbenWarning
from mckibben.units import bar, cm, kPa, ms, percent

SPECIMEN = catalog.specimen("MAS-10-180N-AA-MC-O")
CONTRACTIONS = (2 * percent, 22 * percent)
ATMOSPHERE, GAS, ROOM, DENSITY, KAPPA = 101325.0, 288.0, 293.15, 1.185, 1.4
BETWEEN = sum(CONTRACTIONS) / 2
VALVE, SUPPLY, HIGH, LOW = 2e-9, 7 * bar, 5.5 * bar, 1 * bar
PERIOD, WATCHED, LEADING = 1 * ms, 3000, 200  # samples
NAMES = ("wall_conductance", "leak", "dead_volume")


def flow(conductance, inlet, outlet, temperature):
    """Mass flow by ISO 6358 [kg/s] from air at a temperature [K]; 0 where it would return."""
    ratio = np.minimum(outlet / inlet, 1.0)
    share = np.sqrt(1 - np.maximum((np.minimum(ratio, 0.999) - 0.3) / 0.7, 0.0) ** 2)
    return conductance * DENSITY * inlet * np.sqrt(ROOM / temperature) * share * np.minimum((1 - ratio) / 0.001, 1.0)


def pressures(volume, wall, leak, room):
    """Gauge pressures [Pa] of tests, shape (samples, tests), by Runge and Kutta."""
    state = np.stack([np.full_like(volume, ATMOSPHERE), room])
    stage, since = np.zeros(volume.size, int), np.zeros(volume.size, int)

    def rates(state, filling, venting):
        pressure, temperature = state
        inflow = flow(VALVE * filling, SUPPLY + ATMOSPHERE, pressure, room)
        outflow = flow(VALVE * venting + leak, pressure, ATMOSPHERE, temperature)
        energy = GAS * (inflow * room - outflow * temperature)
        slope = (KAPPA * energy + (KAPPA - 1) * wall * (room - temperature)) / volume
        mass = pressure * volume / (GAS * temperature)
        return np.stack([slope, temperature * (slope / pressure - (inflow - outflow) / mass)])

    found = [state[0]] * LEADING
    while np.any(stage < 4):
        filling, venting = (stage == 0).astype(float), (stage == 2).astype(float)
        k1 = rates(state, filling, venting)
        k2 = rates(state + PERIOD / 2 * k1, filling, venting)
        k3 = rates(state + PERIOD / 2 * k2, filling, venting)
        k4 = rates(state + PERIOD * k3, filling, venting)
        state = state + PERIOD / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        found.append(state[0])
        gauge, since = state[0] - ATMOSPHERE, since + 1
        ends = np.select([stage == 0, stage == 2, stage < 4], [gauge > HIGH, gauge < LOW, since >= WATCHED], False)
        stage, since = stage + ends, np.where(ends, 0, since)
    return np.array(found) - ATMOSPHERE


def growth(contraction):
    """Area 4 V/d of the wall over that between the two contractions."""
    areas = [
        2 * np.sqrt(np.pi * float(SPECIMEN.volume(at)) * SPECIMEN.initial_length * (1 - at))
        for at in (contraction, BETWEEN)
    ]
    return areas[0] / areas[1]


def coverage(runs, *, lab):
    """Print how many intervals hold the truth, and how wide they are."""
    draw = np.random.default_rng(7)
    true = {
        "wall_conductance": np.exp(draw.uniform(np.log(0.03), np.log(0.3), runs)),
        "leak": draw.uniform(0, 1e-13, runs),
        "dead_volume": draw.uniform(0, 6, runs) * cm**3,
    }
    noise = np.exp(draw.uniform(np.log(0.1), np.log(2.0), runs)) * kPa
    room = draw.uniform(288.15, 303.15, runs) if lab else np.full(runs, ROOM)
    zero = draw.uniform(-0.03, 0.03, runs) * bar if lab else np.zeros(runs)
    rows = [
        pressures(
            float(SPECIMEN.volume(at)) + true["dead_volume"], growth(at) * true["wall_conductance"], true["leak"], room
        )
        for at in CONTRACTIONS
    ]
    held, widths, warned, refused = {name: [] for name in NAMES}, {name: [] for name in NAMES}, 0, 0
    for run in range(runs):
        tests = []
        for at, columns in zip(CONTRACTIONS, rows, strict=True):
            gauge = columns[:, run] + zero[run] + draw.normal(0, noise[run], len(columns))
            time = PERIOD * np.arange(gauge.size)
            tests.append(Recording.of(time=time, pressure=gauge, force=0 * gauge, contraction=at))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", McKibbenWarning)
            try:
                found = identify_air(tests, SPECIMEN)
            except IdentificationError:
                refused += 1
                continue
        warned += any(issubclass(one.category, McKibbenWarning) for one in caught)
        for name, one in found.quantities.items():
            low, high = one.interval
            held[name].append(low < true[name][run] < high)
            widths[name].append((high - low) / 2)
    print(f"{'as in the lab' if lab else 'the model is true'}: {runs} runs, {warned} with a warning, {refused} refused")
    for name in NAMES:
        share, half = np.mean(held[name]), np.median(widths[name])
        error = 1.96 * np.sqrt(share * (1 - share) / len(held[name]))
        print(f"  {name}: {share:.0%} +- {error:.0%} hold the truth, median half width {half:.2g} in SI")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    runs = parser.parse_args().runs
    coverage(runs, lab=False)
    coverage(runs, lab=True)
