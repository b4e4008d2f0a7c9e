"""``imufield study``: the papers' tables and figures, reproduced."""

from __future__ import annotations

from imufield.commands.options.result_commands import StudyOptions
from imufield.commands.terminal.output import echo, replace_only, tell_written
from imufield.deliver.parameters.printed_numbers import hanging
from imufield.errors import UsageError
from imufield.files import typed_write_errors
from imufield.sentences import Sentences
from imufield.study.context import StudyContext
from imufield.study.report import StudyReport, as_text, texts
from imufield.study.run import STUDIES, document_title, find_studies, run_study, write_document

sentence = Sentences(__package__)


def run_study_command(options: StudyOptions) -> None:
    """Run studies and print each as it is done; without a name list them.

    Raises
    ------
    UsageError
        If there is no such study, a package it needs is not installed, or the results have no place to go.
    LinkError
        If the scheduler does not answer.
    """
    folder, document, name = options.output, options.document, options.name
    if name is None:
        for study in STUDIES:
            echo(hanging(f"{study:<15} ", texts()[study]["title"].format(runs="several runs")))
        return
    # Refused before hours of computing what would be refused after them, and before a folder is made.
    find_studies(name)
    if folder is not None and folder.exists() and not folder.is_dir():
        raise UsageError(sentence("study.no_folder", folder=folder))
    if folder is not None:
        with typed_write_errors(folder, UsageError):
            folder.mkdir(parents=True, exist_ok=True)
    if document is not None:
        if document.is_dir() or not document.parent.is_dir():
            raise UsageError(sentence("study.no_place", document=document))
        replace_only(document, document_title(name), "--document", "the results of a study")
    context = StudyContext(seed=options.seed, quick=options.quick, workers=options.workers, scheduler=options.scheduler)
    reports: list[StudyReport] = []
    for report in run_study(name, context, folder=folder):
        echo(as_text(report), end="")
        reports.append(report)
    if folder is not None:
        tell_written(folder)
    if document is not None:
        write_document(reports, document, context, name)
        tell_written(document)
