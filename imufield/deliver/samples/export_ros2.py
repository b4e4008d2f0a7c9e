"""Samples as ``sensor_msgs/msg/Imu`` in an MCAP file, as ROS 2, Foxglove and PlotJuggler read it.

The message is fixed in length, since the name of its frame is, so that NumPy fills a block of them at once. It is written in
CDR, little-endian (OMG DDS-XTypes 1.3, section 7.4.3: each number at a multiple of its size behind the head)::

    bytes 0-3    00 01 00 00      CDR, little-endian
    bytes 4-11   i32, u32         stamp, s and ns
    bytes 12-19  u32, "imu", 0    frame_id
    then f64     4 + 9            orientation and covariance: -1 first, not available (REP 145)
                 3 + 9            angular velocity, rad/s; covariance 0, not known
                 3 + 9            linear acceleration, m/s^2
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.link.host_clock import NANOSECONDS
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import UNUSABLE, FloatArray, Samples, Status
from imufield.sentences import Sentences

sentence = Sentences(__package__)

TOPIC = "/imu/data_raw"  # REP 145: data without orientation.
# Flags of one triad alone: they leave the other usable.
_OF_ACCELEROMETER = Status.ACCELEROMETER_INVALID | Status.ACCELEROMETER_SATURATED
_OF_GYROSCOPE = Status.GYROSCOPE_INVALID | Status.GYROSCOPE_SATURATED
SCHEMA_NAME = "sensor_msgs/msg/Imu"
_NOT_AVAILABLE = -1.0  # First element of a covariance (sensor_msgs/Imu.msg).
_LARGEST_S = 2**31 - 1  # builtin_interfaces/Time has an int32.
_MESSAGE = np.dtype(
    [
        ("head", "u1", (4,)),
        ("sec", "<i4"),
        ("nanosec", "<u4"),
        ("frame_size", "<u4"),
        ("frame_id", "S4"),
        ("orientation", "<f8", (4,)),
        ("orientation_covariance", "<f8", (9,)),
        ("angular_velocity", "<f8", (3,)),
        ("angular_velocity_covariance", "<f8", (9,)),
        ("linear_acceleration", "<f8", (3,)),
        ("linear_acceleration_covariance", "<f8", (9,)),
    ]
)


def write_ros2(blocks: Iterable[Samples], path: Path, facts: Mapping[str, str]) -> int:  # noqa: ARG001  (units of ROS are fixed)
    """Write an MCAP file; return the number of messages.

    Raises
    ------
    UsageError
        The samples are counts or pulses: ROS knows SI alone.
    RecordingError
        Times that a stamp cannot hold.
    """
    from mcap.writer import Writer

    rows = 0
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="imufield")
        definition = Path(__file__).with_name("sensor_msgs_Imu.msg").read_text(encoding="ascii").encode()
        schema = writer.register_schema(name=SCHEMA_NAME, encoding="ros2msg", data=definition)
        channel = writer.register_channel(topic=TOPIC, message_encoding="cdr", schema_id=schema)
        for block in blocks:
            stamps = _nanoseconds(block.time_s)
            messages = _messages(block, stamps).tobytes()
            size = _MESSAGE.itemsize
            for row, stamp in enumerate(stamps.tolist()):
                writer.add_message(channel, stamp, messages[row * size : (row + 1) * size], stamp, rows + row)
            rows += len(block)
        writer.finish()  # type: ignore[no-untyped-call]  # the library annotates its arguments only
    return rows


def _nanoseconds(time_s: FloatArray) -> NDArray[np.int64]:
    if len(time_s) and not (time_s[0] >= 0 and time_s[-1] < _LARGEST_S):
        refused = sentence("export_ros2.stamp", first_s=time_s[0], last_s=time_s[-1], limit_s=_LARGEST_S)
        raise RecordingError(refused, Reason.BOUNDS)
    whole = np.floor(time_s)
    # Whole seconds apart: a float64 of both together has no nanoseconds left after an hour.
    parts = np.rint((time_s - whole) * NANOSECONDS).astype(np.int64)
    return whole.astype(np.int64) * NANOSECONDS + parts


def _messages(samples: Samples, stamps: NDArray[np.int64]) -> NDArray[np.void]:
    units = samples.units
    if not units.is_si:
        refused = sentence("export_ros2.units", accelerometer=units.accelerometer, gyroscope=units.gyroscope)
        raise UsageError(refused, Reason.UNITS)
    messages = np.zeros(len(samples), dtype=_MESSAGE)
    messages["head"][:, 1] = 1
    messages["sec"], messages["nanosec"] = stamps // NANOSECONDS, stamps % NANOSECONDS
    messages["frame_size"], messages["frame_id"] = 4, b"imu"
    # A quaternion of length one, although it means nothing: programs that draw it must not divide by zero.
    messages["orientation"][:, 3] = 1.0
    messages["orientation_covariance"][:, 0] = _NOT_AVAILABLE
    for name, values, flag in (
        ("angular_velocity", samples.gyroscope_rate(), UNUSABLE & ~_OF_ACCELEROMETER),
        ("linear_acceleration", samples.accelerometer_rate(), UNUSABLE & ~_OF_GYROSCOPE),
    ):
        messages[name] = values
        # There is no place for a status: what must enter no mean is not available.
        gone = np.isnan(values).any(axis=1) | ((samples.status & np.uint32(flag)) != 0)
        messages[name][gone] = np.nan
        messages[f"{name}_covariance"][gone, 0] = _NOT_AVAILABLE
    return messages
