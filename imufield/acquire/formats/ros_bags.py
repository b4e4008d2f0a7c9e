"""Read messages ``sensor_msgs/Imu`` from recordings of ROS 1 and ROS 2 (bags and MCAP files) through rosbags.

By REP 103 and REP 145 values are in m/s^2 and rad/s, and a covariance that begins with -1 says that there is no such value.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from imufield.acquire.formats.array_file_reader import DAMAGE, first_line
from imufield.acquire.formats.table_arrays import ArrayTable, missing_package
from imufield.acquire.link.host_clock import NANOSECONDS
from imufield.errors import Reason, RecordingError, UsageError
from imufield.files import Origin, open_to_read
from imufield.samples import SAMPLE_COLUMNS, FloatArray, Status
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

sentence = Sentences(__package__)

IMU_TYPE = "sensor_msgs/msg/Imu"
_MAGIC = (b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\0")
# Stamps beyond 1973 count from 1970: whole seconds of the first are subtracted, since a float holds only 0.2 us there.
_EPOCH_S = 100_000_000
_BATCH = 1 << 14
_CONTENTS = "metadata.yaml"


def is_bag(path: Path) -> bool:
    """Tell whether a path is a bag of ROS, by what it starts with or, for a folder, by what is in it."""
    if path.is_dir():
        return (path / _CONTENTS).is_file()
    try:
        with open_to_read(path) as file:
            return file.read(16).startswith(_MAGIC)
    except OSError:
        return False


def read_bag(path: Path, topic: str | None = None) -> ArrayTable:
    """Read one topic of ``sensor_msgs/Imu``.

    Parameters
    ----------
    path : Path
        A .bag, .mcap or .db3 file, or the folder of a ROS 2 bag.
    topic : str, optional
        Needed where there are several.

    Returns
    -------
    ArrayTable
        With the columns of our own exports; without temperature and counter.

    Raises
    ------
    RecordingError
        The bag is damaged from the start, or holds no such topic. Where it is damaged further on, what came before is
        returned, and said.
    UsageError
        There are several topics and none is chosen, or the package for it is not installed.
    """
    try:
        import rosbags.highlevel
        import rosbags.typesys
        from rosbags.rosbag1 import ReaderError as Rosbag1Error
        from rosbags.rosbag2 import ReaderError as Rosbag2Error
    except ImportError as error:
        raise missing_package(f"{path} is a recording of ROS, which", "rosbags", "ros") from error
    _refuse_links(path)
    store = rosbags.typesys.get_typestore(rosbags.typesys.Stores.ROS2_HUMBLE)
    # rosbags checks with assertions, too; the rest comes from the libraries that unpack for it.
    errors = (rosbags.highlevel.AnyReaderError, Rosbag1Error, Rosbag2Error, rosbags.typesys.TypesysError)
    failures = (*errors, *DAMAGE, AssertionError, sqlite3.Error)
    batches: list[FloatArray] = []
    said: list[str] = []
    try:
        with rosbags.highlevel.AnyReader([path], default_typestore=store) as reader:
            _collect(reader, _connections(path, reader.connections, topic), batches)
    except (RecordingError, UsageError):
        raise
    except failures as error:
        cause = first_line(error)
        if not batches:
            raise RecordingError(sentence("ros_bags.damaged", path=str(path), cause=cause), Reason.DAMAGED) from error
        said.append(sentence("ros_bags.lost", name=path.name, count=sum(map(len, batches)), cause=cause))
    if not batches:
        raise RecordingError(sentence("ros_bags.no_message", path=str(path)), Reason.BAD_DATA)
    return _table(path, np.concatenate(batches), said)


def _refuse_links(path: Path) -> None:
    """Refuse links, pipes and devices in the folder of a bag, whose files rosbags opens by itself."""
    for file in path.iterdir() if path.is_dir() else ():
        try:
            if not file.is_dir() or file.is_symlink():
                open_to_read(file, Origin.INSIDE).close()
        except OSError as error:
            raise RecordingError(sentence("ros_bags.no_file", path=str(file), cause=error.strerror), Reason.FOREIGN) from error


def _connections(path: Path, connections: Sequence[Connection], topic: str | None) -> list[Connection]:
    """Return the connections of the one topic that is read."""
    chosen = [each for each in connections if each.msgtype == IMU_TYPE and (topic is None or each.topic == topic)]
    topics = sorted({each.topic for each in chosen})
    if len(topics) > 1:
        raise UsageError(sentence("ros_bags.several_topics", path=str(path), kind=IMU_TYPE, topics=topics))
    if not topics:
        there = sorted({f"{each.topic} ({each.msgtype})" for each in connections}) or "nothing"
        wanted = IMU_TYPE if topic is None else f"{IMU_TYPE} on {topic}"
        raise RecordingError(sentence("ros_bags.no_topic", path=str(path), wanted=wanted, there=there), Reason.BAD_DATA)
    return chosen


def _collect(reader: AnyReader, connections: list[Connection], batches: list[FloatArray]) -> None:
    """Append arrays of shape (k, 9): stamp in s and ns, specific force, rate, status."""
    rows: list[tuple[float, ...]] = []
    try:
        for connection, bag_ns, raw in reader.messages(connections):
            # Its class is made from the definition in the file.
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp, force, rate = message.header.stamp, message.linear_acceleration, message.angular_velocity
            second, nanosecond = stamp.sec, stamp.nanosec
            if not (second or nanosecond):
                # Nobody stamped it; the recorder did.
                second, nanosecond = divmod(bag_ns, NANOSECONDS)
            no_force = message.linear_acceleration_covariance[0] == -1
            no_rate = message.angular_velocity_covariance[0] == -1
            status = no_force * int(Status.ACCELEROMETER_INVALID) | no_rate * int(Status.GYROSCOPE_INVALID)
            rows.append((second, nanosecond, force.x, force.y, force.z, rate.x, rate.y, rate.z, status))
            if len(rows) == _BATCH:
                batches.append(np.array(rows))
                rows = []
    finally:
        # What was read before a damage counts, too.
        if rows:
            batches.append(np.array(rows))


def _table(path: Path, rows: FloatArray, said: list[str]) -> ArrayTable:
    from_s = rows[0, 0] if rows[0, 0] > _EPOCH_S else 0.0
    if from_s:
        said.append(sentence("ros_bags.time_from", name=path.name, from_s=from_s))
    n = len(rows)
    values = np.full((n, len(SAMPLE_COLUMNS)), np.nan)
    values[:, 0] = rows[:, 0] - from_s + rows[:, 1] / NANOSECONDS
    values[:, 1:7] = rows[:, 2:8]
    values[:, -1] = rows[:, 8]
    for flag, columns in ((Status.ACCELEROMETER_INVALID, slice(1, 4)), (Status.GYROSCOPE_INVALID, slice(4, 7))):
        gone = (rows[:, 8].astype(int) & flag) != 0
        # A stretch without a value is a gap; a triad that never has one is not there.
        values[gone, columns] = np.nan
        if gone.all():
            values[:, -1] -= int(flag)
    # The flags are those of values: of gaps a recording of ROS says nothing.
    settings: dict[str, str | float] = {"accelerometer_unit": "m/s^2", "gyroscope_unit": "rad/s", "status": "true"}
    units = ("s", *[""] * (len(SAMPLE_COLUMNS) - 1))
    return ArrayTable(path=path, header=SAMPLE_COLUMNS, values=values, units=units, settings=settings, assumptions=tuple(said))
