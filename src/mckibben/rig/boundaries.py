"""How far a muscle is stretched and let go at each pressure of a test."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import RangeError
from mckibben.muscle import Muscle, Specimen, forces
from mckibben.units import bar

if TYPE_CHECKING:
    from mckibben.rig.protocol import IsobaricProtocol


class Boundaries(NamedTuple):
    """The stroke at each pressure of a protocol.

    Attributes
    ----------
    pressure
        Shape (pressures,): the set pressures [Pa], in the protocol's order.
    contraction_min, contraction_max
        Shape (pressures,): contraction [-] of the most stretched and of the shortest plateau.
    """

    pressure: NDArray[np.float64]
    contraction_min: NDArray[np.float64]
    contraction_max: NDArray[np.float64]


def boundaries(of: Muscle | Specimen, protocol: IsobaricProtocol) -> Boundaries:
    """The stroke at each pressure: the step "determining the boundary values" of the paper's procedure.

    The whole stroke, cut at both ends of the plateaus:

    - Stretched end: no plateau at which the law's force at the set pressure exceeds the rated force less the
      protocol's reserve (Eq. 3 gives 895 N at -3 % and 6 bar; the rating is 630 N).
    - Slack end: `slack_steps` plateaus beyond the last taut one. They show where the muscle goes slack, and
      that the force sensor reads zero there; more of them take time, bend the slack muscle, and tell nothing.

    A specimen without a law has the whole stroke at every pressure.

    Raises
    ------
    RangeError
        As the protocol's `check`; or if at a pressure the force is too high over the whole stroke.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.rig import IsobaricProtocol
    >>> muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    >>> limits = boundaries(muscle, IsobaricProtocol())
    >>> [round(float(end[-1]), 4) for end in (limits.contraction_min, limits.contraction_max)]  # at 6 bar
    [0.0033, 0.2478]
    """
    protocol.check(of)
    pressures = np.array(protocol.pressures)
    stroke = positions(of, protocol)
    if isinstance(of, Specimen):
        ends = (np.full(len(pressures), end) for end in (stroke[0], stroke[-1]))
        return Boundaries(pressures, *ends)
    force = forces(of, stroke, pressures[:, None])
    limit = float(of.specimen.rated_force) * (1 - protocol.force_reserve)
    first = _after_last(force > limit)
    last = np.minimum(np.maximum(_after_last(force > 0), first) + protocol.slack_steps, len(stroke)) - 1
    if len(over := pressures[first == len(stroke)]):
        raise RangeError(
            f"at {', '.join(f'{p / bar:g}' for p in over)} bar the force exceeds {limit:g} N over the whole stroke",
            value=float(over[0]),
            unit="Pa",
            remedy="leave the pressure out, or let the stroke reach a higher contraction",
        )
    return Boundaries(pressures, stroke[first], stroke[last])


def positions(of: Muscle | Specimen, protocol: IsobaricProtocol) -> NDArray[np.float64]:
    """Contraction [-] of the plateaus of the whole stroke, ascending."""
    first, last = protocol.stroke(of)
    step = protocol.step / float(specimen_of(of).initial_length)
    count = math.floor((last - first) / step + 1e-9) + 1
    return first + step * np.arange(count, dtype=np.float64)


def specimen_of(of: Muscle | Specimen) -> Specimen:
    """What is tested, without its law."""
    return of.specimen if isinstance(of, Muscle) else of


def _after_last(where: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Per row, the column after the last one that is true; 0 where none is."""
    count = where.shape[1]
    return np.where(where.any(axis=1), count - np.argmax(where[:, ::-1], axis=1), 0).astype(np.int64)
