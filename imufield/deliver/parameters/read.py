"""Read a parameter file, and refuse every one that cannot be trusted, in one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from imufield.deliver.parameters.document import FORMAT, VERSION, VERSION_WITHOUT_TEMPERATURE
from imufield.deliver.parameters.schema import Document, first_fault, shown
from imufield.deliver.parameters.versions import CONVERTERS, to_current
from imufield.deliver.parameters.write import EDITED, content_sha256
from imufield.errors import ParameterFileError, Reason
from imufield.files import Origin, read_small_file
from imufield.sentences import Sentences, printable_values
from imufield.toml_and_json import decode_toml, parse_toml

sentence = Sentences(__package__)


class VersionedDocument(NamedTuple):
    """A document of a version that is still written, and the version the file is of."""

    document: Document
    version: int


def read_document(path: Path | str, origin: Origin = Origin.TYPED) -> VersionedDocument:
    """Return the content of a parameter file that passed every check, converted where it is of an older version.

    Raises
    ------
    ParameterFileError
        If the file is not there, cut, damaged, newer than this program, not a parameter file, or edited by hand without
        saying so.
    """
    where = str(path)
    try:
        text = decode_toml(read_small_file(path, origin), where, ParameterFileError)
    except OSError as error:
        # A file that nobody named is missing because the session was not solved.
        key, folder = "read.not_there", Path(path).parent
        if origin is Origin.INSIDE and isinstance(error, FileNotFoundError):
            from imufield.acquire.recording.session import SETTINGS_FILE  # late: a file that is there needs no session

            key = "read.not_solved" if (folder / SETTINGS_FILE).exists() else "read.no_session"
        refused = sentence(key, where=where, cause=error.strerror, folder=folder)
        raise ParameterFileError(refused, Reason.FOREIGN) from error
    return parse_document(text, where)


def parse_document(text: str, where: str = "parameter file") -> VersionedDocument:
    """Return the content of a parameter file's text; ``where`` names it in errors, which are those of ``read_document``."""
    document: Document = parse_toml(text, where, ParameterFileError)
    version = _trusted_version(document, where)
    if version < VERSION_WITHOUT_TEMPERATURE:
        try:
            document = to_current(document, version)
        except ParameterFileError as error:
            refused = sentence("read.older", where=where, what=error.message)
            raise ParameterFileError(refused, error.reason, **error.values) from error
    _check(document, where)
    return VersionedDocument({key: printable_values(value) for key, value in document.items()}, version)


def _check(document: Document, where: str) -> None:
    """Check the document against the schema, and against itself."""
    fault = first_fault(document)
    if fault is not None:
        raise ParameterFileError(sentence("read.fault", where=where, what=fault.what), fault.reason, key=fault.key)
    from imufield.deliver.parameters.consistency import contradiction  # late: a refused file needs no models

    is_edited = document["integrity"]["sha256"] == EDITED
    what = contradiction(document, is_edited=is_edited)
    if what:
        refused = sentence("read.edited" if is_edited else "read.fault", where=where, what=what)
        raise ParameterFileError(refused, key=what.partition(" ")[0])


def _trusted_version(document: Document, where: str) -> int:
    """Return the version of a document that is a parameter file, and as it was written."""
    if document.get("format") != FORMAT:
        raise ParameterFileError(sentence("read.format", where=where, wanted=FORMAT), Reason.FOREIGN)
    version = document.get("version")
    if not isinstance(version, int) or isinstance(version, bool) or version < min(CONVERTERS):
        raise ParameterFileError(sentence("read.version", where=where, stated=shown(version), known=VERSION))
    if version > VERSION:
        raise ParameterFileError(sentence("read.newer", where=where, version=version, known=VERSION), Reason.NEWER)
    # Before anything else looks into it: what was changed by hand is not worth a closer look.
    integrity = document.get("integrity")
    noted = integrity.get("sha256") if isinstance(integrity, dict) else None
    if noted is None:
        raise ParameterFileError(sentence("read.cut", where=where))
    if noted not in (EDITED, content_sha256(document)):
        raise ParameterFileError(sentence("read.changed", where=where))
    return version
