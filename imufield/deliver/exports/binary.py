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

import struct
import zlib

import numpy as np

from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.whole_model import WholeModel, apply_header, gauge_note, whole_model
from imufield.errors import ParameterFileError, Reason
from imufield.sentences import Sentences

sentence = Sentences(__package__)

MAGIC = b"IMUFIELD"
VERSION = 1  # apply.h and unpack refuse a newer one.
# The table above; apply.h reads the same offsets.
_LAYOUT = struct.Struct("<8sHHI16s16s32s24s45dI")
SIZE = _LAYOUT.size + 4
_SHAPES = {
    "scale": (3,),
    "bias": (3,),
    "inverse_alignment": (3, 3),
    "quadratic": (3,),
    "raw_zero": (3,),
    "rate_matrix": (3, 3),
    "rate_offset": (3,),
    "g_sensitivity": (3, 3),
    "site": (3,),
}


def export(job: Job) -> Draft:
    """Return the block and the header that reads it."""
    block = pack(job, whole_model(job))
    files = {"imufield_parameters.bin": block, "imufield_apply.h": apply_header().encode("ascii")}
    return Draft(files=files, notes=gauge_note(job))


def pack(job: Job, model: WholeModel) -> bytes:
    """Return the block."""
    calibration, context = job.parameters.calibration, job.parameters.context
    gyroscope = calibration.gyroscope
    texts = []
    for what, text, size in (
        ("raw unit", calibration.accelerometer_raw_unit, 16),
        ("raw unit", gyroscope.raw_unit if model.has_gyroscope and gyroscope is not None else "", 16),
        ("serial number", context.instrument.serial_number, 32),
        ("time", context.created, 24),
    ):
        texts.append(text.encode())
        if len(texts[-1]) > size:
            refused = sentence("binary.text_size", what=what, text=text, found=len(texts[-1]), most=size)
            raise ParameterFileError(refused, Reason.BOUNDS)
    numbers = np.concatenate([values.ravel() for values in model.arrays().values()])
    site = (calibration.gravity.gravity_m_s2, *context.session.temperature_degc)
    flags = model.has_gyroscope | model.quadratic_on_body_axes << 1
    head = (MAGIC, VERSION, SIZE, flags)
    body = _LAYOUT.pack(*head, *texts, *numbers, *site, 0)
    return body + struct.pack("<I", zlib.crc32(body))


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
    _, version, size, flags, *rest = _LAYOUT.unpack(block[: _LAYOUT.size])
    # Before size and CRC, which a newer version may have elsewhere.
    if version > VERSION:
        raise ParameterFileError(sentence("binary.newer", version=version, known=VERSION), Reason.NEWER)
    if size != SIZE or struct.unpack("<I", block[SIZE - 4 : SIZE])[0] != zlib.crc32(block[: SIZE - 4]):
        raise ParameterFileError(sentence("binary.damaged"))
    names = ("accelerometer_raw_unit", "gyroscope_raw_unit", "serial_number", "created")
    content: dict[str, object] = {name: text.rstrip(b"\0").decode() for name, text in zip(names, rest[:4], strict=True)}
    content |= {"has_gyroscope": bool(flags & 1), "quadratic_on_body_axes": bool(flags & 2)}
    at = 4
    for name, shape in _SHAPES.items():
        count = int(np.prod(shape))
        content[name] = np.array(rest[at : at + count]).reshape(shape)
        at += count
    return content
