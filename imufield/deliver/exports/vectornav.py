"""VectorNav: user compensation of accelerometer (register 25) and gyroscope (register 84), VN-100 manual UM001, 6.2.

``out = C (in - B)`` on top of the factory calibration: the same form as ours, C = M and B = o.
"""

from __future__ import annotations

from functools import reduce
from operator import xor

from imufield.deliver.exports.conventions import Correction
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import text_file

ACCELEROMETER_REGISTER = 25
GYROSCOPE_REGISTER = 84


def export(job: Job) -> Draft:
    """Return the commands, one a line, ready to be sent."""
    held = job.corrections(job.free_frame).without_g_sensitivity()
    si = job.in_si(held)
    commands = [_write(ACCELEROMETER_REGISTER, si.accelerometer)]
    if si.gyroscope is not None:
        commands.append(_write(GYROSCOPE_REGISTER, si.gyroscope))
    content = text_file([sentence(command) for command in (*commands, "VNWNV")], end="\r\n")
    notes = (
        "the last command (VNWNV) stores the registers in flash; leave it out to try them until the next reset",
        "these registers act on top of the factory calibration: set them to identity and zero before recording a calibration",
        "the instrument keeps single precision (relative error up to 6e-8)",
    )
    return Draft(files={"vectornav.txt": content}, held=held, notes=notes)


def sentence(body: str) -> str:
    """Return a command with its checksum, exclusive or of the characters between $ and *."""
    return f"${body}*{reduce(xor, body.encode('ascii')):02X}"


def _write(register: int, correction: Correction) -> str:
    numbers = [*correction.matrix.ravel(), *correction.offset]
    # Eleven decimals, not seventeen digits: the whole command stays below the 256 bytes of the receiver.
    return f"VNWRG,{register:02d},{','.join(f'{value:.11f}' for value in numbers)}"
