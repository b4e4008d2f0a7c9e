"""What the options of a command are, and how what was typed runs it."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from typing import Annotated, get_args, get_origin

from imufield.cli.table import COMMANDS
from imufield.commands.options.shared import Converted, Group, Option
from imufield.dataclass import Field, dataclass, fields
from imufield.progress import shown


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """An option or argument as it is typed: name of its field, ``Annotated`` type, its mark, and default (or ``MISSING``)."""

    name: str
    annotation: object
    option: Option
    default: object


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """A command of the table.

    Attributes
    ----------
    name : str
    options : type
        Dataclass of its options; its docstring, from the second paragraph, goes on with the help (see
        ``commands.options.shared``).
    work : str
        "module.function" below ``imufield.commands``, imported when the command runs, and called with the options; an int that
        it returns is the exit code.
    told : str
        Key of what it does, the first paragraph of the help.
    """

    name: str
    options: type
    work: str
    told: str

    def run(self, values: Mapping[str, object], typed: frozenset[str]) -> int:
        """Run it with the values of its parameters, and the names of those that were typed; return the exit code."""
        module, _, function = self.work.rpartition(".")
        # Packages that a command needs may be slow to import.
        with shown(self.name):
            code = getattr(importlib.import_module(f"imufield.commands.{module}"), function)(
                _build(self.options, values, typed)
            )
        return code if type(code) is int else 0


def find_command(name: str) -> Command:
    """Return a command of the table, whose options are imported."""
    place, work, told = next(commands[name] for commands in COMMANDS.values() if name in commands)
    module, _, options = place.partition(".")
    kind = getattr(importlib.import_module(f"imufield.commands.options.{module}"), options)
    return Command(name=name, options=kind, work=work, told=told)


def _mark(entry: Field[object]) -> object:
    """Return what makes a field an option; None for the others."""
    return get_args(entry.type)[1] if get_origin(entry.type) is Annotated else None


def parameters(options: type) -> Iterator[Parameter]:
    """Yield what can be typed, in the order of the help."""
    for entry in fields(options):
        mark = _mark(entry)
        if isinstance(mark, Group):
            yield from parameters(mark.arguments)
        elif isinstance(mark, Converted):
            typed_as = mark.typed_as
            yield Parameter(name=entry.name, annotation=typed_as, option=get_args(typed_as)[1], default=None)
        elif isinstance(mark, Option):
            yield Parameter(name=entry.name, annotation=entry.type, option=mark, default=entry.default)


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
