from pathlib import Path
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from imufield.acquire.link.ports import CanChannel, SerialPort, can_channels, serial_ports


def test_ports_of_this_machine_are_listed_without_error() -> None:
    assert all(port.device for port in serial_ports())


def test_usb_adapters_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [
        SimpleNamespace(device="/dev/ttyS0", description="n/a", vid=None, pid=None, serial_number=None),
        SimpleNamespace(device="/dev/ttyUSB1", description="FT232R", vid=0x0403, pid=0x6001, serial_number="A1"),
    ]
    monkeypatch.setattr(list_ports, "comports", lambda: found)
    assert serial_ports() == [
        SerialPort(device="/dev/ttyUSB1", description="FT232R", vendor_id=0x0403, product_id=0x6001, serial_number="A1"),
        SerialPort(device="/dev/ttyS0", description=""),
    ]


def test_can_interfaces_of_the_system(tmp_path: Path) -> None:
    for name, kind, flags in (("can0", "280", "0x40081"), ("vcan1", "280", "0x80"), ("eth0", "1", "0x1003"), ("odd", "", "")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(kind + "\n", encoding="ascii")
        (tmp_path / name / "flags").write_text(flags + "\n", encoding="ascii")
    assert can_channels(tmp_path) == [CanChannel("socketcan:can0", "up"), CanChannel("socketcan:vcan1", "down")]
    assert can_channels(tmp_path / "nowhere") == []
