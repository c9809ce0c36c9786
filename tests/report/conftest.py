"""A small reproduction: real parts, few of them. Tuned gains are moderate ones doubled, the seeds' spread invented."""

import dataclasses
from html.parser import HTMLParser

import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.paper import Reproduction
from mckibben.paper.claims import evaluate_claims
from mckibben.paper.identification import run_identification, run_joint
from mckibben.paper.settings import SETTINGS, StiffnessReference, bp_scenario, gains_of, pid_scenario
from mckibben.paper.tracking import (
    BP,
    DOUBLED_PID,
    FREE_TUNED_BP,
    PID,
    TUNED_BP,
    TUNED_PID,
    ControllerRun,
    Coupling,
    Tracking,
)
from mckibben.scenario import list_parameters, run_scenario, with_values
from mckibben.simulation import Metrics
from mckibben.study.tune import TuneResult

SEEDS = 3


def _spread(run):
    """Metrics over seeds: the run's own, some larger, and one that never settles."""
    measured = run.result.metrics
    spread = {name: jnp.asarray(value * np.array([1.0, 1.1, 1.3])) for name, value in measured.items()}
    spread["stiffness_settling"] = spread["stiffness_settling"].at[-1].set(jnp.nan)
    return Metrics(**spread)


class Page(HTMLParser):
    """Tags with their attributes, those that are open, and the cells of all tables of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.open, self.cells = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br", "link", "input"):
            self.open.append(tag)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if {"td", "th"} & set(self.open):
            self.cells[-1] = " ".join((self.cells[-1] + data).split())

    @property
    def is_self_contained(self):
        """No part comes from elsewhere."""
        starts = {"src": "data:image/", "href": "#"}
        links = [(value, starts[name]) for _, a in self.tags for name, value in a.items() if name in starts]
        active = {"script", "link", "iframe", "object"} & {tag for tag, _ in self.tags}
        return not active and all(value.startswith(start) for value, start in links)


@pytest.fixture(scope="session")
def page_of():
    """Parser of pages."""
    return Page


@pytest.fixture(scope="session")
def reproduction():
    runs, tuned, coupling = {}, {}, {}
    for setting in SETTINGS:
        moderate = pid_scenario(setting, StiffnessReference.CONSTANT)
        doubled = {a.name: 2 * a.nominal for a in list_parameters(moderate) if a.name.endswith(("kp", "ki"))}
        found = with_values(moderate, doubled)
        tuned[setting.key] = TuneResult(
            doubled, (moderate,), (found,), 5.0, 80.0, 100, at_bound=("controller.position.ki",)
        )
        coupling[setting.key] = Coupling(1e-3, 0.1, 1e-14)
        gains = gains_of(found)
        double = {name: 2 * gain if "position" in name else gain for name, gain in gains_of(moderate).items()}
        for wish in StiffnessReference:
            for name, given in ((PID, None), (DOUBLED_PID, double), (TUNED_PID, gains)):
                scenario = pid_scenario(setting, wish, given, name=name)
                runs[setting.key, wish, name] = ControllerRun(scenario, run_scenario(scenario), None)
            for name, given, ratio in ((BP, None, 2.0), (TUNED_BP, gains, 1.1), (FREE_TUNED_BP, gains, 2.0)):
                scenario = bp_scenario(setting, wish, given, gain_ratio=ratio, name=name)
                run = ControllerRun(scenario, run_scenario(scenario), None)
                runs[setting.key, wish, name] = dataclasses.replace(run, seeds=_spread(run))
    identification, joint = run_identification(repeats=2), run_joint(resolution=81)
    tracking = Tracking(runs, tuned, coupling, SEEDS)
    claims = evaluate_claims(identification, joint, tracking)
    return Reproduction(identification, joint, tracking, claims, True, 12.3)


@pytest.fixture(scope="session")
def written(reproduction, tmp_path_factory):
    """A written report: its folder, and the figures that it has, by name."""
    from mckibben.report import figures, write_report

    folder, drawn = tmp_path_factory.mktemp("report"), list(figures(reproduction))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mckibben.report.page.figures", lambda _: drawn)
        write_report(reproduction, folder)
    return folder, {figure.name: figure for figure in drawn}


@pytest.fixture(scope="session")
def drawn(written):
    """All figures of the report, by name."""
    return written[1]


@pytest.fixture(scope="session")
def page(written):
    """The folder of a written report."""
    return written[0]
