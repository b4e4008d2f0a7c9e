"""``imufield certificate``: the calibration certificate of a parameter file, with its label."""

from __future__ import annotations

import json
from pathlib import Path

from imufield.acquire.recording.session import SETTINGS_FILE, Session
from imufield.commands.options.result_commands import CertificateOptions
from imufield.commands.terminal.output import say, say_each, write_output
from imufield.deliver.certificate.certificate import Certificate, Parties, issue_date, to_json, verification_statements
from imufield.deliver.certificate.dcc import to_xml
from imufield.deliver.certificate.label import label_svg
from imufield.deliver.certificate.page import render_certificate
from imufield.deliver.parameters.file import PARAMETER_FILE, Parameters, load
from imufield.deliver.parameters.write import content_sha256
from imufield.deliver.report.page import load_weasyprint, to_pdf
from imufield.deliver.verification.result import verification_path
from imufield.errors import ParameterFileError, Reason, UsageError
from imufield.files import refuse_overwriting, utf8_text
from imufield.progress import task
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_NAME = "certificate"
_LABEL_FILE = "label.svg"


def run_certificate(options: CertificateOptions) -> tuple[Path, ...]:
    """Write the certificate as page, JSON and XML, and the label; return their paths.

    Raises
    ------
    UsageError
        If a package is missing, or SOURCE_DATE_EPOCH is no date.
    ParameterFileError
        If there are no parameters, they are of another recording, or a file cannot be written.
    """
    if options.pdf:
        load_weasyprint()
    source = Session.newest().folder if options.source is None else options.source
    parameters = load(source)
    path = parameters.path or source / PARAMETER_FILE
    folder = options.output or (source if source.is_dir() else source.parent)
    certificate = Certificate(
        parameters=parameters,
        parties=Parties(laboratory=options.laboratory, customer=options.customer, operator=options.operator),
        protocol=_protocol(source, parameters),
        issued=issue_date(),
        due_months=options.due_months,
        verified=tuple(verification_statements(verification_path(path), content_sha256(parameters.document))),
    )
    say_each(filter(None, (parameters.edited_note, parameters.verdict_note, *certificate.verified)), err=True)
    contents = _contents(certificate, with_pdf=options.pdf)
    # All before any is written: no page without its XML.
    for name in contents:
        refuse_overwriting(folder / name, [path])
    for name, content in contents.items():
        write_output(folder / name, content)
    return tuple(folder / name for name in contents)


def _contents(certificate: Certificate, *, with_pdf: bool) -> dict[str, bytes]:
    """Return what is written, by file name."""
    label = ""
    try:
        label = label_svg(certificate)
    except UsageError as error:
        if error.reason is not Reason.MISSING_PACKAGE:
            raise
        # A certificate without a label is one all the same.
        say(sentence("certificate.no_label", why=error.message), err=True)
    with task("drawing"):
        page = utf8_text(render_certificate(certificate, label))
    contents = {f"{_NAME}.html": page.encode()}
    if with_pdf:
        with task(f"writing {_NAME}.pdf"):
            contents[f"{_NAME}.pdf"] = to_pdf(page)
    text = json.dumps(to_json(certificate), indent=2)
    contents |= {f"{_NAME}.json": f"{text}\n".encode(), f"{_NAME}.xml": to_xml(certificate, contents.get(f"{_NAME}.pdf"))}
    return contents | ({_LABEL_FILE: label.encode()} if label else {})


def _protocol(source: Path, parameters: Parameters) -> str:
    """Return name and hash of the protocol of the recording, where that is at hand.

    Raises
    ------
    ParameterFileError
        If the session that was named is not the one the parameters came from.
    """
    folder = source if source.is_dir() else source.parent
    if not (folder / SETTINGS_FILE).exists():
        return ""
    session = Session.open(folder)
    if session.sha256() != parameters.context.session.sha256:
        if source.is_dir():
            other = sentence("certificate.other_recording", parameters=str(parameters.path), session=str(session.folder))
            raise ParameterFileError(other, Reason.FOREIGN)
        return ""
    protocol = session.record.protocol
    return f"{protocol.name}, SHA-256 {protocol.sha256}"
