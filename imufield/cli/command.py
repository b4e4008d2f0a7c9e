"""Commands of typer made from options classes: a parameter for each option, and back from what was typed to the options."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, Field, fields
from typing import Annotated, get_args, get_origin

import typer

from imufield.commands.options.shared import Converted, Group
from imufield.progress import shown


def make_command(options: type, work: str, told: str) -> Callable[..., None]:
    """Return the function of a command.

    Parameters
    ----------
    options : type
        Dataclass of its options; its docstring, from the second paragraph, goes on with the help (see
        ``commands.options.shared``).
    work : str
        "module.function" below ``imufield.commands``, imported when the command runs, and called with the options; an int that
        it returns is the exit code.
    told : str
        What it does: the first paragraph of the help.
    """

    def command(context: typer.Context, **values: object) -> None:
        # A value that was typed contradicts another; a default of file or variables steps back.
        sources = {name: context.get_parameter_source(name) for name in values}
        typed = frozenset(name for name, source in sources.items() if source is not None and source.name == "COMMANDLINE")
        module, _, function = work.rpartition(".")
        # Packages that a command needs may be slow to import.
        with shown(str(context.info_name)):
            code = getattr(importlib.import_module(f"imufield.commands.{module}"), function)(_build(options, values, typed))
        if type(code) is int:
            raise typer.Exit(code)

    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    parameters = [context, *_parameters(options)]
    command.__doc__ = "\n\n".join([told, *(inspect.getdoc(options) or "").split("\n\n")[1:]])
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # what inspect and typer read
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command


def _mark(entry: Field[object]) -> object:
    """Return what makes a field an option; None for the others."""
    return get_args(entry.type)[1] if get_origin(entry.type) is Annotated else None


def _parameters(options: type) -> Iterator[inspect.Parameter]:
    for entry in fields(options):
        mark = _mark(entry)
        if isinstance(mark, Group):
            yield from _parameters(mark.arguments)
        elif isinstance(mark, Converted):
            yield inspect.Parameter(entry.name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=mark.typed_as)
        elif mark is not None:
            default = inspect.Parameter.empty if entry.default is MISSING else entry.default
            yield inspect.Parameter(entry.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=entry.type)


def _build(options: type, values: Mapping[str, object], typed: frozenset[str]) -> object:
    """Return the options that were typed, or have a default of file or variables."""
    made: dict[str, object] = {}
    for entry in fields(options):
        mark = _mark(entry)
        if isinstance(mark, Group):
            made[entry.name] = mark.build(_build(mark.arguments, values, typed), typed)
        elif isinstance(mark, Converted):
            made[entry.name] = mark.convert(values[entry.name])
        elif mark is not None:
            made[entry.name] = values[entry.name]
    return options(**made)
