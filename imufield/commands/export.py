"""``imufield export``: parameters in another program's format."""

from __future__ import annotations

import json
from pathlib import Path

import typer

from imufield.commands.configuration import parse_settings
from imufield.deliver.exports import TARGETS, export_options, export_parameters, write_exported
from imufield.deliver.parameters.file import load
from imufield.deliver.parameters.numbers import hanging


def run_export(path: Path, target: str | None, settings: list[str] | None, output: Path | None, *, as_json: bool) -> None:
    """Write the files of a target and say what it cannot hold; without a target list them.

    Raises
    ------
    ParameterFileError
        If the file cannot be read, or the target cannot express it.
    """
    if target is None:
        for one in TARGETS.values():
            typer.echo(hanging(f"{one.name:<12} ", f"{one.title}: {one.holds}"))
        return
    parameters = load(path)
    exported = export_parameters(parameters, target, export_options(parse_settings(settings)))
    written = write_exported(exported, output, inputs=[path])
    notes = [*filter(None, (parameters.edited_note, parameters.gyroscope_note)), *exported.notes]
    if as_json:
        files, kept = [str(file.path) for file in written], [str(file.kept) for file in written if file.kept is not None]
        typer.echo(json.dumps({"files": files, "kept": kept, "losses": list(exported.losses), "notes": notes}))
        return
    for file in written:
        typer.echo(f"written: {file.path}")
        if file.kept is not None:
            typer.echo(hanging("         ", f"the file that stood there before is now {file.kept.name}"))
    for loss in exported.losses:
        typer.echo(hanging("lost:    ", loss))
    for note in notes:
        typer.echo(hanging("note:    ", note))
