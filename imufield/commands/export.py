"""``imufield export``: parameters in another program's format."""

from __future__ import annotations

import json

from imufield.commands.options.result_commands import ExportOptions
from imufield.commands.terminal.output import echo
from imufield.deliver.exports import TARGETS, export_options, export_parameters, target, write_exported
from imufield.deliver.parameters.file import load
from imufield.deliver.parameters.printed_numbers import hanging
from imufield.errors import UsageError
from imufield.sentences import Sentences, printable

sentence = Sentences(__package__)


def run_export(options: ExportOptions) -> None:
    """Write the files of a target and say what it cannot express; without a target list them.

    Raises
    ------
    ParameterFileError
        If the file cannot be read, or the target cannot express it.
    UsageError
        If a target is given and no file.
    """
    if options.to is None:
        if options.as_json:
            rows = [
                {"name": each.name, "title": each.title, "holds": each.holds, "asks": dict(each.asks)}
                for each in TARGETS.values()
            ]
            echo(json.dumps({"targets": rows}))
            return
        for each in TARGETS.values():
            echo(hanging(f"{each.name:<12} ", f"{each.title}: {each.holds}"))
        return
    if options.parameters is None:
        raise UsageError(sentence("export.which", to=target(options.to).name))
    parameters = load(options.parameters)
    exported = export_parameters(parameters, options.to, export_options(dict(options.settings), options.to))
    written = write_exported(exported, options.output, inputs=[options.parameters])
    notes = [*filter(None, (parameters.edited_note, parameters.verdict_note, parameters.gyroscope_note)), *exported.notes]
    # What the target cannot hold is part of the answer: a program must not take the file for all there is.
    if options.as_json:
        files, kept = [str(file.path) for file in written], [str(file.kept) for file in written if file.kept is not None]
        echo(json.dumps({"files": files, "kept": kept, "losses": list(exported.losses), "notes": notes}))
        return
    for file in written:
        echo(printable(f"written: {file.path}"))
        if file.kept is not None:
            echo(hanging("         ", sentence("export.kept", name=file.kept.name)))
    for loss in exported.losses:
        echo(hanging("lost:    ", loss))
    for note in notes:
        echo(hanging("note:    ", note))
