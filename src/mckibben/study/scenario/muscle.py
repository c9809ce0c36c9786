"""Muscles in files: entries of the catalog, files of one's own, or all numbers."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    PlainSerializer,
    SerializationInfo,
    ValidationInfo,
    model_serializer,
    model_validator,
)
from pydantic_core import core_schema

from mckibben.component.schema import ComponentModel, model_of
from mckibben.config.document import read_document, to_text
from mckibben.config.fields import Title, read_path, write_path
from mckibben.config.model import ConfigModel, explicit_fields, fail_validation, parse_model, read_text, with_changes
from mckibben.errors import FileError, quoted, suggest
from mckibben.muscle import (
    ChouLaw,
    Domain,
    ForceCorrection,
    ForceLaw,
    MaxwellCreep,
    MaxwellSlip,
    Muscle,
    NoCreep,
    NoFriction,
    Specimen,
    corrected_law,
    scaled_law,
)
from mckibben.units import Strength

_ENDINGS = (".yaml", ".yml")


@dataclass(frozen=True)
class CatalogName:
    """Marks the name of a catalog entry of a kind."""

    kind: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def read(self, value: Any, others: Sequence[str] = ()) -> str:
        """The name, if the catalog has it or it is one of the others."""
        from mckibben import catalog

        known = [*catalog.names(self.kind), *others]
        if value not in known:
            what = {"geometries": "geometry"}.get(self.kind, self.kind.removesuffix("s"))
            fail_validation(f"the catalog has no {what} {quoted(value)}", suggest(str(value), known))
        return value


def read_law(value: Any, info: ValidationInfo) -> str | Path:
    """A law of the catalog, ``chou``, or the path of a fit."""
    if str(value).endswith(_ENDINGS):
        return read_path(value, info, ".yaml")
    return CatalogName("laws").read(value, others=("chou",))


def write_law(value: str | Path, info: SerializationInfo) -> str:
    """Text that `read_law` reads."""
    return write_path(value, info) if isinstance(value, Path) else value


Law = Annotated[str | Path, BeforeValidator(read_law), PlainSerializer(write_law, when_used="json")]


def build_law(named: str | Path, specimen: Specimen) -> ForceLaw:
    """A law of the catalog, that of a fit file, or Chou's law of a specimen."""
    if isinstance(named, Path):
        from mckibben import identification

        return identification.read_law(named)
    from mckibben import catalog

    return ChouLaw.of(specimen) if named == "chou" else catalog.law(named)


def entry_of(kind: str) -> Any:
    """The field ``from``, which names an entry of the catalog."""
    name: Any = Annotated[str, CatalogName(kind)]
    return name | None, Field(None, alias="from")


class CatalogPart(ComponentModel):
    """An entry of the catalog by name, with changes, or all numbers."""

    catalog_function: ClassVar[str]

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, value: Any) -> Any:
        return {"from": value} if isinstance(value, str) and value else value

    @model_serializer(mode="wrap", when_used="json")
    def _write(self, handler: Any) -> Any:
        written = handler(self)
        given = {key: value for key, value in written.items() if value is not None}
        return given["from"] if list(given) == ["from"] else written

    def build(self, *args: Any, **others: Any) -> Any:
        entry = self._entry()
        if entry is None:
            return super().build(*args, **others)
        changes = explicit_fields(self, "entry")
        for name, value in changes.items():
            if isinstance(value, ComponentModel):
                changes[name] = dataclasses.replace(getattr(entry, name), **explicit_fields(value))
        return dataclasses.replace(entry, **changes, **others)

    def effective(self, name: str) -> Any:
        entry = self._entry()
        return super().effective(name) if entry is None or getattr(self, name) is not None else getattr(entry, name)

    def _entry(self) -> Any:
        """The entry of the catalog; None without."""
        name = getattr(self, "entry", None)
        if name is None:
            return None
        from mckibben import catalog

        return getattr(catalog, self.catalog_function)(name)


def expanded(kind: type[ConfigModel], value: Any, info: ValidationInfo) -> Any:
    """A section whose ``from`` names a file: the content of the file, with the changes that the section gives."""
    section = {"from": value} if isinstance(value, str) else value
    named = section.get("from") if isinstance(section, dict) else None
    if not isinstance(named, str) or not named.endswith(_ENDINGS):
        return value
    path, outer = read_path(named, info, ".yaml"), info.context or {}
    files = (*outer.get("files", ()), path)
    if path in files[:-1]:
        fail_validation(f"{named} refers to itself", f"give the numbers in {named}")
    try:
        text = read_text(path, "a muscle", "docs/scenarios.md")
        keys = read_document(text).data or ()
        whole = kind is not SpecimenSpec or "specimen" not in keys
        if kind is MuscleSpec and "parameters" in keys:
            fail_validation(f"{named} is a fit, the law of a muscle", f"write {{specimen: ..., law: {named}}}")
        content: Any = parse_model(kind if whole else _Muscle, text, source=named, folder=path.parent, files=files)[0]
    except FileError as error:
        fail_validation(f"{named}: {'; '.join(map(str, error.problems[:5]))}", f"correct {named}")
    written = (content if whole else content.specimen).model_dump(
        mode="json", by_alias=True, context={"folder": outer.get("folder", Path())}
    )
    return with_changes(written, section)


