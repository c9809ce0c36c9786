"""Components in files: any class of a base by `class`, with units, checks by line, and text that reads back.

A field of a document, or of a component, that holds a component is marked with `Part`. Its section names the class, by
name or `short_name`, with the key ``class`` (the base's `default_class` otherwise), and gives the fields of the class.
Instead of a section, or as its key ``from``, a file may give the name of a catalog entry or the path of a file; the
other keys of the section are then changes to it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import functools
import inspect
import warnings
from collections import ChainMap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin

from pydantic import BeforeValidator, Field, GetCoreSchemaHandler, TypeAdapter, create_model
from pydantic_core import PydanticSerializationError, ValidationError, core_schema

from mckibben.component.base import (
    Checked,
    Component,
    Inherited,
    Units,
    field_hints,
    field_quantities,
    member_of,
    plain,
    same,
)
from mckibben.component.classes import (
    catalog_of,
    classes_of,
    default_class,
    find_class,
    is_abstract,
    name_in_files,
    short_key,
)
from mckibben.component.extensions import load_installed
from mckibben.config.document import read_document, to_text
from mckibben.config.fields import FilePath, Flag, Number, OneOf, Title, read_path, relative_path
from mckibben.config.model import ConfigModel, fail_validation, located_below, parse_text, read_text
from mckibben.errors import FileError, McKibbenError, closest, described, quoted, suggest, with_article
from mckibben.units import SYMBOLS, BoundedInt, Quantity

C = TypeVar("C")

Scope = Mapping[str, Any]
"""Fields around a component that is read, the nearest first."""

ENDINGS = (".yaml", ".yml")
"""Endings of files that hold a component."""


class Section(ConfigModel):
    """Fields of one class in a file; made by `section_of`."""

    class_: Annotated[Any, Field(alias="class")] = None
    from_: Annotated[Any, Field(alias="from")] = None


@functools.cache
def section_of(runtime: type, units: Units = Units(), *, partial: bool = False) -> type[Section]:  # noqa: B008
    """Return the model of a class in files; in a `partial` one no field is required."""
    declared, fields = declared_fields(runtime), {}
    known = forms(runtime, units)
    aliased = {name for names in getattr(runtime, "aliases", {}).values() for name in names}
    for name, form in known.items():
        field = declared[name]
        has_default = not field.default is field.default_factory is dataclasses.MISSING
        if partial or has_default or name in aliased or inherited_from(runtime, name) is not None:
            optional = form | None
            if inherited_from(runtime, name) is not None and part_of(form) is None:
                optional = Annotated[optional, BeforeValidator(lambda value: None if value == "none" else value)]
            fields[name] = optional, None
        else:
            fields[name] = form, ...
    fields |= {alias: (known[names[0]] | None, None) for alias, names in getattr(runtime, "aliases", {}).items()}
    with warnings.catch_warnings(action="ignore"):  # a field may have the name of a method of pydantic
        model = cast(Any, create_model(f"{runtime.__name__}Section", __base__=Section, **fields))
    model.renamed = getattr(runtime, "renamed", {})
    return model


@functools.cache
def declared_fields(runtime: type) -> dict[str, dataclasses.Field]:
    """Return the fields that the constructor of a class takes, by name."""
    taken = inspect.signature(runtime).parameters
    return {one.name: one for one in dataclasses.fields(cast(Any, runtime)) if one.name in taken}


@functools.cache
def forms(runtime: type, units: Units = Units()) -> dict[str, Any]:  # noqa: B008
    """Return the annotation of each field of a class that can appear in a file."""
    hints, found = field_hints(runtime), {}
    for name in declared_fields(runtime):
        form = _form(hints.get(name), units)
        if form is None and hints.get(name) is float:
            form = Annotated[float, getattr(runtime, "unit_of", _no_unit)(name) or Number()]
        if form is not None:
            found[name] = form
    return found


@functools.cache
def _keys(kind: type) -> frozenset[str]:
    """Keys of a section of a class."""
    others = (*getattr(kind, "aliases", {}), *getattr(kind, "renamed", {}))
    return frozenset((*forms(kind), *symbolic_fields(kind), *others))


def symbolic_fields(kind: type) -> list[str]:
    """Return the fields of a class whose unit depends on where it is."""
    marks = field_quantities(kind)
    return [name for name in declared_fields(kind) if name in marks and marks[name].unit in SYMBOLS]


def _no_unit(_: str) -> None:
    """Return no unit, for classes that are not components."""


def part_of(form: Any) -> Part | None:
    """Return the mark of a field that holds a component, or a list of them."""
    marks = (*getattr(form, "__metadata__", ()), *(mark for one in get_args(form) for mark in _marks(one)))
    return next((mark for mark in marks if isinstance(mark, Part)), None)


@functools.cache
def inherited_from(runtime: type, name: str) -> Inherited | None:
    """Return the mark of a field that takes its value from around the component if it is not given."""
    return next((mark for mark in _marks(field_hints(runtime)[name]) if isinstance(mark, Inherited)), None)


def _marks(hint: Any) -> tuple[Any, ...]:
    """Marks of a type, also of an optional one."""
    own = getattr(hint, "__metadata__", ())
    union = get_args(hint) if get_origin(hint) in (Union, UnionType) else ()
    return (*own, *(mark for one in union for mark in _marks(one)))


def _form(hint: Any, units: Units) -> Any:
    """Annotation of a field in files; None for a field that cannot appear there."""
    if get_origin(hint) in (Union, UnionType):
        found = [form for one in get_args(hint) if (form := _form(one, units)) is not None]
        return found[0] if found else None
    if get_origin(hint) is Literal:
        return Annotated[str, OneOf(tuple(word for word in get_args(hint) if word))]
    if get_origin(hint) in (tuple, Sequence):
        inner = _form(get_args(hint)[0], units)
        return None if inner is None else tuple[inner, ...]
    if get_origin(hint) is Annotated:
        base, *marks = get_args(hint)
        mark = next((one for one in marks if isinstance(one, Quantity | BoundedInt)), None)
        if isinstance(mark, Quantity) and mark.unit in SYMBOLS:
            quantity = units.get(mark.unit)
            return None if quantity is None else Annotated[float, quantity]
        if mark is not None:
            return Annotated[base, mark]
        return _form(base, next((one for one in marks if isinstance(one, Units)), units))
    if not isinstance(hint, type):
        return None
    if issubclass(hint, Component | Checked):
        return Annotated[Any, Part(hint, units)]
    if issubclass(hint, enum.Enum):
        return Annotated[str, OneOf(tuple(member.name.lower() for member in hint))]
    return {bool: Flag, str: Title, Path: FilePath}.get(hint)


@dataclass(frozen=True)
class Part:
    """Marks a section of a file that holds a component of a base class; `units` are those of its symbolic fields."""

    base: type
    units: Units = Units()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.with_info_plain_validator_function(
            self.read, serialization=core_schema.plain_serializer_function_ser_schema(self._written, info_arg=True)
        )

    def _written(self, value: Any, info: Any) -> Any:
        return None if value is None else write(value, self, folder=(info.context or {}).get("folder") or Path())

    def read(self, value: Any, info: Any) -> Any:
        """Return the component of a section."""
        if value is None or isinstance(value, self.base):
            return value
        context = dict(info.context or {})
        changed, name = context.pop("changed", None), info.field_name or ""
        given = {key: one for key, one in (info.data or {}).items() if one is not None}
        scope: Scope = ChainMap({"key": name}, given, *context.get("scope", ()))
        around = getattr(changed, getattr(changed, "aliases", {}).get(name, (name,))[0], None)
        written, value = value, self.base.from_file(value)
        below = short_key(written, value)
        if isinstance(value, str) and value:
            if find_class(self.base, value) is not None:
                value = {"class": value}
            elif value == "none":
                return None
            else:
                value = {"from": value}
        if not isinstance(value, dict):
            fail_validation(*self._expected(value), value=value)
        if isinstance(value.get("from"), str) and find_class(self.base, value["from"]) is not None:
            value = {"class": value["from"], **{key: one for key, one in value.items() if key != "from"}}
        section = {key: one for key, one in value.items() if key != "from"}
        if "from" in value:
            if not isinstance(value["from"], str):
                fail_validation(f"{quoted(value['from'])} is not the name of {self._noun}", "give a name or a path")
            around = self._from_source(value["from"], context, scope, info)
            if isinstance(around, dict):  # an entry that lacks fields
                section, around = {**around, **section}, None
            elif not section:
                return around
        elif "class" in value or not isinstance(around, self.base):
            around = None
        fits = around is not None and "class" not in section and set(section) <= _keys(type(around))
        kind = type(around) if fits else self.class_for(section)
        if type(around) is not kind:
            around = None
        model = section_of(kind, self.units, partial=around is not None)
        context |= {"scope": scope.maps if isinstance(scope, ChainMap) else (scope,), "changed": around}
        try:
            read = model.model_validate(section, context=context)
        except ValidationError as error:
            raise located_below(error, below, alone=bool(below) and not isinstance(written[below[0]], dict)) from None
        fields = {name: getattr(read, name) for name in read.model_fields_set - {"class_"}}
        for alias, names in getattr(kind, "aliases", {}).items():
            if alias not in fields:
                continue
            if both := [name for name in names if name in fields]:
                remedy = f"give {alias}, or {' and '.join(names)}"
                fail_validation(f"has {alias} in addition to {' and '.join(both)}", remedy)
            fields |= dict.fromkeys(names, fields.pop(alias))
        fields = {name: member_of(kind, name, one) for name, one in fields.items()}
        return build(kind, fields, scope) if around is None else replaced(around, fields)

    def _from_source(self, name: str, context: dict[str, Any], scope: Scope, info: Any) -> Any:
        """Component of a catalog entry or a file."""
        catalog = catalog_of(self.base)
        if not name.endswith(ENDINGS):
            classes = classes_of(self.base) if is_abstract(self.base) else ()
            known = [*(catalog.names() if catalog else ()), *classes]
            if catalog is None or name not in catalog.names():
                remedy = suggest(name, known) if known else self._expected(name)[1]
                fail_validation(f"{quoted(name)} is not the name of {self._noun}", remedy, value=name)
            found = catalog.entry(name)
        else:
            path = read_path(name, info, ".yaml")
            files = (*context.get("files", ()), path)
            if path in files[:-1]:
                fail_validation(f"{name} refers to itself", f"give the numbers in {name}")
            try:
                if catalog is not None and catalog.read is not None:
                    found = catalog.read(path)
                else:
                    inner = {**context, "files": files, "scope": (scope,)}
                    found = read_component(self.base, path, key=info.field_name or "", context=inner, units=self.units)
            except FileError as error:
                fail_validation(f"{name}: {'; '.join(map(str, error.problems[:5]))}", f"correct {name}")
            name = str(path)
        return found if isinstance(found, dict) else _marked(found, origin=name)

    def class_for(self, section: Mapping[str, Any]) -> type:
        """Return the class of a section; reports a mistake where it names none."""
        known, named = classes_of(self.base), section.get("class")
        if named is None:
            kind = default_class(self.base)
            if kind is not None and set(section) <= _keys(kind):
                return kind
            if meant := next((key for key in section if find_class(self.base, key) is not None), ""):
                fail_validation("lacks the key `class`", f"write `class: {meant}`, and its fields in the same section")
            shared = {name: len(_keys(one) & set(section)) for name, one in known.items()}
            most = max(shared.values(), default=0)
            if most > (0 if kind is None else len(_keys(kind) & set(section))):
                fitting = " or ".join(name for name, count in shared.items() if count == most)
                fail_validation("lacks the key `class`", f"write `class: {fitting}`")
            if section and not most and (remedy := _remedy_without_class(kind, known, set(section))):
                fail_validation("lacks the key `class`", remedy)
            if kind is None:
                fail_validation("lacks the key `class`", f"give one of {', '.join(known)}")
            return kind
        kind = find_class(self.base, named) if isinstance(named, str) else None
        if kind is None:
            remedy = suggest(str(named), list(known)) if known else "there is none yet"
            own = "for a user-defined class, load its module first: `mckibben --extension FILE.py ...`, or a module"
            broken = (f"{one.message} ({one.remedy})" for one in load_installed())
            message = f"there is no class {quoted(named)} of {self.base.__name__}"
            fail_validation(message, "; ".join([remedy, own, *broken]), value=named)
        return kind

    def model_for(self, value: Any) -> type[Section] | None:
        """Return the model of a section, for messages; None for one that names no class."""
        with contextlib.suppress(McKibbenError):
            written, value = value, self.base.from_file(value)
            if isinstance(value, dict) and "class" not in value and "from" in value and len(classes_of(self.base)) > 1:
                return None
            if (below := short_key(written, value)) and isinstance(written[below[0]], dict):
                inner = section_of(self.class_for(value), self.units)
                return cast(Any, create_model)("Keyed", __base__=Section, **{below[0]: (inner, ...)})
            return section_of(self.class_for(value if isinstance(value, dict) else {}), self.units)
        return None

    @property
    def _noun(self) -> str:
        catalog = catalog_of(self.base)
        return with_article(catalog.noun if catalog else self.base.__name__)

    def _expected(self, value: Any) -> tuple[str, str]:
        kind = default_class(self.base)
        keys = ", ".join(forms(kind, self.units)) if kind else "`class` and the fields of the class"
        if value == "":
            return "has no value", "write one, or leave the key out"
        if isinstance(value, Component | Checked):  # in Python
            return f"is {described(value)}", f"give {with_article(self.base.__name__)}"
        return (
            f"{described(value, of_file=True)} is given where keys and values are expected",
            f"give a mapping of {keys}",
        )


def _remedy_without_class(default: type | None, known: Mapping[str, type], keys: set[str]) -> str:
    """Remedy for keys that no class has: a class with parts that have them, or all keys; none if they are misspelt."""
    for name, kind in known.items():
        marks = ((field, part_of(form)) for field, form in forms(kind).items())
        fields = [one for one, mark in marks if mark and any(keys <= _keys(k) for k in classes_of(mark.base).values())]
        if fields and kind is not default:
            return f"write `class: {name}`, with {' and '.join(sorted(keys))} in {' and '.join(fields)}"
    if default is None or len(known) < 2 or any(closest(key, [*_keys(default)]) for key in keys):
        return ""
    others = [name for name, kind in known.items() if kind is not default]
    return f"without `class`, the keys are {', '.join(forms(default))}; other classes are {', '.join(others)}"


def build(kind: type, fields: Mapping[str, Any], scope: Scope) -> Any:
    """Return a component of a class; fields that are not given are inherited from around it, or have their default."""
    inherited = {}
    for name, field in declared_fields(kind).items():
        if name in fields:
            continue
        if (mark := inherited_from(kind, name)) is not None:
            with contextlib.suppress(KeyError):
                inherited[name] = _copy(mark.find(scope))
        if field.default is field.default_factory is dataclasses.MISSING and name not in inherited:
            both = [f"`{alias}` for both" for alias, names in getattr(kind, "aliases", {}).items() if name in names]
            fail_validation(f"lacks {name}", f"give {' or '.join([name, *both])}", follows=mark is not None)
    return _marked(kind(**fields, **inherited), inherited=frozenset(inherited))


def _marked(component: Any, **marks: Any) -> Any:
    """Component that knows its origin (`origin`, `inherited`): neither fields nor leaves, and lost by any change."""
    component = component if "origin" not in marks else _made(component, {})  # entries of a catalog are shared
    for name, value in marks.items():
        object.__setattr__(component, f"_{name}", value)
    return component


def origin_of(component: Any) -> str:
    """Return the catalog entry or the path that a component was read from; empty if it has been changed since."""
    return getattr(component, "_origin", "")


def inherited_fields(component: Any) -> frozenset[str]:
    """Return the names of the fields that a component inherited when it was read."""
    return getattr(component, "_inherited", frozenset())


def replaced(component: C, fields: Mapping[str, Any]) -> C:
    """Return a component with other fields, checked again; what it inherited stays inherited."""
    if not fields:
        return component
    kept = inherited_fields(component) - set(fields)
    return _marked(_made(component, fields), inherited=kept)


def _copy(found: Any) -> Any:
    """A copy of a component: a controller's model is never the same object as that of the plant."""
    return _made(found, {}) if isinstance(found, Component) else found


