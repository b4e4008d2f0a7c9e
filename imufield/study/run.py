"""Find studies by name, run them, save their results, and write the document: the calls behind ``imufield study``.

Listing imports nothing; a study's module is imported when it runs.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from imufield.errors import UsageError
from imufield.files import typed_write_errors, write_atomically
from imufield.sentences import Sentences
from imufield.study.context import StudyContext
from imufield.study.report import StudyReport, as_markdown, make_report, save, texts
from imufield.version import __version__

sentence = Sentences(__package__)

STUDIES = tuple(name for name, text in texts().items() if "function" in text)
"""In the order of the papers, which is that of the document."""
ANSWERS = "answers"
"""Studies of what a calibration says of itself: no papers', so with a document of their own."""


def find_studies(name: str) -> tuple[str, ...]:
    """Return the studies of a name: one, "all" of the papers, all of a paper ("bsas", "ide"), or the "answers".

    Raises
    ------
    UsageError
        If there is none.
    """
    kinds = {study: study.partition("-")[0] for study in STUDIES}
    found = tuple(study for study, kind in kinds.items() if name in (study, kind, "all" if kind != ANSWERS else kind))
    if not found:
        raise UsageError(sentence("run.no_study", study=name, studies=STUDIES))
    return found


def run_study(name: str, context: StudyContext, *, folder: Path | None = None) -> Iterator[StudyReport]:
    """Run one study, all of a paper, or all; yield each report as it is done.

    Parameters
    ----------
    name : str
        One of ``STUDIES``, "bsas", "ide", "all" or "answers".
    context : StudyContext
        Seed, size, workers.
    folder : Path, optional
        Where CSV files and plots go; without it nothing is written.

    Raises
    ------
    UsageError
        If there is no such study, or a package it needs is not installed.
    LinkError
        If a scheduler was given and does not answer.
    """
    for study in find_studies(name):
        module, _, function = texts()[study]["function"].rpartition(".")
        compute = getattr(importlib.import_module(f"imufield.study.{module}"), function)
        report = make_report(study, compute(context, **texts()[study].get("arguments", {})))
        if folder is not None:
            save(report, folder)
        yield report


def document_title(name: str) -> str:
    """Return the first line of the document of a study, of all of a kind, or of all."""
    return str(texts()["document"]["answers_title" if name.startswith(ANSWERS) else "title"])


def write_document(reports: Iterable[StudyReport], path: Path, context: StudyContext, name: str = "all") -> None:
    """Write the reports of ``run_study(name)`` as one Markdown document, with seed and version."""
    # The words of a quick run warn whoever finds the document later.
    size = "a quick run (too few sessions: do not quote these figures)" if context.quick else "a full run"
    head = str(texts()["document"]["answers" if name.startswith(ANSWERS) else "head"])
    head = head.format(title=document_title(name), size=size, seed=context.seed, version=__version__)
    sections = [as_markdown(report) for report in reports]
    with typed_write_errors(path):
        write_atomically(path, "\n".join([head, *sections]).encode())
