"""The command line as typer has it: all commands, or the one that is run."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterable
from functools import partial
from typing import Annotated, cast, get_args

import typer
from typer.core import TyperCommand, TyperGroup

from imufield.cli.command import Command, Parameter, find_command, parameters
from imufield.cli.table import COMMANDS, NAMES
from imufield.commands.options.shared import UnfitValueError, read_number
from imufield.dataclass import MISSING
from imufield.sentences import Sentences, printable_lines
from imufield.version import __version__

sentence = Sentences(__package__)

# What typer raises for a wrong command line. The class has a public name in some versions only; this one has it in all.
_UsageError = cast("type[Exception]", typer.BadParameter.__bases__[0])


def _adapted(parameters: Iterable[object]) -> list[object]:
    """Return the parameters; help shows no type of those without a value, and no list; what has none is not converted.

    What typer converts with is slow to import, and for a command without words not needed.
    """
    for parameter in (parameters := [*parameters]):
        own = vars(parameter)
        if own.get("is_flag"):
            own["metavar"] = ""
        if own["nargs"] != 1 or own["multiple"]:
            own["bare_type"] = partial(_type_of_one, parameter)
        if own["nargs"] == 1 and not own["multiple"] and not own["required"]:
            own["process_value"] = partial(_process_value, type(parameter).process_value, parameter)  # type: ignore[attr-defined]
    return parameters


def _type_of_one(parameter: object) -> str:
    """Return the type that help shows of a list: that of one value, without ``list[...]`` of Python."""
    kind: type = get_args(parameter.type_descriptor.annotation)[0]  # type: ignore[attr-defined]  # one of typer
    return kind.__name__.lower()


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
    from imufield.commands.options.configuration import default_map

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
            made.command(name, cls=_Command, rich_help_panel=panel)(_function(find_command(name)))
    return made


def _function(command: Command) -> Callable[..., None]:
    """Return the function from which typer makes a command."""

    def function(context: typer.Context, **values: object) -> None:
        # A value that was typed contradicts another; a default of file or variables steps back.
        sources = {name: context.get_parameter_source(name) for name in values}
        typed = frozenset(name for name, source in sources.items() if source is not None and source.name == "COMMANDLINE")
        if code := command.run(values, typed):
            raise typer.Exit(code)

    first = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    given = [first, *map(_parameter, parameters(command.options))]
    function.__doc__ = "\n\n".join([sentence(command.told), *(inspect.getdoc(command.options) or "").split("\n\n")[1:]])
    function.__signature__ = inspect.Signature(given)  # type: ignore[attr-defined]  # what inspect and typer read
    function.__annotations__ = {parameter.name: parameter.annotation for parameter in given}
    return function


def _parameter(of: Parameter) -> inspect.Parameter:
    option, more = of.option, {**of.option.more}
    # Files are opened by the commands, which say what is wrong with one and how to go on.
    more["readable"] = False
    if option.check is not None:
        more["callback"] = _saying_why(option.check)
    kind = get_args(of.annotation)[0]
    for number in (float, int):
        if number in (kind, *get_args(kind)):
            # What typer says of a word that is none names neither the word nor the remedy.
            more = {"parser": partial(read_number, kind=number), "metavar": f"<{number.__name__}>", **more}
    if callable(parser := more.get("parser")):
        more["parser"] = _saying_why(parser)
    # What typer knows of them is checked by it.
    make = cast("Callable[..., object]", typer.Argument if option.is_argument else typer.Option)
    made = make(*option.names, **more)
    default = inspect.Parameter.empty if of.default is MISSING else of.default
    annotation: object = Annotated[kind, made]
    return inspect.Parameter(of.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _saying_why(check: Callable[..., object]) -> Callable[[object], object]:
    """Return the check of a value whose refusal is one of typer."""

    def checked(value: object) -> object:
        try:
            return check(value)
        except UnfitValueError as error:
            raise typer.BadParameter(str(error)) from error

    return checked
