from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from imufield.acquire.ports import SerialPort, serial_ports


def test_ports_of_this_machine_are_listed_without_error() -> None:
    assert all(port.device for port in serial_ports())


def test_usb_adapters_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [
        SimpleNamespace(device="/dev/ttyS0", description="n/a", vid=None, pid=None, serial_number=None),
        SimpleNamespace(device="/dev/ttyUSB1", description="FT232R", vid=0x0403, pid=0x6001, serial_number="A1"),
    ]
    monkeypatch.setattr(list_ports, "comports", lambda: found)
    assert serial_ports() == [
        SerialPort("/dev/ttyUSB1", "FT232R", 0x0403, 0x6001, "A1"),
        SerialPort("/dev/ttyS0", ""),
    ]
