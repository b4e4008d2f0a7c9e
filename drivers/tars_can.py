"""Honeywell TARS on a J1939 bus."""

from .mv5_can import SaeCan


class TarsCan(SaeCan):
    """The messages ACCS (PGN 61485), ARI (61482) and SSI2 (61481) of SAE J1939, from source address 0xE2.

    Layout and scale were verified on three real frames of a public recording (9.77 m/s^2 in the third word at rest). The
    order of the axes is assumed to be that of SAE: lateral, longitudinal, vertical; pitch, roll, yaw. Check it by turning the
    instrument.
    """

    name = "tars_can"
    title = "Honeywell TARS (J1939)"
    status = "verified on real bytes"
    manual = "SAE J1939-71 PGN 61481, 61482, 61485; frames of a public logger"


DRIVER = TarsCan
