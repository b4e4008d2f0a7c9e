"""MicroStrain: MIP commands 0x0C,0x37 (accelerometer bias, g) and 0x0C,0x38 (gyroscope bias, rad/s): what is subtracted."""

from __future__ import annotations

import struct

import numpy as np

from imufield.acquire.driver import checksum_of
from imufield.dataclass import replace
from imufield.deliver.exports.conventions import Correction
from imufield.deliver.exports.job import BIAS_ONLY, Draft, Job, sentence
from imufield.deliver.exports.text import comment, row, text_file
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.samples import FloatArray

_COMMANDS_3DM = 0x0C  # Descriptor set of all commands here.
# Title, field descriptor, and the unit of the packet in SI.
_COMMANDS = {
    "accelerometer": ("accelerometer bias, g", 0x37, STANDARD_GRAVITY_M_S2),
    "gyroscope": ("gyroscope bias, rad/s", 0x38, 1.0),
}
# Function selectors of every MIP setting.
_APPLY = 1
_SAVE = 3


def export(job: Job) -> Draft:
    """Return the packets as bytes to send, and as text to read."""
    corrections = job.corrections("sensor")
    si = job.in_si(corrections)
    job.require_positive("accelerometer", np.diag(si.accelerometer.matrix))
    lines, packets = comment(job.heading()), []
    for triad, correction in si.triads.items():
        title, descriptor, unit = _COMMANDS[triad]
        bias = correction.offset / unit
        apply, save = packet(descriptor, _APPLY, bias), packet(descriptor, _SAVE)
        packets += [apply, save]
        lines += ["", f"# {title}: [{row(bias)}]", f"{apply.hex()}  # apply", f"{save.hex()}  # keep after power-off"]
    # What the instrument does: the driver's scale, and this offset taken off.
    scale, _ = job.accelerometer_si()
    bias_only = replace(corrections, accelerometer=Correction(np.eye(3) / scale, corrections.accelerometer.offset))
    return Draft(
        files={"microstrain.txt": text_file(lines), "microstrain.bin": b"".join(packets)},
        target_model=job.gyroscope_bias_only(bias_only),
        accelerometer_lacks=BIAS_ONLY,
        gyroscope_lacks=BIAS_ONLY,
        notes=(sentence("microstrain.idle"), sentence("microstrain.replaces")),
    )


def packet(descriptor: int, function: int, bias: FloatArray | None = None) -> bytes:
    """Return a MIP packet of the 3DM command set with one field."""
    data = b"" if bias is None else struct.pack(">3f", *bias)
    field = bytes([len(data) + 3, descriptor, function]) + data
    message = b"\x75\x65" + bytes([_COMMANDS_3DM, len(field)]) + field
    return message + checksum_of("FLETCHER-16/MOD-256", message).to_bytes(2, "big")
