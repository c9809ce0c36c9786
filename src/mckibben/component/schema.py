"""Models of configuration files from runtime classes, and classes of one's own in configuration files.

A runtime class (`equinox.Module` or dataclass) states unit and range of each number in its annotations:

    time_constant: Annotated[float, Quantity("s", "ms", 0, 1e4, open_lower=True)]

`model_of` makes the model from these. Where a file may hold any subclass of a base class, its field is marked with
`PartOf`; the key ``class`` then names the subclass, which has to be imported before.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import importlib
import inspect
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import Field, GetCoreSchemaHandler, create_model
from pydantic_core import core_schema

from mckibben.component.extensions import load_installed
from mckibben.config.fields import Flag, OneOf
from mckibben.config.model import ConfigModel, explicit_fields, fail_validation
from mckibben.errors import Problem, quoted, suggest
from mckibben.units import COMPONENT, SIGNAL_UNIT, BoundedInt, Quantity


class ComponentModel(ConfigModel):
    """The section of a component, made by `model_of`."""

    runtime: ClassVar[type]
    own_keys: ClassVar[frozenset[str]] = frozenset()
    """Keys that tell it from the models of other classes, see `PartOf`."""

    def build(self, *args: Any, **others: Any) -> Any:
        """The component; what is not given keeps the default of its class."""
        declared = self.runtime.__dataclass_fields__
        for name, value in explicit_fields(self).items():
            if name in declared and name not in others:
                default = declared[name].default
                if isinstance(value, ComponentModel):
                    value = value.build()
                others[name] = type(default)[value.upper()] if isinstance(default, enum.Enum) else value
        return self.runtime(*args, **others)

    def effective(self, name: str) -> Any:
        """The value of a field, in SI: as given, or the default of the runtime class."""
        value = getattr(self, name)
        return default_of(self.runtime, name) if value is None else value


def default_of(runtime: type, name: str) -> Any:
    """The default of a field of a runtime class; None if it has none."""
    default = runtime.__dataclass_fields__[name].default
    return None if default is dataclasses.MISSING else default


def model_of(
    runtime: type,
    *,
    base: type[ConfigModel] = ComponentModel,
    without: Container[str] = (),
    optional: bool = False,
    signal: Any = None,
    model_name: str = "",
    **fields: Any,
) -> Any:
    """The model of a runtime class, from unit and range of its fields; those with a default may be left out."""
    declared, hints = runtime.__dataclass_fields__, get_type_hints(runtime, include_extras=True)
    made = {key: one for key, one in fields.items() if key not in declared}
    for key in declared:
        annotation = fields[key] if key in fields else _annotation(hints[key], signal)
        if key in without or annotation is None:
            continue
        if isinstance(annotation, tuple):
            made[key] = annotation
        elif optional or declared[key].default is not dataclasses.MISSING:
            made[key] = annotation | None, None
        else:
            made[key] = annotation, ...
    model: Any = named_model(model_name or f"{runtime.__name__}Spec", base, made)
    model.runtime = runtime
    return model


def named_model(name: str, base: Any, fields: Mapping[str, Any]) -> Any:
    """A model that `pickle` finds by its name in this module."""
    model = create_model(name, __base__=base, __module__=__name__, **fields)
    globals()[name] = model
    return model


def _annotation(hint: Any, signal: Any) -> Any:
    """The annotation of a field in a file; None for a field that is in no file."""
    if get_origin(hint) in (Union, UnionType):  # such as Seed | Array
        return next(filter(None, (_annotation(one, signal) for one in get_args(hint))), None)
    if get_origin(hint) is Literal:
        return Annotated[str, OneOf(tuple(word for word in get_args(hint) if word))]
    if get_origin(hint) in (tuple, Sequence):
        inner = _annotation(get_args(hint)[0], signal)
        return inner and tuple[inner, ...]
    if get_origin(hint) is Annotated:
        base, *marks = get_args(hint)
        if COMPONENT in marks:
            return Annotated[ComponentModel, PartOf(f"{base.__module__}:{base.__name__}", class_required=True)]
        mark = next((one for one in get_args(hint) if isinstance(one, Quantity | BoundedInt)), None)
        return signal if isinstance(mark, Quantity) and mark.unit == SIGNAL_UNIT else mark and hint
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return Annotated[str, OneOf(tuple(member.name.lower() for member in hint))]
    return Flag if hint is bool else None


@dataclass(frozen=True)
class PartOf:
    """Marks a section that is that of its model, or with the key ``class`` that of any subclass of `base`.

    `others` are models beside it, each taken where one of its `own_keys` is given.
    """

    base: str
    model: type[ComponentModel] = ComponentModel
    signal: Any = None
    class_required: bool = False
    others: tuple[type[ComponentModel], ...] = ()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        def validate(value: Any, inner: Any, info: Any) -> Any:
            if isinstance(value, self.others) or (isinstance(value, self.model) and hasattr(value, "class_name")):
                return value
            model = self.model_for(value)
            return inner(value) if model is None else model.model_validate(value, context=info.context)

        def write(value: Any, info: Any) -> Any:
            options = {"mode": info.mode, "by_alias": info.by_alias, "exclude_none": info.exclude_none}
            return value.model_dump(context=info.context, **options)

        return core_schema.with_info_wrap_validator_function(
            validate,
            handler(source),
            serialization=core_schema.plain_serializer_function_ser_schema(write, info_arg=True),
        )

    def model_for(self, value: Any) -> type[ConfigModel] | None:
        """The model of a section with the key ``class``; None without."""
        if not isinstance(value, dict):
            return None
        if "class" not in value and not self.class_required:
            return next((one for one in self.others if not one.own_keys.isdisjoint(value)), None)
        module, _, name = self.base.partition(":")
        base = getattr(importlib.import_module(module), name)
        known = _public_subclasses(base)
        broken: tuple[Problem, ...] = ()
        if value.get("class") not in [*known]:
            broken, known = load_installed(), _public_subclasses(base)
        if "class" not in value:
            fail_validation("lacks the key `class`", f"give one of {', '.join(sorted(known))}")
        chosen = value["class"]
        if not isinstance(chosen, str) or chosen not in known:
            remedy = suggest(str(chosen), sorted(known)) if known else "there is none yet"
            fail_validation(
                f"there is no class {quoted(chosen)} of {base.__name__}",
                "import its module first (`mckibben --extension FILE.py ...`, or a module); "
                + "; ".join([remedy, *(f"{one.message} ({one.remedy})" for one in broken)]),
                value=chosen,
            )
        runtime = known[chosen]
        own = next((one for one in self.others if one.runtime is runtime), None)
        return _model_of_subclass(runtime, self.model, self.signal) if own is None else _with_class(own)


@functools.cache
def _model_of_subclass(runtime: type, base: type[ComponentModel], signal: Any) -> Any:
    return model_of(runtime, base=base, signal=signal, class_name=(str, Field(alias="class")))


@functools.cache
def _with_class(model: type[ComponentModel]) -> Any:
    return named_model(f"{model.__name__}WithClass", model, {"class_name": (str, Field(alias="class"))})


def _public_subclasses(base: type) -> dict[str, type]:
    return {one.__name__: one for one in concrete_subclasses(base) if not one.__name__.startswith("_")}


def concrete_subclasses(base: type) -> Iterator[type]:
    """All subclasses of a class that are not abstract, of modules that are imported."""
    for one in base.__subclasses__():
        yield from concrete_subclasses(one)
        if not inspect.isabstract(one):
            yield one
