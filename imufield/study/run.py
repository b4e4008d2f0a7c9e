"""Run studies, save their results, and write the document: the calls behind ``imufield study``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from imufield.files import typed_write_errors, write_atomically
from imufield.study.context import StudyContext
from imufield.study.registry import find_studies, load_study
from imufield.study.report import StudyReport, as_markdown, save
from imufield.version import __version__

TITLE = "# The papers' tables and figures, reproduced"
"""First line of the document."""
_HEAD = """{title}

Every table and figure of the two papers that can be computed, the paper's figure beside ours. Where the paper used
hardware, a simulated instrument stands in its place, and the setting says so.

From {size} of all studies with seed {seed} and imufield {version}. The same seed gives the same figures on any number of
workers.

* BSAS: P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
  Sensors, 2020.
* IDE: Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for
  SINS", 2021.
"""


def run_study(
    name: str, context: StudyContext | None = None, *, folder: Path | None = None, plot: bool = True
) -> Iterator[StudyReport]:
    """Run one study, all of a paper, or all; yield each report as it is done.

    Parameters
    ----------
    name : str
        A name of ``registry.STUDIES``, "bsas", "ide" or "all".
    context : StudyContext, optional
        Seed, size, workers.
    folder : Path, optional
        Where CSV files and plots go; without it nothing is written.
    plot : bool
        Whether to draw (needs matplotlib).

    Raises
    ------
    UsageError
        If there is no such study, or a package it needs is not installed.
    LinkError
        If a scheduler was given and does not answer.
    """
    context = context or StudyContext()
    for study in find_studies(name):
        report = load_study(study)(context)
        if folder is not None:
            save(report, folder, plot=plot)
        yield report


def write_document(reports: Iterable[StudyReport], path: Path, context: StudyContext) -> None:
    """Write reports as one Markdown document, with seed and version."""
    # The words of a quick run warn whoever finds the document later.
    size = "a quick run, too few runs to quote" if context.quick else "a full run"
    head = _HEAD.format(title=TITLE, size=size, seed=context.seed, version=__version__)
    sections = [as_markdown(report) for report in reports]
    with typed_write_errors(path):
        write_atomically(path, "\n".join([head, *sections]).encode())
