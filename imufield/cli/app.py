"""The commands of `imufield`, in the order and under the headings in which the help lists them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from imufield.cli import acquire, calibrate, deliver
from imufield.version import __version__

app = typer.Typer(
    name="imufield",
    help="Calibrate an IMU in the field: no turntable, 24 hand-held positions, a parameter file for your INS.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"imufield {__version__}")
        raise typer.Exit


@app.callback()
def root(
    context: typer.Context,
    version: Annotated[  # noqa: ARG001  (answered by its callback, before a command is asked for)
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Calibrate an IMU in the field: no turntable, 24 hand-held positions, a parameter file for your INS."""
    from imufield.commands.configuration import default_map

    context.default_map = default_map()


_COMMANDS: dict[str, dict[str, Callable[..., None]]] = {
    "Calibrate": {
        "devices": acquire.devices,
        "probe": acquire.probe,
        "capture": acquire.capture,
        "solve": calibrate.solve,
        "report": deliver.report,
        "export": deliver.export,
    },
    "Prove and compare": {
        "verify": deliver.verify,
        "history": deliver.history,
        "noise": calibrate.noise,
    },
    "Recordings": {
        "record": acquire.record,
        "import": acquire.import_files,
        "replay": acquire.replay,
        "apply": deliver.apply,
        "export-data": deliver.export_data,
    },
    "Without hardware": {
        "demo": acquire.demo,
        "emulate": acquire.emulate,
        "study": calibrate.study,
    },
}

for _panel, _commands in _COMMANDS.items():
    for _name, _command in _commands.items():
        app.command(_name, rich_help_panel=_panel)(_command)
