import re
from importlib import resources

import jax
import numpy as np
import pytest
from ruamel.yaml import YAML

from mckibben import catalog
from mckibben.catalog.entries import valve_section
from mckibben.errors import NotInCatalogError, ParameterError
from mckibben.muscle import ExponentialLaw
from mckibben.units import factor

OPEN = {"FlowValve": {}, "SwitchingValves": {"period": 0.02}, "PressureRegulator": {"time_constant": 0.03}}


def load_valve(name):
    section = valve_section(name)
    return catalog.valve(name, supply=7e5, **{k: v for k, v in OPEN[section["class"]].items() if k not in section})


LOADERS = {
    "specimens": catalog.specimen,
    "laws": catalog.law,
    "datasets": catalog.dataset,
    "geometries": catalog.geometry,
    "loads": catalog.load,
    "joints": catalog.joint,
    "valves": load_valve,
}
KINDS = tuple(LOADERS)
ENTRIES = [(kind, name) for kind in KINDS for name in catalog.names(kind)]


@pytest.mark.parametrize(("kind", "name"), ENTRIES)
def test_every_entry_loads_and_is_cited(kind, name):
    assert LOADERS[kind](name) is not None
    source = catalog.cite(name)
    assert len(source.splitlines()[0]) > 20
    assert re.search(r"\(.+\)", source.splitlines()[1])


@pytest.mark.parametrize(("kind", "name"), [e for e in ENTRIES if e[0] != "datasets"])
def test_every_number_of_every_entry_is_finite(kind, name):
    assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(LOADERS[kind](name)))


def test_the_coefficients_of_equation_3_are_the_printed_ones_once_they_are_in_bar_and_percent():
    law = catalog.law("lei-mas-10-180n")
    assert isinstance(law, ExponentialLaw)
    printed = {"a1": -245.8, "a2": 109, "b1": 3.216, "b2": -3.442, "c1": 255.6, "c2": -13.18, "decay": 0.3}
    shown = {p.name: float(getattr(law, p.name)) / factor(p.shown, p.unit) for p in law.parameters()}
    assert shown == pytest.approx(printed, rel=1e-14)
    assert law.decay == pytest.approx(30.0, rel=1e-15)
    assert law.b2 == pytest.approx(-3.442 * 100 / 1e5, rel=1e-14)


def test_the_specimen_is_the_papers():
    specimen = catalog.specimen("MAS-10-180N-AA-MC-O")
    assert specimen.name == "MAS-10-180N-AA-MC-O"
    assert (specimen.initial_length, specimen.initial_diameter) == pytest.approx((0.18, 0.01), rel=1e-15)
    assert np.degrees(specimen.braid_angle) == pytest.approx(25, rel=1e-15)
    assert specimen.rated_force == 630.0
    box = specimen.domain
    assert [box.contraction_min, box.contraction_max, box.pressure_min, box.pressure_max] == pytest.approx(
        [-0.03, 0.25, 0.0, 8e5]
    )


def test_the_knee_is_table_2():
    geometry, load = catalog.geometry("knee-table-2"), catalog.load("knee-table-2")
    assert (geometry.joint_length, geometry.joint_radius, geometry.connector_length) == (0.37, 0.03, 0.19)
    assert (load.mass1, load.mass2, load.distance1, load.distance2) == (0.5, 0.5, 0.1, 0.2)
    assert (load.inertia, load.damping, load.gravity) == (0.02, 0.015, 9.81)
    assert load.hanging_angle == pytest.approx(np.pi / 6, rel=1e-15)
    assert load.hanging is True
    joint = catalog.joint("knee-table-2")
    assert joint.geometry == geometry
    assert joint.muscle1.specimen.name == joint.muscle2.specimen.name == "MAS-10-180N-AA-MC-O"


def test_the_measured_map_has_17_pressures_5_lengths_and_40_taut_points():
    data = catalog.dataset("dmsp-10-250-martens2017")
    assert len(data) == 85
    assert np.unique(data.pressure).size == 17
    assert np.unique(np.round(data.contraction, 6)).size == 5
    assert int(np.sum(np.asarray(data.force) > 0)) == 40
    assert len(data.taut) == 40


def test_a_name_like_no_other_gets_the_list():
    with pytest.raises(NotInCatalogError, match="known are lei-mas-10-180n"):
        catalog.law("zzz")
    with pytest.raises(NotInCatalogError, match="geometries"):
        catalog.names("muscles")


def test_all_files_of_the_catalog_are_read():
    files = [f for f in resources.files("mckibben.catalog").iterdir() if f.name.endswith(".yaml")]
    assert files
    written = [
        n for f in files for kind, part in YAML(typ="safe").load(f.read_text()).items() if kind in KINDS for n in part
    ]
    assert sorted(written) == sorted(name for _, name in ENTRIES)


def test_a_valve_has_the_numbers_of_its_data_sheet():
    """The printed C and b give about the printed standard nominal flow, 1400 l/min from 6 to 5 bar."""
    printed = catalog.valve("festo-mpye-5-1-4", supply=7e5)
    ratio = (6.01325 / 7.01325 - printed.critical_ratio) / (1 - printed.critical_ratio)
    flow = printed.conductance * 7.01325e5 * np.sqrt(1 - ratio**2) * 60e3
    assert flow == pytest.approx(1400, rel=0.1)
    assert 1 / (2 * np.pi * printed.spool_lag) == pytest.approx(80, rel=0.01)
    small, large = (catalog.valve(f"festo-mpye-5-{size}", supply=7e5) for size in ("m5", "1-8-hf"))
    assert large.conductance == pytest.approx(7 * small.conductance)


def test_what_the_data_sheet_of_a_valve_leaves_open_is_named():
    with pytest.raises(ParameterError) as refused:
        catalog.valve("festo-mh1")
    assert refused.value.field == "supply"
    assert "period" in str(refused.value)
