"""Recordings of ROS, written by rosbags: bags of ROS 1, of ROS 2 in both storages, and a file of the latter alone."""

from __future__ import annotations

import os
import struct
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard

from imufield.acquire.formats.ros_bags import is_bag
from imufield.acquire.formats.tables import read_tables
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import Status
from tests.refused import refused

pytest.importorskip("rosbags", reason="extra ros")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

N = 400
STAMP_S = 1_700_000_000
RNG = np.random.default_rng(8)
FORCE = RNG.normal(scale=0.1, size=(N, 3)) + np.array([0, 0, 9.8])
RATE = RNG.normal(scale=0.1, size=(N, 3))
KINDS = ("ros1", "sqlite", "mcap", "mcap alone")


def messages(store: Any, *, ros1: bool, stamped: bool, no_force: tuple[int, ...], no_rate: bool) -> Any:
    types = {name: store.types[f"{kind}/msg/{name}"] for kind, name in (
        ("sensor_msgs", "Imu"), ("std_msgs", "Header"), ("builtin_interfaces", "Time"),
        ("geometry_msgs", "Quaternion"), ("geometry_msgs", "Vector3"))}  # fmt: skip
    for row in range(N):
        force_covariance, rate_covariance = np.zeros(9), np.zeros(9)
        force_covariance[0] = -1 if row in no_force else 0
        rate_covariance[0] = -1 if no_rate else 0
        nanosecond = row * 2_500_000
        stamp = types["Time"](STAMP_S + nanosecond // 10**9 if stamped else 0, nanosecond % 10**9 if stamped else 0)
        header = types["Header"](seq=row, stamp=stamp, frame_id="imu") if ros1 else types["Header"](stamp, "a longer name")
        yield STAMP_S * 10**9 + nanosecond, types["Imu"](
            header, types["Quaternion"](0.0, 0.0, 0.0, 1.0), np.zeros(9),
            types["Vector3"](*RATE[row]), rate_covariance, types["Vector3"](*FORCE[row]), force_covariance,
        )  # fmt: skip


def write(
    folder: Path, kind: str, topics: tuple[str, ...] = ("/imu/data",), *, stamped: bool = True,
    no_force: tuple[int, ...] = (), no_rate: bool = False,
) -> Path:  # fmt: skip
    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    path = folder / ("bench.bag" if ros1 else "bench")
    if ros1:
        writer: Any = Writer1(path)
    else:
        writer = Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3 if kind == "sqlite" else StoragePlugin.MCAP)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    with writer:
        name = "sensor_msgs/msg/Imu"
        connections = [writer.add_connection(topic, name, typestore=store) for topic in topics]
        other = writer.add_connection("/temperature", "std_msgs/msg/Float64", typestore=store)
        note = serialize(store.types["std_msgs/msg/Float64"](25.0), "std_msgs/msg/Float64")
        for stamp, message in messages(store, ros1=ros1, stamped=stamped, no_force=no_force, no_rate=no_rate):
            writer.write(other, stamp, note)
            for connection in connections:
                writer.write(connection, stamp, serialize(message, name))
    return path / "bench.mcap" if kind == "mcap alone" else path


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("stamped", [True, False])
def test_values(tmp_path: Path, kind: str, stamped: bool) -> None:
    path = write(tmp_path, kind, stamped=stamped)
    assert is_bag(path)
    table = read_tables([path])
    np.testing.assert_array_equal(table.rows[:, 1:4], FORCE)
    np.testing.assert_array_equal(table.rows[:, 4:7], RATE)
    np.testing.assert_allclose(table.rows[:, 0], np.arange(N) * 0.0025, atol=1e-9)
    assert table.settings == {"accelerometer_unit": "m/s^2", "gyroscope_unit": "rad/s", "status": "true"}
    assert table.status is not None
    assert not table.status.any()
    assert any(f"{STAMP_S} s" in sentence for sentence in table.assumptions)
    assert table.begin_s == STAMP_S


def test_rows_have_no_flags_where_their_column_is_skipped(tmp_path: Path) -> None:
    table = read_tables([write(tmp_path, "mcap")], columns="-,ax,ay,az,gx,gy,gz,-,-,-", rate_hz=400)
    assert table.status is None
    assert table.settings == {"accelerometer_unit": "m/s^2", "gyroscope_unit": "rad/s", "rate_hz": 400}


