"""Serial ports of this machine, for ``imufield devices`` and for error messages that name what is there."""

from __future__ import annotations

from dataclasses import dataclass

from serial.tools import list_ports


@dataclass(frozen=True, slots=True)
class SerialPort:
    """One serial port.

    Attributes
    ----------
    device : str
        What ``--port`` takes.
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
        SerialPort(port.device, _description(port.description), port.vid, port.pid, port.serial_number)
        for port in list_ports.comports()
    ]
    return sorted(found, key=lambda port: (port.vendor_id is None, port.device))


def _description(text: str | None) -> str:
    # pyserial writes "n/a" where the system says nothing.
    return "" if text is None or text == "n/a" else text
