"""Read messages ``sensor_msgs/Imu`` from recordings of ROS 1 and ROS 2 (bags and MCAP files) through rosbags.

By REP 103 and REP 145 values are in m/s^2 and rad/s, and a covariance that begins with -1 says that there is no such value.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from imufield.acquire.formats.foreign_file_reader import IMU_TYPE, damage, first_line
from imufield.acquire.formats.table_arrays import ArrayTable, handed_over, start_reader, unread
from imufield.acquire.link.host_clock import COUNTS_FROM_1970_S, NANOSECONDS
from imufield.errors import Reason, RecordingError, UsageError, missing_package
from imufield.files import Origin, open_to_read
from imufield.samples import SAMPLE_COLUMNS, FloatArray, Status
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_MAGIC = (b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\0")
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
    _refuse_links(path)
    chosen = () if topic is None else (topic,)
    try:
        # rosbags unpacks some recordings into a file.
        with TemporaryDirectory() as folder, start_reader("ros", path, *chosen, TMPDIR=folder) as process:
            arrays, stated = handed_over(process)
    except ImportError as error:
        raise missing_package(f"{path} is a recording of ROS, which", "rosbags", "ros", str(error)) from error
    except damage() as error:
        raise unread(path, error, sentence("ros_bags.damaged", path=str(path), cause=first_line(error))) from error
    rows, cause = arrays["rows"], stated["cause"]
    if cause and not len(rows):
        raise RecordingError(sentence("ros_bags.damaged", path=str(path), cause=cause), Reason.DAMAGED)
    read_topic = _only_topic(path, stated["topics"], topic)
    if not len(rows):
        raise RecordingError(sentence("ros_bags.no_message", path=str(path), topic=read_topic), Reason.BAD_DATA)
    return _table(path, rows, [sentence("ros_bags.lost", name=path.name, count=len(rows), cause=cause)] if cause else [])


def _refuse_links(path: Path) -> None:
    """Refuse links, pipes and devices in the folder of a bag, whose files rosbags opens by itself."""
    for file in path.iterdir() if path.is_dir() else ():
        try:
            if not file.is_dir() or file.is_symlink():
                open_to_read(file, Origin.INSIDE).close()
        except OSError as error:
            raise RecordingError(sentence("ros_bags.no_file", path=str(file), cause=error.strerror), Reason.FOREIGN) from error


def _only_topic(path: Path, there: Sequence[tuple[str, str]], topic: str | None) -> str:
    """Return the topic that is read; refuse a recording of which no topic or several could be."""
    topics = [name for name, kind in there if kind == IMU_TYPE and topic in (None, name)]
    if len(topics) > 1:
        raise UsageError(sentence("ros_bags.several_topics", path=str(path), kind=IMU_TYPE, topics=topics))
    if not topics:
        listed = [f"{name} ({kind})" for name, kind in there] or "nothing"
        wanted = IMU_TYPE if topic is None else f"{IMU_TYPE} on {topic}"
        raise RecordingError(sentence("ros_bags.no_topic", path=str(path), wanted=wanted, there=listed), Reason.BAD_DATA)
    return topics[0]


def _table(path: Path, rows: FloatArray, said: list[str]) -> ArrayTable:
    # Whole seconds are subtracted from what counts from 1970, since a float holds only 0.2 us there.
    from_s = rows[0, 0] if rows[0, 0] > COUNTS_FROM_1970_S else 0.0
    if from_s:
        said.append(sentence("ros_bags.time_from", name=path.name, from_s=from_s))
    n = len(rows)
    values = np.full((n, len(SAMPLE_COLUMNS)), np.nan)
    values[:, 0] = rows[:, 0] - from_s + rows[:, 1] / NANOSECONDS
    values[:, 1:7] = rows[:, 2:8]
    values[:, -1] = 0.0
    triads = ((Status.ACCELEROMETER_INVALID, slice(1, 4)), (Status.GYROSCOPE_INVALID, slice(4, 7)))
    for (flag, columns), gone in zip(triads, rows[:, 8:].T != 0, strict=True):
        values[gone, columns] = np.nan
        # A stretch without a value is a gap; a triad that never has one is not there.
        values[:, -1] += 0 if gone.all() else gone * int(flag)
    # The flags are those of values: of gaps a recording of ROS says nothing.
    settings: dict[str, str | float] = {"accelerometer_unit": "m/s^2", "gyroscope_unit": "rad/s", "status": "true"}
    units = ("s", *[""] * (len(SAMPLE_COLUMNS) - 1))
    return ArrayTable(
        path=path,
        header=SAMPLE_COLUMNS,
        values=values,
        units=units,
        settings=settings,
        assumptions=tuple(said),
        zero_s=(from_s, *[0.0] * (len(SAMPLE_COLUMNS) - 1)),
    )
