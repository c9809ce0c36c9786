"""Help of commands, errors of their usage, and completion of values."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from mckibben.errors import ParameterError, closest, quoted

MORE = "More options"
"""Panel of options that only --help-all shows."""
_UsageError: Any = typer.BadParameter.__base__
_MEANT = {
    "run": "simulate",
    "fit": "identify",
    "plot": "identify DATA --out DIR",
    "laws": "catalog",
    "specimens": "catalog",
    "help": "-h",
}


class Helping:
    """Help of commands and groups: `--help` has everyday options with their first clause, `--help-all` all."""

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        """Return the arguments that are left; an error of usage names the option that is meant."""
        of, given = super(), list(args)
        if "--help-all" in (args[:1] if hasattr(self, "commands") else args):
            ctx.obj = MORE
            typer.echo(self.get_help(ctx))  # type: ignore[attr-defined]
            raise typer.Exit
        try:
            return of.parse_args(ctx, args)  # type: ignore[misc]
        except _UsageError as error:
            if not given and getattr(self, "no_args_is_help", False):
                raise  # prints the help
            message = " ".join(error.format_message().split()).replace("Value error, ", "").rstrip(".")
            text = f"{ctx.command_path}: {message}"
            typed, choices = (re.findall(r"'([^']*)'", side) for side in text.rpartition(" is not one of ")[::2])
            meant = closest(typed[-1], choices) if typed else ""
            did = f"did you mean {meant!r}? if not, " if meant else ""
            raise ParameterError(text, remedy=f"{did}see {ctx.command_path} --help") from None

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write panels of arguments, options and commands."""
        whole, panels = ctx.obj == MORE, dict[str, list[tuple[str, str]]]()
        for param in self.get_params(ctx):  # type: ignore[attr-defined]
            is_option = param.param_type_name == "option"
            panel = getattr(param, "rich_help_panel", None) or ("Options" if is_option else "Arguments")
            if not getattr(param, "hidden", False) and (whole or panel != MORE):
                panels.setdefault(panel, []).append((_heading(param, is_option), _text(param, whole)))
        for name, command in getattr(self, "commands", {}).items():
            panels.setdefault(command.rich_help_panel or "Commands", []).append((name, _clause(command.help or "")))
        for title, rows in panels.items():
            with formatter.section(title):
                formatter.write_dl(rows, col_max=26)
        if not whole:
            formatter.write_paragraph()
            formatter.write_text("All options, their defaults and whole descriptions: --help-all")


def _heading(param: Any, is_option: bool) -> str:
    value = param.metavar or ("" if getattr(param, "is_flag", False) else param.name.upper())
    return f"{', '.join(param.opts)} {value}".rstrip() if is_option else value


def _text(param: Any, whole: bool) -> str:
    """Description of a parameter, whole with its default."""
    text, default = param.help or "", param.default
    has_default = whole and default and isinstance(default, str | int | float) and "default" not in text
    return f"{text} [default: {default}]" if has_default and default is not True else text if whole else _clause(text)


def _clause(text: str) -> str:
    """First clause of a text, without what is in parentheses."""
    return re.split(r"[.;] |\n", re.sub(r" \([^()]*\)", "", text), maxsplit=1)[0].rstrip(".;")


class Command(Helping, TyperCommand):
    """A command."""


class Commands(Helping, TyperGroup):
    """Commands; an unknown one is an error that suggests the closest one, or lists all."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return name, command and other arguments."""
        if self.get_command(ctx, args[0]) is None and not args[0].startswith("-"):
            commands = self.list_commands(ctx)
            meant = (_MEANT.get(args[0]) if ctx.parent is None else "") or closest(args[0], commands)
            remedy = f"did you mean `{ctx.command_path} {meant}`?" if meant else f"known are {', '.join(commands)}"
            raise ParameterError(f"{ctx.command_path} has no command {quoted(args[0])}", value=args[0], remedy=remedy)
        return super().resolve_command(ctx, args)


def completion(name: str, metavar: str = "") -> Callable[[Any, str], list[str]]:
    """Return the function that completes the values of an option or argument: known ones, and files."""

    def complete(ctx: Any, incomplete: str) -> list[str]:
        words = metavar.split("|") if metavar.islower() else []
        values = [*_values(name, ctx), *words, *map(str, Path().glob(f"{incomplete}*"))]
        return [value for value in values if value.startswith(incomplete)]

    return complete


_ENTRIES = {"data": ("datasets", ""), "joint": ("joints", ""), "law": ("laws", ""), "read": ("specimens", "specimen=")}
"""Kinds of entries of the catalog that a parameter takes, and what precedes them."""


def _values(name: str, ctx: Any) -> Iterable[str]:
    """Names of the catalog, of laws, or of the parameters of the scenario that stands before an option."""
    if name in ("over", "conditions", "model_follows"):
        from mckibben.scenario import Scenario, list_parameters

        paths = [word for word in ctx.args if word.endswith((".yaml", ".yml"))]
        return [parameter.name for path in paths[:1] for parameter in list_parameters(Scenario.read(path))]
    if name not in _ENTRIES:
        return []
    from mckibben import catalog
    from mckibben.muscle import LAWS

    (kind, prefix), laws = _ENTRIES[name], [law.removesuffix("Law").lower() for law in LAWS]
    return [*(laws if name == "law" else []), *(f"{prefix}{entry}" for entry in catalog.names(kind))]
