"""The man page of imufield, from what ``--help`` says: ``python .ci/man_page.py FILE`` writes it.

``make wheel`` puts it where ``man imufield`` finds it, ``make docs`` beside the pages. What is generated is never stored, so it
cannot be out of date.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer.main import get_command

from imufield.cli.app import make_app
from imufield.errors import EXIT_INTERRUPTED, ImufieldError
from imufield.version import __version__

FILES = {
    "imufield.toml": "Defaults of a folder, written by imufield init; in the configuration folder those of a user.",
    "imufield-sessions/": "Where capture, record and import put sessions, a folder each.",
    "SESSION/parameters.toml": "The result of solve.",
}


def man_page() -> str:
    """Return the page, in the macros of man(7)."""
    return "\n".join(line for line in lines() if line) + "\n"


def lines() -> Iterator[str]:
    """Yield its lines."""
    group: Any = get_command(make_app())
    yield f'.TH IMUFIELD 1 "" "imufield {__version__}" "User Commands"'
    # Words whole, and only the left side even: names of options and ports are long. Every heading sets both from these.
    yield ".nr HY 0\n.ds AD l\n.nh\n.ad l"
    yield f".SH NAME\nimufield \\- {roff(group.help[0].lower() + group.help[1:].rstrip('.'))}"
    yield ".SH SYNOPSIS\n.B imufield\n.RI [ option ...]\n.I command\n.RI [ argument ...]"
    yield ".SH OPTIONS"
    yield from options(group)
    yield ".TP\n.B \\-\\-help, \\-h\nHelp; behind a command, of that command."
    yield ".SH COMMANDS"
    for name, command in group.commands.items():
        yield from command_lines(name, command)
    yield ".SH ENVIRONMENT"
    variables = {one.envvar: one for command in group.commands.values() for one in command.params if shown(one) and one.envvar}
    for variable, one in sorted(variables.items()):
        yield f".TP\n.B {roff(variable)}\nDefault of {roff(max(one.opts, key=len))}."
    yield ".SH FILES"
    for file, words in FILES.items():
        yield f".TP\n.I {roff(file)}\n{roff(words)}"
    yield ".SH EXIT STATUS\n.TP\n0\nDone.\n.TP\n1\nA defect of imufield, with its traceback."
    kinds = ImufieldError.__subclasses__()
    for code in sorted({kind.exit_code for kind in kinds}):
        yield f".TP\n{code}\n{roff(' '.join(inspect.getdoc(kind) or '' for kind in kinds if kind.exit_code == code))}"
    yield f".TP\n{EXIT_INTERRUPTED}\nInterrupted."


def command_lines(name: str, command: Any) -> Iterator[str]:
    """Yield the section of a command."""
    arguments = " ".join(argument(one) for one in command.params if one.param_type_name == "argument")
    yield f".SS {roff(f'imufield {name} {arguments}'.strip())}"
    words, *examples = inspect.cleandoc(command.help or "").split("Example:")
    for paragraph in words.strip().split("\n\n"):
        yield f"{roff(paragraph)}\n.PP"
    yield from options(command)
    for example in examples:
        yield f".PP\n$ {roff(example)}"


def options(command: Any) -> Iterator[str]:
    """Yield what help says of each argument and option."""
    for one in filter(shown, command.params):
        is_option = one.param_type_name == "option"
        spelled = ", ".join((*one.opts, *one.secondary_opts)) if is_option else argument(one)
        value = "" if not is_option or one.is_flag else f" {one.metavar or one.name.upper()}"
        is_told = one.default not in (None, "", ()) and one.default is not False and not callable(one.default)
        default = f" (default: {one.default})" if is_told else ""
        yield f".TP\n.B {roff(spelled + value)}\n{roff((one.help or '') + default)}"


def shown(one: Any) -> bool:
    """Return whether help shows an argument or option."""
    return not getattr(one, "hidden", False)


def argument(one: Any) -> str:
    """Return an argument as it stands in a command line."""
    name = one.metavar or f"{one.name.upper()}{'...' if one.nargs < 0 else ''}"
    return name if one.required or name.startswith("[") else f"[{name}]"


def roff(text: str) -> str:
    """Return a text in one line that roff prints as it is."""
    text = " ".join(text.split()).replace("\\", "\\e").replace("-", "\\-").replace("`", "")
    return re.sub(r"^([.'])", r"\\&\1", text)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(man_page(), encoding="utf-8")
