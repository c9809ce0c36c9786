"""`mckibben identify` and `validate`: force laws, friction, and their validation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from mckibben.cli.command import command
from mckibben.cli.options import Data, Reading, parse_positive, reads_files
from mckibben.errors import ParameterError, UnitError
from mckibben.units import quantity, show

if TYPE_CHECKING:
    from mckibben.cli.identified import Pool
    from mckibben.dataset import IsobaricDataset
    from mckibben.identification import FrictionForm
    from mckibben.result import Result

_ALL = "all"
_CHOICES = {"auto": None, "on": True, "off": False}


@reads_files("contraction", "sample_rate", "specimen")
@command
def identify(
    data: Data,
    law: Annotated[
        str, Option(help="Force law, such as exponential (Eq. 2); 'mckibben catalog' lists them; 'all' ranks them.")
    ] = "exponential",
    friction: Annotated[
        str,
        Option(
            metavar="FORM",
            help="Friction and drift with the law: on, off, or a form such as coulomb (default: on if loading and "
            "unloading differ, in the form that predicts held-out loops best).",
        ),
    ] = "auto",
    inner: Annotated[
        str,
        Option(metavar="SIZE", help="Inner diameter or measured volume of air at contraction 0, for muscle.yaml."),
    ] = "",
    threshold: Annotated[bool, Option("--threshold", help="Identify a pressure threshold with the law.")] = False,
    pool: Annotated[
        bool, Option("--pool", help="Each file is another specimen of one make; one law for all, and errors left out.")
    ] = False,
    for_length: Annotated[
        str, Option(metavar="LENGTH", help="Initial length of a specimen that --pool predicts, for muscle.yaml.")
    ] = "",
    keep_outliers: Annotated[
        bool, Option("--keep-outliers", help="Fit all points, those off the surface through the others, too.")
    ] = False,
    *,
    reading: Reading,
    progress: Any = None,
) -> Result:
    """Fit a force law to measured points: estimates with standard errors, and cross-validation errors.

    With --law all, every law is fitted, and laws are ranked by cross-validation over pressures, inner contractions,
    directions and repeats; the error at the highest pressure, predicted from all lower ones, is shown. Where loading
    and unloading differ, friction and drift of the force sensor are identified with the law (--friction off: without).
    """
    from mckibben.cli.identified import Identified, Ranked, Source
    from mckibben.study.inputs import law_type_named

    law_type, robust = law_type_named(law) if law != _ALL else None, not keep_outliers
    form = None if friction in _CHOICES else _friction_form(friction)
    if law_type is None and (friction != "auto" or threshold or pool):
        raise ParameterError(
            "--friction, --threshold and --pool apply to a single law", remedy="choose one, such as --law exponential"
        )
    volume = _inner(inner)
    if pool or for_length:
        if friction != "auto" or threshold or any(volume) or not pool:
            raise ParameterError(
                "--pool fits a single law, and applies to no other option of the fit",
                remedy="give --pool, --law, --for-length, --keep-outliers and --out alone",
            )
        return _pooled(law_type, [reading.data([file]) for file in data], for_length, robust)
    points = reading.data(data)
    _check_inner(volume[0], points.table.attrs.get("initial_length"))
    source = Source(data, points, reading.recipe, volume)
    if law_type is None:
        from mckibben.identification import rank

        return Ranked(rank(points, robust=robust, progress=progress), source)
    from mckibben.identification import identify_threshold, identify_with_friction, shows_hysteresis

    asked = True if form else _CHOICES[friction]
    if threshold and asked is None and shows_hysteresis(points):
        asked = True  # the misfit of the law without its threshold would hide the friction
    fitted = identify_with_friction(law_type, points, friction=asked, form=form, robust=robust)
    late = identify_threshold(law_type, fitted.points, robust=robust) if threshold else None
    return Identified(fitted, late, source)


def _pooled(law_type: Any, data: list[IsobaricDataset], for_length: str, robust: bool) -> Pool:
    """Pool of datasets, one per specimen."""
    from mckibben.cli.identified import Pool
    from mckibben.identification import identify_pooled

    length = parse_positive("--for-length", for_length, "m") if for_length else None
    return Pool(identify_pooled(law_type, data, robust=robust), length)


def _inner(text: str) -> tuple[float | None, float | None]:
    """Inner diameter [m] or volume of air [m^3] at contraction 0, from either."""
    if not text:
        return None, None
    try:
        quantity(text, "m^3")
    except UnitError:
        return parse_positive("--inner", text, "m"), None
    return None, parse_positive("--inner", text, "m^3")


def _check_inner(diameter: float | None, length: float | None) -> None:
    """Raise a `ParameterError` for a diameter above the initial length [m]."""
    if diameter is not None and length and diameter > length:
        message = f"--inner is {show(diameter, 'mm')}, more than the initial length, {show(length, 'mm')}"
        remedy = "check both, such as --inner '10 mm' --initial-length '200 mm'"
        raise ParameterError(message, value=diameter, upper=length, unit="m", remedy=remedy)


def _friction_form(text: str) -> FrictionForm:
    from mckibben.identification import FrictionForm

    try:
        return FrictionForm(text)
    except ValueError:
        forms = ", ".join([*_CHOICES, *(form.value for form in FrictionForm)])
        message = f"--friction {text!r} is not a form of friction"
        raise ParameterError(message, value=text, remedy=f"take {forms}") from None


@reads_files("contraction", "sample_rate", "specimen")
@command
def validate(
    law: Annotated[
        str, Argument(metavar="LAW", help="A file of a fit or a muscle, a law from the catalog, or 'chou'.")
    ],
    data: Data,
    specimen: Annotated[str, Option(help="Specimen, or its file, whose braid angle and diameter 'chou' uses.")] = "",
    *,
    reading: Reading,
) -> Result:
    """Validate a force law with measured points: errors by pressure and direction. Friction is not included."""
    from mckibben.identification import validate as run
    from mckibben.study.inputs import law_named

    known = law_named(law, specimen=specimen)
    return run({Path(law).name if Path(law).is_absolute() else law: known}, reading.data(data))
