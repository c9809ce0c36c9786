"""MuJoCo engine plugin for muscles: their functions as C, and the surrounding C code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, SupportsFloat

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, PyTree

from mckibben.actuator.base import AirState, AirVolume, state_of_muscle
from mckibben.codegen.c import write_c
from mckibben.codegen.source_module import SourceModule
from mckibben.export.targets import Exported, filled
from mckibben.joint import RigidTendon, Tendon
from mckibben.muscle import Muscle, MuscleState
from mckibben.numerics.calculus import value_and_derivative
from mckibben.rig.compiled import FlatTree
from mckibben.version import __version__


class Activations(NamedTuple):
    """Activations of an actuator; empty ones have no leaves."""

    creep: PyTree  # [N, Pa]
    valve: PyTree  # its state, and the temperature of the air [K]
    pressure: PyTree  # [Pa], unless the valve is ideal


class PluginMuscle(NamedTuple):
    """State of a muscle in MuJoCo.

    Attributes
    ----------
    activations, anchors
        Numbers of activations, which MuJoCo integrates, and of anchors of friction elements, which the plugin holds.
    slips
        Whether friction or creep slip after each step.
    filtered
        Whether MuJoCo's own filter models the valve.
    """

    activations: int
    anchors: int
    slips: bool
    filtered: bool

    def dynamics(self, valve: PyTree) -> dict[str, str]:
        """Attributes of the actuator in MJCF."""
        if not self.activations:
            return {}
        size = {"actdim": str(self.activations)}
        if self.filtered:
            return size | {"dyntype": "filter", "dynprm": repr(float(valve.time_constant))}
        return size | {"dyntype": "none"}


class MuscleModel(NamedTuple):
    """MJCF, the module of the forces of its muscles, their kinds, and the omitted parts."""

    xml: str
    module: SourceModule
    muscles: tuple[PluginMuscle, ...]
    left_out: tuple[str, ...]


def is_filter(valve: PyTree) -> bool:
    """Return whether MuJoCo's filter models a valve."""
    return valve.is_first_order and valve.is_linear


