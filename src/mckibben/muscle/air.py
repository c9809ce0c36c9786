"""Air in a muscle: mass flow by ISO 6358, and the pressure by a polytropic change of state or an energy balance."""

from __future__ import annotations

import math
import warnings
from types import SimpleNamespace
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np

from mckibben.component.checks import check_positive, check_within
from mckibben.errors import McKibbenWarning, RangeError
from mckibben.muscle.base import ForceLaw
from mckibben.numerics.calculus import derivative
from mckibben.units import Quantity, atm, bar, factor, mm

CriticalRatio = Annotated[float, Quantity("1", "1", 0, 0.99)]

ATMOSPHERE = atm
"""Atmospheric pressure [Pa, absolute]."""

TEMPERATURE = 293.15
"""Temperature of the room and the supply, and of polytropic air in a muscle [K]."""

GAS_CONSTANT = 288.0
"""Gas constant of air at 65 % relative humidity [J/(kg*K)], from ISO 6358."""

DENSITY = 1.185
"""Density of air in the reference state of ISO 8778 [kg/m^3]: 20 degrees C, 1 bar, 65 % relative humidity (ANR)."""

ENERGY = GAS_CONSTANT * TEMPERATURE
"""R T [J/kg]: pressure times volume per mass."""

L_PER_S_BAR = 1e-3 / bar
"""A sonic conductance of 1 dm^3/(s*bar), the unit of data sheets, in m^3/(s*Pa)."""

BLOCKED_FORCE = 8.2
"""Force of a muscle at its initial length over p pi d^2/4 at a braid angle of 25 deg; 14 at 20 deg, 5 at 30 deg.

C.-P. Chou and B. Hannaford, IEEE Trans. Robotics and Automation 12 (1996) 90-102.
"""

USUAL_DIAMETERS = (factor("lbf") ** -0.25, 2.0)
"""Usual ratios of the diameter that the force of a muscle implies to its own, which may be the inner one of its hose.

Below the first, lbf or kgf are nearer to the force than N.
"""

DIAMETERS = 1.7e-3, 80e-3
"""Diameters [m] of muscles, the smallest and the largest."""

HEAT_CAPACITY_RATIO = 1.4
"""Ratio kappa of the specific heat capacities of air."""

LAMINAR = 0.999
"""Ratio of pressures above which the flow is proportional to their difference (ISO 6358)."""

FLOATS = SimpleNamespace(maximum=max, minimum=min, sqrt=math.sqrt)
"""Arithmetic of Python floats for `mass_flow`, a hundred times faster than `jax.numpy` outside of compiled code."""


def implied_diameter(force_per_pressure: float, contraction: float = 0.0) -> float:
    """Diameter [m] of a muscle with a force per pressure [m^2] at a contraction, up to 20 %, as of an ideal braid.

    Examples
    --------
    >>> round(implied_diameter(8.2 * math.pi / 4 * 0.01**2), 6), round(implied_diameter(2.5e-4, 0.2), 4)
    (0.01, 0.0099)
    """
    steepness = 1.5 * (BLOCKED_FORCE + 1)  # 3 / tan^2 of the braid angle
    ideal = steepness * (1 - min(max(contraction, 0.0), 0.2)) ** 2 - (1 + steepness / 3)
    return math.sqrt(4 * force_per_pressure / (math.pi * ideal))


def inner_volume(length: float, diameter: float) -> float:
    """Volume [m^3] of a muscle by length and inner diameter [m]; `RangeError` below 1 mm or above the length."""
    check_within("muscle", 1e-3, length, "m", remedy="give a length, such as 14 mm", diameter=diameter)
    return math.pi / 4 * diameter**2 * length


