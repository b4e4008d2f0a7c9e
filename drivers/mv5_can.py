"""MicroStrain MV5-AR on a J1939 bus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from imufield.acquire.driver import Driver, Evidence, Wire


class Mv5Can(Driver):
    """The messages ACCS, ARI and SSI2 of SAE J1939 from source address 0xE2, as driver ``aceinna_can`` lists them.

    Words are taken in SAE order: lateral, longitudinal, vertical; pitch, roll, yaw.
    """

    name: ClassVar[str] = "mv5_can"
    title: ClassVar[str] = "MicroStrain MV5-AR (J1939)"
    protocol: ClassVar[str] = "j1939_imu"
    wire: ClassVar[Wire] = "can"
    default_baud: ClassVar[int] = 250_000
    bauds: ClassVar[tuple[int, ...]] = (250_000, 500_000)
    status: ClassVar[Evidence] = "document only"
    manual: ClassVar[str] = "SAE J1939-71 PGN 61481, 61482, 61485; signal names of an open-source MV5 driver"
    settings: ClassVar[Mapping[str, object]] = {"axes": "sae"}


DRIVER = Mv5Can
