"""`mckibben new`: commented files to start from."""

from __future__ import annotations

from pathlib import Path

from mckibben.cli.command import plain_command
from mckibben.cli.options import echo
from mckibben.errors import ParameterError, RangeError, quoted, suggest

_KINDS = ("joint", "bench", "robot")
_MUSCLE = "{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}"


@plain_command
def new(kind: str, file: Path, muscle: Path | None = None) -> None:
    """Write a commented file to start from: a joint, a test on a bench, or a robot.

    Parameters
    ----------
    kind : joint|bench|robot
        What the file describes.
    file : FILE.yaml
        The new file; an existing one is not replaced.
    muscle : MUSCLE.yaml
        Muscle of the joint or test, as `mckibben identify --out` writes it. Default: one of the catalog.
    """
    if kind not in _KINDS:
        raise ParameterError(f"there is no template {quoted(kind)}", field="kind", remedy=suggest(kind, _KINDS))
    from mckibben.codegen.templates import filled
    from mckibben.storage.files import atomic_write

    values: dict[str, object] = {"file": file, "name": file.stem}
    if kind != "robot":
        values |= _values_for(kind, muscle, file)
    elif muscle:
        raise ParameterError("a robot has the muscles of its file", field="muscle", remedy="leave --muscle out")
    with atomic_write(file) as target:
        target.write_text(filled(f"{kind}.yaml", values, "mckibben.cli"), encoding="utf-8")
    echo(f"wrote {file}; its first lines say what to do with it")


def _values_for(kind: str, path: Path | None, file: Path) -> dict[str, object]:
    """Return the muscle of a file, and numbers that suit it."""
    from mckibben import catalog
    from mckibben.component.schema import read_component
    from mckibben.config.fields import relative_path
    from mckibben.muscle import Muscle
    from mckibben.units import bar, mm, percent

    if path is None:
        muscle, text = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n")), _MUSCLE
    else:
        muscle, text = read_component(Muscle, path), f"{{from: {relative_path(path, file.parent)}}}"
    highest = int(float(muscle.domain.pressure_max) / bar)
    values: dict[str, object] = {
        "muscle": text,
        "rest_length": f"{0.9 * float(muscle.specimen.initial_length) / mm:.0f} mm",
        "pressures": ", ".join(f"{level} bar" for level in range(1, highest + 1)),
        "highest": f"{highest + 0.5} bar",
        "force": f"{min(muscle.specimen.force_limit, 1500.0):g} N",
        "contraction": f"{0.9 * float(muscle.domain.contraction_max) / percent:.0f} %",
    }
    return values | _attainable(values, file) if kind == "joint" else values


def _attainable(values: dict[str, object], file: Path) -> dict[str, object]:
    """Return two stiffnesses that the joint of the template has at both ends of its motion and in between."""
    import numpy as np

    from mckibben.codegen.templates import filled
    from mckibben.scenario import Scenario
    from mckibben.units import deg

    unknown = {"file": file, "name": file.stem, "low": "1 N*m/rad", "high": "1 N*m/rad"}
    text = filled("joint.yaml", values | unknown, "mckibben.cli")
    scenario, angle = Scenario.parse(text, folder=file.parent), np.array([-10, 0, 10]) * deg
    lowest, highest = scenario.joint.attainable_stiffness(angle, -scenario.load.gravity_torque(angle))
    low, high = float(np.max(lowest)), float(np.min(highest))
    if not low < high:
        remedy = "leave --muscle out, and adapt the file to the muscle; or see `mckibben size`"
        raise RangeError("the muscle cannot move the joint of the template", field="muscle", remedy=remedy)
    before, after = (low + part * (high - low) for part in (0.4, 0.6))
    return {"low": f"{before:.3g} N*m/rad", "high": f"{after:.3g} N*m/rad"}