class MuscleFunctions:
    """Functions of one muscle of a plant: force, rates of its activations, and slip after a step.

    Parameters
    ----------
    fixed
        The plant without its real numbers, which are parameters of the module.
    number
        Number of the muscle, from 1.
    muscle_of, path_of
        Selection of the muscle with its tendon from a plant, and its path [m] at MuJoCo's length.
    start
        State of the muscle, its pressure [Pa], and the state of valve and air.
    filtered
        Whether MuJoCo's filter models the valve.
    """

    def __init__(
        self,
        fixed: PyTree,
        number: int,
        muscle_of: Callable[[PyTree], tuple[Muscle, Tendon]],
        path_of: Callable[[PyTree, Array], Array],
        start: tuple[MuscleState, SupportsFloat, PyTree],
        filtered: bool,
    ) -> None:
        self._fixed, self._number, self._muscle_of, self._path_of = fixed, number, muscle_of, path_of
        valve = fixed.valve.for_muscle(number - 1)
        state, pressure, air = start
        pressure = pressure if valve.holds_pressure else ()
        self.pressure = float(start[1])
        """Pressure [Pa] at the start."""
        self._start = jax.tree.map(np.asarray, Activations(state.creep, air, pressure))
        self._layout = FlatTree.like(self._start)
        slips = bool(state.friction or state.creep)
        self.summary = PluginMuscle(self._layout.size, len(state.friction), slips, filtered)
        self.activations = self._layout.pack(self._start)
        """Activations at the start."""

    def add_to(self, module: SourceModule) -> None:
        """Add the functions to a module."""
        number, (activations, anchors, slips, filtered) = self._number, self.summary
        zero = np.zeros(())
        inputs = {"length": zero, "velocity": zero, "command": zero}
        inputs |= {"act": np.zeros(activations)} if activations else {}
        argument = f"input{number}"
        held = {argument: inputs | ({"anchors": np.zeros(anchors)} if anchors else {})}

        def force(parameters: PyTree, **arguments: PyTree) -> dict[str, PyTree]:
            return {"force": self._force(parameters, arguments[argument])}

        def rates(parameters: PyTree, **arguments: PyTree) -> dict[str, PyTree]:
            return {f"rate{number}": {"act": self._rates(parameters, arguments[argument])}}

        def settled(parameters: PyTree, **arguments: PyTree) -> dict[str, PyTree]:
            return {f"after{number}": self._settled(parameters, arguments[argument])}

        def unset(parameters: PyTree, **arguments: PyTree) -> dict[str, PyTree]:
            return {f"first{number}": {"anchors": self._unset(parameters, arguments[argument])}}

        module.add(f"force{number}", f"force of muscle {number}, 0 or below", force, held)
        if activations > filtered:
            module.add(f"rates{number}", f"rates of the activations of muscle {number}", rates, held)
        if slips:
            module.add(f"settled{number}", f"muscle {number} after a step; the force does not change", settled, held)
        if anchors:
            module.add(f"unset{number}", f"unstressed anchors of muscle {number}", unset, {argument: inputs})

    def _at(
        self, parameters: PyTree, inputs: PyTree
    ) -> tuple[PyTree, tuple[Muscle, Tendon], Array, Array, Activations, MuscleState]:
        """Plant, muscle with its tendon, path and its derivative, activations, and state of the muscle."""
        plant = eqx.combine(parameters["plant"], self._fixed)
        path, slope = value_and_derivative(lambda length: self._path_of(plant, length), inputs["length"])
        acts = self._layout.unpack(inputs["act"]) if "act" in inputs else self._start
        if not plant.valve.holds_pressure:
            acts = acts._replace(pressure=inputs["command"])
        state = MuscleState(tuple(inputs.get("anchors", ())), acts.creep)
        return plant, self._muscle_of(plant), path, slope, acts, state

    def _force(self, parameters: PyTree, inputs: PyTree) -> Array:
        """Force on MuJoCo's length [N], or torque [N*m]: 0 or below, as muscles pull."""
        _, (muscle, tendon), path, slope, (_, _, pressure), state = self._at(parameters, inputs)
        contraction = tendon.contraction(muscle, path, pressure, state)
        viscous = muscle.viscous_force(contraction, pressure, slope * inputs["velocity"], state)
        return -(muscle.tension(contraction, pressure, state) + viscous) * slope

    def _rates(self, parameters: PyTree, inputs: PyTree) -> Array:
        """Rates of the activations: creep, state of the valve and temperature of the air, pressure."""
        plant, (muscle, tendon), path, slope, (_, state, pressure), held = self._at(parameters, inputs)
        valve, command, velocity = plant.valve.for_muscle(self._number - 1), inputs["command"], inputs["velocity"]
        creep = muscle.state_rate(held, slope * velocity, pressure).creep
        if not valve.holds_pressure:
            return self._layout.pack(Activations(creep, ((), ()), ()), jnp)

        def volumes() -> tuple[AirVolume, AirVolume]:
            def volume(path: ArrayLike, pressure: ArrayLike) -> Array:
                return muscle.specimen.volume(tendon.contraction(muscle, path, pressure, held))

            size, growth = value_and_derivative(lambda x: volume(x, pressure), path)
            stretched = None
            if not isinstance(tendon, RigidTendon):
                stretched = value_and_derivative(lambda p: volume(path, p), pressure)[1]
            air = AirVolume(size + valve.attached_volume, growth * slope * velocity, stretched)
            return air, air

        inner, temperature = state
        states: PyTree = ()
        if jax.tree.leaves(state):
            states = AirState((inner,) * 2, (), (temperature,) * 2 if jax.tree.leaves(temperature) else ())
        (changed, _), moved = valve.rates((pressure, pressure), states, (command, command), volumes)
        rates = Activations(creep, state_of_muscle(moved, 0), changed)
        return self._layout.pack(rates, jnp)

    def _settled(self, parameters: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        """Activations and anchors of the friction after a step; the force does not change."""
        plant, (muscle, tendon), path, _, acts, state = self._at(parameters, inputs)
        contraction = tendon.contraction(muscle, path, acts.pressure, state)
        friction, creep = muscle.update_state(state, contraction, acts.pressure)
        pressure = acts.pressure if plant.valve.holds_pressure else ()
        held = Activations(creep, acts.valve, pressure)
        settled = {"act": self._layout.pack(held, jnp)} if self._layout.size else {}
        return settled | ({"anchors": jnp.stack(friction)} if friction else {})

    def _unset(self, parameters: PyTree, inputs: PyTree) -> Array:
        """Anchors at which the friction elements are without stress."""
        _, (muscle, tendon), path, _, acts, _ = self._at(parameters, inputs)
        return jnp.stack(muscle.init_state(tendon.contraction(muscle, path, acts.pressure), acts.pressure).friction)


def plugin_source(muscles: Sequence[PluginMuscle], name: str) -> str:
    """C code of the plugin around the functions of its muscles."""
    return filled("plugin.c", {"name": name, "muscles": muscles})


def plugin_files(model: MuscleModel, title: str) -> Exported:
    """MJCF of a model, the plugin, and instructions, in which it has a title."""
    name = model.module.name
    left_out = ("controller and reference: set data.ctrl yourself", *model.left_out)
    sources = write_c(model.module, f"Muscles of {title}, written by mckibben {__version__}.")
    contents = {
        f"{name}.xml": model.xml,
        f"{name}.h": sources.header,
        f"{name}.c": sources.source,
        "plugin.c": plugin_source(model.muscles, name),
        "Makefile": filled("plugin.mk", {"name": name}),
        "README.md": filled("mujoco.md", {"name": name, "title": title, "left_out": left_out}),
    }
    return Exported(contents, left_out)
