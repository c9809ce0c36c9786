"""Components in files: any class of a base by `class`, with units, checks by line, and text that reads back.

A field of a document, or of a component, that holds a component is marked with `ComponentField`. Its section names the
class, by name or `short_name`, with the key ``class`` (otherwise the base's `default_class`), and gives its fields.
Instead of a section, or as its key ``from``, a file may name a catalog entry or a file; other keys are changes to it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import warnings
from collections import ChainMap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin

from pydantic import (
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    SerializationInfo,
    TypeAdapter,
    ValidationInfo,
    create_model,
)
from pydantic_core import PydanticSerializationError, ValidationError, core_schema

from mckibben.component.base import (
    Checked,
    Component,
    Inherited,
    Units,
    field_hints,
    field_quantities,
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
from mckibben.config.document import read_document, to_text
from mckibben.config.fields import FilePath, Flag, OneOf, Title, read_number, read_path, relative_path
from mckibben.config.model import ConfigModel, fail_validation, located_below, marks_in, read_text, validated
from mckibben.errors import FileError, McKibbenError, closest, described, quoted, suggest, with_article
from mckibben.units import HINGE, SYMBOLS, BoundedInt, JointType, Quantity

C = TypeVar("C")

Fields = dict[str, Any]
"""Values of the keys of a section, or of the fields of a component, which are of any type."""

Scope = Mapping[str, Any]
"""Fields of the sections around a component that is read, the nearest first."""

ENDINGS = (".yaml", ".yml")
"""Endings of files that hold a component."""


class ComponentSection(ConfigModel):
    """Fields of one class in a file; made by `section_of`."""

    class_: Annotated[Any, Field(alias="class")] = None
    from_: Annotated[Any, Field(alias="from")] = None


_NONE = BeforeValidator(lambda value: None if value == "none" else value)


@functools.cache
def section_of(runtime: type, units: Units = Units(), *, partial: bool = False) -> type[ComponentSection]:  # noqa: B008
    """Return the pydantic model of a class in files.

    Unit, shown unit and range of each field are those of its type in the class.

    Parameters
    ----------
    runtime
        Class of the component.
    units
        Quantities of fields whose unit depends on where the component is.
    partial
        Whether no field is required, as for changes to a component.

    Examples
    --------
    >>> from mckibben.actuator import FirstOrderValve
    >>> section_of(FirstOrderValve).model_validate({"time_constant": "20 ms"}).time_constant
    0.02
    """
    declared, types = declared_fields(runtime), field_types(runtime, units)
    aliases = getattr(runtime, "aliases", {})
    aliased = {name for names in aliases.values() for name in names}
    fields: dict[str, tuple[Any, Any]] = {}
    for name, kind in types.items():
        has_default = not declared[name].default is declared[name].default_factory is dataclasses.MISSING
        inherits = inherited_from(runtime, name) is not None
        if not (partial or has_default or name in aliased or inherits):
            fields[name] = kind, ...
        elif inherits and component_field(kind) is None:
            fields[name] = Annotated[kind | None, _NONE], None
        else:
            fields[name] = kind | None, None
    fields |= {alias: (types[names[0]] | None, None) for alias, names in aliases.items()}
    with warnings.catch_warnings(action="ignore"):  # a field may have the name of a method of pydantic
        return cast(Any, create_model)(f"{runtime.__name__}Section", __base__=ComponentSection, **fields)


@functools.cache
def declared_fields(runtime: type) -> dict[str, dataclasses.Field]:
    """Return the fields that the constructor of a class takes, by name."""
    taken = inspect.signature(runtime).parameters
    return {field.name: field for field in dataclasses.fields(cast(Any, runtime)) if field.name in taken}


@functools.cache
def field_types(runtime: type, units: Units = Units()) -> dict[str, Any]:  # noqa: B008
    """Return the annotation of each field of a class that can appear in a file."""
    hints, types = field_hints(runtime), {}
    for name in declared_fields(runtime):
        kind = _type_in_files(hints.get(name), units)
        if kind is None and hints.get(name) is float:
            unit_of = getattr(runtime, "unit_of", lambda _: None)
            kind = Annotated[float, unit_of(name) or BeforeValidator(read_number)]
        if kind is not None:
            types[name] = kind
    return types


def _places(kind: type, name: str) -> list[str]:
    """Fields of a class that hold a component of a class named in a file."""
    marks = {field: component_field(annotation) for field, annotation in field_types(kind).items()}
    return [field for field, mark in marks.items() if mark and find_class(mark.base, name)]


@functools.cache
def _keys(kind: type) -> frozenset[str]:
    """Keys of a section of a class."""
    return frozenset((*field_types(kind), *symbolic_fields(kind), *getattr(kind, "aliases", {})))


def symbolic_fields(kind: type) -> list[str]:
    """Return the fields of a class whose unit depends on where it is."""
    marks = field_quantities(kind)
    return [name for name in declared_fields(kind) if name in marks and marks[name].unit in SYMBOLS]


def component_field(annotation: object) -> ComponentField | None:
    """Return the mark of a field that holds a component, or a list of them."""
    return next(marks_in(annotation, ComponentField), None)


@functools.cache
def inherited_from(runtime: type, name: str) -> Inherited | None:
    """Return the mark of a field that takes its value from the scope if a file leaves it out."""
    return next(marks_in(field_hints(runtime)[name], Inherited), None)


def _type_in_files(hint: object, units: Units) -> Any:
    """Annotation of a field in files; None for a field that cannot appear there."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return next((kind for argument in arguments if (kind := _type_in_files(argument, units)) is not None), None)
    if origin is Literal:
        return Annotated[str, OneOf(tuple(filter(None, arguments)))]
    if origin in (tuple, Sequence):
        inner = _type_in_files(arguments[0], units)
        return None if inner is None else tuple[inner, ...]
    if origin is Annotated:
        return _annotated_type(*arguments, units=units)
    if not isinstance(hint, type):
        return None
    if issubclass(hint, Component | Checked):
        return Annotated[Any, ComponentField(hint, units)]
    return {bool: Flag, str: Title, Path: FilePath}.get(hint)


