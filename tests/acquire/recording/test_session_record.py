import math
import tomllib
from contextlib import suppress
from dataclasses import Field, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import get_type_hints

import pytest
import tomli_w

from imufield.acquire.recording.session import Session
from imufield.acquire.recording.session_record import (
    FORMAT,
    VERSION,
    GuideRecord,
    LinkRecord,
    ProtocolRecord,
    SessionRecord,
    SettingRecord,
    SiteRecord,
)
from imufield.errors import Reason, RecordingError
from tests.refused import refused

PATH = Path("session.toml")
WHOLE = """
format = "imufield-session"
version = 1
created = "2026-03-01T12:00:00Z"
software = "imufield 0.1.0"
model = "STIM300"
finished = false
kind = "capture"
scheme = "paper24"

[instrument]
driver = "stim300"
serial_number = 1234

[link]
port = "/dev/ttyUSB0"
baud = 921600

[protocol]
name = "stim300"
sha256 = "ab"
text = "[protocol]"

[settings.range_g]
value = 10
origin = "given"

[units]
accelerometer = "g"

[nominal]
raw_zero = [1, 2.5, 0]
rate_hz = 500.0

[guide]
hold_s = 8
rotations = "horizontal"
revisit_first = true

[site]
gravity_m_s2 = 9.81
"""


def test_the_whole_document_is_typed() -> None:
    record = SessionRecord.read(tomllib.loads(WHOLE), PATH)
    assert (record.model, record.kind, record.scheme, record.finished) == ("STIM300", "capture", "paper24", False)
    assert (record.instrument.driver, record.instrument.serial_number, record.instrument.firmware) == ("stim300", "1234", "")
    assert (record.link.port, record.link.bus, record.link.baud) == ("/dev/ttyUSB0", None, 921600)
    assert record.settings == {"range_g": SettingRecord(10, "given")}
    assert record.nominal.raw_zero == (1.0, 2.5, 0.0)
    assert record.guide == GuideRecord(hold_s=8.0, rotations="horizontal", revisit_first=True)
    assert record.site == SiteRecord(gravity_m_s2=9.81)


def test_what_is_not_there_is_none() -> None:
    content = tomllib.loads(WHOLE.partition("kind")[0])
    record = SessionRecord.read(content, PATH)
    assert (record.scheme, record.guide, record.site, record.nominal.raw_zero) == (None, GuideRecord(), SiteRecord(), None)
    assert (record.software, record.protocol.sha256) == ("imufield 0.1.0", "not known")


def test_one_zero_stands_for_all_axes() -> None:
    content = {**tomllib.loads(WHOLE), "nominal": {"raw_zero": 32768}}
    assert SessionRecord.read(content, PATH).nominal.raw_zero == (32768.0, 32768.0, 32768.0)


def test_records_are_written_in_their_order_without_what_is_none(tmp_path: Path) -> None:
    guide = GuideRecord(revisit_first=True, hold_s=8.0, earlier_scale_raw=1.5)
    session = Session.create(tmp_path, "imu", {"guide": guide, "site": SiteRecord(latitude_deg=45.0)})
    text = (session.folder / "session.toml").read_text()
    tables = "[guide]\nhold_s = 8.0\nearlier_scale_raw = 1.5\nrevisit_first = true\n\n[site]\nlatitude_deg = 45.0\n"
    assert text.endswith(tables)
    assert Session.open(session.folder).record.guide == guide


