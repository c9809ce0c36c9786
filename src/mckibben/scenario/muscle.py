"""Files of muscles and specimens."""

from __future__ import annotations

import os
from collections.abc import Mapping
from math import inf, nan
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from mckibben import catalog
from mckibben.component.checks import check_positive
from mckibben.component.schema import read_component, write
from mckibben.config.document import to_text
from mckibben.errors import UnitError
from mckibben.muscle import ForceLaw, MaxwellSlip, Specimen
from mckibben.muscle.air import inner_volume, volume_terms
from mckibben.storage.files import atomic_write
from mckibben.units import justified, quantity

if TYPE_CHECKING:
    from mckibben.identification import Fit, FitWithFriction

_HEAD = """\
# A muscle identified by mckibben, for scenarios and protocols: `muscle: muscle.yaml`, or with changes
# `muscle: {from: muscle.yaml, strength: 0.9}`. The specimen may also have initial_diameter and braid_angle (for the use
# of air, a simulated rig and Chou's law), rated_force (no limit without it), and a domain, such as
# `domain: {contraction_max: 25 %, pressure_max: 8 bar}`, its limits; without one, they are 0 bar and the law's points.
# The law is used at the pressures of its points; with `extrapolate: true` of the muscle, up to the limits of the
# specimen. The stiffness beyond the points is then a guess, and results say so.
"""
_UNDETERMINED = """\
# The data do not determine {}: it has the least value that they allow. Stiffness for small
# motion and the width of small loops depend on it; record a short stroke with a reversal.
"""
_VOLUME = """\
# The volume is assumed: from that at contraction 0 and the law's work per pressure, mckibben.muscle.air.volume_terms.
"""


def read_specimen(path: str | os.PathLike[str]) -> Specimen:
    """Return the specimen of a specimen file or a muscle file; `ScenarioError` with all problems."""
    return read_component(Specimen, Path(path), key="specimen")


def write_muscle(
    path: Path,
    identified: ForceLaw,
    *,
    specimen: str,
    initial_length: float | None,
    volume: float | None = None,
    law: str | dict[str, str] = "fit.yaml",
    friction: MaxwellSlip | None = None,
    errors: Mapping[str, float] = MappingProxyType({}),
    undetermined: Mapping[str, float] | None = None,
) -> bool:
    """Write the muscle file of an identified law, replacing a file.

    Without a specimen of the catalog and an initial length [m], nothing is written, and the answer is False. A comment
    names the undetermined parameters of the friction.

    Parameters
    ----------
    path
        File to write.
    identified
        Law whose work per pressure gives the volume at other contractions.
    specimen
        Name of the specimen, of the catalog or another one; empty for "my muscle".
    initial_length
        Initial length of the data [m]; None for that of the catalog.
    volume
        Volume of the air at contraction 0 [m^3]; it gives the muscle `Specimen.volume_terms` if its initial length is
        known.
    law
        Reference to the law, relative to the file, or its section.
    friction, errors, undetermined
        Friction of the muscle, standard errors of its parameters by name, which give them their digits, and upper
        bounds [m] of its lengths that the data do not determine, which get two.
    """
    name = specimen or "my muscle"
    known = catalog.specimen(name) if name in catalog.names("specimens") else None
    if known is None and initial_length is None:
        return False
    section: dict[str, Any] = {"from": name}
    if known is None or initial_length not in (None, float(known.initial_length)):
        length = write(Specimen(name, initial_length or 0.0))["initial_length"]
        section = {"name" if known is None else "from": name, "initial_length": length}
    head = _HEAD + "".join(map(_UNDETERMINED.format, undetermined or ()))
    if initial_length and volume is not None:
        terms = volume_terms(identified, initial_length, volume)
        written = write(Specimen(name, initial_length, volume_terms=terms))["volume_terms"]
        section |= {"volume_terms": [*map(justified, written)]}
        head += _VOLUME
    data = {"specimen": name if section == {"from": name} else section, "law": law}
    if friction is not None:
        errors = {**errors, **dict.fromkeys(undetermined or (), inf)}
        data["friction"] = {name: justified(text, errors.get(name, nan)) for name, text in write(friction).items()}
    with atomic_write(path, overwrite=True) as part:
        part.write_text(head + to_text(data), encoding="utf-8")
    return True


def air_volume(text: str, length: float | None) -> float | None:
    """Return the volume [m^3] of the air at contraction 0, as a text or by an inner diameter; None if it is not known.

    A diameter needs the initial length [m] of the muscle. Raises `UnitError` if the text is neither, and `RangeError`
    for one that is not possible.

    >>> [round(1e6 * one, 2) for one in (air_volume("10 mm", 0.3), air_volume("30 mL", None))], air_volume("", 0.3)
    ([23.56, 30.0], None)
    """
    if not text.strip():
        return None
    try:
        volume = quantity(text, "m^3")
    except UnitError:
        diameter = quantity(text, "m")
        return inner_volume(length, diameter) if length else None
    check_positive("muscle", "m^3", fill=volume)
    return volume


def write_identified(
    path: Path,
    fit: Fit | FitWithFriction,
    attributes: Mapping[str, Any],
    *,
    name: str = "",
    volume: float | None = None,
) -> bool:
    """Write the muscle of a fit, whose file fit.yaml is in the same folder; arguments and answer as `write_muscle`.

    Parameters
    ----------
    path, fit
        File to write, and law, with friction where it was identified.
    attributes
        Those of the points of the fit, with name and initial length [m] of the specimen.
    name, volume
        Name of a specimen that has none, and volume of the air at contraction 0 [m^3] if it is known.
    """
    loops = getattr(fit, "hysteresis", None)
    return write_muscle(
        path,
        fit.law,
        specimen=attributes["specimen"] or name,
        initial_length=attributes.get("initial_length"),
        volume=volume,
        friction=loops.friction if loops else None,
        errors=loops.standard_errors if loops else {},
        undetermined=loops.undetermined if loops else None,
    )
