"""Aceinna MTLT305, MTLT335 and OpenIMU300RI on a J1939 bus."""

from __future__ import annotations

from collections.abc import Iterable

from imufield.acquire.driver import Driver, Message
from imufield.acquire.protocol.can_frame import EXTENDED, pack_frame

HOST_ADDRESS = 0xF9
"""J1939 address of an off-board service tool."""
EVERYBODY = 0xFF
_REQUEST_PGN = 0xEA00
_VERSION_PGN = 0xFEDA
_PRIORITY = 6


def request(pgn: int, destination: int = EVERYBODY, source: int = HOST_ADDRESS) -> bytes:
    """Return the request for a message, as a packed frame."""
    identifier = EXTENDED | _PRIORITY << 26 | (_REQUEST_PGN | destination) << 8 | source
    # J1939-21: the number of the message goes out least significant byte first.
    return pack_frame(identifier, pgn.to_bytes(3, "little"))


class AceinnaCan(Driver):
    """Messages of SAE J1939, one frame each, sent 100 times a second.

    29-bit identifiers, little-endian::

        ==============  ==========  ========================================================
        message         identifier  data
        ==============  ==========  ========================================================
        ACCS  61485     08F02Daa    3 x u16, raw / 100 - 320 m/s^2; byte 6 figures of merit
        ARI   61482     0CF02Aaa    3 x u16, raw / 128 - 250 deg/s; byte 6 figures of merit
        SSI2  61481     0CF029aa    2 x u24, raw / 32768 - 250 deg; bytes 6 and 7 quality, latency
        version  65242  18FEDAaa    major, minor, patch, stage, build; answer to a request
        ==============  ==========  ========================================================

    The source address is 0x80 as delivered. 0xFFxx stands for not available, 0xFExx for an error. No frame has a
    counter, so losses show in time stamps alone. Resolution is coarse: 0.01 m/s^2 and 0.0078 deg/s. The three words are
    X, Y, Z by the DBC of the MTLT305D; OpenIMU300RI as delivered needs ``--set axes=openimu300ri``.

    Layout and scale were checked against a recording of an MTLT305D. The order of axes is not verified: turn the instrument
    by hand and see which axis responds.
    """

    name = "aceinna_can"
    title = "Aceinna MTLT305, MTLT335, OpenIMU300RI (J1939)"
    protocol = "j1939_imu"
    wire = "can"
    bauds = (250_000, 500_000, 125_000, 1_000_000)
    status = "verified on real bytes"
    manual = "Aceinna MTLT305D DBC rev. 19.1.51, OpenIMU300RI firmware and python-mtlt (open source)"
    # The save command (PGN 65361) is not here on purpose: nothing is ever written to the instrument's memory.
    identity_commands = (request(_VERSION_PGN),)

    @classmethod
    def identity(cls, messages: Iterable[Message]) -> dict[str, str]:
        """Return the firmware's version, which is all that one frame tells."""
        for message in messages:
            if message["kind"] == "SoftwareVersion" and "VersionMajor" in message:
                parts = ("Major", "Minor", "Patch", "Stage", "Build")
                return {"firmware": ".".join(str(message[f"Version{part}"]) for part in parts if f"Version{part}" in message)}
        return {}


DRIVER = AceinnaCan
