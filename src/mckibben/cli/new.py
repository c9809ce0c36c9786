"""`mckibben new`: commented files to start from."""

from __future__ import annotations

from pathlib import Path

from mckibben.cli.command import plain_command
from mckibben.cli.options import echo
from mckibben.errors import ParameterError, quoted, suggest

_KINDS = ("joint", "bench", "robot")
_MUSCLE = (
    "{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n, friction: {half_width: 7.5 N, presliding_length: 0.5 mm}}"
)
_FRICTION = 0.012  # typical half width of a muscle without friction, relative to its largest tension


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
        values |= _values_for(muscle, file)
    elif muscle:
        raise ParameterError("a robot has the muscles of its file", field="muscle", remedy="leave --muscle out")
    text = _joint_text(values, file) if kind == "joint" else filled(f"{kind}.yaml", values, "mckibben.cli")
    with atomic_write(file) as target:
        target.write_text(text, encoding="utf-8")
    echo(f"wrote {file}; its first lines say what to do with it")


def _values_for(path: Path | None, file: Path) -> dict[str, object]:
    """Return the muscle of a file, and numbers that suit it."""
    from mckibben import catalog
    from mckibben.component.schema import read_component
    from mckibben.config.fields import relative_path
    from mckibben.muscle import Muscle
    from mckibben.units import bar, mm, percent

    if path is None:
        muscle, text = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n")), _MUSCLE
    else:
        muscle, text = read_component(Muscle, path), f"from: {relative_path(path, file.parent)}"
        if not muscle.has_friction:
            highest_tension = float(muscle.tension(0.0, muscle.domain.pressure_max))
            half_width = f"{_FRICTION * highest_tension:.2g} N"
            text += f", friction: {{half_width: {half_width}, presliding_length: 0.5 mm}}"
        text = f"{{{text}}}"
    highest = int(float(muscle.domain.pressure_max) / bar)
    return {
        "muscle": text,
        "rest_length": f"{0.9 * float(muscle.specimen.initial_length) / mm:.0f} mm",
        "pressures": ", ".join(f"{level} bar" for level in range(1, highest + 1)),
        "highest": f"{highest + 0.5} bar",
        "force": f"{min(muscle.specimen.force_limit, 1500.0):g} N",
        "contraction": f"{0.9 * float(muscle.domain.contraction_max) / percent:.0f} %",
    }


def _joint_text(values: dict[str, object], file: Path) -> str:
    """Return the text of a joint, with stiffnesses that it has."""
    from mckibben.scenario import UNKNOWN, Scenario, laboratory, starting_stiffness, starting_text

    read = Scenario.parse(starting_text(values | UNKNOWN), folder=file.parent)
    return starting_text(values | laboratory(read.joint) | starting_stiffness(read.joint, read.load))
