"""A lab in plain arrays that shares no code with the plants of the toolkit, as a joint rig.

No class of the toolkit's plant, muscles, valves or sensors is used. Muscles: a force law after J. Sarosi, with a
pressure threshold; LuGre friction; air with an energy balance and a warm wall, in a braid. Valves: ISO 6358 with other
conductances and critical ratios to fill and to vent, a tube with a volume, a restriction and a dead time, a reservoir
behind a line, a delay of the commands; a slow pressure regulator with a second-order lag and a dead zone, a fast
proportional valve with a pressure loop of its own, or switching valves with pulse width modulation and unequal delays.
Sensors: an encoder of 13 bits with an offset, and noisy pressure sensors with offsets and a converter of 12 bits.

    mckibben --extension benchmarks/foreign_rig.py rig control SCENARIO.yaml --rig RIG.yaml --out DIR

RIG.yaml: `rig: {class: ForeignRig, valves: regulator}`, or `spool`, `switching`. benchmarks/foreign_lab.py calibrates,
tunes and evaluates controllers on it.
"""

import sys
from dataclasses import dataclass
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree

from mckibben.codegen.native import compile_native
from mckibben.rig import JointHardware
from mckibben.rig.backend import Backend, Block, Channel, Watchdog
from mckibben.units import BoundedInt, bar, deg

PERIOD, STEPS, LATEST = 1e-3, 10, 12  # control period [s], integration steps in it, oldest command kept
HIGHEST = 6e5  # command [Pa]
ATM, RT, RHO, KAPPA = 1.013e5, 287.0 * 293.15, 1.185, 1.4
L = 1e-8  # m^3/(s Pa) per L/(s bar)
SPECIMEN = {"length": 0.25, "diameter": 0.015, "angle": np.deg2rad(25.0)}

COMMON = {
    "r1": 0.0286, "r2": 0.0277, "rest1": 0.2247, "rest2": 0.2256,  # 28 mm and 225 mm on the drawing
    "mass": 1.2, "arm": 0.25, "damping": 0.06, "bearing": 0.03,
    "a1": 60e3, "a2": -34.0, "a3": -4.1e-3, "a4": 1.02e-3, "a5": -30.0, "strength1": 0.97, "strength2": 1.04,
    "threshold": 15e3, "coulomb": 5.0, "by_force": 0.015, "bristle": 2.2e4, "viscous": 25.0,
    "wall": 0.4, "volume": 0.93, "zero": np.deg2rad(0.5), "encoder": 2 * np.pi / 2**13, "noise": 3e3, "bias1": 900.0,
    "bias2": -1200.0, "adc": 10e5 / 2**12, "compressor": 7.2e5, "disturbance": 0.0, "disturbed": 0.0,
}  # fmt: skip
REGULATOR = {
    "fill": 0.034 * L, "vent": 0.022 * L, "b_fill": 0.18, "b_vent": 0.42, "tube_c": 0.15 * L, "tube_v": 5e-6,
    "wn": 75.0, "zeta": 0.75, "band": 0.35e5, "dead": 1.5e3, "reservoir": 0.3e-3, "line": 0.04 * L,
    "delay": 5, "sound": 3,
}  # fmt: skip
SPOOL = {
    "fill": 0.42 * L, "vent": 0.36 * L, "b_fill": 0.28, "b_vent": 0.36, "tube_c": 0.5 * L, "tube_v": 6e-6,
    "wn": 500.0, "zeta": 0.7, "band": 1.2e5, "dead": 0.045, "reservoir": 0.5e-3, "line": 0.2 * L,
    "ki": 2.5, "delay": 2, "sound": 2,
}  # fmt: skip
SWITCHING = {
    "fill": 0.052 * L, "vent": 0.068 * L, "b_fill": 0.22, "b_vent": 0.45, "tube_c": 0.18 * L, "tube_v": 2.5e-6,
    "period": 8e-3, "opens": 1.4e-3, "shuts": 2.3e-3, "band": 0.5e5, "dead": 2.0e3, "reservoir": 0.4e-3,
    "line": 0.06 * L, "delay": 2, "sound": 1,
}  # fmt: skip
KINDS = {"regulator": REGULATOR, "spool": SPOOL, "switching": SWITCHING}


def numbers(kind, **others):
    """Numbers of a plant, some of them others."""
    return {**COMMON, **KINDS[kind], **others}


