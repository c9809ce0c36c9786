"""Figures and the HTML report; the only place that imports matplotlib. Drawing takes numbers and returns figures."""

from mckibben.report.comparison import controller_comparison, gain_histories
from mckibben.report.contest import contest_air, contest_errors, contest_wishes, write_contest
from mckibben.report.creep import relaxation
from mckibben.report.figures import ReportFigure, figures
from mckibben.report.html import write_report
from mckibben.report.hysteresis import loops
from mckibben.report.joint import attainable_stiffness, torque_stiffness_map
from mckibben.report.muscle import isobaric, isobaric_curves, law_comparison, measured_muscles
from mckibben.report.plan import planned
from mckibben.report.ranking import ranking
from mckibben.report.style import house_style, save
from mckibben.report.sweep import sweep
from mckibben.report.tracking import control_results, tracking
from mckibben.report.tracking_errors import error_curves
from mckibben.report.tuning import tuning
from mckibben.report.uncertainty import force_bands, profile_likelihood

__all__ = [
    "ReportFigure",
    "attainable_stiffness",
    "contest_air",
    "contest_errors",
    "contest_wishes",
    "control_results",
    "controller_comparison",
    "error_curves",
    "figures",
    "force_bands",
    "gain_histories",
    "house_style",
    "isobaric",
    "isobaric_curves",
    "law_comparison",
    "loops",
    "measured_muscles",
    "planned",
    "profile_likelihood",
    "ranking",
    "relaxation",
    "save",
    "sweep",
    "torque_stiffness_map",
    "tracking",
    "tuning",
    "write_contest",
    "write_report",
]
