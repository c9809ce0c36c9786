"""The muscles of a joint or a leg as an actuator of mjlab, with drawn plants as domain randomisation.

Needs mjlab 1.6, which is not an extra of mckibben, because it needs PyTorch and another version of MuJoCo Warp.
"""
# pyrefly: ignore-errors

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import mujoco
import numpy as np

from mckibben.errors import ExportError
from mckibben.export.episodes import example_of, plants_of
from mckibben.export.targets import Exported
from mckibben.export.warp import check_version, drawn_muscles, loaded, split_parameters, warp_files, warp_leg
from mckibben.leg import LegPlant, LegStart
from mckibben.numerics.batching import lanes_of
from mckibben.numerics.compiled import numeric
from mckibben.scenario import Scenario
from mckibben.study.compare.suite import Suite

check_version("mjlab", "1.6", "1.7")  # of other versions, the imports fail
import torch  # noqa: E402
from mjlab.actuator.actuator import TransmissionType  # noqa: E402
from mjlab.actuator.xml_actuator import XmlActuator, XmlActuatorCfg  # noqa: E402
from mjlab.entity import Entity, EntityArticulationInfoCfg, EntityCfg  # noqa: E402


@dataclass(kw_only=True)
class MuscleActuatorCfg(XmlActuatorCfg):
    """Muscles of an exported joint or leg; their commands [Pa] are the effort targets of its tendons."""

    module: ModuleType  # written by ``mckibben export --to warp``
    parameters: Mapping[str, Any] = field(default_factory=dict)  # by `PARAMETERS` and `command_delay`, a row per plant
    start: Sequence[float] = ()  # activations at the start of each episode
    left_out: tuple[str, ...] = ()  # parts of the scenario, and varied parameters, that the actuator does not have

    transmission_type: TransmissionType = TransmissionType.TENDON
    command_field: Any = "effort"

    def build(self, entity: Entity, target_ids: list[int], target_names: list[str]) -> MuscleActuator:
        return MuscleActuator(self, entity, target_ids, target_names)


