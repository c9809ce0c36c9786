"""Air through a valve and in a chamber, in plain floats: ISO 6358 and the ideal gas."""

from __future__ import annotations

import math

from mckibben.units import bar

ATMOSPHERE = 1.01325e5
"""Of the room [Pa, absolute]."""

TEMPERATURE = 293.15
"""Of the room and the air [K]; the chambers are small and slow enough to keep it."""

GAS_CONSTANT = 288.0
"""Of air at 65 % relative humidity [J/(kg*K)], as ISO 6358 has it."""

DENSITY = 1.185
"""Of air in the reference state of ISO 8778 [kg/m^3]: 20 degrees C, 1 bar, 65 % relative humidity (ANR)."""

ENERGY = GAS_CONSTANT * TEMPERATURE
"""R T [J/kg]: pressure times volume of a kilogram."""

L_PER_S_BAR = 1e-3 / bar
"""A sonic conductance of 1 dm^3/(s*bar), the unit of data sheets, in m^3/(s*Pa)."""

_LAMINAR = 0.999  # beyond this ratio of pressures the flow is proportional to their difference, as the standard says


def mass_flow(conductance: float, critical: float, upstream: float, downstream: float) -> float:
    r"""The flow [kg/s] from one pressure to another [Pa, absolute]; negative where it goes backwards.

    .. math::

        G = C \rho_0 p_1 \psi, \qquad \psi = \begin{cases} 1 & p_2/p_1 \le b \\
        \sqrt{1 - \left(\frac{p_2/p_1 - b}{1 - b}\right)^2} & \text{above} \end{cases}

    Parameters
    ----------
    conductance
        C, sonic conductance [m^3/(s*Pa)].
    critical
        b, the ratio of pressures at which the flow chokes [-].
    upstream, downstream
        p1 and p2.

    References
    ----------
    ISO 6358-1:2013, "Determination of flow-rate characteristics of components using compressible fluids".

    Examples
    --------
    A choked valve of 0.01 dm^3/(s*bar) at 10 bar passes 0.1 dm^3/s of air in its reference state:

    >>> round(mass_flow(0.01 * L_PER_S_BAR, 0.3, 10e5, 2e5) / DENSITY * 1e3, 6)
    0.1
    """
    if downstream > upstream:
        return -mass_flow(conductance, critical, downstream, upstream)
    if upstream <= 0:
        return 0.0
    ratio = downstream / upstream
    if ratio <= critical:
        share = 1.0
    elif ratio < _LAMINAR:
        share = math.sqrt(1 - ((ratio - critical) / (1 - critical)) ** 2)
    else:
        edge = math.sqrt(1 - ((_LAMINAR - critical) / (1 - critical)) ** 2)
        share = edge * (1 - ratio) / (1 - _LAMINAR)
    return conductance * DENSITY * upstream * share