def law(n, contraction, pressure, strength=1.0):
    """Force [N] of the muscle at a contraction and gauge pressure [Pa]."""
    p = jnp.maximum(pressure, 0.0)
    p = p - n["threshold"] * jnp.tanh(p / n["threshold"])
    k = contraction
    force = (p * 1e-3 + n["a1"] * 1e-3) * jnp.exp(n["a2"] * k) + n["a3"] * p * k + n["a4"] * p + n["a5"]
    return strength * jnp.maximum(force, 0.0)


def drag(n, force, side, travel):
    """Friction [N] in a test of the muscle that shortens (side -1) or lengthens; it slides wherever it is."""
    return side * (n["coulomb"] + n["by_force"] * force)


def weighted(n, weight):
    """Numbers with a weight [kg] clipped on at 200 mm."""
    moment = n["mass"] * n["arm"] + weight * 0.2
    arm = (n["mass"] * n["arm"] ** 2 + weight * 0.2**2) / moment
    return {**n, "arm": arm, "mass": moment / arm}


def braid_volume(n, contraction):
    """Volume [m^3] of a muscle with its fittings."""
    length, d, angle = SPECIMEN["length"], SPECIMEN["diameter"], SPECIMEN["angle"]
    left = 1 - contraction
    around = (1 - (np.cos(angle) * left) ** 2) / np.sin(angle) ** 2
    return n["volume"] * np.pi / 4 * d**2 * length * left * around + 2e-6


def iso(c, b, up, down):
    """Mass flow [kg/s] from up to down [Pa, absolute] (up >= down)."""
    ratio = jnp.minimum(down / up, 1.0)
    sub = jnp.sqrt(jnp.maximum(1 - ((jnp.minimum(ratio, 0.998) - b) / (1 - b)) ** 2, 1e-9))
    sub = jnp.where(ratio > 0.998, sub * (1 - ratio) / 0.002, sub)
    return c * RHO * up * jnp.where(ratio < b, 1.0, sub)


def both(c, b, one, two):
    """Mass flow [kg/s] from one to two, in either direction."""
    return jnp.where(one > two, 1, -1) * iso(c, b, jnp.maximum(one, two), jnp.minimum(one, two))


def start(n, angle=0.0, pressures=(0.0, 0.0)):
    """State at rest: joint, muscles 1 and 2 (axis 0), supply, and the flows and commands under way."""
    p = jnp.asarray(pressures, float)
    return {
        "angle": jnp.asarray(angle, float), "speed": jnp.zeros(()), "bristle": jnp.zeros(2), "muscle": p,
        "heat": jnp.full(2, 293.15), "tube": p, "first": p, "second": jnp.zeros(2), "integral": jnp.zeros(2),
        "phase": jnp.zeros(()), "duty": jnp.zeros(2), "supply": jnp.asarray(n["compressor"], float),
        "air": jnp.zeros(()), "time": jnp.zeros(()),
        "flows": jnp.zeros((6, 2)), "commands": jnp.broadcast_to(p, (LATEST, 2)),
    }  # fmt: skip


def contractions(n, angle):
    """Contractions of both muscles; a positive angle shortens muscle 2."""
    one = (n["rest1"] + n["r1"] * angle) / SPECIMEN["length"]
    two = (n["rest2"] - n["r2"] * angle) / SPECIMEN["length"]
    return 1 - jnp.stack([one, two])


