"""Columns of results: unit and meaning, declared where a column is made."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar, TypeVar, get_type_hints

from mckibben.errors import ParameterError
from mckibben.result import Column
from mckibben.units import HINGE, JointType

K = TypeVar("K", bound=type)


@dataclass(frozen=True)
class Label(Column):
    """Unit and meaning (`title`) of a column of trajectories, telemetry or metrics.

    Parameters
    ----------
    along
        Further dimension of a column with several rows, such as "joint".
    note
        Explanation for the docstring.
    """

    _: KW_ONLY
    along: str = ""
    note: str = ""


_LABELS: dict[str, Label] = {}
_OWNERS: dict[str, str] = {}


def declare(owner: str, labels: Mapping[str, Label]) -> None:
    """Declare the columns that a class or module makes, so that all results give them unit and meaning.

    An owner may declare its own again. Raises `ParameterError` if another owner gives a column a different unit.
    """
    for name, label in labels.items():
        declared, by = _LABELS.get(name, label), _OWNERS.get(name, owner)
        if declared.unit != label.unit and by != owner:
            message = f"{owner} has the column {name!r} in {label.unit}, {by} in {declared.unit}"
            remedy = "give it another name"
            raise ParameterError(message, field="telemetry_labels", value=name, unit=label.unit, remedy=remedy)
        _LABELS[name], _OWNERS[name] = label, owner


def labels_of(kind: type) -> dict[str, Label]:
    """Return the labels of the fields of a class, such as ``angle: Annotated[Array, Label("rad", "joint angle")]``."""
    hints = get_type_hints(kind, vars(sys.modules[kind.__module__]), include_extras=True)
    marks = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    return {name: mark for name, annotations in marks.items() for mark in annotations if isinstance(mark, Label)}


def labelled(kind: K) -> K:
    """Declare the columns of a class with labelled fields, and list them in its docstring; a class decorator.

    Each field becomes an entry of the section Attributes: name, meaning, unit, and note.
    """
    labels = labels_of(kind)
    declare(_owner(kind), labels)
    lines = []
    for name, label in labels.items():
        text = f"{label.title[0].upper()}{label.title[1:]} [{label.unit}]{label.note and f'; {label.note}'}."
        lines += [name, *textwrap.wrap(text, 110, initial_indent="    ", subsequent_indent="    ")]
    kind.__doc__ = f"{kind.__doc__}\n\nAttributes\n----------\n" + "\n".join(lines) + "\n"
    return kind


class Labelled:
    """Base of components with telemetry."""

    __slots__ = ()

    telemetry_labels: ClassVar[Mapping[str, Label]] = {}
    """Unit and meaning of the columns of the telemetry."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        declare(_owner(cls), vars(cls).get("telemetry_labels", {}))


def _owner(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def attributes(name: str, joint_type: JointType = HINGE) -> dict[str, str]:
    """Return unit and meaning of a column as NetCDF attributes; of an unknown one, its name alone.

    >>> attributes("nobody_made_it")
    {'long_name': 'nobody made it'}
    """
    label = _LABELS.get(name)
    if label is None:
        return {"long_name": name.replace("_", " ")}
    label = label.for_joint(joint_type)
    return {"units": label.unit, "long_name": label.title}
