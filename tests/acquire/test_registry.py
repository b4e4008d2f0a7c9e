"""Finding drivers."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from imufield.acquire import registry
from imufield.acquire.driver import Driver
from imufield.acquire.registry import driver_names, load_driver
from imufield.errors import ProtocolError, Reason


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
        "text": "other_good:DRIVER",
    }
    points = "\n".join(f"{name} = {value}" for name, value in names.items())
    (dist / "entry_points.txt").write_text(f"[imufield.drivers]\n{points}\n")
    (tmp_path / "other_good.py").write_text(
        "from imufield.acquire.driver import Driver\nclass Good(Driver):\n    name = 'good'\nDRIVER = Good\n"
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
    ("name", "says", "reason"),
    [
        ("stim30", "did you mean 'stim300'", Reason.UNKNOWN_DRIVER),
        ("broken", "no_such_library_anywhere", Reason.DRIVER_FAILED),
        ("odd", "is a int, not a class", Reason.DRIVER_FAILED),
        ("text", "2 drivers called 'text', from imufield, other", Reason.UNKNOWN_DRIVER),
        ("", "there is no driver ''", Reason.UNKNOWN_DRIVER),
        ("../conftest", "there is no driver", Reason.UNKNOWN_DRIVER),
    ],
)
def test_failures_are_typed(plugins: Path, name: str, says: str, reason: Reason) -> None:
    with pytest.raises(ProtocolError) as caught:
        load_driver(name)
    assert says in caught.value.message
    assert caught.value.reason is reason


def test_a_failed_import_keeps_its_cause(plugins: Path) -> None:
    with pytest.raises(ProtocolError) as caught:
        load_driver("broken")
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)


def test_two_shipped_points_cannot_hide_each_other() -> None:
    assert registry.GROUP == "imufield.drivers"
    assert EntryPoint("stim300", "imufield.drivers.stim300:DRIVER", registry.GROUP).load() is load_driver("stim300")
