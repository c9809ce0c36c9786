"""Files of muscles and specimens."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mckibben import catalog
from mckibben.component.schema import read_component, write
from mckibben.config.document import to_text
from mckibben.muscle import ForceLaw, MaxwellSlip, Specimen
from mckibben.muscle.air import volume_terms
from mckibben.storage.files import atomic_write

_HEAD = """\
# A muscle identified by mckibben, for scenarios and protocols: `muscle: muscle.yaml`, or with changes
# `muscle: {from: muscle.yaml, strength: 0.9}`. The specimen may also have initial_diameter and braid_angle (for the use
# of air, a simulated rig and Chou's law), rated_force (no limit without it), and a domain, such as
# `domain: {contraction_max: 25 %, pressure_max: 8 bar}`, its limits; without one, they are 0 bar and the law's points.
# The law is used at the pressures of its points; with `extrapolate: true` of the muscle, up to the limits of the
# specimen. The stiffness beyond the points is then a guess, and results say so.
"""
_UNDETERMINED = """\
# The data do not determine {}: its value is a guess, of at most one step of the length. Stiffness for small
# motion and the width of small loops depend on it; measure a reversal in smaller steps.
"""
_VOLUME = """\
# The volume is assumed: from that at contraction 0 and the law's work per pressure, mckibben.muscle.air.volume_terms.
"""


def read_specimen(path: str | os.PathLike[str]) -> Specimen:
    """Return the specimen of a specimen file or a muscle file; `ScenarioError` with all problems."""
    return read_component(Specimen, Path(path), key="specimen")


def muscle_text(
    law: str | dict[str, str],
    *,
    specimen: str,
    initial_length: float | None,
    friction: MaxwellSlip | None = None,
    undetermined: Sequence[str] = (),
    volume: tuple[float, ...] | None = None,
) -> str:
    """Return the text of a muscle's file, its law a reference or a section.

    It is empty if neither the catalog nor the data give the initial length [m]. A comment names the undetermined
    parameters of the friction. `volume` are `Specimen.volume_terms`.
    """
    name = specimen or "my muscle"
    known = catalog.specimen(name) if name in catalog.names("specimens") else None
    if known is None and initial_length is None:
        return ""
    section: Any = name
    if known is None or initial_length not in (None, float(known.initial_length)):
        length = write(Specimen(name, initial_length or 0.0))["initial_length"]
        section = {"name" if known is None else "from": name, "initial_length": length}
    if volume is not None:
        terms = write(Specimen(name, initial_length or 1.0, volume_terms=volume))["volume_terms"]
        section = {"from": section} if isinstance(section, str) else section
        section |= {"volume_terms": terms}
    data = {"specimen": section, "law": law}
    return (
        _HEAD
        + (_VOLUME if volume else "")
        + (_UNDETERMINED.format(" and ".join(undetermined)) if undetermined else "")
        + to_text(data if friction is None else {**data, "friction": write(friction)})
    )


def write_muscle(
    path: Path,
    identified: ForceLaw,
    *,
    specimen: str,
    initial_length: float | None,
    volume: float | None = None,
    law: str | dict[str, str] = "fit.yaml",
    friction: MaxwellSlip | None = None,
    undetermined: Sequence[str] = (),
) -> bool:
    """Write the `muscle_text` of an identified law, replacing a file; False if it is empty, and nothing is written.

    A volume [m^3] of the air at contraction 0 gives the muscle `volume_terms`, if its initial length [m] is known.
    """
    terms = volume_terms(identified, initial_length, volume) if initial_length and volume is not None else None
    text = muscle_text(
        law,
        specimen=specimen,
        initial_length=initial_length,
        friction=friction,
        undetermined=undetermined,
        volume=terms,
    )
    if text:
        with atomic_write(path, overwrite=True) as part:
            part.write_text(text, encoding="utf-8")
    return bool(text)
