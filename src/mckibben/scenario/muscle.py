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
    friction, undetermined
        Friction of the muscle, and the names of its parameters that the data do not determine.
    """
    name = specimen or "my muscle"
    known = catalog.specimen(name) if name in catalog.names("specimens") else None
    if known is None and initial_length is None:
        return False
    section: dict[str, Any] = {"from": name}
    if known is None or initial_length not in (None, float(known.initial_length)):
        length = write(Specimen(name, initial_length or 0.0))["initial_length"]
        section = {"name" if known is None else "from": name, "initial_length": length}
    head = _HEAD + (_UNDETERMINED.format(" and ".join(undetermined)) if undetermined else "")
    if initial_length and volume is not None:
        terms = volume_terms(identified, initial_length, volume)
        section |= {"volume_terms": write(Specimen(name, initial_length, volume_terms=terms))["volume_terms"]}
        head += _VOLUME
    data = {"specimen": name if section == {"from": name} else section, "law": law}
    data |= {} if friction is None else {"friction": write(friction)}
    with atomic_write(path, overwrite=True) as part:
        part.write_text(head + to_text(data), encoding="utf-8")
    return True