def _made(component: Any, fields: Mapping[str, Any]) -> Any:
    """Component with other fields; a class with its own constructor is made from the arguments of that."""
    kind = type(component)
    return kind(**{name: getattr(component, name) for name in declared_fields(kind)} | dict(fields))


def inherit(component: Any, scope: Scope) -> Any:
    """Return a component whose inherited fields, and those of its parts, are taken from a scope again."""
    if isinstance(component, tuple):
        return tuple(inherit(one, scope) for one in component)
    if not isinstance(component, Component):
        return component
    fields, kind = {}, type(component)
    names = inherited_fields(component)
    own = {name: getattr(component, name) for name in declared_fields(kind) if name not in names}
    around = ChainMap(own, dict(scope))
    for name in declared_fields(kind):
        before = getattr(component, name)
        mark = inherited_from(kind, name) if name in names else None
        after = _copy(mark.find(around)) if mark else inherit(before, around)
        if after is not before:
            fields[name] = after
    return _marked(replaced(component, fields), inherited=names) if fields else component


def independent(component: Any) -> Any:
    """Return a component without inherited fields: they keep their values."""
    if isinstance(component, tuple):
        return tuple(map(independent, component))
    if not isinstance(component, Component):
        return component
    fields = {name: independent(getattr(component, name)) for name in declared_fields(type(component))}
    changed = {name: one for name, one in fields.items() if one is not getattr(component, name)}
    if not changed and not inherited_fields(component):
        return component
    return _made(component, changed)


