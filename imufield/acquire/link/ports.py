"""List the serial ports and CAN channels of this machine, for ``imufield devices`` and for error messages."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from serial.tools import list_ports

from imufield.dataclass import dataclass

_NETWORK = Path("/sys/class/net")
_TYPE_CAN = "280"  # ARPHRD_CAN of Linux, ``if_arp.h``.


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialPort:
    """One serial port.

    Attributes
    ----------
    device : str
        Name of the port, the value of ``--port``.
    description : str
        What the system or the USB adapter calls itself.
    vendor_id, product_id : int or None
        USB identity; None for ports that are not on USB.
    serial_number : str or None
        Of the USB adapter, not of the instrument.
    """

    device: str
    description: str
    vendor_id: int | None = None
    product_id: int | None = None
    serial_number: str | None = None


def serial_ports() -> list[SerialPort]:
    """List the serial ports of this machine by name, USB adapters first."""
    found = [
        SerialPort(
            device=port.device,
            # pyserial writes "n/a" where the system says nothing.
            description="" if port.description in (None, "n/a") else port.description,
            vendor_id=port.vid,
            product_id=port.pid,
            serial_number=port.serial_number,
        )
        for port in list_ports.comports()
    ]
    return sorted(found, key=lambda port: (port.vendor_id is None, port.device))


@dataclass(frozen=True, slots=True)
class CanChannel:
    """A CAN interface of the system: the value of ``--bus``, and whether it is up or down."""

    bus: str
    state: str


def can_channels(network: Path = _NETWORK) -> list[CanChannel]:
    """List the CAN interfaces that the system itself knows (Linux); adapters with drivers of their own are not among them."""
    found = []
    with suppress(OSError):
        for folder in sorted(network.iterdir()):
            with suppress(OSError):
                if (folder / "type").read_text(encoding="ascii").strip() == _TYPE_CAN:
                    is_up = int((folder / "flags").read_text(encoding="ascii"), 16) & 1
                    found.append(CanChannel(f"socketcan:{folder.name}", "up" if is_up else "down"))
    return found
