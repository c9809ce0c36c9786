"""Entries of the catalog as objects in SI."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import MISSING
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from mckibben.actuator import Actuator, AirValve
from mckibben.catalog.publications import FOLDER, find, names
from mckibben.component.base import field_quantities
from mckibben.component.calls import checked_call
from mckibben.component.classes import Catalog, find_class, register
from mckibben.component.schema import section_of
from mckibben.errors import ParameterError
from mckibben.joint import AntagonisticJoint, Geometry, KneeGeometry, KneeLoad, Load
from mckibben.muscle import LAWS, Domain, ForceLaw, Muscle, Specimen
from mckibben.muscle.air import nominal_conductance
from mckibben.units import quantity

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset


@checked_call
@functools.cache
def specimen(name: str) -> Specimen:
    """Return a specimen such as "MAS-10-180N-AA-MC-O"; `NotInCatalogError` with a suggestion for other names.

    >>> specimen("MAS-10-180N-AA-MC-O").initial_length
    0.18
    """
    entry, _ = find("specimens", name)
    return Specimen(
        name=name,
        initial_length=quantity(entry["initial_length"], "m"),
        initial_diameter=quantity(entry["initial_diameter"], "m"),
        braid_angle=quantity(entry["braid_angle"], "rad"),
        rated_force=quantity(entry["rated_force"], "N"),
        domain=_domain(entry),
    )


@checked_call
@functools.cache
def law(name: str) -> ForceLaw:
    """Return a published parameter set as a law in SI, with the domain of its data.

    "lei-mas-10-180n" is Eq. 3 of the paper: 584.7 N at the initial length and 6 bar.

    >>> round(float(law("lei-mas-10-180n").force(0.0, 6e5)), 1)
    584.7
    """
    entry, _ = find("laws", name)
    law_type = LAWS[entry["type"]]
    values = {p.name: quantity(entry["parameters"][p.name], p.unit) for p in law_type.parameters()}
    return law_type(**values, domain=_domain(entry))


@checked_call
def dataset(name: str) -> IsobaricDataset:
    """Return a measured table such as "dmsp-10-250-martens2017", with its source as an attribute.

    >>> len(dataset("dmsp-10-250-martens2017"))
    85
    """
    from mckibben.dataset import IsobaricDataset, read_dataset  # xarray: only where data is read

    entry, source = find("datasets", name)
    length = entry.get("initial_length")
    with resources.as_file(FOLDER / "tables" / entry["table"]) as path:
        read = read_dataset(path, initial_length=quantity(length, "m") if length else None, specimen=entry["specimen"])
    table = read.table.assign_attrs(source=source)
    del table.attrs["columns_read"]
    return IsobaricDataset(table)


@checked_call
@functools.cache
def geometry(name: str) -> KneeGeometry:
    """Return the geometry of a published joint, such as "knee-table-2" (Eqs. 4 and 5 with Table 2).

    >>> geometry("knee-table-2").joint_radius
    0.03
    """
    return KneeGeometry(**_quantities(KneeGeometry, find("geometries", name)[0]))


@checked_call
@functools.cache
def load(name: str) -> KneeLoad:
    """Return the load of a published joint, such as "knee-table-2" (Eq. 6 with Table 2).

    >>> round(float(load("knee-table-2").total_inertia), 3)
    0.045
    """
    return KneeLoad(**_quantities(KneeLoad, find("loads", name)[0]))


@checked_call
@functools.cache
def joint(name: str) -> AntagonisticJoint:
    """Return a published joint with its muscles, such as "knee-table-2" with two muscles of Eq. 3.

    Torque [N*m] at 0 deg, 3 bar against 6 bar (Eq. 7):

    >>> round(float(joint("knee-table-2").torque(0.0, (3e5, 6e5))), 3)
    8.624
    """
    entry, _ = find("joints", name)
    muscle = Muscle(specimen(entry["specimen"]), law(entry["law"]))
    return AntagonisticJoint(geometry(entry["geometry"]), muscle, muscle)


@checked_call
def valve(name: str, **others: Any) -> AirValve:
    """Return a valve such as "festo-mh1"; supply [Pa] and switching period [s] complete its data sheet.

    Raises `ParameterError` for a field that neither the data sheet nor the arguments give.

    >>> from mckibben.units import bar, ms
    >>> valve("festo-mh1", supply=7 * bar, period=20 * ms)
    SwitchingValves(...)
    """
    section = valve_section(name)
    kind = cast(Any, find_class(Actuator, section["class"]))
    fields = section_of(kind, partial=True).model_validate(section)
    values = {key: getattr(fields, key) for key in fields.model_fields_set - {"class_"}} | others
    required = (field.name for field in dataclasses.fields(kind) if field.default is field.default_factory is MISSING)
    if missing := [field for field in required if field not in values]:
        message = f"{name}: the data sheet does not determine {' and '.join(missing)}"
        remedy = f"give {' and '.join(f'{field}=...' for field in missing)}, in SI"
        raise ParameterError(message, field=missing[0], remedy=remedy)
    return kind(**values)


def valve_section(name: str) -> dict[str, Any]:
    """Return the entries that `from` adds to a scenario's `valve` section, a flow converted to a conductance."""
    section = {key: value for key, value in find("valves", name)[0].items() if key != "where"}
    if "nominal_flow" in section:
        flow = quantity(section.pop("nominal_flow"), "m^3/s")
        section["conductance"] = nominal_conductance(flow, quantity(section["critical_ratio"], "1"))
    return section


def leg_section(name: str) -> dict[str, Any]:
    """Return the entries that `from` adds to a `robot` section of a file, in the units of the source."""
    return {key: value for key, value in find("legs", name)[0].items() if key != "where"}


def _quantities(kind: type, entry: dict[str, Any]) -> dict[str, Any]:
    """Fields of a class with their SI units."""
    return {name: mark.read(entry[name]) for name, mark in field_quantities(kind).items()}


def _domain(entry: dict[str, Any]) -> Domain:
    contraction, pressure = entry["contraction"], entry["pressure"]
    return Domain(*(quantity(text, "1") for text in contraction), *(quantity(text, "Pa") for text in pressure))


def _read_law(path: Path) -> ForceLaw:
    from mckibben.identification import read_law

    return read_law(path)


for _base, _noun, _kind, _entry, _read in (
    (Specimen, "specimen", "specimens", specimen, None),
    (ForceLaw, "law", "laws", law, _read_law),
    (Geometry, "geometry", "geometries", geometry, None),
    (Load, "load", "loads", load, None),
    (Actuator, "valve", "valves", valve_section, None),
):
    register(_base, Catalog(_noun, functools.partial(names, _kind), _entry, _read))
