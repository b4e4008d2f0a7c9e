"""Write a parameter file: TOML laid out for a person, exact for a program, safe against a crash.

Every float is written with the digits that give the same float64 back. The last table holds a SHA-256 over the content
as canonical JSON (keys sorted, no blanks, NaN as null), so comments and layout may change and values may not. ``document`` says
which keys there are, ``parameters.schema.json`` what each may be, and ``comments.toml`` what is written beside them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import tomli

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.deliver.parameters.context import Context
from imufield.deliver.parameters.document import to_document
from imufield.deliver.parameters.schema import Document, first_fault, json_ready
from imufield.errors import ParameterFileError
from imufield.files import Origin, read_small_file, typed_write_errors, write_keeping
from imufield.sentences import Sentences
from imufield.toml_and_json import decode_toml, parse_toml

EDITED = "edited"
"""Stands in place of the hash where a person changed the file on purpose."""

_ROW_WIDTH = 100  # an array of texts longer than this gets one line each

sentence = Sentences(__package__)


def content_sha256(document: Document) -> str:
    """Return the hash of a document's values, its own ``integrity`` left out."""
    content = {key: value for key, value in document.items() if key != "integrity"}
    # default=str: a date, which this format never holds, must end as "changed by hand" and not as a defect.
    text = json.dumps(json_ready(content), sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def to_toml(document: Document) -> str:
    """Return the text of a parameter file, hash included.

    Raises
    ------
    ParameterFileError
        If the document breaks the rules of the format, e.g. a parameter is NaN.
    """
    fault = first_fault(document)
    if fault is not None:
        raise ParameterFileError(sentence("write.fault", what=fault.what), fault.reason, key=fault.key)
    comments = tomli.loads(Path(__file__).with_name("comments.toml").read_text(encoding="utf-8"))
    # The hash last, in a table of its own: a file cut short has none.
    complete = document | {"integrity": {"sha256": content_sha256(document)}}
    return "\n".join([_comment(comments["head"]), *_table_lines(complete, "", comments["tables"])]) + "\n"


def write_parameters(path: Path | str, calibration: Calibration, observations: Observations, context: Context) -> Path | None:
    """Write a parameter file; an existing one is kept as ``parameters-<n>.toml``.

    Returns
    -------
    Path or None
        Where the file that stood there before is kept.
    """
    return write_document(path, to_document(calibration, observations, context))


def as_written(path: Path, document: Document) -> Document:
    """Return a document with the time of the file at ``path`` where all else is the same: solved again, and no other result."""
    try:
        content = read_small_file(path, Origin.INSIDE)
        created = parse_toml(decode_toml(content, str(path), ParameterFileError), str(path), ParameterFileError).get("created")
    except (OSError, ParameterFileError):
        return document
    same = document | {"created": created}
    # What was written while the clock was ahead is put right.
    is_earlier = isinstance(created, str) and created <= document["created"]
    return same if is_earlier and first_fault(same) is None and to_toml(same).encode() == content else document


def write_document(path: Path | str, document: Document, *, advice: str = "") -> Path | None:
    """Write a document as ``write_parameters`` does; ``advice`` is what else to do where it cannot be written.

    Raises
    ------
    ParameterFileError
        If the document breaks the rules of the format, or the file cannot be written; a file that stood there is intact.
    """
    path = Path(path)
    # Before the file is touched: a document that breaks the rules leaves the old file where it is.
    text = to_toml(document)
    with typed_write_errors(path, advice=advice):
        return write_keeping(path, text.encode("utf-8"))


def _table_lines(table: Document, name: str, comments: Mapping[str, str]) -> Iterator[str]:
    plain = {key: value for key, value in table.items() if not _tables(value)}
    for key, value in plain.items():
        yield f"{key} = {_value(value)}"
    # TOML: what follows a heading belongs to it, so that tables come behind the plain values.
    for key, value in table.items():
        if key in plain:
            continue
        inner = f"{name}.{key}" if name else key
        for part in _tables(value):
            yield ""
            if inner in comments:
                yield _comment(comments[inner])
            yield f"[[{inner}]]" if isinstance(value, list) else f"[{inner}]"
            yield from _table_lines(part, inner, comments)


def _tables(value: object) -> list[Document]:
    """Return the tables that a value is written as; none where it is a plain value."""
    if isinstance(value, dict):
        return [value]
    return value if isinstance(value, list) and value and isinstance(value[0], dict) else []


def _comment(text: str) -> str:
    return "\n".join(f"# {line}".rstrip() for line in text.splitlines())


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON's escapes are TOML's, but TOML wants the delete character escaped as well.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if not isinstance(value, list):
        return repr(value)
    items = [_value(item) for item in value]
    in_one_line = "[" + ", ".join(items) + "]"
    rows = bool(value) and isinstance(value[0], list)
    if not rows and (len(in_one_line) <= _ROW_WIDTH or not all(isinstance(item, str) for item in value)):
        return in_one_line
    return "[\n" + "".join(f"    {item},\n" for item in items) + "]"
