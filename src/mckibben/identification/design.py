"""What the points of a test determine: whether they show how the force varies with contraction and with pressure."""

from __future__ import annotations

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.dataset.checks import force_plane, residuals_of
from mckibben.dataset.preprocessing import held_loads
from mckibben.dataset.schema import format_range
from mckibben.errors import IdentificationError
from mckibben.identification.summary import CONTRACTION_NOISE
from mckibben.units import bar, percent


def check_design(points: IsobaricDataset) -> None:
    """Refuse points that cannot give a force law, whatever the law.

    The force of a muscle falls with contraction at a constant pressure and rises with pressure at a constant
    contraction, the more the less it is. Points show this if the product of both is neither a function of the pressure
    nor affine in the contraction, to its noise, and if the plane through their forces, or through the contractions at
    which loads were held, has these slopes, significantly (95 %), and explains most of the variance. A test at one
    load, one pressure or one length does not, nor do two lines in the plane of contraction and pressure.

    Parameters
    ----------
    points
        Taut points.

    Raises
    ------
    IdentificationError
        With what such points do give, and the smallest further test.

    Examples
    --------
    >>> at_one_load = IsobaricDataset.of(
    ...     pressure=[1e5, 2e5, 3e5, 4e5, 5e5], contraction=[0.05, 0.12, 0.16, 0.19, 0.21], force=[98, 98, 98, 98, 98]
    ... )
    >>> check_design(at_one_load)
    Traceback (most recent call last):
        ...
    mckibben.errors.IdentificationError: the points are on a curve or two lines, at 5..21 % and 1..5 bar: ...
    """
    force, contraction, pressure = points.force, points.contraction, points.levels
    pressures, contractions = (
        f"{format_range(values / size)} {unit}"
        for values, size, unit in ((points.pressures, bar, "bar"), (contraction, percent, "%"))
    )
    if len(points.pressures) == 1:
        raise IdentificationError(
            f"all points are at one pressure ({pressures}): they give the stiffness there, not a force law",
            field="pressure",
            remedy="measure the same contractions at two further pressures or more",
        )
    loads = f"the contraction over pressure at {format_range(force)} N, not a force law"
    table = "a table of the pressure at this load is inverse_table (command line: --of inverse)"
    remedy = f"measure at three further loads or more, or strokes at constant pressures; {table}"
    relative = (pressure - pressure.mean()) / np.ptp(pressure)
    across = residuals_of(contraction * relative, np.column_stack([np.vander(relative, 4), contraction]))
    if np.sqrt(np.mean(across**2)) <= CONTRACTION_NOISE:
        raise IdentificationError(
            f"the points are on a curve or two lines, at {contractions} and {pressures}: they show the force "
            f"there, such as {loads}",
            field="contraction",
            remedy=remedy,
        )
    if (held := held_loads(points.table)) is None:
        plane = force_plane(contraction, pressure, force)
    else:  # it is the contraction that was measured, and falls with the load
        plane = force_plane(held, pressure, contraction)
    if min(plane.falls, plane.rises) <= 1 or plane.share <= 1 / 2:
        raise IdentificationError(
            f"the force ({format_range(force)} N) does not fall with contraction ({contractions}) and rise with "
            f"pressure ({pressures}), as that of a muscle: at one load, the points give {loads}",
            field="force",
            remedy=remedy,
        )
