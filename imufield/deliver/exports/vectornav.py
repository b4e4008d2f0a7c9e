"""VectorNav: user compensation of accelerometer (register 25) and gyroscope (register 84), VN-100 manual UM001, 6.2.

``out = C (in - B)`` on top of the factory calibration: the same form as ours, C = M and B = o.
"""

from __future__ import annotations

from functools import reduce
from operator import xor

from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.text import text_file

# Manual UM001, 6.2: C by rows, then B.
REGISTERS = {"accelerometer": 25, "gyroscope": 84}


def export(job: Job) -> Draft:
    """Return the commands, one a line, ready to be sent."""
    corrections = job.corrections(job.free_frame).without_g_sensitivity()
    commands = []
    for triad, correction in job.in_si(corrections).triads.items():
        numbers = [*correction.matrix.ravel(), *correction.offset]
        # Eleven decimals, not seventeen digits: the whole command stays below the 256 bytes of the receiver.
        commands.append(f"VNWRG,{REGISTERS[triad]:02d},{','.join(f'{value:.11f}' for value in numbers)}")
    content = text_file([with_checksum(command) for command in (*commands, "VNWNV")], end="\r\n")
    notes = tuple(map(sentence, ("vectornav.stores", "vectornav.factory", "vectornav.single_precision")))
    return Draft(files={"vectornav.txt": content}, target_model=corrections, notes=notes)


def with_checksum(body: str) -> str:
    """Return a command with its checksum, exclusive or of the characters between $ and *."""
    return f"${body}*{reduce(xor, body.encode('ascii')):02X}"