def volume_terms(law: ForceLaw, initial_length: float, volume: float, degree: int = 4) -> tuple[float, ...]:
    r"""Return coefficients [m^3] of the volume over the contraction, for `Specimen.volume_terms`, from a force law.

    .. math:: V(\varepsilon) = V_0 + l_0 \int_0^\varepsilon \frac{\partial F}{\partial p}\,d\varepsilon

    The virtual work of the air, F = -p dV/dl. For Chou's law (Eq. 1) this is the volume inside the braid; for others it
    is an assumption, as their force per pressure includes losses in the bladder. The force per pressure at the middle
    of the law's pressures is fitted by a polynomial over its contractions.

    Parameters
    ----------
    initial_length, volume
        l0 [m], and V0 [m^3], the volume of the air at contraction 0.
    degree
        Degree of the polynomial.

    Raises
    ------
    RangeError
        If a number is not positive, or the law's domain is not finite.

    Warns
    -----
    McKibbenWarning
        If the diameter that the force implies is below 0.4 or above 2 times that of the volume.

    Examples
    --------
    >>> from mckibben import ChouLaw, catalog
    >>> braid = catalog.specimen("DMSP-10-250")
    >>> terms = volume_terms(ChouLaw.of(braid), braid.initial_length, float(braid.volume(0.0)))
    >>> [round(1e6 * float(v), 2) for v in (np.polyval(terms[::-1], 0.2), braid.volume(0.2))]  # cm^3
    [41.71, 41.71]
    """
    check_positive("volume_terms", "m", initial_length=initial_length)
    check_positive("volume_terms", "m^3", volume=volume)
    box = law.domain.intersection(law.formula_domain)
    bounds = [
        float(number) for number in (box.contraction_min, box.contraction_max, box.pressure_min, box.pressure_max)
    ]
    if not all(map(math.isfinite, bounds)):
        raise RangeError(f"the domain of the law, {box.bounds()}, is not finite", remedy="give the law a domain")
    contraction = np.linspace(min(bounds[0], 0.0), bounds[1], 201)
    gain = np.asarray(derivative(lambda p: law.force(contraction, p), jnp.full(contraction.shape, np.mean(bounds[2:]))))
    diameter = math.sqrt(4 * volume / (math.pi * initial_length))
    implied = implied_diameter(max(float(np.interp(0.0, contraction, gain)), 0.0))
    if not USUAL_DIAMETERS[0] <= implied / diameter <= USUAL_DIAMETERS[1]:
        text = (
            f"the volume is that of a diameter of {diameter / mm:.3g} mm, the force that of about {implied / mm:.2g} mm"
        )
        warnings.warn(f"{text}: check the units of diameter or volume, and of the force", McKibbenWarning, stacklevel=2)
    work = np.polynomial.Polynomial.fit(contraction, gain, degree - 1).convert().integ()
    return tuple(float(number) for number in (work * initial_length + volume).coef)


def flow_share(critical: Any, ratio: Any, xp: Any = jnp) -> Any:
    """Return the flow as a fraction of choked flow, at a ratio of absolute pressures up to `LAMINAR`."""
    beyond = xp.maximum((xp.minimum(ratio, LAMINAR) - critical) * (1 / (1 - critical)), 0.0)
    return xp.sqrt(1 - beyond**2)


def mass_flow(conductance: Any, critical: Any, inlet: Any, outlet: Any, xp: Any = jnp) -> Any:
    r"""Return the mass flow [kg/s] through a valve at absolute pressures [Pa]; negative towards the inlet.

    .. math::

        \dot m = C \rho_0 p_1 \sqrt{1 - \left(\frac{p_2/p_1 - b}{1 - b}\right)^2}, \qquad \dot m = C \rho_0 p_1
        \text{ where } p_2/p_1 \le b

    ISO 6358-1:2013, with the sonic conductance C [m^3/(s*Pa)] and the critical pressure ratio b [-], for air of 20
    degrees C; C is the same in both directions. The example of SMC's data sheets (C = 2 dm^3/(s*bar), b = 0.3, from 0.5
    to 0.4 MPa absolute) reads 420 dm^3/min (ANR) from a chart:

    >>> round(float(mass_flow(2 * L_PER_S_BAR, 0.3, 5e5, 4e5)) / DENSITY * 60e3)
    420
    """
    upstream, downstream = xp.maximum(inlet, outlet), xp.minimum(inlet, outlet)
    inverse = 1 / xp.maximum(upstream, 1e-9)  # a single division, the slowest operation; a vacuum has no ratio
    direction = xp.minimum(xp.maximum((inlet - outlet) * inverse * (1 / (1 - LAMINAR)), -1.0), 1.0)
    return conductance * DENSITY * upstream * flow_share(critical, downstream * inverse, xp) * direction


def pressure_behind(conductance: Any, critical: Any, pressure: Any, flow: Any) -> Any:
    """Return the absolute pressure [Pa] beyond a restriction through which a mass flow [kg/s] arrives at a pressure.

    The inverse of `mass_flow` for its inlet; a negative flow leaves. The lowest is that at which the flow is choked.

    >>> flow = mass_flow(2 * L_PER_S_BAR, 0.3, 5e5, 4e5)
    >>> round(float(pressure_behind(2 * L_PER_S_BAR, 0.3, 4e5, flow)), 3)
    500000.0
    >>> round(float(pressure_behind(2 * L_PER_S_BAR, 0.3, 5e5, -flow)), 3)
    400000.0
    """
    choked = flow * (1 / (conductance * DENSITY))  # pressure [Pa] that drives the flow if it is choked
    steepest = flow_share(critical, LAMINAR) / (1 - LAMINAR)
    linear = pressure + choked * (1 / steepest)
    square, product = pressure**2 + (choked * (1 - critical)) ** 2, critical * pressure
    subsonic = square / (product + jnp.sqrt(jnp.maximum(product**2 + (1 - 2 * critical) * square, 0.0)))
    upstream = jnp.where(choked * critical >= pressure, choked, subsonic)
    share = jnp.sqrt(jnp.maximum(1 - (choked / pressure) ** 2, 0.0))
    downstream = pressure * (critical + (1 - critical) * share)
    above = jnp.where(linear * LAMINAR <= pressure, linear, upstream)
    return jnp.where(flow > 0, above, jnp.where(linear >= LAMINAR * pressure, linear, downstream))


