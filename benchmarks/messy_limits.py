"""Kinds of files whose numbers are wrong although nothing in the file says so; counted apart, by ``--limits``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from messy_kinds import cells, csv, limit, text
from messy_notations import scaled


@limit
def digit_lost_in_transmission(p, rng):
    rows = cells(p)
    at = 4
    rows[at][2] = rows[at][2][1:] if float(rows[at][2][1:] or 0) else rows[at][2]
    return csv(p.without([at]), text(rows))


@limit
def pressure_delayed_by_rows(p, rng):
    return csv(p, text(cells(replace(p, pressure=np.roll(p.pressure, 2)))))


@limit
def contraction_sorted(p, rng):
    return csv(p, text(cells(replace(p, contraction=np.sort(p.contraction)))))


@limit
def force_copied_down(p, rng):
    """Excel fill: last value copied over some rows."""
    f = p.force.copy()
    f[5:9] = f[5]
    return csv(p, text(cells(replace(p, force=f))))


@limit
def contraction_abs_value(p, rng):
    q = replace(p, contraction=(p.contraction - 2).round(2))
    return csv(q, text(cells(replace(q, contraction=np.abs(q.contraction)))))


@limit
def pressure_rounded_to_bar(p, rng):
    return csv(p, text(cells(replace(p, pressure=np.floor(p.pressure)))))


@limit
def psi_named_bar_low(p, rng):
    """Low pressures: 0.1 to 0.7 bar in psi named bar."""
    q = replace(p, pressure=(p.pressure / 10).round(3), force=(p.force / 10).round(3))
    return csv(q, text(scaled(q, 0, 14.5037738)))


@limit
def pounds_named_newtons(p, rng):
    return csv(p, text(scaled(p, 2, 1 / 4.448)))
