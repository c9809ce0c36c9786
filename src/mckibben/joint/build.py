"""A joint between two equal muscles, from the name of its paths or geometry."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import ModuleType

from mckibben.component.calls import checked_call
from mckibben.component.classes import classes_of, find_class
from mckibben.component.schema import declared_fields, read_component
from mckibben.errors import ParameterError, quoted, suggest
from mckibben.joint.antagonistic import AntagonisticJoint
from mckibben.joint.geometry import Geometry
from mckibben.joint.paths import MusclePath, PairedPaths
from mckibben.muscle import Muscle


@checked_call
def joint(
    muscle: Muscle | str | os.PathLike[str], kind: str | Geometry | MusclePath = "pulley", **fields: object
) -> AntagonisticJoint:
    """Return a joint between two equal muscles; `mckibben.joint` itself is this function, too.

    Muscles that differ, and series springs, are arguments of `AntagonisticJoint`.

    Parameters
    ----------
    muscle
        Each of the muscles, such as ``fit.muscle()``, or its file, such as ``fit/muscle.yaml``.
    kind
        Path of each muscle or geometry of both: its class by name, as in a file, or an object.
    fields
        Fields of the class, in SI or as text with a unit. Default of the `rest_length` of a path: that of the muscle in
        the middle of its contractions, from which the joint turns equally far to both sides.

    Raises
    ------
    ParameterError
        If the name is not that of a class, or fields are given with an object.

    Examples
    --------
    >>> from mckibben import catalog
    >>> muscle = Muscle(catalog.specimen("DMSP-10-250"), catalog.law("lei-mas-10-180n"))
    >>> joint(muscle, "pulley", radius="35 mm")
    <AntagonisticJoint: PairedPaths(path1=Pulley(radius=0.035, rest_length=0.21875), path2=...), two of Muscle(...)>
    """
    if isinstance(muscle, str | os.PathLike):
        muscle = read_component(Muscle, Path(muscle))
    if isinstance(kind, str):
        path, geometry = find_class(MusclePath, kind), find_class(Geometry, kind)
        if path is None and geometry is None:
            kinds = [*classes_of(MusclePath), *classes_of(Geometry)]
            message = f"there is no path or geometry {quoted(kind)}"
            raise ParameterError(message, field="kind", value=kind, remedy=suggest(kind, kinds))
        if path and "rest_length" in declared_fields(path) and not {"rest_length", "lengths"} & {*fields}:
            middle = (max(muscle.domain.contraction_min, 0.0) + muscle.domain.contraction_max) / 2
            fields["rest_length"] = float(muscle.specimen.initial_length * (1 - middle))
        kind = (path or geometry)(**fields)  # type: ignore[misc]  # one of them is a class
    elif fields:
        raise ParameterError(f"{next(iter(fields))} is given with an object", remedy="give it to its class")
    return AntagonisticJoint(PairedPaths(kind, kind) if isinstance(kind, MusclePath) else kind, muscle, muscle)


class CallableModule(ModuleType):
    """Module `mckibben.joint`, which makes a joint if it is called: ``mk.joint(muscle, "pulley", radius="35 mm")``."""

    __call__ = staticmethod(joint)


def make_callable(name: str) -> None:
    """Let a module be called as the function `joint`."""
    sys.modules[name].__class__ = CallableModule
