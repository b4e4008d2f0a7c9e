"""``imufield report``: one page per session, and a calibration record on one sheet."""

from __future__ import annotations

import platform
import shlex
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path

import numpy as np

from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session, open_or_newest
from imufield.calibrate.model.observations import join_observations
from imufield.commands.options.result_commands import ReportOptions
from imufield.commands.terminal.output import say, write_output
from imufield.deliver.parameters.file import PARAMETER_FILE, Parameters, load
from imufield.deliver.parameters.write import content_sha256
from imufield.deliver.report.data import (
    Closure,
    ReportData,
    closure,
    convergence,
    observations_of,
    with_gyroscope,
)
from imufield.deliver.report.page import load_weasyprint, render_record, render_report, to_pdf
from imufield.deliver.report.stillness_trace import Trace, trace
from imufield.deliver.verification.result import read_verification, verification_note, verification_path
from imufield.errors import CalibrationError, ParameterFileError, Reason, UsageError, load_package
from imufield.files import real_path, refuse_overwriting, utf8_text
from imufield.pipeline.solving import read_recording
from imufield.progress import task
from imufield.sentences import Sentences
from imufield.version import __version__

sentence = Sentences(__package__)

REPORT_FILE = "report.html"
RECORD_FILE = "calibration-record.html"


def run_report(options: ReportOptions) -> tuple[Path, ...]:
    """Write report and record, as PDF too where that is asked for; return their paths.

    Raises
    ------
    UsageError
        If jinja2 or, for PDF, WeasyPrint is not installed, or report and record have one name.
    ParameterFileError
        If the parameters are not of this session, or a page cannot be written.
    """
    # Asked first: a missing package should not be found out after the replay.
    load_package("jinja2", "the report", "report")
    if options.pdf:
        load_weasyprint()
    data, folder = gather(options)
    pages = _pages(options, data.parameters.path, folder)
    if options.pdf:
        pages += tuple(path.with_suffix(".pdf") for path in pages)
    inputs = [
        *filter(None, (data.parameters.path, options.preset)),
        *([] if options.session is None else Session.open(folder).parts),
    ]
    if len(set(map(real_path, pages))) < len(pages):
        raise UsageError(sentence("report.one_name", output=pages[0], record=pages[1]))
    # Both before either is written: no page without the other.
    for path in pages:
        refuse_overwriting(path, inputs)
    with task("drawing"):
        texts = [utf8_text(render_report(data)), utf8_text(render_record(data))]
    # One after the other: a PDF takes seconds.
    for number, path in enumerate(pages):
        with task(f"writing {path.name}"):
            write_output(path, texts[number].encode() if number < len(texts) else to_pdf(texts[number - len(texts)]))
    say(sentence("report.record", record=pages[1].name))
    return pages


def _pages(options: ReportOptions, parameters: Path | None, folder: Path) -> tuple[Path, ...]:
    """Return where report and record go: unless named, the report is called after the parameters, the record after the report.

    So two results in one folder have two names.
    """
    is_alone = options.session is None and parameters is not None and parameters.name != PARAMETER_FILE
    default = folder / (f"{parameters.stem}.html" if is_alone and parameters is not None else REPORT_FILE)
    report = options.output or default
    record = RECORD_FILE if report.name == REPORT_FILE else f"{report.stem}-record.html"
    return report, options.record or report.with_name(record)


def gather(options: ReportOptions) -> tuple[ReportData, Path]:
    """Return what the report shows, and the folder it belongs into; raises as ``run_report``."""
    # Parameters alone have a report, too: without what only their recording tells.
    session = None if options.session is None and options.parameters is not None else open_or_newest(options.session)
    # A folder, not a name in it: what stands there may come from somebody else.
    parameters = load(options.parameters or (session.folder if session is not None else Path()))
    path = parameters.path or Path(PARAMETER_FILE)
    preset = None if options.preset is None else load(options.preset)
    _check_belongs(parameters, session, preset)
    traced, closed, notes = (None, None, ()) if session is None else _read(session, parameters, preset)
    before = None if preset is None else preset.calibration.accelerometer
    results, sha256 = verification_path(path), content_sha256(parameters.document)
    note = verification_note(results, sha256)
    data = ReportData(
        parameters=parameters,
        preset=preset,
        trace=traced,
        closure=closed,
        convergence=convergence(observations_of(parameters), parameters.calibration, before),
        verification=read_verification(results, sha256),
        provenance=tuple(_provenance(path, parameters, session)),
        operator=options.operator,
        notes=(*notes, *filter(None, (note,))),
    )
    return data, path.parent if session is None else session.folder


def _check_belongs(parameters: Parameters, session: Session | None, preset: Parameters | None) -> None:
    own = "" if session is None else session.serial_number
    if preset is not None:
        preset.check_instrument(parameters.context.instrument.serial_number or own)
        preset.check_unit("accelerometer", parameters.calibration.accelerometer_raw_unit)
    if session is None:
        return
    parameters.check_instrument(own)
    wanted = parameters.context.session.sha256
    if wanted and wanted != session.sha256():
        other = sentence("report.other_recording", parameters=str(parameters.path), session=str(session.folder))
        raise ParameterFileError(other, Reason.FOREIGN)


def _read(
    session: Session, parameters: Parameters, preset: Parameters | None
) -> tuple[Trace | None, Closure | None, tuple[str, ...]]:
    """Return what only the recording tells, and sentences about what it does not."""
    damage: list[Damage] = []
    with ExitStack() as stack:
        try:
            reading = stack.enter_context(read_recording(session, damage))
        except CalibrationError as error:
            # Parameters that are here all the same have a report.
            return None, None, (error.message,)
        units = reading.observations.units
        parameters.check_unit("accelerometer", units.accelerometer_rate_unit)
        if parameters.calibration.gyroscope is not None:
            parameters.check_unit("gyroscope", units.gyroscope_rate_unit)
        positions, old = with_gyroscope(observations_of(parameters), reading.observations), None
        if preset is not None and preset.calibration.gyroscope is not None:
            old = preset.calibration.gyroscope.parameters
        closed = None
        # Positions that were given otherwise have no time, and no moves between them.
        if len(positions) and np.isfinite(positions.start_s).all():
            stills = positions if reading.rests is None else join_observations(positions, reading.rests)
            closed = closure(stills, reading.between(positions), parameters, old, nominal=reading.gyroscope_scale)
        return trace(reading.cells, parameters), closed, tuple(entry.what for entry in damage)


def _provenance(path: Path, parameters: Parameters, session: Session | None) -> Iterator[tuple[str, str]]:
    converted = f", converted from version {parameters.version}" if parameters.is_converted else ""
    yield "Parameter file", f"{path}{converted}"
    if session is not None:
        record = session.record
        yield "Protocol", f"{record.protocol.name}, SHA-256 {record.protocol.sha256}"
        if record.settings:
            settings = {name: f"{name} = {setting.value} ({setting.origin})" for name, setting in record.settings.items()}
            # A rate of zero stands for one that only the recording tells.
            if "rate_hz" in settings and record.settings["rate_hz"].value == 0:
                settings["rate_hz"] = "rate_hz measured on the recording"
            yield "Settings", "; ".join(settings.values())
        yield "Recorded by", record.software
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "jinja2"))
    yield "Report by", f"imufield {__version__}, Python {platform.python_version()}, {packages}"
    yield "Command", shlex.join(["imufield", *sys.argv[1:]])
