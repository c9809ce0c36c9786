"""Reachability first: what a joint can hold, whether a reference can be followed, what is nearest, how to build it."""

from mckibben.reachability.bands import Bands, Holdable, Range, holdable
from mckibben.reachability.design import Design, design
from mckibben.reachability.envelope import HEADERS, Envelope, envelope
from mckibben.reachability.motion import Motion, motion_of
from mckibben.reachability.nearest import Kept, Offer, keep_design, keep_offer, nearest_references
from mckibben.reachability.targets import VARIED, Choice, Wanted, read_choice, read_wanted
from mckibben.reachability.trackability import Following, follow

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
