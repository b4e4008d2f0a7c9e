"""What no driver may send."""

from __future__ import annotations

from collections.abc import Callable

FORBIDDEN: dict[str, Callable[[bytes], bool]] = {
    "stim300": lambda data: data.startswith((b"$save", b"$saf", b"$sb", b"s\r", b"z", b"R\r")),
    "xsens_mtdata2": lambda data: data[2] in (0x0E, 0x18, 0x40, 0x48, 0x84, 0x8E, 0xEC) or (data[2] == 0xC0 and data[3] > 0),
    "vectornav_binary": lambda data: data[1:6] in (b"VNWNV", b"VNRFS", b"VNRST", b"VNTAR", b"VNFWU"),
    "microstrain_mip": lambda data: (
        data[2:6:3] == bytes([0x01, 0x7E]) or data[5] in (0x30, 0x09, 0x40) or data[6:7] in (b"\3", b"\5")
    ),
    "aceinna_serial": lambda data: (
        data[2:4] in (b"sC", b"rD", b"WF", b"WE", b"UE", b"LE", b"JI", b"JA", b"WA", b"SR", b"uC", b"uA")
    ),
    "witmotion": lambda data: data[2] in (0x00, 0x01, 0x04),
}
"""Commands that write to flash or EEPROM, load factory settings, reset, or change the bit rate, by their bytes."""
FORBIDDEN["vectornav_ascii"] = FORBIDDEN["vectornav_binary"]
