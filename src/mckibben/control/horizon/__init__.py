r"""The best way to go over a horizon, within limits: control-limited differential dynamic programming of a joint.

The joint is followed in stages of one length by what matters of it, errors against the wish: those of angle, velocity,
acceleration and stiffness, :math:`x = (e, \dot e, a, s)`. What is chosen are the two pressures :math:`w` at the end of
each stage. They give acceleration and stiffness there, :math:`v = (a', s')`, by a map that is affine in them and bends
with the angle; all else is linear and does not change from stage to stage:

.. math::

    v = M(\theta)\,w + c(\theta, \omega), \quad
    e' = e + h \dot e + \tfrac{h^2}{2}((1 - \mu_2) a + \mu_2 a'), \quad \dot e' = \dot e + h ((1 - \mu_1) a + \mu_1 a')

    J = \sum \frac{h}{2} \Big(e'^2 + d(d - 2)(\dot e'^2 + a'^2) + \Big(\frac{a' - a}{h}\Big)^2
        + s'^2 + \rho \Big(\frac{s' - s}{h}\Big)^2\Big) + \text{what it costs from then on without limits}

Without limits and with short stages the angle is a triple integrator with the poles of :math:`z^3 + d z^2 + d z + 1`,
and the stiffness an integrator with its one pole, each apart from the other. What such cost from a state on is known in
closed form; added at the end, it makes the length of the horizon tell where limits count, not how fast the loop is.

Everything here has no unit: time counts in 1/omega_c of the loop, errors in what the user holds for equal ones.
"""

from mckibben.control.horizon.outlook import Bent, Outlook
from mckibben.control.horizon.planning import Move, planned
from mckibben.control.horizon.policy import Policy, later, steady

__all__ = ["Bent", "Move", "Outlook", "Policy", "later", "planned", "steady"]
