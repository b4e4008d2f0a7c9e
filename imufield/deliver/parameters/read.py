"""Read a parameter file, and refuse every one that cannot be trusted, in one sentence."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imufield.deliver.parameters.document import FORMAT, VERSION
from imufield.deliver.parameters.schema import Document, first_fault, shown
from imufield.deliver.parameters.versions import CONVERTERS, to_current
from imufield.deliver.parameters.write import EDITED, content_sha256
from imufield.errors import ParameterFileError, Reason
from imufield.files import read_small_file

_ROUNDING = 1e-9  # Relative: a covariance that was computed and printed is symmetric to a few units of the last digit.
_REMEDY = "solve the session again, or take a kept parameters-<n>.toml"


class VersionedDocument(NamedTuple):
    """A document of the current version, and the version the file is of."""

    document: Document
    version: int


def read_document(path: Path | str) -> VersionedDocument:
    """Return the content of a parameter file that passed every check, converted where it is of an older version.

    Raises
    ------
    ParameterFileError
        If the file is not there, cut, damaged, newer than this program, not a parameter file, or edited by hand without
        saying so.
    """
    try:
        text = read_small_file(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ParameterFileError(f"{path} is no text file; check the file name, or {_REMEDY}", where=str(path)) from error
    except OSError as error:
        raise ParameterFileError(
            f"{path} cannot be read ({error.strerror}); check the file name, or make it with imufield solve",
            Reason.FOREIGN,
            where=str(path),
        ) from error
    return parse_document(text, str(path))


def parse_document(text: str, where: str = "parameter file") -> VersionedDocument:
    """Return the content of a parameter file's text; ``where`` names it in errors, which are those of ``read_document``."""
    try:
        document: Document = tomllib.loads(text)
        version = _trusted_version(document, where)
        if version != VERSION:
            try:
                document = to_current(document, version)
            except ParameterFileError as error:
                raise ParameterFileError(f"{where}: {error.message}", error.reason, where=where, **error.values) from error
        _check(document, where)
    except ParameterFileError:
        raise
    except (ValueError, RecursionError) as error:
        # Besides bad TOML: nesting and whole numbers so large that Python gives up on them.
        line = " ".join(str(error).split())
        raise ParameterFileError(f"{where} is damaged or no TOML ({line}); {_REMEDY}", where=where) from error
    return VersionedDocument(document, version)


def _check(document: Document, where: str) -> None:
    """Check the document against the schema, and against itself."""
    fault = first_fault(document)
    if fault is not None:
        raise ParameterFileError(f"{where}: {fault.key} {fault.what}; {_REMEDY}", fault.reason, where=where, key=fault.key)
    what = _inconsistency(document)
    if what:
        raise ParameterFileError(f"{where}: {what}; {_REMEDY}", where=where)
    from imufield.deliver.parameters.consistency import contradiction  # late: a refused file needs no models

    is_edited = document["integrity"]["sha256"] == EDITED
    what = contradiction(document, is_edited=is_edited)
    if what:
        remedy = "in a file edited by hand change what follows from a value with it, or take a kept parameters-<n>.toml"
        raise ParameterFileError(
            f"{where}: {what}; {remedy if is_edited else _REMEDY}", where=where, key=what.partition(" ")[0]
        )


def _trusted_version(document: Document, where: str) -> int:
    """Return the version of a document that is a parameter file, and as it was written."""
    if document.get("format") != FORMAT:
        raise ParameterFileError(
            f'{where} has no line format = "{FORMAT}"; give a parameter file written by imufield solve', Reason.FOREIGN
        )
    version = document.get("version")
    if not isinstance(version, int) or isinstance(version, bool) or version < min(CONVERTERS):
        raise ParameterFileError(f"{where}: version is {shown(version)} instead of {VERSION}; {_REMEDY}", where=where)
    if version > VERSION:
        raise ParameterFileError(
            f"{where} has version {version} and this imufield reads up to version {VERSION}; update imufield",
            Reason.NEWER,
            version=version,
        )
    # Before anything else looks into it: what was changed by hand is not worth a closer look.
    integrity = document.get("integrity")
    noted = integrity.get("sha256") if isinstance(integrity, dict) else None
    if noted is None:
        raise ParameterFileError(f"{where} is cut short: the table [integrity] at its end is missing; {_REMEDY}", where=where)
    if noted not in (EDITED, content_sha256(document)):
        raise ParameterFileError(
            f"{where} was changed after it was written (its values do not give the hash in [integrity]); {_REMEDY}, or, "
            f'where the change is meant, write sha256 = "{EDITED}" there',
            where=where,
        )
    return version


def _inconsistency(document: Document) -> str:
    """Say what is wrong that a schema cannot state; empty where nothing is."""
    names, matrix = document["covariance"]["names"], document["covariance"]["matrix"]
    positions, tables = document["session"]["positions"], len(document["position"])
    if positions != tables:
        return f"session.positions is {positions}, but there are {tables} [[position]] tables"
    if any(len(row) != len(names) for row in [matrix, *matrix]):
        return f"covariance.matrix is not {len(names)} by {len(names)} as covariance.names asks"
    triads = (_triad_fault(document[triad], triad) for triad in ("accelerometer", "gyroscope") if triad in document)
    return _covariance_fault(matrix) or next(filter(None, triads), "")


def _covariance_fault(rows: list[list[float]]) -> str:
    """Say what makes it no covariance; elements that are not known, NaN, are none."""
    matrix = np.array(rows, dtype=np.float64).reshape(len(rows), len(rows))
    if np.any(np.diagonal(matrix) < 0):
        return "covariance.matrix has a variance below zero"
    # Where the gauge fixes a parameter nothing but rounding is left of its row.
    free = np.diagonal(matrix) > 0
    sigma = np.sqrt(np.diagonal(matrix)[free])
    correlation = matrix[np.ix_(free, free)] / np.outer(sigma, sigma)
    if np.any(np.abs(correlation - correlation.T) > _ROUNDING):
        return "covariance.matrix is not symmetric"
    if np.any(np.abs(correlation) > 1 + _ROUNDING):
        return "covariance.matrix has a correlation beyond 1"
    return ""


def _triad_fault(table: Document, triad: str) -> str:
    if 0 in table["scale"]:
        return f"{triad}.scale has a zero, with which nothing can be corrected"
    misalignment = np.array(table["misalignment_rad"], dtype=np.float64)
    if np.any(np.diagonal(misalignment) != 0):
        return f"{triad}.misalignment_rad has a diagonal other than zero, which belongs into scale"
    if abs(np.linalg.det(np.eye(3) + misalignment)) < 1e-3:  # axes this close to one plane measure no third direction
        return f"{triad}.misalignment_rad puts the three axes into one plane"
    return ""
