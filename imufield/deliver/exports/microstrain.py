"""MicroStrain: MIP commands 0x0C,0x37 (accelerometer bias, g) and 0x0C,0x38 (gyroscope bias, rad/s): what is subtracted."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np

from imufield.deliver.exports.conventions import Correction, Corrections
from imufield.deliver.exports.flight_stack import bias_only_gyroscope
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import comment, row, text_file
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.samples import FloatArray

_COMMANDS_3DM = 0x0C
_ACCELEROMETER_BIAS = 0x37
_GYROSCOPE_BIAS = 0x38
_APPLY = 1
_SAVE = 3


def export(job: Job) -> Draft:
    """Return the packets as bytes to send, and as text to read."""
    full = job.corrections("sensor")
    si = job.in_si(full)
    job.require_positive("accelerometer", np.diag(si.accelerometer.matrix))
    commands = [("accelerometer bias, g", _ACCELEROMETER_BIAS, si.accelerometer.offset / STANDARD_GRAVITY_M_S2)]
    if si.gyroscope is not None:
        commands.append(("gyroscope bias, rad/s", _GYROSCOPE_BIAS, si.gyroscope.offset))
    lines, packets = comment(job.heading()), []
    for title, descriptor, bias in commands:
        apply, save = packet(descriptor, _APPLY, bias), packet(descriptor, _SAVE)
        packets += [apply, save]
        lines += ["", f"# {title}: [{row(bias.tolist())}]", f"{apply.hex()}  # apply", f"{save.hex()}  # keep after power-off"]
    files = {"microstrain.txt": text_file(lines), "microstrain.bin": b"".join(packets)}
    note = ("set the instrument to idle before the packets; they replace the biases in it and keep single precision",)
    lacks = "scale and misalignment cannot be held"
    return Draft(files=files, held=_bias_only(job, full), accelerometer_lacks=lacks, gyroscope_lacks=lacks, notes=note)


def packet(descriptor: int, function: int, bias: FloatArray | None = None) -> bytes:
    """Return a MIP packet of the 3DM command set with one field."""
    data = b"" if bias is None else struct.pack(">3f", *bias)
    field = bytes([len(data) + 3, descriptor, function]) + data
    message = b"\x75\x65" + bytes([_COMMANDS_3DM, len(field)]) + field
    first = second = 0
    for byte in message:
        first = (first + byte) % 256
        second = (second + first) % 256
    return message + bytes([first, second])


def _bias_only(job: Job, full: Corrections) -> Corrections:
    scale, _ = job.accelerometer_si()
    held = replace(full, accelerometer=Correction(np.eye(3) / scale, full.accelerometer.offset))
    return bias_only_gyroscope(job, held)
