"""Command lines that say all themselves, read without typer: making typer's commands takes as long as two imports of NumPy.

Read here is what typer would read alike. Whatever else there is (help, an abbreviation, a variable or a file with a default, a
value that does not fit, a word too many) is left to typer, which knows what to do or to say.
"""

from __future__ import annotations

import os
import re
from collections import deque
from collections.abc import Collection, Mapping
from pathlib import Path
from types import NoneType
from typing import get_args, get_origin

from imufield.cli.command import Command, Parameter, parameters
from imufield.commands.options.shared import UnfitValueError
from imufield.dataclass import MISSING, dataclass
from imufield.errors import UsageError

_INTEGER = re.compile(r"[+-]?[0-9]{1,18}")
_NUMBER = re.compile(r"[+-]?[0-9]+(?:\.[0-9]*)?(?:[eE][+-]?[0-9]{1,3})?")


class _UnclearError(Exception):
    """Typer is to read this one."""


@dataclass(frozen=True, slots=True)
class _Type:
    """Type of a value, and whether there are several."""

    of_one: object
    is_list: bool


def read(command: Command, words: list[str], defaults: Collection[str]) -> tuple[dict[str, object], frozenset[str]] | None:
    """Return the values of a command's parameters, and the names of those typed; None for what typer is to read.

    Parameters
    ----------
    command : Command
    words : list of str
        What was typed behind its name.
    defaults : collection of str
        Names of parameters that have a default elsewhere.
    """
    known = [*parameters(command.options)]
    if any(parameter.name in defaults or os.environ.get(_variable(parameter)) for parameter in known):
        return None
    try:
        found = _typed(known, deque(words))
        values = {parameter.name: _value(parameter, found.get(parameter.name)) for parameter in known}
    except (_UnclearError, UnfitValueError, UsageError):
        return None
    return values, frozenset(found)


def _variable(parameter: Parameter) -> str:
    return str(parameter.option.more.get("envvar", ""))


def _typed(known: list[Parameter], words: deque[str]) -> dict[str, list[str | bool]]:
    """Return the words of each parameter that was typed."""
    found: dict[str, list[str | bool]] = {}
    switches = {name: (parameter, is_on) for parameter in known for name, is_on in _names(parameter).items()}
    arguments: list[str | bool] = []
    while words:
        word = words.popleft()
        if not word.startswith("-"):
            arguments.append(word)
            continue
        name, equals, value = word.partition("=")
        parameter, is_on = switches.get(name, (None, None))
        # A short name takes an equals sign for a part of the value.
        if parameter is None or (equals and not (word.startswith("--") and is_on is None)):
            raise _UnclearError
        if is_on is None and not equals:
            value = words.popleft() if words else ""
            # Perhaps the next option, and the value was forgotten.
            if value.startswith("-"):
                raise _UnclearError
        found.setdefault(parameter.name, []).append(value if is_on is None else is_on)
    places = [parameter for parameter in known if parameter.option.is_argument]
    if len(places) == 1 and _type(places[0]).is_list and arguments:
        return {**found, places[0].name: arguments}
    if len(arguments) > len(places) or (len(places) > 1 and any(_type(place).is_list for place in places)):
        raise _UnclearError
    return {**found, **{place.name: [word] for place, word in zip(places, arguments, strict=False)}}


def _names(parameter: Parameter) -> dict[str, bool | None]:
    """Return what stands for an option, as typer has it, and of a switch which way it goes."""
    if parameter.option.is_argument:
        return {}
    own = parameter.name.replace("_", "-")
    if _type(parameter).of_one is not bool:
        return dict.fromkeys(parameter.option.names or (f"--{own}",))
    sides = [name.partition("/") for name in parameter.option.names or (f"--{own}/--no-{own}",)]
    return {**{on: True for on, _, _ in sides}, **{off: False for _, _, off in sides if off}}


def _type(parameter: Parameter) -> _Type:
    """Return the type of the values: of ``list[Path] | None`` it is ``Path``."""
    kind = get_args(parameter.annotation)[0]
    kinds = [each for each in get_args(kind) if each is not NoneType]
    if NoneType in get_args(kind) and len(kinds) == 1:
        kind = kinds[0]
    return _Type(get_args(kind)[0], is_list=True) if get_origin(kind) is list else _Type(kind, is_list=False)


def _value(parameter: Parameter, words: list[str | bool] | None) -> object:
    if words is None:
        if parameter.default is MISSING:
            raise _UnclearError
        return parameter.default
    kind, option = _type(parameter), parameter.option
    values = [_read_one(kind.of_one, word, option.more) for word in words]
    if not kind.is_list and len(values) > 1:
        raise _UnclearError
    value = values if kind.is_list else values[0]
    return value if option.check is None else option.check(value)


def _read_one(kind: object, word: str | bool, more: Mapping[str, object]) -> object:
    if isinstance(word, bool):
        return word
    if callable(parser := more.get("parser")):
        return parser(word)
    if not word:
        raise _UnclearError
    if kind is int and _INTEGER.fullmatch(word):
        return int(word)
    if kind is float and _NUMBER.fullmatch(word):
        return float(word)
    if kind is str:
        return word
    if kind is Path:
        return Path(word)
    raise _UnclearError