def _annotated_type(base: Any, *marks: object, units: Units) -> Any:
    """Annotation in files of a field with unit and range, or of a component with units of its symbolic fields."""
    mark = next((mark for mark in marks if isinstance(mark, Quantity | BoundedInt)), None)
    if isinstance(mark, Quantity) and mark.unit in SYMBOLS:
        mark = units.get(mark.unit)
        return None if mark is None else Annotated[float, mark]
    if mark is not None:
        return Annotated[base, mark]
    return _type_in_files(base, next((mark for mark in marks if isinstance(mark, Units)), units))


@dataclass(frozen=True)
class ComponentField:
    """Marks a section of a file that holds a component of a base class.

    Parameters
    ----------
    base
        Class of the component, or a base of it.
    units
        Quantities of its symbolic fields, such as the signal of a reference.
    """

    base: type
    units: Units = Units()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.with_info_plain_validator_function(
            self.read, serialization=core_schema.plain_serializer_function_ser_schema(self._written, info_arg=True)
        )

    def _written(self, value: object, info: SerializationInfo) -> object:
        return None if value is None else write(value, self, context=info.context)

    def read(self, value: object, info: ValidationInfo) -> Any:
        """Return the component of a section, of the name of a class or catalog entry, or of a path.

        With a component of the same place in another object (`changed` in the context), a section that names no class
        changes its fields. Mistakes are those of pydantic, each with its key.
        """
        if value is None or isinstance(value, self.base):
            return value
        section, key = self._section(value)
        if section is None:
            return None
        context = dict(info.context or {})
        default, fields = _default_of(context.pop("changed", None), info.field_name), info.data or {}
        siblings = {name: field for name, field in fields.items() if field is not None}
        scope = ChainMap[str, Any]({"key": info.field_name or ""}, siblings, *context.get("scope", ()))
        if (source := section.pop("from", None)) is not None:
            default = self._from_source(source, context, scope, info)
            if isinstance(default, dict):  # an entry that lacks fields
                section, default = {**default, **section}, None
            elif not section:
                return default
        elif "class" in section or not isinstance(default, self.base):
            default = None
        changes = default is not None and "class" not in section and set(section) <= _keys(type(default))
        kind = type(default) if changes else self.class_for(section)
        default = default if type(default) is kind else None
        fields = self._fields(kind, section, context | {"scope": scope.maps, "changed": default}, value, key)
        return _built(kind, fields, scope) if default is None else replaced(default, fields)

    def _fields(self, kind: type, section: Fields, context: Fields, written: object, key: tuple[str, ...]) -> Fields:
        """Fields of a class that a section gives, which is `written` below a key or by a shorthand."""
        model = section_of(kind, self.units, partial=context["changed"] is not None)
        try:
            read = model.model_validate(section, context=context)
        except ValidationError as error:
            is_short = bool(key) and not isinstance(cast(Fields, written)[key[0]], dict)
            raise located_below(error, key, shorthand=is_short) from None
        return _expanded(kind, {name: getattr(read, name) for name in read.model_fields_set - {"class_"}})

    def _section(self, written: object) -> tuple[Fields | None, tuple[str, ...]]:
        """A value as keys and values, None of ``none``, and the key below which the fields are written, if any."""
        value = self.base.from_file(written)  # type: ignore[attr-defined]
        key = short_key(written, value)
        if isinstance(value, str) and value:
            is_class = find_class(self.base, value) is not None
            if value == "none" and not is_class:
                return None, key
            value = {"class" if is_class else "from": value}
        if not isinstance(value, dict):
            fail_validation(*self._expected(value), value=value)
        source = value.get("from", "")
        if not isinstance(source, str):
            fail_validation(f"{quoted(source)} is not the name of {self._noun}", "give a name or a path")
        if "from" in value and find_class(self.base, source) is not None:
            value = {"class": source, **{name: field for name, field in value.items() if name != "from"}}
        return dict(value), key

    def _from_source(self, name: str, context: Fields, scope: Scope, info: ValidationInfo) -> Any:
        """Component of a catalog entry or a file."""
        catalog = catalog_of(self.base)
        if not name.endswith(ENDINGS):
            names = catalog.names() if catalog else ()
            if catalog is None or name not in names:
                sources = [*names, *(classes_of(self.base) if is_abstract(self.base) else ())]
                remedy = suggest(name, sources) if sources else self._expected(name)[1]
                fail_validation(f"{quoted(name)} is not the name of {self._noun}", remedy, value=name)
            component = catalog.entry(name)
            return component if isinstance(component, dict) else _marked(component, origin=name)
        path = read_path(name, info, ".yaml")
        files = (*context.get("files", ()), path)
        if path in files[:-1]:
            fail_validation(f"{name} refers to itself", f"give the numbers in {name}")
        try:
            if catalog is not None and catalog.read is not None:
                component = catalog.read(path)
            else:
                inner = {**context, "files": files, "scope": (scope,)}
                component = read_component(self.base, path, key=info.field_name or "", context=inner, units=self.units)
        except FileError as error:
            fail_validation(f"{name}: {'; '.join(map(str, error.problems[:5]))}", f"correct {name}")
        return component if isinstance(component, dict) else _marked(component, origin=str(path))

    def class_for(self, section: Mapping[str, object]) -> type:
        """Return the class of a section; reports a mistake where it names none."""
        if "class" not in section:
            return self._default_class(section)
        named = section["class"]
        kind = find_class(self.base, named) if isinstance(named, str) else None
        if kind is None:
            classes = classes_of(self.base)
            remedy = suggest(str(named), list(classes)) if classes else "there is none yet"
            hint = "for a user-defined class, load its module first: `mckibben --extension FILE.py ...`, or a module"
            for name, other in classes.items():
                if places := _places(other, str(named)):
                    remedy, hint = f"write `class: {name}`", f"it can be its {' and its '.join(places)}"
            message = f"there is no class {quoted(named)} of {self.base.__name__}"
            fail_validation(message, f"{remedy}; {hint}", value=named)
        return kind

    def _default_class(self, section: Mapping[str, object]) -> type:
        """The class of a section that names none: the default of the base, unless its keys are those of others."""
        classes, kind, keys = classes_of(self.base), default_class(self.base), {*section}
        if kind is not None and (keys <= _keys(kind) or len(classes) == 1):
            return kind
        if meant := next((key for key in section if find_class(self.base, key) is not None), ""):
            fail_validation("lacks the key `class`", f"write `class: {meant}`, and its fields in the same section")
        if fitting := [name for name, other in classes.items() if keys and keys <= _keys(other)]:
            fail_validation("lacks the key `class`", f"write `class: {' or '.join(fitting)}`")
        if kind is None or not any(closest(key, [*_keys(kind)]) for key in section):
            default = f"; without it the keys are {', '.join(field_types(kind))}" if kind else ""
            fail_validation("lacks the key `class`", f"give one of {', '.join(classes)}{default}")
        return kind

    def section_keys(self, value: object) -> Collection[str]:
        """Return the keys of a section, for messages; none of one that names no class."""
        with contextlib.suppress(McKibbenError):
            section = self.base.from_file(value)  # type: ignore[attr-defined]
            return _keys(self.class_for(section if isinstance(section, dict) else {}))
        return ()

    @property
    def _noun(self) -> str:
        catalog = catalog_of(self.base)
        return with_article(catalog.noun if catalog else self.base.__name__)

    def _expected(self, value: object) -> tuple[str, str]:
        kind = default_class(self.base)
        keys = ", ".join(field_types(kind, self.units)) if kind else "`class` and the fields of the class"
        if value == "":
            return "has no value", "write one, or leave the key out"
        if isinstance(value, Component | Checked):  # in Python
            return f"is {described(value)}", f"give {with_article(self.base.__name__)}"
        return (
            f"{described(value, of_file=True)} is given where keys and values are expected",
            f"give a mapping of {keys}",
        )


