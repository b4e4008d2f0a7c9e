"""Honeywell TARS on a J1939 bus."""

from .mv5_can import SaeCan


class TarsCan(SaeCan):
    """The messages ACCS, ARI and SSI2 of SAE J1939 from source address 0xE2, as driver ``aceinna_can`` lists them.

    Words are taken in SAE order: lateral, longitudinal, vertical; pitch, roll, yaw. Layout and scale fit three frames of
    a public recording (9.77 m/s^2 in the third word at rest); the order of the axes is an assumption.
    """

    name = "tars_can"
    title = "Honeywell TARS (J1939)"
    status = "verified on real bytes"
    manual = "SAE J1939-71 PGN 61481, 61482, 61485; frames of a public logger"


DRIVER = TarsCan
