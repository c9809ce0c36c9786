"""Figures and the HTML report; the only place that imports matplotlib. Drawing takes numbers and returns figures."""

from mckibben.report.animation import animate
from mckibben.report.benchmark import benchmark_air, benchmark_errors, benchmark_references, write_benchmark
from mckibben.report.diagram import draw_control_loop
from mckibben.report.drawing import draw_joint
from mckibben.report.figures import ReportFigure, figures
from mckibben.report.identification import force_bands, loops, profile_likelihood, ranking, relaxation
from mckibben.report.joint import (
    attainable_stiffness,
    calibration,
    design,
    envelope,
    stiffness,
    torque_stiffness_map,
)
from mckibben.report.leg import foot_ellipses, jump_traces, landing_forces, write_jump, write_landing
from mckibben.report.leg_animation import render_leg
from mckibben.report.leg_player import leg_player
from mckibben.report.muscle import isobaric, isobaric_curves, law_comparison, measured_muscles
from mckibben.report.page import write_report
from mckibben.report.study import planned, sweep, tuning
from mckibben.report.style import house_style, save
from mckibben.report.tracking import (
    control_results,
    controller_comparison,
    error_curves,
    gain_histories,
    margins,
    tracking,
)

__all__ = [
    "ReportFigure",
    "animate",
    "attainable_stiffness",
    "benchmark_air",
    "benchmark_errors",
    "benchmark_references",
    "calibration",
    "control_results",
    "controller_comparison",
    "design",
    "draw_control_loop",
    "draw_joint",
    "envelope",
    "error_curves",
    "figures",
    "foot_ellipses",
    "force_bands",
    "gain_histories",
    "house_style",
    "isobaric",
    "isobaric_curves",
    "jump_traces",
    "landing_forces",
    "law_comparison",
    "leg_player",
    "loops",
    "margins",
    "measured_muscles",
    "planned",
    "profile_likelihood",
    "ranking",
    "relaxation",
    "render_leg",
    "save",
    "stiffness",
    "sweep",
    "torque_stiffness_map",
    "tracking",
    "tuning",
    "write_benchmark",
    "write_jump",
    "write_landing",
    "write_report",
]