def _default_of(component: object, name: str | None) -> object:
    """The part of a component under a key of a file; None without one."""
    key = name or ""
    return getattr(component, getattr(component, "aliases", {}).get(key, (key,))[0], None)


def _expanded(kind: type, fields: Fields) -> Fields:
    """Fields of a class from those of its section: one key may give several."""
    for alias, names in getattr(kind, "aliases", {}).items():
        if alias in fields:
            if both := [name for name in names if name in fields]:
                remedy = f"give {alias}, or {' and '.join(names)}"
                fail_validation(f"has {alias} in addition to {' and '.join(both)}", remedy)
            fields |= dict.fromkeys(names, fields.pop(alias))
    return fields


def _built(kind: type[C], fields: Mapping[str, object], scope: Scope) -> C:
    """Return a component of a class; other fields are inherited from the scope, or have their default."""
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


def _marked(component: C, **marks: object) -> C:
    """Component that knows its origin (`origin`, `inherited`): neither fields nor leaves, and lost by any change."""
    component = component if "origin" not in marks else _copied(component, {})  # entries of a catalog are shared
    for name, value in marks.items():
        object.__setattr__(component, f"_{name}", value)
    return component


def origin_of(component: object) -> str:
    """Return the catalog entry or the path that a component was read from; empty if it has been changed since.

    >>> from mckibben.joint import Load
    >>> load = parse_component(Load, "from: knee-table-2", source="example")
    >>> origin_of(load), origin_of(replaced(load, {"damping": 0.1}))
    ('knee-table-2', '')
    """
    return getattr(component, "_origin", "")


