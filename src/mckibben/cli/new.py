"""`mckibben new`: commented files to start from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mckibben.cli.command import plain_command
from mckibben.cli.options import echo
from mckibben.errors import ParameterError, quoted, suggest

if TYPE_CHECKING:
    from mckibben.muscle import Muscle

_KINDS = ("joint", "axis", "bench", "robot")
_AGAINST = ("spring", "weight", "muscle")
_MUSCLE = (
    "{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n, friction: {half_width: 7.5 N, presliding_length: 0.5 mm}}"
)
_FRICTION = 0.012  # typical half width of a muscle without friction, relative to its largest tension


@plain_command
def new(kind: str, file: Path, muscle: Path | None = None, against: str | None = None) -> None:
    """Write a commented file to start from: a joint, a linear axis, a test on a bench, or a robot.

    Parameters
    ----------
    kind : joint|axis|bench|robot
        What the file describes.
    file : FILE.yaml
        The new file; an existing one is not replaced.
    muscle : MUSCLE.yaml
        Muscle of the joint, axis or test, as `mckibben identify --out` writes it. Default: one of the catalog.
    against : spring|weight|muscle
        What the muscle of an axis pulls against (default: a spring).
    """
    if kind not in _KINDS:
        raise ParameterError(f"there is no template {quoted(kind)}", field="kind", remedy=suggest(kind, _KINDS))
    if against and (kind != "axis" or against not in _AGAINST):
        text = f"a {kind} has no --against" if kind != "axis" else f"there is no axis against {quoted(against)}"
        remedy = "leave it out" if kind != "axis" else suggest(against, _AGAINST)
        raise ParameterError(text, field="against", value=against, remedy=remedy)
    from mckibben.codegen.templates import filled
    from mckibben.storage.files import atomic_write

    values: dict[str, object] = {"file": file, "name": file.stem}
    if kind == "robot":
        if muscle:
            raise ParameterError("a robot has the muscles of its file", field="muscle", remedy="leave --muscle out")
        text = filled("robot.yaml", values, "mckibben.cli")
    else:
        chosen, written = _muscle(muscle, file)
        values |= _values_for(chosen, written)
        if kind == "bench":
            text = filled("bench.yaml", values, "mckibben.cli")
        else:
            from mckibben.scenario import axis_text

            axis = axis_text(values, chosen, against or "spring", file.parent) if kind == "axis" else ""
            text = axis or _joint_text(values, file)
    with atomic_write(file) as target:
        target.write_text(text, encoding="utf-8")
    echo(f"wrote {file}; its first lines say what to do with it")


def _muscle(path: Path | None, file: Path) -> tuple[Muscle, str]:
    """Return the muscle of a file, by default one of the catalog, and its text in the new file."""
    from mckibben import catalog
    from mckibben.component.schema import read_component
    from mckibben.config.fields import relative_path
    from mckibben.muscle import Muscle

    if path is None:
        muscle, text = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n")), _MUSCLE
    else:
        muscle, text = read_component(Muscle, path), f"from: {relative_path(path, file.parent)}"
        if not muscle.has_friction:
            highest_tension = float(muscle.tension(0.0, muscle.domain.pressure_max))
            half_width = f"{_FRICTION * highest_tension:.2g} N"
            text += f", friction: {{half_width: {half_width}, presliding_length: 0.5 mm}}"
        text = f"{{{text}}}"
    return muscle, text


def _values_for(muscle: Muscle, text: str) -> dict[str, object]:
    """Return numbers that suit a muscle."""
    from mckibben.units import bar, mm, percent

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
