"""Finding drivers."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from imufield.acquire import registry
from imufield.acquire.driver import Driver
from imufield.acquire.instrument.baud_search import serial_candidates
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.registry import driver_names, load_driver
from imufield.errors import ProtocolError, Reason, UsageError
from tests.refused import refused


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder on the path whose ``entry_points.txt`` other distributions would have installed."""
    dist = tmp_path / "other-1.0.dist-info"
    dist.mkdir()
    (dist / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    names = {
        "good": "other_good:DRIVER",
        "broken": "other_broken:DRIVER",
        "odd": "other_odd:DRIVER",
        "angry": "other_angry:DRIVER",
        "leaving": "other_leaving:DRIVER",
        "bare": "other_bare:DRIVER",
        "lost": "other_lost:DRIVER",
        "text": "other_good:DRIVER",
    }
    points = "\n".join(f"{name} = {value}" for name, value in names.items())
    (dist / "entry_points.txt").write_text(f"[imufield.drivers]\n{points}\n")
    (tmp_path / "other_good.py").write_text(
        "from imufield.drivers.text import Text\nclass Good(Text):\n    name = 'good'\nDRIVER = Good\n"
    )
    (tmp_path / "other_angry.py").write_text("{}['key']\n")
    (tmp_path / "other_leaving.py").write_text("import sys\nsys.exit(3)\n")
    (tmp_path / "other_bare.py").write_text(
        "from imufield.acquire.driver import Driver\nclass Bare(Driver):\n    name = 'bare'\nDRIVER = Bare\n"
    )
    (tmp_path / "other_lost.py").write_text(
        "from other_good import Good\nclass Lost(Good):\n    name = 'lost'\n    protocol = 'nowhere'\nDRIVER = Lost\n"
    )
    (tmp_path / "other_broken.py").write_text("import no_such_library_anywhere\n")
    (tmp_path / "other_odd.py").write_text("DRIVER = 5\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_listing_imports_nothing(plugins: Path) -> None:
    sys.modules.pop("imufield.drivers.text", None)
    assert {"stim300", "text", "good", "broken"} <= set(driver_names())
    assert "imufield.drivers.text" not in sys.modules
    assert "other_broken" not in sys.modules


def test_drivers_of_others_load_like_ours(plugins: Path) -> None:
    assert load_driver("good").name == "good"
    assert issubclass(load_driver("stim300"), Driver)


@pytest.mark.parametrize(
    ("name", "key", "facts"),
    [
        ("stim30", "unknown", ("'stim30'", "'stim300'")),
        ("broken", "failed", ("no_such_library_anywhere",)),
        ("odd", "no_driver", ("int", "Driver")),
        ("angry", "failed", ("KeyError: 'key'",)),
        ("leaving", "failed", ("SystemExit",)),
        ("bare", "incomplete", ("title, protocol, default_baud, bauds, status, manual",)),
        ("text", "several", ("2", "'text'", "imufield, other")),
        ("", "unknown", ("''",)),
        ("../conftest", "unknown", ("'../conftest'",)),
    ],
)
def test_failures_are_typed(plugins: Path, name: str, key: str, facts: tuple[str, ...]) -> None:
    reason = Reason.UNKNOWN_DRIVER if key in ("unknown", "several") else Reason.DRIVER_FAILED
    with refused(ProtocolError, reason, *facts, key=f"registry.{key}") as caught:
        load_driver(name)
    assert caught.value.values["name"] == name


@pytest.mark.parametrize("name", ["stim30", "", "../conftest"])
def test_a_name_that_was_typed_wrong_is_a_usage_error(plugins: Path, name: str) -> None:
    with pytest.raises(UsageError):
        load_driver(name)


def test_a_protocol_that_was_typed_wrong_is_a_usage_error() -> None:
    with refused(UsageError, Reason.BAD_PROTOCOL, "nix") as caught:
        load_protocol("nix")
    assert caught.value.values["name"] == "nix"


def test_recognition_passes_over_drivers_that_cannot_be_used(plugins: Path) -> None:
    # Two of one name are an error of their own; what is left here is others' alone.
    points = plugins / "other-1.0.dist-info" / "entry_points.txt"
    points.write_text(points.read_text().replace("text = other_good:DRIVER", ""))
    said: list[str] = []
    found = {one.name for one in serial_candidates(say=said.append)}
    assert {"good", "text", "stim300", "xsens_mtdata2"} <= found
    assert not {"broken", "odd", "angry", "leaving", "bare", "lost"} & found
    assert [next(name for name in ("angry", "bare", "broken", "leaving", "nowhere", "odd") if name in one) for one in said] == [
        "angry",
        "bare",
        "broken",
        "leaving",
        "nowhere",
        "odd",
    ]
    assert all(one.startswith("passed over: ") and "\n" not in one for one in said)


def test_a_failed_import_keeps_its_cause(plugins: Path) -> None:
    with pytest.raises(ProtocolError) as caught:
        load_driver("broken")
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)


def test_two_shipped_points_cannot_hide_each_other() -> None:
    assert registry.GROUP == "imufield.drivers"
    assert EntryPoint("stim300", "imufield.drivers.stim300:DRIVER", registry.GROUP).load() is load_driver("stim300")
