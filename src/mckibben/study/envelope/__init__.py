"""Reachability first: what a joint can hold, whether a reference can be followed, what is nearest, how to build it."""

from mckibben.study.envelope.angles import Holdable, holdable
from mckibben.study.envelope.band import Bands, Range
from mckibben.study.envelope.design import Design, design
from mckibben.study.envelope.envelope import HEADERS, Envelope, envelope
from mckibben.study.envelope.following import Following, follow
from mckibben.study.envelope.keeping import keep_design, keep_offer
from mckibben.study.envelope.motion import Motion, motion_of
from mckibben.study.envelope.nearest import Kept, Offer, nearest_references
from mckibben.study.envelope.wanted import VARIED, Choice, Wanted, read_choice, read_wanted

__all__ = [
    "HEADERS",
    "VARIED",
    "Bands",
    "Choice",
    "Design",
    "Envelope",
    "Following",
    "Holdable",
    "Kept",
    "Motion",
    "Offer",
    "Range",
    "Wanted",
    "design",
    "envelope",
    "follow",
    "holdable",
    "keep_design",
    "keep_offer",
    "motion_of",
    "nearest_references",
    "read_choice",
    "read_wanted",
]