class MuscleActuator(XmlActuator):
    """Muscles whose forces, pressures and delays are computed by callbacks of MuJoCo Warp in every world.

    `muscles` has the parameters of the worlds: ``muscles.set("valve.time_constant", values)``.
    """

    cfg: MuscleActuatorCfg

    def initialize(self, mj_model: mujoco.MjModel, model: Any, data: Any, device: str) -> None:
        super().initialize(mj_model, model, data, device)
        prefix = mj_model.actuator(self._mjs_actuators[0].id).name.removesuffix(self.cfg.module.ACTUATORS[0])
        kind, parameters = self.cfg.module.Muscles, self.cfg.parameters
        self.muscles = drawn_muscles(kind, parameters, mj_model, data.nworld, device, prefix)
        self._act, self._start = data.act, torch.tensor(self.cfg.start, dtype=torch.float, device=device)
        actuators = [mj_model.actuator(one) for one in range(mj_model.nu)]
        self._places = [int(one.actadr[0]) for one in actuators if one.name.startswith(prefix) and one.actnum[0]]
        self._needs_call = device != "cpu"  # in a captured graph, the callbacks are called at the capture alone
        self.muscles.install(model)
        model.callback.act_bias = self._noting(model.callback.act_bias)

    def _noting(self, function: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
        def noting(m: Any, d: Any) -> None:
            self._needs_call = False
            function(m, d)

        return noting

    def compute(self, cmd: Any) -> torch.Tensor:
        if self._needs_call:
            raise RuntimeError("the CUDA graphs lack the muscles: call sim.create_graph() after creating the scene")
        return super().compute(cmd)

    def pressures(self) -> torch.Tensor:
        """Return the gauge pressures [Pa], shape (worlds, muscles); `ExportError` with ideal valves."""
        if min(self.cfg.module.PRESSURES) < 0:
            raise ExportError("pressures of ideal valves are the commands", field="valve", remedy="use the commands")
        return self._act[:, self.muscles.pressures]

    def reset(self, env_ids: torch.Tensor | slice | None = None) -> None:
        super().reset(env_ids)
        rows = slice(None) if env_ids is None else env_ids
        for place, value in zip(self._places, self._start, strict=True):
            self._act[rows, place] = value


def muscle_entity(
    scenario: Scenario | Suite | str | os.PathLike[str],
    random_plant: Sequence[str] = (),
    plants: int = 256,
    seed: int = 0,
) -> EntityCfg:
    """Entity of mjlab for the plant of a scenario: its MJCF, its start, and its muscles as actuator.

    Each world has the muscles, valves and delay of a plant drawn from `random_plant`, such as
    ``valve.time_constant=10..50 ms``, in the syntax of ``mckibben sweep``; a suite brings its conditions. Parameters of
    the load, and parts that MuJoCo Warp cannot represent, are in `left_out` of the actuator: vary the load with the
    events of mjlab.

    Raises `ExportError` for parts that cannot be exported, and for muscles without a tendon; importing this module with
    another version of mjlab raises it, too.
    """
    scenario, random_plant = example_of(scenario, random_plant)
    made = warp_files(scenario, "joint", Path())
    return _entity(made, plants_of(scenario, random_plant, plants, seed).varying if random_plant else ())


def leg_entity(plant: LegPlant, start: LegStart) -> EntityCfg:
    """Entity of mjlab for a leg at a start; numbers may be arrays over plants (`drawn_plant`), taken by the worlds.

    Arrays of masses and other parts of the bodies are left out (`left_out`). Raises `ExportError` as `muscle_entity`.
    """
    varying, fixed = eqx.partition(numeric(plant), lanes_of(plant)[1])
    first = eqx.combine(jax.tree.map(lambda one: one[0], varying), fixed)
    return _entity(warp_leg(first, "joint", timestep=1e-3, start=first.begin(start)), varying)


def _entity(made: Exported, varying: Any) -> EntityCfg:
    """Entity of an exported model, with the numbers of plants that vary."""
    spec = mujoco.MjSpec.from_string(made.files["joint.xml"])
    module = loaded(str(made.files["joint_warp.py"]))
    if missing := set(module.ACTUATORS) - {one.name for one in spec.tendons}:
        raise ExportError(
            "a muscle without a tendon cannot be an actuator of mjlab",
            field="geometry",
            value=sorted(missing),
            remedy="give all muscles a path between two points or over a pulley",
        )
    parameters, others = split_parameters(varying, module.PARAMETERS)
    key, left_out = spec.keys[0], (*made.left_out, *(f"variation of {name}" for name in others))
    if not np.array_equal(spec.option.gravity, mujoco.MjSpec().option.gravity):
        left_out += (f"gravity of the load: give MujocoCfg the gravity {tuple(map(float, spec.option.gravity))}",)
    actuator = MuscleActuatorCfg(
        target_names_expr=tuple(map(re.escape, module.ACTUATORS)),
        module=module,
        parameters=parameters,
        start=list(key.act),
        left_out=left_out,
    )

    def start_left_out() -> mujoco.MjSpec:
        spec = mujoco.MjSpec.from_string(made.files["joint.xml"])
        spec.delete(spec.keys[0])  # mjlab adds its own
        spec.option = mujoco.MjSpec().option  # those of `MujocoCfg` apply
        return spec

    names = [re.escape(joint.name) for joint in spec.joints]
    positions, speeds = (dict(zip(names, each, strict=True)) for each in (key.qpos, key.qvel))
    return EntityCfg(
        spec_fn=start_left_out,
        init_state=EntityCfg.InitialStateCfg(joint_pos=positions, joint_vel=speeds),
        articulation=EntityArticulationInfoCfg(actuators=(actuator,)),
    )