def test_what_is_not_available(tmp_path: Path) -> None:
    table = read_tables([write(tmp_path, "mcap", no_force=(7, 8), no_rate=True)])
    assert np.flatnonzero(np.isnan(table.rows[:, 1:4]).all(axis=1)).tolist() == [7, 8]
    assert table.status is not None
    assert np.flatnonzero(table.status & np.uint32(Status.ACCELEROMETER_INVALID)).tolist() == [7, 8]
    # A topic that never has rates is one of an accelerometer.
    assert np.isnan(table.rows[:, 4:7]).all()
    assert not (table.status & np.uint32(Status.GYROSCOPE_INVALID)).any()


def test_several_topics_and_none(tmp_path: Path) -> None:
    path = write(tmp_path, "ros1", ("/a/imu", "/b/imu"))
    with refused(UsageError, Reason.USAGE, "--topic /a/imu", "/b/imu"):
        read_tables([path])
    assert len(read_tables([path], topic="/b/imu").rows) == N
    with refused(RecordingError, Reason.BAD_DATA, "sensor_msgs/msg/Imu", "/c", "/temperature"):
        read_tables([path], topic="/c")


@pytest.mark.parametrize("kind", ["ros1", "mcap alone"])
def test_cut_and_damaged(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path, kind)
    content = path.read_bytes()
    rng = np.random.default_rng(5)
    for number in range(12):
        damaged = bytearray(content if number % 2 else content[: rng.integers(20, len(content) - 8)])
        for place in rng.integers(20, len(damaged), 20 if number % 2 else 0):
            damaged[place] = rng.integers(256)
        path.write_bytes(damaged)
        with suppress(RecordingError, UsageError):
            read_tables([path])
    path.write_bytes(content[: len(content) // 2])
    with refused(RecordingError, Reason.DAMAGED, str(path)):
        read_tables([path])


def test_other_files_are_none(tmp_path: Path) -> None:
    (tmp_path / "text.bag").write_text("0 1 2 3\n1 1 2 3\n")
    assert not is_bag(tmp_path / "text.bag")
    assert not is_bag(tmp_path)
    (tmp_path / "head.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    with refused(RecordingError, Reason.DAMAGED, "head.bag"):
        read_tables([tmp_path / "head.bag"])


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux enforces RLIMIT_AS, by which a reader is limited")
def test_a_small_recording_that_unpacks_to_gigabytes(tmp_path: Path) -> None:
    path = tmp_path / "trap.mcap"
    packed = zstandard.ZstdCompressor().compress(bytes(1 << 20))
    # A frame says in its head what it unpacks to; the chunk states a thousand times as much as there is.
    chunk = struct.pack("<QQQII", 0, 1, 1 << 30, 0, 4) + b"zstd" + struct.pack("<Q", 1000 * len(packed)) + packed * 1000
    records = (1, struct.pack("<II", 0, 0)), (6, chunk), (2, bytes(20))
    content = b"".join(struct.pack("<BQ", kind, len(body)) + body for kind, body in records)
    path.write_bytes(b"\x89MCAP0\r\n" + content + b"\x89MCAP0\r\n")
    with refused(RecordingError, Reason.DAMAGED, str(path), key="ros_bags.damaged"):
        read_tables([path])


@pytest.mark.parametrize("what", ["link", "pipe"])
def test_a_folder_with_a_link_or_pipe_is_refused(tmp_path: Path, what: str) -> None:
    bag = write(tmp_path, "mcap")
    (bag / "bench.mcap").rename(tmp_path / "outside.mcap")
    if what == "link":
        (bag / "bench.mcap").symlink_to(tmp_path / "outside.mcap")
    else:
        os.mkfifo(bag / "bench.mcap")
    with refused(RecordingError, Reason.FOREIGN, "bench.mcap", what, key="ros_bags.no_file"):
        read_tables([bag])


def test_a_folder_reads_no_file_elsewhere(tmp_path: Path) -> None:
    bag = write(tmp_path, "mcap")
    (bag / "bench.mcap").rename(tmp_path / "outside.mcap")
    contents = bag / "metadata.yaml"
    contents.write_text(contents.read_text().replace("bench.mcap", "../outside.mcap"))
    with refused(RecordingError, Reason.DAMAGED, key="ros_bags.damaged"):
        read_tables([bag])
