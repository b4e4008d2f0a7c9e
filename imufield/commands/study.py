"""``imufield study``: the papers' tables and figures, reproduced."""

from __future__ import annotations

import sys
from pathlib import Path

import typer

from imufield.study.context import StudyContext
from imufield.study.report import StudyReport, as_text
from imufield.study.run import run_study, write_document


def run_study_command(
    name: str,
    *,
    quick: bool,
    seed: int,
    workers: int | None,
    scheduler: str | None,
    output: Path | None,
    document: Path | None,
) -> None:
    """Run studies and print each as it is done.

    Raises
    ------
    UsageError
        If there is no such study, or a package it needs is not installed.
    LinkError
        If the scheduler does not answer.
    """
    context = StudyContext(seed=seed, quick=quick, workers=workers, scheduler=scheduler, progress=_tell)
    reports: list[StudyReport] = []
    for report in run_study(name, context, folder=output):
        typer.echo(as_text(report))
        reports.append(report)
    if document is not None:
        write_document(reports, document, context)
        typer.echo(f"written: {document}")


def _tell(done: int, total: int) -> None:
    if sys.stderr.isatty():
        typer.echo(f"\r{done} of {total} runs", nl=done == total, err=True)