def exchange_rate(index: float, critical: float, conductance: float, volume: float) -> float:
    """Return a bound on the rate [1/s] at which a conductance evens out the pressure in a volume [m^3]."""
    return index * ENERGY * DENSITY * flow_share(critical, LAMINAR, FLOATS) / (1 - LAMINAR) * conductance / volume


def nominal_conductance(flow: float, critical: float = 0.3) -> float:
    """Return the sonic conductance [m^3/(s*Pa)] of a valve with a standard nominal flow [m^3/s (ANR)].

    That is the flow from 6 bar to 5 bar gauge pressure, stated in data sheets without C. With a critical pressure ratio
    b [-] of 0.2 instead of 0.3, C is 6 % higher; with 0.5 it is 14 % lower:

    >>> round(nominal_conductance(100e-3 / 60) / L_PER_S_BAR, 3)  # 100 dm^3/min
    0.393
    """
    return flow / (7 * bar * flow_share(critical, 6 / 7, FLOATS))


def pressure_rate(index: Any, pressure: Any, flow: Any, volume: Any, volume_rate: Any) -> Any:
    r"""Return the rate [Pa/s] of the absolute pressure [Pa] in a volume [m^3] with a mass inflow [kg/s].

    .. math:: \dot p = \frac{n}{V} \left(R T \dot m - p \dot V\right)

    E. Richer and Y. Hurmuzlu, "A High Performance Pneumatic Force Actuator System: Part I", ASME Journal of Dynamic
    Systems, Measurement, and Control 122 (2000), with one polytropic index n for filling, venting and compression, and
    air of room temperature. Without flow p V^n is constant; at n = 1 the mass p V / (R T) is conserved. Where the
    volume depends on the pressure itself (a muscle in series with a spring), give V + n p dV/dp as the volume, and its
    rate [m^3/s] at constant pressure.
    """
    return index * (ENERGY * flow - pressure * volume_rate) * (1 / volume)


def flow_of_warm_air(flow: Any, temperature: Any) -> Any:
    r"""Return a mass flow [kg/s] into a volume whose air has a temperature [K], from that of air at room temperature.

    Where it leaves (negative), :math:`\dot m = \dot m_0 \sqrt{T_0 / T}`: ISO 6358, with the upstream temperature T.
    """
    return flow * jnp.where(flow < 0, jnp.sqrt(TEMPERATURE / temperature), 1.0)


def heat_as_flow(conductance: Any, temperature: Any) -> Any:
    """Return the inflow [kg/s] of air at room temperature that changes the pressure as the heat from the wall does.

    The wall has room temperature and a conductance [W/K] to the air, whose temperature is given [K].
    """
    share = (HEAT_CAPACITY_RATIO - 1) / (HEAT_CAPACITY_RATIO * ENERGY)
    return conductance * share * (TEMPERATURE - temperature)


def effective_index(conductance: Any, pressure: Any, volume: Any, frequency: Any) -> Any:
    r"""Return the complex polytropic index of small changes of a volume [m^3] at a frequency [Hz], behind a shut valve.

    .. math::

        n = -\frac{V}{p} \frac{\delta p}{\delta V} = \frac{1 + i \omega \kappa \tau}{1 + i \omega \tau},
        \qquad \tau = \frac{p V}{(\kappa - 1) h A\, T_0}

    at an absolute pressure [Pa], with the conductance h A [W/K] of the wall: 1 for slow motion, kappa for fast motion,
    and a loss in between. The energy balance m c_v T' = h A (T0 - T) - p V', linearised.

    >>> n = effective_index(0.5, 6e5, 24e-6, 1.0)
    >>> round(float(n.real), 3), round(float(n.imag), 3)
    (1.282, 0.183)
    """
    rate = (HEAT_CAPACITY_RATIO - 1) * TEMPERATURE * conductance / (pressure * volume)
    circular = 2j * math.pi * frequency
    return (rate + HEAT_CAPACITY_RATIO * circular) / (rate + circular)


def temperature_rate(temperature: Any, pressure: Any, rate: Any, flow: Any, volume: Any, volume_rate: Any) -> Any:
    r"""Return the rate [K/s] of the temperature [K] of air whose absolute pressure [Pa] changes at a rate [Pa/s].

    .. math:: \dot T = \frac{T}{p V} (V \dot p + p \dot V - R T \dot m)

    The ideal gas law p V = m R T, differentiated, with the mass inflow [kg/s], the volume [m^3] and its rate [m^3/s].
    """
    gained = volume * rate + pressure * volume_rate - GAS_CONSTANT * temperature * flow
    return temperature * gained * (1 / (pressure * volume))
