"""The command line as typer has it: all commands, or the one that is run."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Collection, Iterable
from functools import partial
from typing import Annotated, cast

import typer
from typer.core import TyperCommand, TyperGroup

from imufield.cli.command import make_command
from imufield.cli.table import COMMANDS, NAMES
from imufield.sentences import Sentences, printable_lines
from imufield.version import __version__

sentence = Sentences(__package__)

# What typer raises for a wrong command line. The class has a public name in some versions only; this one has it in all.
_UsageError = cast("type[Exception]", typer.BadParameter.__bases__[0])


def _adapted(parameters: Iterable[object]) -> list[object]:
    """Return the parameters; help shows no type beside those that have no value, and what has none is not converted.

    What typer converts with is slow to import, and for a command without words not needed.
    """
    for parameter in (parameters := [*parameters]):
        own = vars(parameter)
        if own.get("is_flag"):
            own["metavar"] = ""
        if own["nargs"] == 1 and not own["multiple"] and not own["required"]:
            own["process_value"] = partial(_process_value, type(parameter).process_value, parameter)  # type: ignore[attr-defined]
    return parameters


def _process_value(process: Callable[..., object], parameter: object, context: typer.Context, value: object) -> object:
    return None if value is None else process(parameter, context, value)


class _Command(TyperCommand):
    def get_params(self, ctx: typer.Context) -> list[object]:  # type: ignore[override]  # typer names the base of it
        return _adapted(super().get_params(ctx))


class _Commands(TyperGroup):
    def get_params(self, ctx: typer.Context) -> list[object]:  # type: ignore[override]  # the same
        return _adapted(super().get_params(ctx))

    def invoke(self, ctx: typer.Context) -> object:  # type: ignore[override]  # typer names the base of it
        try:
            return super().invoke(ctx)
        except _UsageError as error:
            # What it quotes may be a name that a shell filled in, and typer prints it itself.
            vars(error)["message"] = printable_lines(str(vars(error)["message"]))
            raise


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"imufield {__version__}")
        raise typer.Exit


def _root(
    context: typer.Context,
    version: Annotated[  # noqa: ARG001  (answered by its callback, before a command is asked for)
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    from imufield.commands.configuration import default_map

    context.default_map = default_map()


boxes = True
"""Whether an error stands in a box, for a person at a terminal; else its sentence is the last line."""


def make_app(wanted: Collection[str] = NAMES) -> typer.Typer:
    """Return the command line with these commands; making one takes a millisecond, and its options must be imported."""
    made = typer.Typer(
        name="imufield",
        cls=_Commands,
        help=sentence("root.program"),
        no_args_is_help=True,
        context_settings={"help_option_names": ["--help", "-h"]},
        pretty_exceptions_enable=False,
        rich_markup_mode="rich" if boxes else None,
    )
    made.callback()(_root)
    for panel, commands in COMMANDS.items():
        for name in (name for name in commands if name in wanted):
            place, work, key = commands[name]
            module, _, options = place.partition(".")
            kind = getattr(importlib.import_module(f"imufield.commands.options.{module}"), options)
            command = make_command(kind, work, told=sentence(key))
            made.command(name, cls=_Command, rich_help_panel=panel)(command)
    return made
