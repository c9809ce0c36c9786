"""Figure of a calibration: stiffness before and after, over angle and along the recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from mckibben.calibration import JointCalibration, JointRecording
from mckibben.report.style import BLACK, BLUE, DOUBLE, ORANGE, blank, draw_band, legend_above, letter, styled
from mckibben.units import deg

_STRIDE = 100  # samples


@styled
def calibration(found: JointCalibration, recordings: Sequence[JointRecording]) -> Figure:
    """Stiffness by the model before and after, with 95 % intervals, over time of the recordings; and their change."""
    figure = blank(DOUBLE, 2.9)
    over_time, over_angle = figure.subplots(1, 2, width_ratios=(2, 1))
    start = 0.0
    for number, one in enumerate(recordings):
        angle, pressures = one.angle[::_STRIDE], one.pressures[::_STRIDE]
        pair = pressures[:, 0], pressures[:, 1]
        before, wide = found.prior_stiffness(angle, pair)
        after, narrow = found.stiffness(angle, pair)
        time = start + one.time[::_STRIDE] - one.time[0]
        start = float(time[-1])
        over_time.axvline(start, color=BLACK, linewidth=0.6)
        names = (("model before", before, wide, ORANGE), ("calibrated", after, narrow, BLUE))
        for name, value, deviation, colour in names:
            label = name if number == 0 else None
            over_time.plot(time, value, color=colour, linewidth=1.0, label=label)
            band = f"{name}, 95 % interval" if number == 0 else None
            draw_band(
                over_time, time, value - 1.96 * deviation, value + 1.96 * deviation, color=colour, alpha=0.2, label=band
            )
        order = np.argsort(angle)
        over_angle.plot(angle[order] / deg, (after - before)[order], ".", color=BLUE, markersize=2)
    letter(over_time, 0, "stiffness along the recordings")
    letter(over_angle, 1, "calibrated less before")
    over_time.set(xlabel="time [s]", ylabel="stiffness [N·m/rad]")
    over_angle.set(xlabel="joint angle [deg]", ylabel="difference [N·m/rad]")
    over_angle.axhline(0.0, color=BLACK, linewidth=0.6)
    legend_above(figure, over_time, columns=2)
    return figure
