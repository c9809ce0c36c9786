"""Files of muscles and specimens."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from mckibben import catalog
from mckibben.component.schema import read_component, write
from mckibben.config.document import to_text
from mckibben.muscle import MaxwellSlip, Specimen

_HEAD = """\
# A muscle identified by mckibben, for scenarios and protocols: `muscle: muscle.yaml`, or with changes
# `muscle: {from: muscle.yaml, strength: 0.9}`. The specimen may also have initial_diameter and braid_angle (for the use
# of air, a simulated rig and Chou's law), rated_force (no limit without it), and a domain, such as
# `domain: {contraction_max: 25 %, pressure_max: 8 bar}`; without one, 0 bar and the range of the law's points limit it.
"""


def read_specimen(path: str | os.PathLike[str]) -> Specimen:
    """Return the specimen of a specimen file or a muscle file; `ScenarioError` with all problems."""
    return read_component(Specimen, Path(path), key="specimen")


def muscle_text(law: str, *, specimen: str, initial_length: float | None, friction: MaxwellSlip | None = None) -> str:
    """Return the text of a muscle's file; empty if neither the catalog nor the data give the initial length [m]."""
    name = specimen or "my muscle"
    known = catalog.specimen(name) if name in catalog.names("specimens") else None
    if known is None and initial_length is None:
        return ""
    section: Any = name
    if known is None or initial_length not in (None, float(known.initial_length)):
        length = write(Specimen(name, initial_length or 0.0))["initial_length"]
        section = {"name" if known is None else "from": name, "initial_length": length}
    data = {"specimen": section, "law": law}
    return _HEAD + to_text(data if friction is None else {**data, "friction": write(friction)})