def slope(kind, n, s, command, inflow, opening):
    """Derivatives of the state; `inflow` [kg/s] arrives from the tubes."""
    k, (p1, p2) = contractions(n, s["angle"]), s["muscle"]
    tension = jnp.stack([law(n, k[0], p1, n["strength1"]), law(n, k[1], p2, n["strength2"])])
    arms = jnp.stack([-n["r1"], n["r2"]])
    stretch = -arms * s["speed"]  # d length/dt
    coulomb = n["coulomb"] + n["by_force"] * tension
    level = coulomb * (1 + 0.3 * jnp.exp(-((stretch / 4e-3) ** 2)))
    bristle = stretch - n["bristle"] * jnp.abs(stretch) / level * s["bristle"]
    friction = n["bristle"] * s["bristle"] + 30.0 * bristle + n["viscous"] * stretch
    torque = jnp.sum(arms * (tension + friction))
    torque += n["disturbed"] * s["disturbance"] - n["bearing"] * jnp.tanh(s["speed"] / 0.02) - n["damping"] * s["speed"]
    torque -= n["mass"] * 9.81 * n["arm"] * jnp.sin(s["angle"])
    room = braid_volume(n, k)
    room_rate = jax.jvp(lambda a: braid_volume(n, contractions(n, a)), (s["angle"],), (s["speed"],))[1]
    p, heat = s["muscle"] + ATM, s["heat"]
    come, gone = jnp.maximum(inflow, 0), jnp.maximum(-inflow, 0)
    p_rate = KAPPA / room * (RT * come - RT * heat / 293.15 * gone - p * room_rate)
    p_rate += (KAPPA - 1) / room * n["wall"] * (293.15 - heat)
    mass = p * room / (287.0 * heat)
    heat_rate = heat * (p_rate / p + room_rate / room - (come - gone) / mass)
    tube, supply = s["tube"] + ATM, s["supply"] + ATM
    fill = jnp.maximum(opening, 0) * iso(n["fill"], n["b_fill"], supply, jnp.minimum(tube, supply))
    vent = jnp.maximum(-opening, 0) * iso(n["vent"], n["b_vent"], jnp.maximum(tube, ATM), ATM)
    out = both(n["tube_c"], 0.3, tube, p)
    line = iso(n["line"], 0.3, n["compressor"] + ATM, jnp.minimum(supply, n["compressor"] + ATM))
    rates = {
        "angle": s["speed"], "speed": torque / (n["mass"] * n["arm"] ** 2), "bristle": bristle, "muscle": p_rate,
        "heat": heat_rate, "tube": 1.15 * RT / n["tube_v"] * (fill - vent - out),
        "supply": RT / n["reservoir"] * (line - jnp.sum(fill)), "air": jnp.sum(fill) / RHO,
    }  # fmt: skip
    if kind == "regulator":  # second-order lag of the command
        rates["first"] = s["second"]
        rates["second"] = n["wn"] ** 2 * (command - s["first"]) - 2 * n["zeta"] * n["wn"] * s["second"]
    elif kind == "spool":  # pressure loop, second-order spool
        error = (command - s["tube"]) / n["band"]
        drive = jnp.clip(error + s["integral"], -1, 1)
        rates["integral"] = n["ki"] * jnp.where(jnp.abs(error + s["integral"]) > 1, -s["integral"] * 4, error)
        rates["first"] = s["second"]
        rates["second"] = n["wn"] ** 2 * (drive - s["first"]) - 2 * n["zeta"] * n["wn"] * s["second"]
    return rates, out


def opened(kind, n, s, command):
    """Opening of each valve, -1 to 1, and the state with the duties of the pulses."""
    if kind == "regulator":
        error = s["first"] - s["tube"]
        return jnp.clip(jnp.sign(error) * jnp.maximum(jnp.abs(error) - n["dead"], 0) / n["band"], -1, 1), s
    if kind == "spool":
        spool = jnp.clip(s["first"], -1, 1)
        return jnp.sign(spool) * jnp.maximum(jnp.abs(spool) - n["dead"], 0) / (1 - n["dead"]), s
    new = s["phase"] >= n["period"] - 1e-9
    phase = jnp.where(new, 0.0, s["phase"])
    error = command - s["tube"]
    wanted = jnp.sign(error) * jnp.clip((jnp.abs(error) - n["dead"]) / n["band"], 0, 1)
    wanted = jnp.where(jnp.abs(wanted) < 0.06, 0.0, wanted)
    duty = jnp.where(new, wanted, s["duty"])
    width = jnp.abs(duty) * n["period"] + n["shuts"]
    full = jnp.abs(duty) > 0.97
    on = (duty != 0) & (full | ((phase > n["opens"]) & (phase < width)))
    return jnp.where(on, jnp.sign(duty), 0.0), {**s, "phase": phase + PERIOD / STEPS, "duty": duty}


def advance(kind, n, s, command):
    """State after a control period with a command [Pa] that the host has sent at its beginning."""
    commands = jnp.concatenate([s["commands"][1:], jnp.stack(command)[None]])
    now = commands[LATEST - 1 - n["delay"]]
    inflow = s["flows"][6 - n["sound"]]
    number = jnp.floor(s["time"] / 0.8)
    odd = number - 2 * jnp.floor(number / 2)
    pulse = jnp.where(s["time"] - 0.8 * number < 0.1, 1 - 2 * odd, 0.0)
    s = {**s, "commands": commands, "disturbance": pulse}
    h = PERIOD / STEPS

    def one(carry, _):
        s, total = carry
        opening, s = opened(kind, n, s, now)
        rate, out = slope(kind, n, s, now, inflow, opening)
        middle = {**s, **{name: s[name] + h / 2 * value for name, value in rate.items()}}
        rate, out = slope(kind, n, middle, now, inflow, opening)
        s = {**s, **{name: s[name] + h * value for name, value in rate.items()}}
        if kind == "spool":
            s["first"] = jnp.clip(s["first"], -1.05, 1.05)
        return (s, total + out / STEPS), None

    (s, flow), _ = lax.scan(one, (s, jnp.zeros(2)), None, length=STEPS)
    s = {**s, "flows": jnp.concatenate([s["flows"][1:], flow[None]]), "time": s["time"] + PERIOD}
    s.pop("disturbance")
    return s