class DomainSpec(model_of(Domain, optional=True)):
    """Permissible contraction and pressure; what is not given follows from the law."""


class SpecimenSpec(
    model_of(
        Specimen,
        optional=True,
        base=CatalogPart,
        entry=entry_of("specimens"),
        name=(Title | None, None),
        domain=DomainSpec,
    )
):
    """A specimen: an entry of the catalog by name, a file, or the numbers of `Specimen`.

    In text the name or path alone will do: ``specimen: DMSP-10-250`` or ``specimen: specimen.yaml``.
    """

    catalog_function = "specimen"

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, value: Any, info: ValidationInfo) -> Any:
        return expanded(SpecimenSpec, value, info)

    @model_validator(mode="after")
    def _complete(self) -> SpecimenSpec:
        missing = [key for key in ("name", "initial_length") if getattr(self, key) is None]
        if getattr(self, "entry", None) is None and missing:
            remedy = "give both, such as `{name: my muscle, initial_length: 250 mm}`, or a name of the catalog"
            fail_validation(f"lacks {' and '.join(missing)}", remedy)
        self.build()  # raises for a reversed domain
        return self


class _Muscle(ConfigModel):
    """The file of a muscle, of which only the specimen is read."""

    model_config = ConfigDict(extra="ignore")

    specimen: SpecimenSpec


class FrictionSpec(model_of(MaxwellSlip)):
    """Hysteresis and viscous friction of a muscle."""


class CreepSpec(model_of(MaxwellCreep)):
    """Creep of a muscle."""


class CorrectionSpec(model_of(ForceCorrection)):
    """Correction of a muscle's force, found by `mckibben calibrate`."""


class MuscleSpec(ConfigModel):
    """A specimen and its law (of the catalog, ``chou``, or the path of a fit file), or the path of a muscle's file.

    `strength` multiplies all forces of the law; `correction` is added to them.
    """

    specimen: SpecimenSpec
    law: Law
    strength: Strength | None = None
    correction: CorrectionSpec | None = None
    friction: FrictionSpec | None = None
    creep: CreepSpec | None = None

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, str) and value and not value.endswith(_ENDINGS):
            remedy = "name a file such as the muscle.yaml of `mckibben identify --out`, or give specimen and law"
            fail_validation(f"{quoted(value)} is no muscle's file", remedy)
        return expanded(cls, value, info)

    def build(self, law: ForceLaw | None = None) -> Muscle:
        """The muscle; with another law of the same kind in place of its own, if given."""
        specimen = self.specimen.build()
        law = build_law(self.law, specimen) if law is None else law
        if self.strength is not None:
            law = scaled_law(law, self.strength)
        return Muscle(
            specimen,
            law if self.correction is None else corrected_law(law, self.correction.build()),
            NoFriction() if self.friction is None else self.friction.build(),
            NoCreep() if self.creep is None else self.creep.build(),
        )


def read_specimen(path: str | os.PathLike[str]) -> Specimen:
    """The specimen of a file, of its own or that of a muscle; `ScenarioError` with all problems."""
    text = read_text(path, "a specimen", "docs/scenarios.md")
    source, folder = os.fspath(path), Path(path).parent
    if "specimen" in (read_document(text).data or ()):
        return parse_model(_Muscle, text, source=source, folder=folder)[0].specimen.build()
    return parse_model(SpecimenSpec, text, source=source, folder=folder)[0].build()


_HEAD = """\
# A muscle identified by mckibben, for scenarios and protocols: `muscle: muscle.yaml`, or with changes
# `muscle: {from: muscle.yaml, strength: 0.9}`. The specimen may also have initial_diameter and braid_angle (for the use
# of air, a simulated rig and Chou's law), rated_force (no limit without it), and a domain, such as
# `domain: {contraction_max: 25 %, pressure_max: 8 bar}`; without one, 0 bar and the range of the law's points limit it.
"""


def muscle_text(law: str, *, specimen: str, initial_length: float | None, friction: MaxwellSlip | None = None) -> str:
    """Text of a muscle's file; empty if neither the catalog nor the data give the initial length [m]."""
    from mckibben import catalog

    name = specimen or "my muscle"
    numbers: dict[str, Any] = {"name": name, "initial_length": initial_length}
    if name in catalog.names("specimens"):
        same = initial_length in (None, float(catalog.specimen(name).initial_length))
        numbers = {"from": name} if same else {"from": name, "initial_length": initial_length}
    elif initial_length is None:
        return ""
    data = {"specimen": SpecimenSpec.model_validate(numbers).model_dump(mode="json", by_alias=True), "law": law}
    if friction is not None:
        rows = {key: getattr(friction, key) for key in FrictionSpec.model_fields}
        rows = {key: value for key, value in rows.items() if value is not None}
        data["friction"] = FrictionSpec.model_validate(rows).model_dump(mode="json", by_alias=True)
    return _HEAD + to_text(data)
