"""The parts of a protocol file as the objects that run it. Only here is JAX needed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from mckibben import catalog
from mckibben.config.model import explicit_fields
from mckibben.errors import Problem, ScenarioError
from mckibben.muscle import ChouLaw, ForceLaw, Muscle, NoCreep, NoFriction, Specimen
from mckibben.rig.backend import MovingBackend
from mckibben.rig.bench import Bench, Drive, RigLimits
from mckibben.rig.calibration import Calibration, calibrations_in, content_of
from mckibben.rig.steps import Step, steps_of
from mckibben.study.rig.document import CardSpec, RigTest, SimulatedRigSpec
from mckibben.study.rig.steps import ProtocolSpec, steps

if TYPE_CHECKING:
    from mckibben.rig.ni import Terminals

_APART = 1_000_003  # between the seeds of sessions


@dataclass(frozen=True)
class Setup:
    """A rig that is not opened yet, and its bench."""

    backend: MovingBackend
    bench: Bench


def build_setup(test: RigTest, session: int = 0) -> Setup:
    """The rig of a test; `session` counts its resumptions.

    Raises
    ------
    ScenarioError
        If a calibration cannot be read.
    RigError
        If a driver or a package is missing.
    """
    of = build_muscle(test)
    if test.rig.simulated is not None:
        backend, calibrations, drive = _simulated(test.rig.simulated, test, of, session)
    else:
        assert test.rig.nidaqmx is not None  # the model of the rig sees to it
        backend, calibrations, drive = _card(test.rig.nidaqmx)
    specimen = of.specimen if isinstance(of, Muscle) else of
    limits = RigLimits(**{"force": float(specimen.rated_force), **explicit_fields(test.limits)})
    bench = Bench(
        of=of,
        mounted_at=test.muscle.mounted_at,
        drive=drive,
        calibrations=calibrations,
        limits=limits,
        rate=backend.rate,
        **explicit_fields(test.recording),
    )
    return Setup(backend, bench)


def build_muscle(test: RigTest) -> Muscle | Specimen:
    """The specimen with its law, or alone if the law is unknown."""
    specimen = catalog.specimen(test.muscle.specimen)
    return specimen if test.muscle.law is None else Muscle(specimen, _law(test.muscle.law, specimen))


def build_steps(protocol: ProtocolSpec, of: Muscle | Specimen) -> tuple[Step, ...]:
    """The steps of a protocol.

    Raises
    ------
    RangeError
        If a whole test does not suit the muscle.
    """
    if protocol.steps is not None:
        return steps(protocol.steps)
    return steps_of(getattr(protocol, protocol.form).build(), of)


def _simulated(
    spec: SimulatedRigSpec, test: RigTest, of: Muscle | Specimen, session: int
) -> tuple[MovingBackend, Mapping[str, Calibration], Drive]:
    from dataclasses import replace

    from mckibben.rig.simulated import (
        FORCE_SENSOR,
        PRESSURE_SENSOR,
        Converter,
        RealTimeRig,
        Regulator,
        SimulatedRig,
        Stretcher,
    )

    specimen = of.specimen if isinstance(of, Muscle) else of
    law = spec.law or test.muscle.law
    assert law is not None  # the model of the test sees to it
    friction = NoFriction() if spec.friction is None else spec.friction.build()
    creep = NoCreep() if spec.creep is None else spec.creep.build()
    muscle = Muscle(specimen, _law(law, specimen), friction, creep)
    parts: dict[str, Any] = {}
    if spec.parts == "ideal":
        parts = {
            "regulator": Regulator(hysteresis=0.0, repeatability=0.0, leak=0.0),
            "stretcher": Stretcher(backlash=0.0),
            "converter": Converter(bits=32),
            "force_sensor": replace(FORCE_SENSOR, noise=0.0),
            "pressure_sensor": replace(PRESSURE_SENSOR, noise=0.0),
        }
    twin = SimulatedRig(muscle, seed=spec.seed + _APART * session, mounted_at=test.muscle.mounted_at, **parts)
    return RealTimeRig(twin) if spec.paced else twin, twin.calibrations, twin.drive


def _card(spec: CardSpec) -> tuple[MovingBackend, Mapping[str, Calibration], Drive]:
    from mckibben.rig.ni import NiRig

    calibrations = read_calibrations(cast(Path, spec.calibration))
    given = {name: getattr(spec, name) for name in ("rate", "patience", "server") if getattr(spec, name) is not None}
    return NiRig(build_wiring(spec), **given), calibrations, Drive(**explicit_fields(spec.drive) if spec.drive else {})


def build_wiring(spec: CardSpec) -> Terminals:
    """Terminals of the card."""
    from mckibben.rig.ni import Terminals

    def at(name: str) -> str:
        return f"{spec.device}/{getattr(spec, name)}"

    return Terminals(
        inputs={name: at(name) for name in ("force", "pressure")},
        outputs={"valve": at("valve")},
        counter=at("counter"),
        heartbeat=at("heartbeat"),
        hold=at("hold"),
        direction=at("direction"),
    )


def read_calibrations(path: Path) -> dict[str, Calibration]:
    """The calibrations of a file: a JSON object of them, by the names of their channels.

    Raises
    ------
    ScenarioError
        With all that is wrong with them.
    """
    content = content_of(path, "see docs/rig-hardware.md")
    problems = [
        Problem("is missing", field=name, remedy="calibrate it, see docs/rig-hardware.md")
        for name in ("force", "pressure", "valve")
        if name not in content
    ]
    found, wrong = calibrations_in(content)
    if problems or wrong:
        raise ScenarioError(str(path), [*problems, *wrong])
    return found


def _law(named: str | Path, specimen: Specimen) -> ForceLaw:
    if isinstance(named, Path):
        from mckibben.identification import read_law

        return read_law(named)
    return ChouLaw.of(specimen) if named == "chou" else catalog.law(named)
