"""Base model of configuration files; files to models, with line, field and remedy of every mistake."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, NoReturn, Protocol, Self, TypeVar, cast, get_args, runtime_checkable

from pydantic import (
    BaseModel,
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic.fields import FieldInfo
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
from mckibben.storage.files import atomic_write, similar_file
from mckibben.units import HINGE, JointType


class ConfigModel(BaseModel):
    """Base of sections of configuration files: frozen, without unknown keys.

    A section adds remedies to the errors of its own keys: the closest known key, an example of a missing one.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    @model_validator(mode="wrap")
    @classmethod
    def _explain_keys(cls, value: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return handler(value)
        except ValidationError as error:
            raise _Keys(cls, value).explained(error) from None


class DocumentModel(ConfigModel):
    r"""Base of files, which are read with all their mistakes at once, and written back to the last bit.

    Attributes
    ----------
    kind, examples
        What such a file is, and the path of an example, for messages.

    Examples
    --------
    >>> class Pulley(DocumentModel):
    ...     kind: ClassVar[str] = "pulley"
    ...     radius: float
    ...     groove: float = 0.0
    >>> Pulley.parse("radus: 1\ngrove: 2", source="pulley.yaml")
    Traceback (most recent call last):
        ...
    mckibben.errors.ScenarioError: pulley.yaml: 2 problems
      line 1, radus: is not a known key here; did you mean 'radius'?
      line 2, grove: is not a known key here; did you mean 'groove'?
    """

    kind: ClassVar[str] = "scenario"
    examples: ClassVar[str] = "examples/"

    def __init__(self, /, *args: object, **fields: Any) -> None:
        if args:
            name = type(self).__name__
            remedy = f"to read a file, write {name}.read({args[0]!r:.60})"
            raise CallError(f"{name} takes its fields by name", remedy=remedy)
        try:
            self.__pydantic_validator__.validate_python(fields, self_instance=self, context={})
        except ValidationError as error:
            raise ScenarioError(type(self).__name__, _problems(error, Document(fields))) from None

    @field_validator("*", mode="after")
    @classmethod
    def _not_none(cls, value: Any, info: ValidationInfo) -> Any:
        if value is None and type(None) not in get_args(cls.model_fields[str(info.field_name)].annotation):
            fail_validation("cannot be none", "give a class and its fields, or a name of the catalog")
        return value

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # files are validated without it

    @classmethod
    def read(cls, path: str | os.PathLike[str], **context: JointType) -> Self:
        """Read a file; a `JointDocument` takes a `joint_type` as well.

        Raises
        ------
        ScenarioError
            With every problem of the file: line, field, value, range and remedy.
        """
        text = read_text(path, f"a {cls.kind}", cls.examples)
        return cls.parse(text, source=os.fspath(path), folder=Path(path).parent, **context)

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
        """Return a copy with other values of fields, given and checked as those of the constructor.

        Raises `ScenarioError` with every problem, as the constructor does.
        """
        fields = {field.alias or name: getattr(self, name) for name, field in type(self).model_fields.items()}
        return type(self)(**{**fields, **changes})

    def __dir__(self) -> list[str]:
        return [name for name in super().__dir__() if name.startswith("_") or not hasattr(BaseModel, name)]

    def to_yaml(self, path: str | os.PathLike[str]) -> None:
        """Write a file that `read` reads back to the last bit."""
        with atomic_write(path, overwrite=True) as temporary:
            temporary.write_text(self.dumps(folder=Path(path).parent), encoding="utf-8")

    def dumps(self, *, folder: str | os.PathLike[str] = ".") -> str:
        """Return text that `parse` reads back to the last bit; paths are relative to a folder."""
        return to_text(self._written(Path(folder)))

    def _written(self, folder: Path) -> dict[str, Any]:
        return self.model_dump(mode="json", by_alias=True, context={"folder": folder})


def fields_by_key(model: type[BaseModel]) -> dict[str, str]:
    """Names of the fields by their keys in a file, which may be aliases such as ``class``."""
    return {info.alias or name: name for name, info in model.model_fields.items()}


class _ValidationError(McKibbenError, ValueError):
    """A mistake found by a validator; `follows`: from another one."""

    def __init__(self, message: str, *, follows: bool, **details: Any) -> None:
        super().__init__(message, **details)
        self.follows = follows


def fail_validation(
    message: str, remedy: str = "", *, follows: bool = False, value: object = None, field: str | None = None
) -> NoReturn:
    """Report a mistake from within a validator, which becomes a `Problem` with the line of the validated value.

    Parameters
    ----------
    message, remedy
        Predicate about the value, such as "is longer than the run", and what to do.
    value
        The value, unless it is that of the validator.
    follows
        Whether it follows from others, and is left out if there are others.
    field
        Key, or keys joined by dots, below the place of the validator.
    """
    raise _ValidationError(message, remedy=remedy, follows=follows, value=value, field=field)


def with_changes(content: object, section: Mapping[str, object]) -> object:
    """Content to which a section's ``from`` refers, with the section's other keys.

    Mappings are merged key by key, lists of parts by the names of the parts.

        >>> with_changes({"links": [{"name": "shank", "mass": "1 kg"}]}, {"links": {"shank": {"mass": "2 kg"}}})
        {'links': ({'name': 'shank', 'mass': '2 kg'},)}
    """
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
        names = [entry.get("name", entry.get("over")) if isinstance(entry, dict) else None for entry in content]
        for name in changes:
            if name not in names:
                fail_validation(f"there is no part {quoted(name)}", suggest(name, list(filter(None, names))))
        return tuple(_merged(entry, changes.get(name, {})) for name, entry in zip(names, content, strict=True))
    content = {"from": content} if isinstance(content, str) else content
    return {**content, **{key: _merged(content.get(key), change) for key, change in changes.items()}}


def read_text(path: str | os.PathLike[str], what: str = "a scenario", example: str = "examples/") -> str:
    """Return the text of a configuration file, in UTF-8.

    `what` and `example` are named in the `ScenarioError` that is raised if there is none, or one that is too long.
    """
    if not isinstance(path, str | os.PathLike):
        raise ScenarioError(what, [Problem(f"{path!r:.60} is not a path", remedy=f"give one, see {example}")])
    longest, remedy = 4 * LONGEST_TEXT, f"give the path of {what}, see {example}"
    try:
        with Path(path).open("rb") as file:
            content = file.read(longest + 1)
        if len(content) <= longest:
            return content.decode("utf-8-sig")
        problem = Problem(f"is longer than {LONGEST_TEXT} characters")
    except UnicodeDecodeError:
        problem = Problem("is not text in UTF-8", remedy="give a YAML file")
    except (OSError, ValueError) as error:  # of a null character in the path
        similar = similar_file(Path(path)) if isinstance(error, FileNotFoundError) else ""
        reason = getattr(error, "strerror", "") or str(error)
        problem = Problem(f"cannot be read: {reason}", remedy=f"{similar} if not, {remedy}" if similar else remedy)
    raise ScenarioError(os.fspath(path), [problem])


def located_below(error: ValidationError, place: Place, *, shorthand: bool = False) -> ValidationError:
    """Return the mistakes of a validation as those of a section below a place.

    Of a `shorthand`, one value in place of the only field of the section, the key of the field is left out.
    """
    details: Any = [{**item, "loc": (*place, *item["loc"][shorthand:])} for item in error.errors(include_url=False)]
    return ValidationError.from_exception_data(error.title, details)


P = TypeVar("P", bound=DocumentModel)
M = TypeVar("M")


class JointDocument(DocumentModel):
    """Base of documents beside that of a joint, whose units are those of the joint."""

    @classmethod
    def parse(
        cls, text: str, *, source: str = "", folder: str | os.PathLike[str] = ".", joint_type: JointType = HINGE
    ) -> Self:
        """Read YAML text, of a slide in its units (`joint_type=mckibben.units.SLIDE`)."""
        return parse_model(cls, text, source=source or cls.kind, folder=folder, joint_type=joint_type)[0]


def parse_model(
    kind: type[P], text: str, *, source: str, folder: str | os.PathLike[str] = ".", **context: object
) -> tuple[P, Document]:
    """Return a model from YAML text, and the document with its lines.

    A text that is `confined` may name only files in its folder. Raises `ScenarioError` with every problem of the text.
    """
    document, context = read_document(text), {"confined": False, **context, "folder": Path(folder)}
    expected = f"a {kind.kind}, see {kind.examples}"
    return validated(kind.model_validate, document, source, context, fields_by_key(kind), expected), document


def validated(
    validate: Callable[..., Any],
    document: Document,
    source: str,
    context: Mapping[str, object],
    keys: Collection[str],
    expected: str,
) -> Any:
    """Return the data of a document, validated by pydantic.

    Raises `ScenarioError` with every problem, or with one if the `keys` show that another kind of file is `expected`.
    """
    if document.data is None:
        raise ScenarioError(source, document.problems)
    try:
        value = validate(document.data, context=context)
    except ValidationError as error:
        if other := _kind_of(document.data, keys):
            raise ScenarioError(source, [Problem(f"is {other}", remedy=f"give {expected}")]) from None
        raise ScenarioError(source, _problems(error, document)) from None
    if document.problems:
        raise ScenarioError(source, document.problems)
    return value


_KINDS = (
    ({"robot"}, "a robot, which `mckibben robot`, `simulate`, `margins`, `tune`, `sweep`, `compare` and `export` read"),
    ({"controllers", "references"}, "a suite, which `mckibben compare` reads"),
    ({"joint", "controller", "reference"}, "a scenario of a joint, which `mckibben simulate` reads"),
    ({"muscle", "rig"}, "a protocol, which `mckibben rig run` reads"),
    ({"rig", "approach"}, "a joint rig, which `mckibben rig control` reads"),
    ({"law", "fit"}, "a fit, which is the `law` of a muscle"),
    ({"specimen", "law"}, "a muscle, which is the `muscle` of a joint"),
)
"""Keys that only one kind of file has, what it is, and what reads it."""


def _kind_of(data: object, fields: Collection[str]) -> str:
    """What a file with this data is, and what reads it; empty if it may be of the kind with the `known` keys."""
    keys = {*data} if isinstance(data, dict) else set()
    return next((what for marks, what in _KINDS if marks <= keys and not marks <= {*fields}), "")


_MISSING, _UNKNOWN = "is missing", "is not a known key here"


class _Keys:
    """Keys of a section in a file: known ones, given ones, and for each unknown one the closest, or nothing."""

    def __init__(self, model: type[BaseModel], value: object) -> None:
        self.known = {info.alias or name: info for name, info in model.model_fields.items()}
        self.given: dict[str, object] = value if isinstance(value, dict) else {}
        free = [name for name in self.known if name not in self.given] or [*self.known]
        self.meant = {key: closest(str(key), free) for key in self.given if key not in self.known}

    def explained(self, error: ValidationError) -> ValidationError:
        """Return an error with remedies, without missing keys for which an unknown one probably stands."""
        details = []
        for detail in error.errors(include_url=False):
            message, remedy = self._text(detail)
            if message:
                entered = None if detail["type"] == "missing" else detail["input"]
                cause = _ValidationError(message, remedy=remedy, follows=False, value=entered)
                detail = {"type": "value_error", "loc": detail["loc"], "input": entered, "ctx": {"error": cause}}
            if message is not None:
                details.append(detail)
        return ValidationError.from_exception_data(error.title, cast(Any, details))

    def _text(self, detail: ErrorDetails) -> tuple[str | None, str]:
        """Message and remedy for a key of the section; empty for another error, None for one that follows."""
        kind, place, value = detail["type"], detail["loc"], detail["input"]
        message, key = f"{described(value, of_file=True)} is given where ", str(place[0]) if len(place) == 1 else ""
        if key and kind == "missing":
            return (None, "") if key in self.meant.values() else (_MISSING, f"add it{self._example(key)}")
        if key and kind == "extra_forbidden":
            if key[0].isdigit() and value == "":
                return "follows a comma", "write decimals with a point"
            return _UNKNOWN, self._remedy(key)
        if key and kind == "dict_type" and value not in ("", None):
            remedy = f"give a mapping with one name per section{self._example(key)}"
            return f"{message}names and sections are expected", remedy
        if not place and str(value).lstrip().startswith("<"):
            return f"{message}YAML is expected", "of MJCF or URDF, `mckibben robot read FILE` makes a file of a robot"
        if not place and kind == "model_type" and value not in ("", None):
            return f"{message}keys and values are expected", f"give a mapping of {', '.join(self.known)}"
        return "", ""

    def _example(self, key: str) -> str:
        """Example of a missing key; empty without one."""
        info = self.known[key]
        examples = [*(info.examples or ()), *(getattr(mark, "example", "").strip("'") for mark in info.metadata)]
        if example := next(filter(None, examples), ""):
            return f", such as `{key}: {example}`"
        keys = _keys_of(info, None)
        return f", a mapping of {', '.join(keys)}" if keys else ""

    def _remedy(self, key: str) -> str:
        """Remedy for an unknown key: the closest one, the section to which it belongs, or all keys."""
        if meant := self.meant[key]:
            return suggest(key, [meant])
        owners = (name for name, info in self.known.items() if key in _keys_of(info, self.given.get(name)))
        return f"it is a key of {owner}" if (owner := next(owners, "")) else suggest(key, [*self.known])


def _problems(error: ValidationError, document: Document) -> list[Problem]:
    """The errors of a validation in the order of the file, without those that follow from another one."""
    details = error.errors(include_url=False)
    causes = [detail.get("ctx", {}).get("error") for detail in details]
    all_follow = all(getattr(cause, "follows", False) for cause in causes)  # from errors that are not reported here
    problems = []
    for detail, cause in zip(details, causes, strict=True):
        place = detail["loc"]
        follows = (detail["type"] == "too_short" and any(other["loc"][:-1] == place for other in details)) or (
            getattr(cause, "follows", False) and not all_follow
        )
        if not follows and not document.is_rejected(place):
            problems.append(_problem(detail, document))
    return sorted([*document.problems, *_indented(problems)], key=lambda problem: problem.line or 0)


def _indented(problems: list[Problem]) -> Iterator[Problem]:
    """Yield the problems; a missing key of the file that stands in another section is indented too far."""
    missing = {problem.field for problem in problems if problem.message == _MISSING}
    keys = {problem.field: problem.field.rpartition(".")[2] for problem in problems if problem.message == _UNKNOWN}
    deeper = {field: key for field, key in keys.items() if key in missing - {field}}
    for problem in problems:
        if problem.field in deeper:
            yield replace(problem, message="is indented too far: it is a key of the file", remedy="indent it less")
        elif problem.field not in deeper.values():
            yield problem


# message and remedy by pydantic's kind of error
_MESSAGES = {
    "tuple_type": ("{value} is given where a list is expected", "write [first, second, ...]"),
    "string_type": ("{value} is given where text is expected", "write one line of text"),
    "too_long": (
        "has {actual_length} items, more than {max_length}",
        "put them in a CSV file (samples: {{file: reference.csv}})",
    ),
    "too_short": ("has {actual_length} items, fewer than {min_length}", "give at least {min_length}"),
}


def _problem(detail: ErrorDetails, document: Document) -> Problem:
    """Problem of one error of a validation."""
    value, context, place = detail["input"], detail.get("ctx", {}), detail["loc"]
    if isinstance(error := context.get("error"), McKibbenError):
        return _raised(error, place, document, value)
    message, remedy = detail["msg"], ""
    if value in ("", None):
        message, remedy = "has no value", "write one, or leave the key out"
    elif texts := _MESSAGES.get(detail["type"]):
        values = {**context, "value": described(value, of_file=True)}
        message, remedy = (text.format(**values) for text in texts)
    return Problem(message, document.line(place), dotted(place), remedy, value)


def _raised(error: McKibbenError, place: Place, document: Document, value: object) -> Problem:
    """Problem of an error that a validator raised, at the innermost place that the file has."""
    if isinstance(error, FileError):  # from a file that the text names
        first, *others = error.problems
        more = f" (and {len(others)} more)" if others else ""
        name = Path(error.source).name
        return Problem(f"{name}: {first}{more}", document.line(place), dotted(place), f"correct {name}", value)
    keys = error.field.split(".") if error.field else ()
    place = document.known((*place, *(int(key) if key.isdigit() else key for key in keys)), place)
    return Problem.of(error, document.line(place), dotted(place))


@runtime_checkable
class HasKeys(Protocol):
    """Mark of a field whose keys depend on its content."""

    def section_keys(self, value: object) -> Collection[str]:
        """Return the keys that a section may have, for messages; none if it does not select a class."""


def _keys_of(info: FieldInfo, value: object) -> Collection[str]:
    """Keys of the section of a field."""
    for mark in (*info.metadata, *marks_in(info.annotation, HasKeys)):
        if isinstance(mark, HasKeys):
            return mark.section_keys(value)
    model = _model_in(info.annotation)
    return fields_by_key(model) if model else ()


def marks_in(hint: object, kind: type[M]) -> Iterator[M]:
    """Yield the marks of a class in a type such as ``Annotated[float, Mark] | None``, or in its parts.

    >>> from typing import Annotated
    >>> list(marks_in(tuple[Annotated[float, "N", 3], ...] | None, str))
    ['N']
    """
    for argument in get_args(hint):
        if isinstance(argument, kind):
            yield argument
        else:
            yield from marks_in(argument, kind)


def _model_in(annotation: object) -> type[BaseModel] | None:
    """The model in an annotation such as ``Model | None`` or ``tuple[Model, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model_in, get_args(annotation))), None)
