"""MicroStrain MV5-AR on a J1939 bus."""

from collections.abc import Mapping
from typing import ClassVar

from imufield.acquire.driver import Driver


class SaeCan(Driver):
    """What instruments have in common that send the messages of SAE J1939 with their words in SAE order."""

    protocol = "j1939_imu"
    wire = "can"
    bauds = (250_000, 500_000)
    settings: ClassVar[Mapping[str, object]] = {"axes": "sae"}


class Mv5Can(SaeCan):
    """The messages ACCS (PGN 61485), ARI (61482) and SSI2 (61481) of SAE J1939, from source address 0xE2.

    Words are taken in SAE order: lateral, longitudinal, vertical; pitch, roll, yaw.
    """

    name = "mv5_can"
    title = "MicroStrain MV5-AR (J1939)"
    status = "document only"
    manual = "SAE J1939-71 PGN 61481, 61482, 61485; signal names of an open-source MV5 driver"


DRIVER = Mv5Can
