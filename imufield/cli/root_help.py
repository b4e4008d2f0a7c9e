"""The help that lists the commands, as typer prints it, without typer: half the time, and what a newcomer asks for first."""

from __future__ import annotations

import os
import sys

from imufield.cli.table import COMMANDS, COMPLETION, NAMES
from imufield.sentences import Sentences

sentence = Sentences(__package__)

OF_TYPER = (
    "TERMINAL_WIDTH",
    "GITHUB_ACTIONS",
    "PY_COLORS",
    "FORCE_COLOR",
    "_TYPER_FORCE_DISABLE_TERMINAL",
    COMPLETION,
)
"""Typer's own switches, and its request for words to complete: where one is set, it prints its help itself."""
_OPTIONS = (
    ("--version", "", "Print the version."),
    ("--install-completion", "", "Install completion for the current shell."),
    ("--show-completion", "", "Show completion for the current shell, to copy it or customize the installation."),
    ("--help", "-h", "Show this message and exit."),
)


def print_help() -> bool:
    """Print it on standard output; False where that is left to typer."""
    if any(os.environ.get(name) for name in OF_TYPER) or sys.platform == "win32":
        return False
    from rich.columns import Columns
    from rich.padding import Padding
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    from imufield.console import PlainTextConsole

    console = PlainTextConsole()
    usage = Text.assemble(("Usage: ", "yellow"), "imufield [OPTIONS] COMMAND [ARGS]...")
    console.print(Padding(usage, 1), style="bold")
    console.print(Padding(Text(sentence("root.program")), (0, 1, 1, 1)))

    def show(title: str, table: Table) -> None:
        console.print(Panel(table, border_style="dim", title=title, title_align="left"))

    options = Table(highlight=True, show_header=False, expand=True, box=None, pad_edge=False)
    for name, short, told in _OPTIONS:
        options.add_row(Text(name, "bold cyan"), Text(short, "bold green"), "", "", "", Columns([told]))
    show("Options", options)
    for title, commands in COMMANDS.items():
        listed = Table(highlight=False, show_header=False, expand=True, box=None, pad_edge=False)
        listed.add_column(style="bold cyan", no_wrap=True, width=max(map(len, NAMES)))
        listed.add_column(ratio=10)
        for name, (_, _, key) in commands.items():
            listed.add_row(name, Text(sentence(key)))
        show(title, listed)
    console.print()
    return True
