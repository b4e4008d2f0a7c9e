"""Adding an instrument as the pages say: a driver in another package, a DBC file with its mapping, both as they stand there."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import cantools
import numpy as np
import pytest

from imufield.acquire.decode.statistics import remarks
from imufield.acquire.decoder import Decoder
from imufield.acquire.instrument.can_map import parse_map, protocol_from_dbc
from imufield.acquire.protocol.can_frame import Frame
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.samples import Samples, Status, concatenate
from tests.acquire.plain_frames import pack_frames

DOCS = Path(__file__).resolve().parent.parent / "docs"
N = 50


def fenced(page: str, kind: str) -> str:
    blocks = re.findall(rf"^```{kind}\n(.*?)^```", (DOCS / page).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return str(blocks[0])


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Return a folder that Python finds the package of the page in, as an installer leaves it."""
    site = tmp_path / "site"
    package = site / "my_package"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "my_imu.py").write_text(fenced("protocols.md", "python"), encoding="utf-8")
    (package / "broken.py").write_text("import a_module_that_is_not_there\n", encoding="utf-8")
    about = site / "my_package-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1.0\n", encoding="utf-8")
    (offered,) = re.findall(r"^    (my_imu = .*)$", (DOCS / "protocols.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    (about / "entry_points.txt").write_text(
        f"[imufield.drivers]\n{offered.replace(chr(34), '')}\nbroken = my_package.broken:Broken\n", encoding="utf-8"
    )
    return site


def imufield(site: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    paths = [str(site), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "COLUMNS": "200"}
    return subprocess.run(
        [sys.executable, "-m", "imufield", *arguments],
        cwd=site.parent,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=250,
    )


def test_a_driver_of_another_package(site: Path) -> None:
    listed = imufield(site, "devices", "--json")
    assert listed.returncode == 0, listed.stderr
    drivers = {one["name"]: one for one in json.loads(listed.stdout)["drivers"]}
    assert drivers["my_imu"]["title"] == "My IMU"
    assert drivers["my_imu"]["status"] == "document only"
    assert "a_module_that_is_not_there" in drivers["broken"]["title"]
    assert "stim300" in drivers
    lines = [f"{number % 256},0.0,{number / 100},1.0\r\n" for number in range(N)]
    (site.parent / "dump.txt").write_text("".join(lines), encoding="ascii", newline="")
    imported = imufield(site, "import", "dump.txt", "--driver", "my_imu", "--rate-hz", "100", "-o", "mine")
    assert imported.returncode == 0, imported.stderr
    assert f"{N} samples" in imported.stderr
    exported = imufield(site, "export-data", "mine", "-o", "out.csv")
    assert exported.returncode == 0, exported.stderr
    table = np.genfromtxt(site.parent / "out.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["ay"], 9.80665 * np.arange(N) / 100, rtol=1e-12)
    np.testing.assert_allclose(table["az"], 9.80665)


@pytest.fixture
def bus_file(tmp_path: Path) -> Path:
    path = tmp_path / "my_imu.dbc"
    path.write_text(fenced("can.md", ""), encoding="ascii")
    return path


def frames(dbc: Path, late_s: float = 0.0) -> bytes:
    """Return what cantools makes of known values, 100 samples a second; some second frames are stamped ``late_s`` later."""
    database = cantools.database.load_file(dbc)
    found = []
    for number in range(N):
        at_s = number * 0.01
        motion = {"AccLong": number / 100, "AccLat": -1.0, "AccVert": 9.8, "Count": number, "SensorState": 0, "Limits": 0}
        if number == 20:
            motion["SensorState"] = 3
        turning = {"RollRate": 1.0, "PitchRate": 2.0, "YawRate": number}
        for name, values in (("Motion", motion), ("Turning", turning), ("Housekeeping", {"Temperature": 25.5})):
            message = database.get_message_by_name(name)
            stamp_s = at_s + (late_s if name == "Turning" and number % 16 == 5 else 0.0)
            found.append(Frame(message.frame_id, bytes(message.encode(values)), stamp_s))
            at_s += 0.0005
    return pack_frames(found)


def check(protocol: Protocol, dbc: Path) -> Samples:
    decoder = Decoder(protocol)
    samples = concatenate([decoder.feed(frames(dbc), N * 0.01), decoder.flush()])
    assert len(samples) == N
    np.testing.assert_allclose(samples.accelerometer[:, 0], np.arange(N) / 100, atol=1e-9)
    np.testing.assert_allclose(samples.accelerometer[:, 1], 1.0, atol=1e-9)
    np.testing.assert_allclose(np.degrees(samples.gyroscope[:, 2]), np.arange(N), atol=1e-9)
    assert samples.counter.tolist() == list(range(N))
    return samples


def test_a_dbc_file_with_its_mapping(bus_file: Path) -> None:
    text = (DOCS / "can.md").read_text(encoding="utf-8")
    (typed,) = re.findall(r"^    imufield capture [^\n]* --dbc my_imu\.dbc (.*?)\n\n", text, flags=re.MULTILINE | re.DOTALL)
    mapping = parse_map([*(word for word in shlex.split(typed.replace("\\\n", "")) if word != "--map"), "counter=Count"])
    check(protocol_from_dbc(bus_file, mapping), bus_file)


def test_the_same_as_a_file(bus_file: Path, tmp_path: Path) -> None:
    (tmp_path / "my_imu.toml").write_text(fenced("can.md", "toml"), encoding="utf-8")
    samples = check(load_protocol(tmp_path / "my_imu.toml"), bus_file)
    np.testing.assert_allclose(samples.temperature_degc, 25.5)
    assert np.flatnonzero(samples.status & np.uint32(Status.INSTRUMENT_FAULT)).tolist() == [20]


@pytest.mark.parametrize(("limit", "incomplete"), [("", 0), ("limit_s = 0.005\n", 3)])
def test_the_file_loses_nothing_where_a_busy_host_stamps_late(
    limit: str, incomplete: int, bus_file: Path, tmp_path: Path
) -> None:
    page = fenced("can.md", "toml").replace('starts_with = "Motion"\n', f'starts_with = "Motion"\n{limit}')
    (tmp_path / "my_imu.toml").write_text(page, encoding="utf-8")
    decoder = Decoder(load_protocol(tmp_path / "my_imu.toml"))
    samples = concatenate([decoder.feed(frames(bus_file, 0.008), N * 0.01), decoder.flush()])
    assert len(samples) == decoder.statistics.samples == N
    assert decoder.statistics.samples_incomplete == np.isnan(samples.gyroscope).any(axis=1).sum() == incomplete
    said = [f"{incomplete} of {N} samples ({2 * incomplete} %) lack acceleration or angular rate and are not averaged"]
    assert remarks([decoder.statistics]) == (said if incomplete else [])
