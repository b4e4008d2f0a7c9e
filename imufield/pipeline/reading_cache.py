"""Cache of a replayed recording (``Reading``) beside it, so that the next ``solve`` need not replay hours of samples.

``capture`` keeps it as soon as it has seen all of the recording, else who replays it first. It is believed only under a digest
of the recording, of what ``session.toml`` says, and of this program's version and files, with a secret of this user: what came
with the session of another, who could write anything there, is read anew. Nothing is said of it: the result is the same.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

import numpy as np

from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.recording.session import SETTINGS_FILE, Session
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.moves.slots import Slots
from imufield.dataclass import fields, is_dataclass
from imufield.deliver.report.stillness_trace import TraceCells
from imufield.files import SMALL_FILE_LIMIT_BYTES, Origin, read_small_file, write_atomically
from imufield.guide.positions import SCHEME_FILE
from imufield.pipeline.reading import Reading
from imufield.samples import SampleUnits
from imufield.toml_and_json import parse_json
from imufield.version import __version__

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

CACHE_FILE = ".imufield-reading"  # Hidden: it is nobody's result.
_DIGEST_BYTES = 32
_TYPES = {
    "observations": Observations,
    "rests": Observations,
    "units": SampleUnits,
    "slots": Slots,
    "cells": TraceCells,
    "best": DecoderStatistics,
}

_Made = TypeVar("_Made", bound="DataclassInstance")


def write_cache(session: Session, reading: Reading) -> None:
    """Write a reading beside its recording."""
    body = _packed(reading)
    if len(body) + _DIGEST_BYTES <= SMALL_FILE_LIMIT_BYTES:
        # A folder that cannot be written, or a full disk, only costs the time that this would save.
        with suppress(OSError):
            write_atomically(session.folder / CACHE_FILE, _digest(session, reading.sha256, body) + body)


def is_cached(session: Session) -> bool:
    """Tell whether something is kept; whether it is to be believed, ``cached_reading`` tells."""
    return (session.folder / CACHE_FILE).exists()


def cached_reading(session: Session, sha256: str) -> Reading | None:
    """Return the reading that is kept of a recording with this hash; None where there is none to be believed."""
    try:
        content = read_small_file(session.folder / CACHE_FILE, Origin.INSIDE)
        body = content[_DIGEST_BYTES:]
        own = hmac.compare_digest(content[:_DIGEST_BYTES], _digest(session, sha256, body))
    except OSError:
        return None
    return _unpacked(body) if own else None


def _digest(session: Session, sha256: str, body: bytes) -> bytes:
    """Return the keyed hash of all that a reading hangs on, and of the reading itself."""
    digest = hmac.new(_secret(), f"{sha256} {_code_sha256()} {np.__version__}\n".encode(), "sha256")
    for name in (SETTINGS_FILE, SCHEME_FILE):
        found = bytes(_DIGEST_BYTES)  # Of a file that is not there: what follows always begins at the same place.
        with suppress(FileNotFoundError):
            found = hashlib.sha256(read_small_file(session.folder / name, Origin.INSIDE)).digest()
        digest.update(found)
    digest.update(body)
    return digest.digest()


def _secret() -> bytes:
    """Return what only this user's programs know, made at its first use."""
    import platformdirs  # Only where something is kept.

    path = platformdirs.user_state_path("imufield", ensure_exists=True) / "secret"
    with suppress(FileNotFoundError):
        if len(found := read_small_file(path, Origin.INSIDE)) == _DIGEST_BYTES:
            return found
    import secrets

    # Nobody else may read it; writing keeps that. Of two programs that make one at once the later wins, which costs a replay.
    path.touch()
    path.chmod(0o600)
    write_atomically(path, secrets.token_bytes(_DIGEST_BYTES))
    return path.read_bytes()


@cache
def _code_sha256() -> str:
    """Return the hash of this program's version, and of its files by size and time: the number stays while they are edited."""
    digest = hashlib.sha256(__version__.encode())
    # By their content it would take as long as all else that is done for what is kept.
    for folder, _, names in sorted(os.walk(Path(__file__).parent.parent)):
        for path in (f"{folder}/{name}" for name in sorted(names) if name.endswith((".py", ".toml"))):
            found = os.stat(path)  # noqa: PTH116  (a Path of each file takes longer than its time and size)
            digest.update(f"{path} {found.st_size} {found.st_mtime_ns}\n".encode())
    return digest.hexdigest()


def _packed(reading: Reading) -> bytes:
    """Return a line of JSON with all that is no array, and of each array type and shape; behind it their numbers."""
    found = dict(_flat(reading))
    arrays = {name: value for name, value in found.items() if isinstance(value, np.ndarray)}
    others = {name: value for name, value in found.items() if name not in arrays}
    shapes = {name: (array.dtype.str, array.shape) for name, array in arrays.items()}
    line = json.dumps([others, shapes]).encode()
    return b"".join([line, b"\n", *(array.tobytes() for array in arrays.values())])


def _flat(value: DataclassInstance, prefix: str = "") -> Iterator[tuple[str, object]]:
    for field in fields(value):
        entry = getattr(value, field.name)
        if is_dataclass(entry) and not isinstance(entry, type):
            yield from _flat(entry, f"{prefix}{field.name}.")
        else:
            yield prefix + field.name, entry


def _unpacked(body: bytes) -> Reading:
    at = body.index(b"\n") + 1
    # What it is instead of these types, a TypeError or the like tells.
    found, shapes = cast("tuple[dict[str, object], dict[str, tuple[str, list[int]]]]", parse_json(body[:at]))
    for name, (kind, shape) in shapes.items():
        # From a buffer: what somebody wrote of a shape allocates nothing.
        array = np.frombuffer(body, kind, math.prod(shape), at)
        found[name] = array.reshape(shape)
        at += array.nbytes
    return _made(Reading, found)


def _made(kind: type[_Made], found: Mapping[str, object], prefix: str = "") -> _Made:
    values = {}
    for field in fields(kind):
        name = prefix + field.name
        if name in found:
            value = found[name]
            values[field.name] = tuple(value) if isinstance(value, list) else value
        else:
            values[field.name] = _made(_TYPES[field.name], found, f"{name}.")
    return kind(**values)
