"""An elbow in plain arrays, written by an independent referee, that shares no code with the plants of the toolkit.

Pulleys of 25 mm with two unlike muscles of 20 mm: a force that is a polynomial of the contraction and saturates with
pressure, a pressure threshold that grows with contraction, friction with four presliding lengths, polytropic air with
other exponents to fill and to vent, a limb that hangs at an angle. Valves (ISO 6358): two proportional valves per
muscle with overlap and a sampled pressure loop on the pressure at their outlet (`pair`), or a regulator with a rate
limit, hysteresis, a second-order lag and a dead zone (`servo`); tubes with volumes, through which the flow is
turbulent, a reservoir, and a compressor that cycles. Sensors: an encoder of 12 bits with an offset; pressure sensors
with gains, noise, a lag and a converter of 12 bits. The rig, its signals and the nozzle are those of
benchmarks/foreign_rig.py.

    mckibben --extension benchmarks/foreign_elbow.py rig control SCENARIO.yaml --rig RIG.yaml --out DIR

RIG.yaml: `rig: {class: ElbowRig, valves: pair}`, or `servo`.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jax import lax

from mckibben.component.extensions import load_extension

rig = load_extension(Path(__file__).with_name("foreign_rig.py"))  # found without PYTHONPATH, as an extension

PERIOD, STEPS, LATEST = rig.PERIOD, 20, 12  # control period [s], integration steps in it, oldest command kept
ATM, RT, RHO, L = rig.ATM, rig.RT, rig.RHO, rig.L
SPECIMEN = {"length": 0.30, "diameter": 0.02}
SPANS = np.array([0.15e-3, 0.5e-3, 1.2e-3, 3e-3])  # presliding lengths [m]
PARTS = np.array([0.3, 0.3, 0.25, 0.15])  # of the friction

COMMON = {
    "r1": 0.0253, "r2": 0.0246, "rest1": 0.2706, "rest2": 0.2693,  # 25 mm and 270 mm on the drawing
    "mass": 2.15, "arm": 0.295, "inertia": 0.010, "tilt": np.deg2rad(1.0), "damping": 0.15, "bearing": 0.05,
    "area": 2.3e-3, "saturation": 0.044e-6, "threshold": 22e3, "by_contraction": 60e3, "passive": 180.0,
    "strength1": 0.97, "strength2": 1.05, "scale1": 1.0, "scale2": 0.97,
    "coulomb": 6.0, "by_force": 0.015, "viscous": 40.0, "volume": 0.95, "fitting": 4e-6,
    "zero": np.deg2rad(0.7), "encoder": 2 * np.pi / 2**12, "noise": 2e3, "gain1": 1.01, "gain2": 0.992,
    "sensor_lag": 4e-3, "adc": 10e5 / 2**12, "compressor": 7.0e5, "swing": 0.04, "swing_period": 7.0, "disturbed": 0.0,
}  # fmt: skip
PAIR = {
    "fill": 0.48 * L, "vent": 0.40 * L, "b_fill": 0.25, "b_vent": 0.4, "tube_k": 1.2e-5, "tube_v": 12e-6,
    "overlap_fill": 0.06, "overlap_vent": 0.10, "spool": 3.0e-3, "kp": 1 / 0.8e5, "ti": 0.20, "widest": 0.9,
    "reservoir": 0.6e-3, "line": 0.4 * L, "delay": 4,
}  # fmt: skip
SERVO = {
    "fill": 0.22 * L, "vent": 0.16 * L, "b_fill": 0.2, "b_vent": 0.45, "tube_k": 6e-6, "tube_v": 19e-6,
    "rate": 55e5, "play": 4e3, "wn": 64.0, "zeta": 0.8, "dead": 8e3, "band": 0.4e5,
    "reservoir": 0.4e-3, "line": 0.18 * L, "delay": 8,
}  # fmt: skip
KINDS = {"pair": PAIR, "servo": SERVO}


def numbers(kind, **others):
    """Numbers of a plant, some of them others."""
    return {**COMMON, **KINDS[kind], **others}


def law(n, contraction, pressure, strength=1.0, scale=1.0):
    """Force [N] of the muscle at a contraction and gauge pressure [Pa]."""
    k = contraction / scale
    above = pressure - n["threshold"] - n["by_contraction"] * jnp.maximum(k, 0.0)
    p = 0.5 * (above + jnp.sqrt(above**2 + 4e3**2))
    p = p - n["saturation"] * p**2
    force = p * n["area"] * (1 - 5 * k + 4 * k**2) - n["passive"] * k + 2.5e4 * jnp.maximum(0.03 - k, 0.0) ** 2
    return strength * jnp.maximum(force, 0.0)


def drag(n, force, side, travel):
    """Friction [N] in a test of the muscle that shortens (side -1) or lengthens, a travel after it turned."""
    share = np.sum(PARTS * np.clip(travel * SPECIMEN["length"] / SPANS - 1, -1, 1))
    return side * share * (n["coulomb"] + n["by_force"] * force) * (force > 0)


def weighted(n, weight):
    """Numbers with a weight [kg] clipped on at 300 mm."""
    moment, inertia = n["mass"] * n["arm"] + weight * 0.3, total_inertia(n) + weight * 0.3**2
    arm = moment / n["mass"]
    return {**n, "arm": arm, "inertia": inertia - n["mass"] * arm**2}


def total_inertia(n):
    """Moment of inertia [kg m^2] about the axis."""
    return n["mass"] * n["arm"] ** 2 + n["inertia"]


def muscle_volume(n, k, k_rate):
    """Volume [m^3] of a muscle with its fittings at a contraction, and its rate."""
    empty = n["volume"] * np.pi / 4 * SPECIMEN["diameter"] ** 2 * SPECIMEN["length"]
    volume = empty * (1 + 7.3 * k * (1 - 2.5 * k + 4 / 3 * k**2)) + n["fitting"]
    return volume, empty * 7.3 * (1 - 5 * k + 4 * k**2) * k_rate


def tube_flow(n, one, two):
    """Mass flow [kg/s]: square root of the difference of the pressures [Pa], linear near zero."""
    difference = one - two
    return n["tube_k"] * difference / jnp.sqrt(jnp.abs(difference) + 500.0)


def start(n, angle=0.0, pressures=(0.0, 0.0)):
    """State at rest: joint, muscles 1 and 2 (axis 0), tubes, valves, sensors, supply, and the commands under way."""
    p, none = jnp.asarray(pressures, float), jnp.zeros(2)
    return {
        "angle": jnp.asarray(angle, float), "speed": jnp.zeros(()), "slip": jnp.zeros((2, 4)), "muscle": p,
        "tube": p, "integral": none, "drive": none, "fill": none, "vent": none, "limited": p, "played": p, "first": p,
        "second": none, "sense": p, "supply": jnp.asarray(n["compressor"], float), "air": jnp.zeros(()),
        "time": jnp.zeros(()), "commands": jnp.broadcast_to(p, (LATEST, 2)),
    }  # fmt: skip


def contractions(n, angle):
    """Contractions of both muscles; a positive angle shortens muscle 2."""
    return 1 - jnp.stack([n["rest1"] + n["r1"] * angle, n["rest2"] - n["r2"] * angle]) / SPECIMEN["length"]


def slope(kind, n, s, disturbance):
    """Derivatives of the state, and the speeds [m/s] at which the muscles lengthen."""
    arms = jnp.stack([-n["r1"], n["r2"]])
    stretch = -arms * s["speed"]
    k, (p1, p2) = contractions(n, s["angle"]), s["muscle"]
    tension = [law(n, k[0], p1, n["strength1"], n["scale1"]), law(n, k[1], p2, n["strength2"], n["scale2"])]
    tension = jnp.stack(tension)
    share = jnp.sum(PARTS * s["slip"] / SPANS, axis=1)
    friction = (n["coulomb"] + n["by_force"] * tension) * share + n["viscous"] * stretch
    torque = jnp.sum(arms * (tension + friction)) + n["disturbed"] * disturbance
    torque -= n["bearing"] * jnp.tanh(s["speed"] / 0.03) + n["damping"] * s["speed"]
    torque -= n["mass"] * 9.81 * n["arm"] * jnp.sin(s["angle"] + n["tilt"])
    room, room_rate = muscle_volume(n, k, -stretch / SPECIMEN["length"])
    p, tube, supply = s["muscle"] + ATM, s["tube"] + ATM, s["supply"] + ATM
    through = tube_flow(n, tube, p)
    fill = s["fill"] * rig.iso(n["fill"], n["b_fill"], supply, jnp.minimum(tube, supply))
    vent = s["vent"] * rig.iso(n["vent"], n["b_vent"], jnp.maximum(tube, ATM), ATM)
    cycle = s["time"] / n["swing_period"]
    source = n["compressor"] * (1 - n["swing"] * (cycle - jnp.floor(cycle))) + ATM
    line = rig.iso(n["line"], 0.3, source, jnp.minimum(supply, source))
    rates = {
        "angle": s["speed"], "speed": torque / total_inertia(n),
        "muscle": jnp.where(tube > p, 1.3, 1.15) / room * (RT * through - p * room_rate),
        "tube": 1.2 * RT / n["tube_v"] * (fill - vent - through),
        "supply": RT / n["reservoir"] * (line - jnp.sum(fill)), "air": jnp.sum(fill) / RHO,
        "sense": (s["muscle"] - s["sense"]) / n["sensor_lag"],
    }  # fmt: skip
    if kind == "pair":
        for name, way in (("fill", 1), ("vent", -1)):
            overlap = n[f"overlap_{name}"]
            opening = jnp.clip((way * s["drive"] - overlap) / (1 - overlap), 0, n["widest"])
            rates[name] = (opening - s[name]) / n["spool"]
    else:
        rates["first"] = s["second"]
        rates["second"] = n["wn"] ** 2 * (s["played"] - s["first"]) - 2 * n["zeta"] * n["wn"] * s["second"]
    return rates, stretch


def looped(n, s, command):
    """State after the pressure loop of a pair of valves, which runs in every second period."""
    tick = jnp.round(s["time"] / PERIOD)
    due = tick - 2 * jnp.floor(tick / 2) < 0.5
    error = command - s["tube"]
    wanted = n["kp"] * error + s["integral"]
    free = (jnp.abs(wanted) < 1) | (wanted * error < 0)
    integral = jnp.where(free, s["integral"] + n["kp"] * error * 2 * PERIOD / n["ti"], s["integral"])
    integral = jnp.where(due, jnp.clip(integral, -0.4, 0.4), s["integral"])
    return {**s, "integral": integral, "drive": jnp.where(due, jnp.clip(wanted, -1, 1), s["drive"])}


def regulated(n, s, command, step):
    """State with the openings of a servo regulator."""
    limited = s["limited"] + jnp.clip(command - s["limited"], -n["rate"] * step, n["rate"] * step)
    played = jnp.clip(s["played"], limited - n["play"] / 2, limited + n["play"] / 2)
    error = s["first"] - s["tube"]
    opening = jnp.clip(jnp.sign(error) * jnp.maximum(jnp.abs(error) - n["dead"], 0) / n["band"], -1, 1)
    return {
        **s,
        "limited": limited,
        "played": played,
        "fill": jnp.maximum(opening, 0),
        "vent": jnp.maximum(-opening, 0),
    }


def advance(kind, n, s, command):
    """State after a control period with a command [Pa] that the host has sent at its beginning."""
    commands = jnp.concatenate([s["commands"][1:], jnp.stack(command)[None]])
    now = commands[LATEST - 1 - n["delay"]]
    number = jnp.floor(s["time"] / 0.8)
    odd = number - 2 * jnp.floor(number / 2)
    pulse = jnp.where(s["time"] - 0.8 * number < 0.1, 1 - 2 * odd, 0.0)
    s = {**s, "commands": commands}
    h = PERIOD / STEPS
    if kind == "pair":
        s = looped(n, s, now)

    def one(s, _):
        if kind == "servo":
            s = regulated(n, s, now, h)
        rates, _ = slope(kind, n, s, pulse)
        middle = {**s, **{name: s[name] + h / 2 * rate for name, rate in rates.items()}}
        rates, stretch = slope(kind, n, middle, pulse)
        s = {**s, **{name: s[name] + h * rate for name, rate in rates.items()}}
        return {**s, "slip": jnp.clip(s["slip"] + h * stretch[:, None], -SPANS, SPANS)}, None

    s, _ = lax.scan(one, s, None, length=STEPS)
    return {**s, "time": s["time"] + PERIOD}


def sensed(n, s, noise):
    """Readings of encoder [rad] and pressure sensors [Pa], for standard normal noise of shape (2,)."""
    angle = jnp.floor((s["angle"] + n["zero"]) / n["encoder"] + 0.5) * n["encoder"]
    read = s["sense"] * jnp.stack([n["gain1"], n["gain2"]]) + n["noise"] * noise
    return angle, jnp.floor(read / n["adc"] + 0.5) * n["adc"]


class ElbowRig(rig.ForeignRig):
    """The elbow by its valves."""
