"""A block for flash or EEPROM, little-endian, with magic, version and CRC-32; ``apply.h`` beside it reads it in C.

========  ====  ==========================================================================================
offset    size  content
========  ====  ==========================================================================================
0         8     "IMUFIELD"
8         2     version, u16, 1
10        2     size of the block, u16, 472
12        4     flags, u32: bit 0 there is a gyroscope, bit 1 the quadratic term is on body axes
16        16    raw unit of the accelerometer, ASCII, padded with zero bytes
32        16    raw unit of the gyroscope
48        32    serial number, UTF-8
80        24    time of calibration, UTC, ISO 8601
104       168   scale 3, bias 3, inverse_alignment 9 (rows), quadratic 3, raw_zero 3, float64
272       168   rate_matrix 9 (rows), rate_offset 3, g_sensitivity 9 (rows), float64
440       24    gravity in m/s^2, lowest and highest temperature in degC (NaN: not known), float64
464       4     reserved, 0
468       4     CRC-32 (zlib) of bytes 0 to 467
========  ====  ==========================================================================================
"""

from __future__ import annotations

import zlib

import numpy as np

from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.whole_model import WholeModel, apply_header, gauge_note, whole_model
from imufield.errors import ParameterFileError, Reason

MAGIC = b"IMUFIELD"
VERSION = 1  # apply.h and unpack refuse a newer one.
# The table above; apply.h reads the same offsets.
_LAYOUT = np.dtype(
    [
        ("magic", "S8"),
        ("version", "<u2"),
        ("size", "<u2"),
        ("flags", "<u4"),
        ("accelerometer_raw_unit", "S16"),
        ("gyroscope_raw_unit", "S16"),
        ("serial_number", "S32"),
        ("created", "S24"),
        ("scale", "<f8", (3,)),
        ("bias", "<f8", (3,)),
        ("inverse_alignment", "<f8", (3, 3)),
        ("quadratic", "<f8", (3,)),
        ("raw_zero", "<f8", (3,)),
        ("rate_matrix", "<f8", (3, 3)),
        ("rate_offset", "<f8", (3,)),
        ("g_sensitivity", "<f8", (3, 3)),
        ("site", "<f8", (3,)),
        ("reserved", "<u4"),
        ("crc", "<u4"),
    ]
)
SIZE = _LAYOUT.itemsize


def export(job: Job) -> Draft:
    """Return the block and the header that reads it."""
    block = pack(job, whole_model(job))
    files = {"imufield_parameters.bin": block, "imufield_apply.h": apply_header().encode("ascii")}
    return Draft(files=files, notes=gauge_note(job))


def pack(job: Job, model: WholeModel) -> bytes:
    """Return the block."""
    calibration, context = job.parameters.calibration, job.parameters.context
    gyroscope = calibration.gyroscope if model.has_gyroscope else None
    record = np.zeros((), _LAYOUT)
    record["magic"], record["version"], record["size"] = MAGIC, VERSION, SIZE
    record["flags"] = model.has_gyroscope | model.quadratic_on_body_axes << 1
    for name, what, text in (
        ("accelerometer_raw_unit", "raw unit", calibration.accelerometer_raw_unit),
        ("gyroscope_raw_unit", "raw unit", "" if gyroscope is None else gyroscope.raw_unit),
        ("serial_number", "serial number", context.instrument.serial_number),
        ("created", "time", context.created),
    ):
        encoded, most = text.encode(), _LAYOUT[name].itemsize
        if len(encoded) > most:
            refused = sentence("binary.text_size", what=what, text=text, found=len(encoded), most=most)
            raise ParameterFileError(refused, Reason.BOUNDS)
        record[name] = encoded
    for name, values in model.arrays().items():
        record[name] = values
    record["site"] = (calibration.gravity.gravity_m_s2, *context.session.temperature_degc)
    record["crc"] = zlib.crc32(record.tobytes()[:-4])
    return record.tobytes()


def unpack(block: bytes) -> dict[str, object]:
    """Return the content of a block: arrays by name, ``has_gyroscope``, ``quadratic_on_body_axes`` and the four texts.

    Raises
    ------
    ParameterFileError
        If the block is cut, damaged, newer, or none of ours.
    """
    # The magic first: a file of another kind is neither cut nor damaged.
    if block[:8] != MAGIC:
        raise ParameterFileError(sentence("binary.foreign", found=block[:8], wanted=MAGIC))
    if len(block) < SIZE:
        raise ParameterFileError(sentence("binary.cut", found=len(block), wanted=SIZE))
    record = np.frombuffer(block, _LAYOUT, 1)[0]
    # Before size and CRC, which a newer version may have elsewhere.
    if record["version"] > VERSION:
        raise ParameterFileError(sentence("binary.newer", version=record["version"], known=VERSION), Reason.NEWER)
    if record["size"] != SIZE or record["crc"] != zlib.crc32(block[: SIZE - 4]):
        raise ParameterFileError(sentence("binary.damaged"))
    flags = int(record["flags"])
    content: dict[str, object] = {"has_gyroscope": bool(flags & 1), "quadratic_on_body_axes": bool(flags & 2)}
    # Behind the head, and before the reserved bytes and the CRC.
    for name in (_LAYOUT.names or ())[4:-2]:
        content[name] = record[name].decode() if _LAYOUT[name].kind == "S" else record[name].copy()
    return content