def test_what_nothing_reads_stays_in_the_file(tmp_path: Path) -> None:
    content = tomllib.loads(WHOLE)
    content["guide"]["assistant"] = "somebody"
    (tmp_path / "session.toml").write_text(tomli_w.dumps(content))
    Session.open(tmp_path).update(finished=True)
    assert (tmp_path / "session.toml").read_text() == tomli_w.dumps({**content, "finished": True})


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ({"instrument": {"colour": "red"}}, Reason.UNKNOWN_KEY),
        ({"site": {"latitud_deg": 48.0}}, Reason.UNKNOWN_KEY),
        ({"guide": {"hold_s": 0}}, Reason.DAMAGED),
        ({"guide": {"hold_s": "8"}}, Reason.DAMAGED),
        ({"guide": {"earlier_scale_raw": float("nan")}}, Reason.DAMAGED),
        ({"site": {"gravity_m_s2": 98.1}}, Reason.DAMAGED),
        ({"site": {"latitude_deg": True}}, Reason.DAMAGED),
        ({"nominal": {"raw_zero": [1.0, 2.0]}}, Reason.DAMAGED),
        ({"nominal": {"raw_zero": [1.0, 2.0, float("inf")]}}, Reason.DAMAGED),
        ({"settings": {"range_g": 10}}, Reason.DAMAGED),
        ({"settings": {"range_g": {"origin": "given"}}}, Reason.DAMAGED),
    ],
)
def test_a_damaged_table_is_refused(table: dict[str, object], reason: Reason) -> None:
    (name,) = table
    with refused(RecordingError, reason, name) as caught:
        SessionRecord.read({**tomllib.loads(WHOLE), **table}, PATH)
    assert caught.value.reason is reason


ANYTHING: tuple[object, ...] = (
    *(True, -1, 0, 2**63, 1e308, 5e-324, -5e-324, 1e400, float("nan")),
    *("", "x", [], [[1]], {}, {"a": 1}, datetime(2026, 1, 1, tzinfo=UTC)),
)


@pytest.mark.parametrize("value", ANYTHING, ids=repr)
@pytest.mark.parametrize(
    ("name", "kind"), [("link", LinkRecord), ("protocol", ProtocolRecord), ("guide", GuideRecord), ("site", SiteRecord)]
)
def test_whatever_is_read_is_of_its_type_and_can_be_computed_with(name: str, kind: type, value: object) -> None:
    for entry, declared in get_type_hints(kind).items():
        # A record that can be read is one that arithmetic gets through: squares and quotients are numbers.
        with suppress(RecordingError):
            record = getattr(SessionRecord.read({**tomllib.loads(WHOLE), name: {entry: value}}, PATH), name)
            found = getattr(record, entry)
            assert isinstance(found, declared), (entry, found)
            if isinstance(found, float) and found:
                assert math.isfinite(found**2 / (1 / found) ** 2), (entry, found)


@pytest.mark.parametrize(("entry", "limits"), [(entry, entry.metadata) for entry in fields(GuideRecord) if entry.metadata])
def test_what_an_option_takes_a_session_can_hold(entry: Field[object], limits: dict[str, float]) -> None:
    # The guide writes what was typed: were the limits of an option wider, no session could be made.
    for value in limits.values():
        record = SessionRecord.read({**tomllib.loads(WHOLE), "guide": {entry.name: value}}, PATH)
        assert getattr(record.guide, entry.name) == value


@pytest.mark.parametrize(
    ("began", "recorded"),
    [
        ("2024-03-01T12:00:00Z", "2024-03-01T12:00:00Z"),
        ("2024-3-1T12:0:0Z", ""),
        ("2024-13-01T12:00:00Z", ""),
        # Digits of another script, and what no calendar of a plot reaches.
        ("\u0662\u0660\u0662\u0664-03-01T12:00:00Z", ""),
        ("0001-01-01T00:00:00Z", ""),
        ("9999-12-31T00:00:00Z", ""),
        ("\x1b[31m", ""),
        (20240301, ""),
    ],
)
def test_a_moment_that_is_none_dates_nothing(began: object, recorded: str) -> None:
    content = {"format": FORMAT, "version": VERSION, "created": "2026-03-01T12:00:00Z", "model": "IMU", "finished": True}
    record = SessionRecord.read(content | {"kind": "import", "import": {"began": began}}, Path("session.toml"))
    assert record.recorded == recorded
    assert SessionRecord.read(content | {"kind": "import"}, Path("session.toml")).recorded == ""