def inherited_fields(component: object) -> frozenset[str]:
    """Return the names of the fields that a component inherited when it was read."""
    return getattr(component, "_inherited", frozenset())


def replaced(component: C, fields: Mapping[str, object]) -> C:
    """Return a component with other fields, checked again; what it inherited stays inherited."""
    if not fields:
        return component
    return _marked(_copied(component, fields), inherited=inherited_fields(component) - set(fields))


def _copy(value: C) -> C:
    """A copy of a component: a controller's model is never the same object as that of the plant."""
    return _copied(value, {}) if isinstance(value, Component) else value


def _copied(component: C, fields: Mapping[str, object]) -> C:
    """Component with other fields; a class with its own constructor is made from the arguments of that."""
    kind = type(component)
    return kind(**{name: getattr(component, name) for name in declared_fields(kind)} | dict(fields))


def inherit(component: Any, scope: Scope) -> Any:
    """Return a component whose inherited fields, and those of its parts, are taken from a scope again.

    A study that varies a field of the plant thus varies what its parts inherit. The same object is returned if nothing
    changes.
    """
    if isinstance(component, tuple):
        return tuple(inherit(member, scope) for member in component)
    if not isinstance(component, Component):
        return component
    kind, names = type(component), inherited_fields(component)
    before = {name: getattr(component, name) for name in declared_fields(kind)}
    inner = ChainMap({name: value for name, value in before.items() if name not in names}, dict(scope))
    fields = {}
    for name, value in before.items():
        mark = inherited_from(kind, name) if name in names else None
        fields[name] = _copy(mark.find(inner)) if mark else inherit(value, inner)
    changed = {name: value for name, value in fields.items() if value is not before[name]}
    return _marked(replaced(component, changed), inherited=names) if changed else component