def write(component: Any, part: Part | None = None, *, folder: Path = Path()) -> Any:
    """Return the section of a component, as plain data with units: what differs from the defaults of its class."""
    if origin := origin_of(component):
        return relative_path(Path(origin), folder) if origin.endswith(ENDINGS) else origin
    kind = type(component)
    part = Part(kind) if part is None else part
    given: dict[str, Any] = {}
    explicit_none = []
    for name in forms(kind, part.units):
        field, value = declared_fields(kind)[name], getattr(component, name)
        implied = name in inherited_fields(component) if inherited_from(kind, name) else same(value, field.default)
        if implied:
            continue
        if value is None:
            explicit_none.append(name)
        given[name] = plain(value)
    for alias, (first, *others) in getattr(kind, "aliases", {}).items():
        if first in given and all(same(given.get(other), given[first]) for other in others):
            given[alias] = given.pop(first)
            given = {name: one for name, one in given.items() if name not in others}
    model = section_of(kind, part.units)
    named = None if kind is default_class(part.base) else name_in_files(part.base, kind)
    try:
        section = model.model_construct(class_=named, **given).model_dump(
            mode="json", by_alias=True, exclude_none=True, context={"folder": folder}
        )
    except PydanticSerializationError as error:
        raise McKibbenError(f"this {kind.__name__} cannot be written to a file: {error}") from None
    section |= dict.fromkeys(explicit_none, "none")
    short = getattr(part.base, "to_file", None)
    section = section if short is None else short(section)
    return named if list(section) == ["class"] else section


