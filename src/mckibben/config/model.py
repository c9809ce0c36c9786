"""Base model of configuration files; files to models, with line, field and remedy of every mistake."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NoReturn, Protocol, Self, TypeVar, get_args, get_origin, runtime_checkable

from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, field_validator
from pydantic_core import ErrorDetails

from mckibben.config.document import LONGEST_TEXT, Document, Place, dotted, read_document, to_text
from mckibben.errors import (
    CallError,
    FileError,
    McKibbenError,
    ParameterError,
    Problem,
    ScenarioError,
    closest,
    described,
    quoted,
    suggest,
)
from mckibben.storage.files import atomic_write, check_seal, similar_file


class ConfigModel(BaseModel):
    """A section of a configuration file: frozen, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class DocumentModel(ConfigModel):
    """Base of files; `kind` and `examples` name them in messages."""

    kind: ClassVar[str] = "scenario"
    examples: ClassVar[str] = "examples/"

    def __init__(self, /, *args: object, **fields: Any) -> None:
        if args:
            name = type(self).__name__
            remedy = f"to read a file, write {name}.read({args[0]!r:.60})"
            raise CallError(f"{name} takes its fields by name", remedy=remedy)
        try:
            super().__init__(**fields)
        except ValidationError as error:
            problems = problems_of(error, Document(fields), type(self))
            raise ScenarioError(type(self).__name__, problems) from None

    @field_validator("*", mode="after")
    @classmethod
    def _not_none(cls, value: Any, info: ValidationInfo) -> Any:
        if value is None and type(None) not in get_args(cls.model_fields[str(info.field_name)].annotation):
            fail_validation("cannot be none", "give a class and its fields, or a name of the catalog")
        return value

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # files are validated without it

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file; raises ScenarioError with every problem: line, field, value, range and remedy."""
        text = read_text(path, f"a {cls.kind}", cls.examples)
        return cls.parse(text, source=os.fspath(path), folder=Path(path).parent)

    @classmethod
    def parse(cls, text: str, *, source: str = "", folder: str | os.PathLike[str] = ".") -> Self:
        """Read YAML text; errors as for `read`, with `source`; paths are relative to `folder`."""
        return parse_model(cls, text, source=source or cls.kind, folder=folder)[0]

    def __setattr__(self, name: str, value: Any) -> None:  # pyrefly: ignore[bad-override]
        try:
            super().__setattr__(name, value)
        except ValidationError:
            remedy = f"make a copy with `.replace({name}=...)`"
            raise ParameterError(f"a {self.kind} cannot be changed", field=name, value=value, remedy=remedy) from None

    def replace(self, **changes: Any) -> Self:
        """Return a copy with other values of fields, given and checked as those of the constructor."""
        fields = {field.alias or name: getattr(self, name) for name, field in type(self).model_fields.items()}
        return type(self)(**{**fields, **changes})

    def __dir__(self) -> list[str]:
        return [name for name in super().__dir__() if name.startswith("_") or not hasattr(BaseModel, name)]

    def to_yaml(self, path: str | os.PathLike[str]) -> None:
        """Write a file that `read` reads back to the last bit."""
        with atomic_write(path, overwrite=True) as part:
            part.write_text(self.dumps(folder=Path(path).parent), encoding="utf-8")

    def dumps(self, *, folder: str | os.PathLike[str] = ".") -> str:
        """Return text that `parse` reads back to the last bit; paths are relative to a folder."""
        return to_text(self._written(Path(folder)))

    def _written(self, folder: Path) -> dict[str, Any]:
        return self.model_dump(mode="json", by_alias=True, context={"folder": folder})


def fields_by_key(model: type[BaseModel]) -> dict[str, str]:
    """Names of the fields by their keys in a file."""
    return {info.alias or name: name for name, info in model.model_fields.items()}


def explicit_fields(part: ConfigModel | None, *without: str) -> dict[str, Any]:
    """The fields that are given, by name; the others keep the default of the class that is built."""
    if part is None:
        return {}
    return {
        name: getattr(part, name)
        for name in type(part).model_fields
        if name not in without and getattr(part, name) is not None
    }


class _ValidationError(McKibbenError, ValueError):
    """A mistake found by a validator; `parent`: of the section around the field; `follows`: from another one."""

    def __init__(self, message: str, *, parent: bool, follows: bool, **details: Any) -> None:
        super().__init__(message, **details)
        self.parent, self.follows = parent, follows


def fail_validation(
    message: str,
    remedy: str = "",
    *,
    parent: bool = False,
    follows: bool = False,
    value: object = None,
    field: str | None = None,
) -> NoReturn:
    """Report a mistake from within a validator.

    With `parent` it is a mistake of the section around the field. One that `follows` from others is left out if there
    are others. `field` is the key, or the keys joined by dots, below the place of the validator.
    """
    raise _ValidationError(message, remedy=remedy, parent=parent, follows=follows, value=value, field=field)


def with_changes(content: object, section: Mapping[str, object]) -> object:
    """Content to which a section's ``from`` refers, with the section's other keys."""
    return _merged(_with_tuples(content), {key: field for key, field in section.items() if key != "from"})


def _with_tuples(content: object) -> object:
    """Tuples in place of lists, as documents are read."""
    if isinstance(content, dict):
        return {key: _with_tuples(field) for key, field in content.items()}
    return tuple(map(_with_tuples, content)) if isinstance(content, list | tuple) else content


def _merged(content: Any, changes: Any) -> Any:
    """Changes key by key, of a list of parts by their names; a name is short for ``{from: name}``."""
    if not isinstance(changes, dict) or content is None:
        return changes
    if isinstance(content, tuple):
        known = [part.get("name") if isinstance(part, dict) else None for part in content]
        for name in changes:
            if name not in known:
                fail_validation(f"there is no part {quoted(name)}", suggest(name, list(filter(None, known))))
        return tuple(_merged(part, changes.get(name, {})) for name, part in zip(known, content, strict=True))
    content = {"from": content} if isinstance(content, str) else content
    return {**content, **{key: _merged(content.get(key), change) for key, change in changes.items()}}


def read_text(path: str | os.PathLike[str], what: str = "a scenario", example: str = "examples/") -> str:
    """Text of a configuration file; ScenarioError (`what`, see `example`) if it is unreadable or its seal is broken."""
    if not isinstance(path, str | os.PathLike):
        raise ScenarioError(what, [Problem(f"{path!r:.60} is not a path", remedy=f"give one, see {example}")])
    source, longest, similar = os.fspath(path), 4 * LONGEST_TEXT, ""
    try:
        with Path(path).open("rb") as file:
            content = file.read(longest + 1)
        if len(content) > longest:
            raise ScenarioError(source, [Problem(f"is longer than {LONGEST_TEXT} characters")])
        check_seal(Path(path))
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ScenarioError(source, [Problem("is not text in UTF-8", remedy="give a YAML file")]) from None
    except OSError as error:
        reason = error.strerror or str(error)
        if isinstance(error, FileNotFoundError):
            similar = similar_file(Path(path))
    except FileError as error:
        raise ScenarioError(source, error.problems) from None
    except ValueError as error:  # such as a null character in the path
        reason = str(error)
    remedy = f"{similar + ' if not, ' if similar else ''}give the path of {what}, see {example}"
    problem = Problem(f"cannot be read: {reason}", remedy=remedy)
    raise ScenarioError(source, [problem]) from None


def located_below(error: ValidationError, place: Place, *, shorthand: bool = False) -> ValidationError:
    """Return the mistakes of a validation as those of a section below a place, or of a value in place of its field."""
    details: Any = [{**item, "loc": (*place, *item["loc"][shorthand:])} for item in error.errors(include_url=False)]
    return ValidationError.from_exception_data(error.title, details)


P = TypeVar("P", bound=ConfigModel)
M = TypeVar("M")


def parse_model(
    kind: type[P], text: str, *, source: str, folder: str | os.PathLike[str] = ".", confined: bool = False
) -> tuple[P, Document]:
    """A model from YAML text, and the document with its lines; ScenarioError with every problem of the text.

    A `confined` text may name only files in its folder.
    """
    context = {"folder": Path(folder), "confined": confined}
    return parse_text(kind.model_validate, kind, text, source=source, context=context)


def parse_text(
    validate: Callable[..., Any],
    model: type[BaseModel],
    text: str,
    *,
    source: str,
    context: Mapping[str, object],
    key: str = "",
) -> tuple[Any, Document]:
    """Validate YAML text, or its section under a key, with a pydantic validator; errors as for `parse_model`."""
    document = read_document(text)
    if not document.readable:
        raise ScenarioError(source, document.problems)
    if isinstance(document.data, dict) and key in document.data:
        document = document.below(key)
    try:
        validated = validate(document.data, context=context)
    except ValidationError as error:
        problems = problems_of(error, document, model)
        if not key and (other := kind_of(document.data, _keys_of(model))):
            whole = issubclass(model, DocumentModel)
            asked = f"a {model.kind}, see {model.examples}" if whole else f"a file with {', '.join(_keys_of(model))}"
            problems = [Problem(f"is {other}", remedy=f"give {asked}")]
        raise ScenarioError(source, problems) from None
    if document.problems:
        raise ScenarioError(source, document.problems)
    return validated, document


_KINDS = (
    ({"leg"}, "a leg, which `mckibben leg` reads"),
    ({"controllers", "references"}, "a suite, which `mckibben compare` reads"),
    ({"joint", "controller", "reference"}, "a scenario of a joint, which `mckibben simulate` reads"),
    ({"muscle", "rig"}, "a protocol, which `mckibben rig run` reads"),
    ({"rig", "approach"}, "a joint rig, which `mckibben rig control` reads"),
    ({"law", "fit"}, "a fit, which is the `law` of a muscle"),
    ({"specimen", "law"}, "a muscle, which is the `muscle` of a joint"),
)
"""Keys that only one kind of file has, what it is, and what reads it."""


def kind_of(data: object, known: Collection[str] = ()) -> str:
    """Return what a file with this data is, and what reads it; empty if it may be of the kind with the `known` keys."""
    keys = {*data} if isinstance(data, dict) else set()
    return next((what for marks, what in _KINDS if marks <= keys and not marks <= {*known}), "")


def problems_of(error: ValidationError, document: Document, model: type[BaseModel]) -> list[Problem]:
    """The errors of a validation in the order of the file, without those that follow from another one."""
    details = error.errors(include_url=False)
    unknown = (detail["loc"] for detail in details if detail["type"] == "extra_forbidden")
    misspelt = {(*place[:-1], key) for place in unknown if (key := _closest_key(place, document, model))}
    causes = [detail.get("ctx", {}).get("error") for detail in details]
    all_follow = all(getattr(cause, "follows", False) for cause in causes)  # from errors that are not reported here
    problems = []
    for detail, cause in zip(details, causes, strict=True):
        place = detail["loc"]
        parent = getattr(cause, "parent", False)  # of a section that probably lacks only the key that is misspelt
        follows = (
            (detail["type"] == "missing" and place in misspelt)
            or (parent and any(key[:-1] == place[:-1] for key in misspelt))
            or (detail["type"] == "too_short" and any(other["loc"][:-1] == place for other in details))
            or (getattr(cause, "follows", False) and not all_follow)
        )
        if not follows and not document.is_rejected(place):
            problems.append(_problem(detail, document, model))
    return sorted([*document.problems, *problems], key=lambda problem: problem.line or 0)


_BEGINNING = 40  # characters of a file that are shown
# message and remedy by pydantic's kind of error
_MESSAGES = {
    "dict_type": ("{value} is given where names and sections are expected", "give a mapping with one name per section"),
    "tuple_type": ("{value} is given where a list is expected", "write [first, second, ...]"),
    "string_type": ("{value} is given where text is expected", "write one line of text"),
    "too_long": (
        "has {actual_length} items, more than {max_length}",
        "put them in a CSV file (samples: {{file: reference.csv}})",
    ),
    "too_short": ("has {actual_length} items, fewer than {min_length}", "give at least {min_length}"),
}


def _problem(detail: ErrorDetails, document: Document, model: type[BaseModel]) -> Problem:
    """Problem of one error of a validation."""
    kind, value, context, place = detail["type"], detail["input"], detail.get("ctx", {}), detail["loc"]
    if isinstance(error := context.get("error"), McKibbenError):
        return _raised(error, place, document, value)
    message, remedy = detail["msg"], ""
    if kind == "missing":
        message, remedy = "is missing", f"add it{_example(place, document, model)}"
    elif kind == "extra_forbidden":
        message, remedy = "is not a known key here", _remedy_of_key(place, document, model)
        if str(place[-1])[:1].isdigit() and value == "":
            message, remedy = "follows a comma", "write decimals with a point"
    elif value in ("", None):
        message, remedy = "has no value", "write one, or leave the key out"
    elif kind == "model_type" and not place and isinstance(value, str):  # of the whole file
        message = f"has no keys, and begins with {value[:_BEGINNING]!r}: it is another kind of file"
        remedy = f"give a mapping of {', '.join(_keys_of(model))}"
    elif kind == "model_type":
        message = f"{described(value, of_file=True)} is given where keys and values are expected"
        remedy = f"give a mapping of {', '.join(_keys_of(_model_at(place, document, model))) or 'the key `class`'}"
    elif kind in _MESSAGES:
        shown = {**context, "value": described(value, of_file=True)}
        message, remedy = (text.format(**shown) for text in _MESSAGES[kind])
        remedy += _example(place, document, model) if kind == "dict_type" else ""
    return Problem(message, document.line(place), dotted(place), remedy, value)


def _raised(error: McKibbenError, place: Place, document: Document, value: object) -> Problem:
    """Problem of an error that a validator raised, at the innermost place that the file has."""
    if isinstance(error, FileError):  # from a file that the text names
        first, *others = error.problems
        more = f" (and {len(others)} more)" if others else ""
        name = Path(error.source).name
        return Problem(f"{name}: {first}{more}", document.line(place), dotted(place), f"correct {name}", value)
    place = document.known(place[:-1] if isinstance(error, _ValidationError) and error.parent else place)
    keys = error.field.split(".") if error.field else ()
    place = document.known((*place, *(int(key) if key.isdigit() else key for key in keys)), place)
    return Problem.of(error, document.line(place), dotted(place))


def _example(place: Place, document: Document, model: type[BaseModel]) -> str:
    """Example of a missing key; empty without one."""
    parent = _model_at(place[:-1], document, model)
    names = {info.alias or name: info for name, info in parent.model_fields.items()} if parent else {}
    if (info := names.get(str(place[-1]))) is None:
        return ""
    examples = [*(info.examples or ()), *(getattr(mark, "example", "").strip("'") for mark in info.metadata)]
    if example := next(filter(None, examples), ""):
        return f", such as `{place[-1]}: {example}`"
    inner = model_in(info.annotation)
    return f", a mapping of {', '.join(_keys_of(inner))}" if inner else ""


def _closest_key(place: Place, document: Document, model: type[BaseModel]) -> str:
    """The key that an unknown one may stand for, one that is not given yet if there is one; else empty."""
    keys = _keys_of(_model_at(place[:-1], document, model))
    return closest(str(place[-1]), [key for key in keys if (*place[:-1], key) not in document.lines] or keys)


def _remedy_of_key(place: Place, document: Document, model: type[BaseModel]) -> str:
    """Remedy for an unknown key: the closest one, the section to which it belongs, or all keys."""
    key, keys = str(place[-1]), _keys_of(_model_at(place[:-1], document, model))
    nearest = _closest_key(place, document, model)
    owners = [name for name in keys if key in _keys_of(_model_at((*place[:-1], name), document, model))]
    return f"it is a key of {owners[0]}" if owners and not nearest else suggest(key, [nearest] if nearest else keys)


def _model_at(place: Place, document: Document, model: type[BaseModel]) -> type[BaseModel] | None:
    """The model that validates a place."""
    annotation, value = model, document.data
    for key in place:
        value = _item(value, key)
        marks: Sequence[object] = ()
        if get_origin(annotation) is dict:  # of sections, by names that people choose
            annotation = get_args(annotation)[1]
        elif not isinstance(key, int):
            section = model_in(annotation)
            fields = {info.alias or name: info for name, info in section.model_fields.items()} if section else {}
            if key not in fields:
                return None
            annotation, marks = fields[key].annotation, fields[key].metadata
        for mark in (*marks, *marks_in(annotation, ModelMark)):
            if isinstance(mark, ModelMark):
                annotation = mark.model_for(value) or annotation
    return None if get_origin(annotation) is dict else model_in(annotation)


def _item(value: Any, key: str | int) -> Any:
    try:
        return value[key]
    except (KeyError, IndexError, TypeError):
        return None


def _keys_of(model: type[BaseModel] | None) -> list[str]:
    return list(fields_by_key(model)) if model else []


@runtime_checkable
class ModelMark(Protocol):
    """Mark of a field whose model depends on its content."""

    def model_for(self, value: object) -> type[BaseModel] | None:
        """Return the model of a value of the field, for messages; None if it does not select one."""


def marks_in(hint: object, kind: type[M]) -> Iterator[M]:
    """Yield the marks of a class in a type such as ``Annotated[float, Mark] | None``, or in its parts."""
    for part in (*getattr(hint, "__metadata__", ()), *get_args(hint)):
        if isinstance(part, kind):
            yield part
        else:
            yield from marks_in(part, kind)


def model_in(annotation: object) -> type[BaseModel] | None:
    """The model in an annotation such as ``Model | None`` or ``tuple[Model, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(model_in, get_args(annotation))), None)
