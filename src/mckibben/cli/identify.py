"""`mckibben identify`, `validate` and `catalog`: laws, friction and creep of a muscle; published ones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from mckibben.cli.command import command
from mckibben.cli.options import Progress, check_unused, of_option
from mckibben.cli.reading import Data, Reading

if TYPE_CHECKING:
    from mckibben.muscle import ForceLaw
    from mckibben.result import Result

_ALL = "all"
_CHOICES: dict[str, str | bool | None] = {"auto": None, "on": True, "off": False}


@command
def identify(
    data: Data,
    of: Literal["force", "creep", "inverse", "torque"] = "force",
    law: str = "exponential",
    friction: str = "auto",
    inner: str = "",
    keep_outliers: bool = False,
    *,
    reading: Reading,
    progress: Progress = None,
) -> Result:
    """Identify a muscle: a force law with standard errors and cross-validation errors, or its creep.

    With --law all, laws are ranked by cross-validation. Where loading and unloading differ, friction and drift of the
    force sensor are identified with the law.

    Parameters
    ----------
    of : force|torque|inverse|creep
        What to identify: the force law of measured points; that of two equal muscles from torques of
        their joint at angles and pressures; of a test at constant loads, the pressure over
        contraction, load and direction as a table (CSV and C); or, of recordings over time, the creep after
        steps of the pressure at fixed lengths.
    law
        Force law, such as exponential (Eq. 2); 'mckibben catalog' lists them; 'all' ranks them.
    friction : FORM
        Friction and drift with the law: on, off, or a form such as coulomb (default: on if loading and
        unloading differ, in the form that predicts held-out loops best).
    inner : SIZE
        Inner diameter or measured volume of air at contraction 0, for muscle.yaml.

    Other Parameters
    ----------------
    keep_outliers
        Fit all points, those off the surface through the others, too.
    """
    form = "" if friction == "auto" else friction
    if of != "force":
        if of == "inverse":
            from mckibben.identification import inverse_table

            return inverse_table(reading.data(data))
        check_unused(f"--of {of}", inner=inner, friction=form)
        if of == "torque":
            from mckibben.cli.identified import of_torque

            return of_torque(data, law, reading)
        from mckibben.identification import identify_pressure_creep

        return identify_pressure_creep(reading.recordings(data))
    from mckibben.cli.identified import Source, identified, ranked
    from mckibben.identification import rank
    from mckibben.scenario import inputs

    law_type, robust = inputs.law_type_named(law) if law != _ALL else None, not keep_outliers
    if law_type is None:
        check_unused("--law all", friction=form)
    points = reading.data(data)
    volume = None
    if inner:
        from mckibben.scenario import air_volume  # 0.2 s to import

        with of_option("--inner"):
            volume = air_volume(inner, points.table.attrs.get("initial_length"))
    source = Source(data, points, reading.recipe, volume)
    if law_type is None:
        return ranked(rank(points, robust=robust, progress=progress), source)
    fitted = inputs.identify(points, law_type, friction=_CHOICES.get(friction, friction), robust=robust)
    return identified(fitted, source)


@command
def validate(law: str, data: Data, *, reading: Reading) -> Result:
    """Validate a force law with measured points: errors by pressure and direction. Friction is not included.

    The law 'chou' takes braid angle and diameter of a specimen, such as --read specimen=DMSP-10-250.

    Parameters
    ----------
    law : LAW
        A file of a fit or a muscle, a law from the catalog, or 'chou'.
    """
    from mckibben.identification import validate as run
    from mckibben.scenario.inputs import law_named

    validated: ForceLaw = law_named(law, specimen=reading.recipe.specimen or "")
    return run({Path(law).name if Path(law).is_absolute() else law: validated}, reading.data(data))


@command
def catalog() -> Result:
    """List the force laws, published parameters, specimens, datasets and valves."""
    from mckibben.catalog.overview import Overview

    return Overview()