def write_text(component: Any, *, folder: Path = Path(), base: type | None = None) -> str:
    """Return the text of a file that holds a component."""
    section = write(component, None if base is None else Part(base), folder=folder)
    return to_text(section if isinstance(section, dict) else {"from": section})


def read_component(
    base: type[C],
    path: Path,
    *,
    key: str = "",
    context: Mapping[str, Any] | None = None,
    units: Units = Units(),  # noqa: B008
) -> C:
    """Return the component of a file, or that under a key of it; ScenarioError with every problem and its line."""
    text = read_text(path, f"a {base.__name__}", "docs/scenarios.md")
    return parse_component(base, text, source=str(path), folder=path.parent, key=key, context=context, units=units)


def parse_component(
    base: type[C],
    text: str,
    *,
    source: str,
    folder: Path = Path(),
    key: str = "",
    context: Mapping[str, Any] | None = None,
    units: Units = Units(),  # noqa: B008
) -> C:
    """Return the component of a YAML text; as `read_component`."""
    part = Part(base, units)
    model = part.model_for(read_document(text).data) or Section
    adapter: Any = TypeAdapter(Annotated[Any, part])
    inner = {**(context or {}), "folder": folder}
    found, _ = parse_text(adapter.validate_python, model, text, source=source, key=key, context=inner)
    return found