def independent(component: Any) -> Any:
    """Return a component without inherited fields: they keep their values, also if a study varies the plant."""
    if isinstance(component, tuple):
        return tuple(map(independent, component))
    if not isinstance(component, Component):
        return component
    before = {name: getattr(component, name) for name in declared_fields(type(component))}
    fields = {name: independent(value) for name, value in before.items()}
    changed = {name: value for name, value in fields.items() if value is not before[name]}
    return _copied(component, changed) if changed or inherited_fields(component) else component


def write(component: object, field: ComponentField | None = None, *, context: Mapping[str, Any] | None = None) -> Any:
    """Return the section of a component in a file, as plain data with units.

        >>> from mckibben.actuator import FirstOrderValve
        >>> write(FirstOrderValve(0.02))
        {'time_constant': '20 ms'}

    It holds the fields that differ from the defaults of the class. A component that is unchanged since it was read
    from a catalog or a file is its name or its path, relative to the `folder` of the context, which has the
    `joint_type`, too. Raises `McKibbenError` for a component that no file can hold, such as one with a field of a type
    without a form in files.
    """
    context = context or {}
    if origin := origin_of(component):
        return relative_path(Path(origin), context.get("folder") or Path()) if origin.endswith(ENDINGS) else origin
    kind = type(component)
    field = ComponentField(kind) if field is None else field
    values: Fields = {}
    for name in field_types(kind, field.units):
        value, default = getattr(component, name), declared_fields(kind)[name].default
        implied = name in inherited_fields(component) if inherited_from(kind, name) else same(value, default)
        if not implied:
            values[name] = plain(value)
    explicit_none = [name for name, value in values.items() if value is None]
    values = _with_aliases(kind, values, context.get("joint_type", HINGE))
    model = section_of(kind, field.units)
    named = None if kind is default_class(field.base) else name_in_files(field.base, kind)
    try:
        section = model.model_construct(class_=named, **values).model_dump(
            mode="json", by_alias=True, exclude_none=True, context=context
        )
    except PydanticSerializationError as error:
        raise McKibbenError(f"this {kind.__name__} cannot be written to a file: {error}") from None
    section |= dict.fromkeys(explicit_none, "none")
    to_file = getattr(field.base, "to_file", None)
    section = section if to_file is None else to_file(section)
    return named if list(section) == ["class"] else section


def _with_aliases(kind: type, values: Fields, joint_type: JointType) -> Fields:
    """Values of fields, with one key for several that are the same, or for one that has another name on a joint."""
    for alias, (first, *others) in getattr(kind, "aliases", {}).items():
        applies = others or joint_type.words(first) == alias
        if applies and first in values and all(same(values.get(other), values[first]) for other in others):
            values[alias] = values.pop(first)
            values = {name: value for name, value in values.items() if name not in others}
    return values


def write_text(component: object, *, folder: Path = Path(), base: type | None = None) -> str:
    """Return the text of a file that holds a component.

    Paths are relative to `folder`; with a `base` the class is named unless it is the default of the base. Errors are as
    for `write`.
    """
    section = write(component, None if base is None else ComponentField(base), context={"folder": folder})
    return to_text(section if isinstance(section, dict) else {"from": section})


def read_component(
    base: type[C],
    path: Path,
    *,
    key: str = "",
    context: Mapping[str, Any] | None = None,
    units: Units = Units(),  # noqa: B008
) -> C:
    """Return the component of a YAML file.

    Parameters
    ----------
    base
        Class of the component, or a base of it; the section then names the class.
    key
        Key of the section, or keys joined by points, each if the file has it; otherwise the whole file is the section.
    context
        Fields around the section, from which it may inherit.
    units
        Units of fields whose unit depends on where the component is used.

    Raises
    ------
    ScenarioError
        With every problem of the file: line, field, value, range and remedy.
    """
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
    """Return the component of a YAML text; arguments and errors as for `read_component`.

    >>> from mckibben.actuator import Actuator
    >>> parse_component(Actuator, "{class: first_order, time_constant: 20 ms}", source="example").time_constant
    0.02
    """
    field, document = ComponentField(base, units), read_document(text)
    for name in key.split("."):
        if isinstance(document.data, dict) and name in document.data:
            document = document.below(name)
    validate = TypeAdapter[Any](Annotated[Any, field]).validate_python
    inner, keys = {**(context or {}), "folder": folder}, field.section_keys(document.data)
    return validated(validate, document, source, inner, keys, f"a file with {', '.join(keys)}")