def sensed(n, s, noise):
    """Readings of encoder [rad] and pressure sensors [Pa], for standard normal noise of shape (2,)."""
    angle = jnp.floor((s["angle"] + n["zero"]) / n["encoder"] + 0.5) * n["encoder"]
    read = s["muscle"] + jnp.stack([n["bias1"], n["bias2"]]) + n["noise"] * noise
    return angle, jnp.floor(read / n["adc"] + 0.5) * n["adc"]


class ForeignJoint(Backend):
    """A foreign plant, a module like this one, as a joint rig that is faster than real time, with a weight [kg]."""

    physical = True

    def __init__(self, module, kind, seed, period, patience, weight=0.0):
        if abs(period - PERIOD) > 1e-12:
            raise ValueError(f"the control period is {period:g} s, that of this rig {PERIOD:g} s")
        self.rate, self.patience, self.kind = 1 / period, patience, kind
        plant = module.weighted(module.numbers(kind), weight)
        first, unravel = ravel_pytree(module.start(plant))
        self.first, self.random = np.asarray(first), np.random.default_rng(seed)

        def step(state, given):
            after = module.advance(kind, plant, unravel(state), (given[0], given[1]))
            angle, read = module.sensed(plant, after, given[2:])
            return ravel_pytree(after)[0], jnp.stack([angle, read[0], read[1]])

        self.step = compile_native(step, first.size, 4)

    @property
    def inputs(self):
        """Angle and pressures."""
        pressures = [Channel(name, "Pa", -0.5 * bar, 10 * bar) for name in ("pressure1", "pressure2")]
        return [Channel("angle", "rad", -170 * deg, 170 * deg), *pressures]

    @property
    def outputs(self):
        """Both valves."""
        return [Channel(name, "Pa", 0.0, 9 * bar) for name in ("valve1", "valve2")]

    @property
    def description(self):
        """Description for the record."""
        return {"kind": f"foreign {self.kind}"}

    def open(self):
        """Open it, vented and at rest."""
        self.command, self.now, self.next, self.watchdog = (0.0, 0.0), 0.0, 0, Watchdog(self.patience)
        self.state, self.row = self.step(self.first, np.zeros(4))

    def clock(self):
        """Time of the last sample [s]."""
        return self.now

    def heartbeat(self):
        """Reset the watchdog."""
        self.watchdog.reset(self.now)

    def read(self, count, *, timeout=1.0):
        """The next samples."""
        first, rows = self.next, []
        for _ in range(count):
            if self.watchdog.expires(self.next * PERIOD):
                self.vent()
            if self.next:
                given = np.array([*self.command, *self.random.standard_normal(2)])
                self.state, self.row = self.step(self.state, given)
            rows.append([*self.row])
            self.next += 1
        times = np.array([PERIOD * number for number in range(first, self.next)])
        self.now = float(times[-1])
        return Block(first, times, np.array(rows), np.zeros(count, np.int64))

    def set_valves(self, pressures):
        """Set both valves [Pa]."""
        if not self.watchdog.has_expired:
            self.command = tuple(min(max(one, 0.0), HIGHEST) for one in pressures)

    def vent(self):
        """Vent both muscles."""
        self.command = (0.0, 0.0)

    def close(self):
        """Vent."""
        self.vent()


WEIGHTS = []  # kg, to be clipped on for the coming sessions


@dataclass(frozen=True, kw_only=True)
class ForeignRig(JointHardware):
    """The plant of a class's module by its valves; in a calibration, `weight` [g] is on the second session."""

    valves: str
    seed: Annotated[int, BoundedInt(0, 10**6)] = 0
    weight: Annotated[int, BoundedInt(0, 10**4)] = 0

    def backend(self, plant, run):
        """Return the joint."""
        WEIGHTS.append(1e-3 * self.weight if WEIGHTS else 0.0)
        module = sys.modules[type(self).__module__]
        return ForeignJoint(module, self.valves, self.seed, run.period, run.patience, WEIGHTS[-1])
