"""What is sound and gets damaged, made once by the programs that make such files; and what a hostile file is."""

from __future__ import annotations

import re
import shutil
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

PROJECT = Path(__file__).resolve().parents[2]
SESSION = "s"
AXES = ("ax", "ay", "az", "gx", "gy", "gz")
OUTSIDE = Path("..") / "outside"

Make = Callable[[Path], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class HostileFile:
    """A file, or a folder, and the command that meets it in the working folder."""

    name: str
    command: tuple[str, ...]
    make: Make
    names_outside: bool = False
    """The command itself names something outside of the working folder."""


class Sound:
    """What is sound: made once, in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def session(self) -> Path:
        """Folder of a solved session."""
        from imufield.cli.run import run

        shutil.copytree(PROJECT / "fixtures" / "stim300-six-faces", self.folder / SESSION)
        assert run(["solve", str(self.folder / SESSION)]) == 0
        return self.folder / SESSION

    @cached_property
    def session_text(self) -> str:
        return (PROJECT / "fixtures" / "stim300-six-faces" / "session.toml").read_text()

    @cached_property
    def parameters_text(self) -> str:
        """A parameter file that says of itself that it was edited, so that what was edited is read."""
        return re.sub(r'(?m)^sha256 = "[0-9a-f]+"\n\Z', 'sha256 = "edited"\n', (self.session / "parameters.toml").read_text())

    @cached_property
    def rows(self) -> np.ndarray:
        """Seven columns of a unit on its six sides: time, specific force, rate."""
        random = np.random.default_rng(1)
        time = np.arange(400) * 0.01
        force = np.repeat(9.8 * np.vstack([np.eye(3), -np.eye(3), np.eye(3)[:2]]), 50, axis=0)
        return np.column_stack([time, force + random.normal(0, 0.01, (400, 3)), random.normal(0, 0.01, (400, 3))])

    def bytes_of(self, write: Callable[[Path], None], suffix: str) -> bytes:
        """Return what a writer of files writes; once for each."""
        path = self.folder / f"{write.__name__}{suffix}"
        if not path.exists():
            write(path)
        return path.read_bytes()

    def mat(self, path: Path) -> None:
        from scipy.io import savemat

        savemat(path, {"time_s": self.rows[:, 0], "acc": self.rows[:, 1:4], "gyro": self.rows[:, 4:]}, do_compression=True)

    def mat_4(self, path: Path) -> None:
        from scipy.io import savemat

        savemat(path, {"data": self.rows}, format="4")

    def mat_structure(self, path: Path) -> None:
        from scipy.io import savemat

        savemat(path, {"imu": {"time": self.rows[:, 0], "accel_mps2": self.rows[:, 1:4], "gyro_rads": self.rows[:, 4:]}})

    def hdf5(self, path: Path) -> None:
        import h5py

        with h5py.File(path, "w") as file:
            group = file.create_group("imu0")
            group["time"], group["accelerometer"], group["gyroscope"] = self.rows[:, 0], self.rows[:, 1:4], self.rows[:, 4:]
            file.create_dataset("imu0/packed", data=self.rows, chunks=(100, 7), compression="gzip")

    def parquet(self, path: Path) -> None:
        import pyarrow as pa
        from pyarrow import parquet

        table = pa.table([*map(np.ascontiguousarray, self.rows.T)], names=["timestamp", *AXES])
        parquet.write_table(table, path)

    def npy(self, path: Path) -> None:
        with path.open("wb") as file:
            np.save(file, self.rows)

    def npz(self, path: Path) -> None:
        with path.open("wb") as file:
            np.savez_compressed(file, time=self.rows[:, 0], acc=self.rows[:, 1:4], gyro=self.rows[:, 4:])

    def bag(self, path: Path) -> None:
        self._ros(path)

    def db3(self, path: Path) -> None:
        self._ros2(path, "sqlite3")

    def ros_mcap(self, path: Path) -> None:
        self._ros2(path, "mcap")

    def _ros2(self, path: Path, storage: str) -> None:
        folder = path.with_suffix(".folder")
        self._ros(folder, storage)
        (content,) = [*folder.glob("*.db3"), *folder.glob("*.mcap")]
        shutil.copy(content, path)

    def _ros(self, path: Path, storage: str = "") -> None:
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        is_first = not storage
        store = get_typestore(Stores.ROS1_NOETIC if is_first else Stores.ROS2_HUMBLE)
        kinds = store.types
        vector, quaternion = kinds["geometry_msgs/msg/Vector3"], kinds["geometry_msgs/msg/Quaternion"]
        imu, header, stamp = (
            kinds[f"{name}"] for name in ("sensor_msgs/msg/Imu", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
        )
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        with Writer1(path) if is_first else Writer(path, version=9, storage_plugin=plugin) as writer:
            connection = writer.add_connection("/imu/data", imu.__msgtype__, typestore=store)
            for time_s, *values in self.rows[:120].tolist():
                time = stamp(sec=int(time_s), nanosec=round(1e9 * (time_s % 1)))
                head = header(stamp=time, frame_id="imu", **({"seq": 0} if is_first else {}))
                none = np.zeros(9)
                message = imu(
                    header=head,
                    orientation=quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
                    orientation_covariance=none,
                    angular_velocity=vector(*values[3:]),
                    angular_velocity_covariance=none,
                    linear_acceleration=vector(*values[:3]),
                    linear_acceleration_covariance=none,
                )
                data = (store.serialize_ros1 if is_first else store.serialize_cdr)(message, imu.__msgtype__)
                writer.write(connection, round(1e9 * time_s) + 10**18, data)

    def can_log(self, suffix: str) -> bytes:
        """Return a log of a bus as one of the loggers writes it."""
        import can

        path = self.folder / f"log{suffix}"
        if not path.exists():
            writers = {
                ".log": can.CanutilsLogWriter,
                ".asc": can.ASCWriter,
                ".blf": can.BLFWriter,
                ".trc": can.TRCWriter,
                ".csv": can.CSVWriter,
                ".mf4": can.MF4Writer,
            }
            with writers[suffix](str(path)) as writer:
                for number in range(300):
                    for identifier in (372, 376, 380):
                        data = struct.pack("<HHHH", 32768, 0, 30000 + number, 0)
                        writer(can.Message(number * 0.01 + 1.6e9, identifier, is_extended_id=False, data=data, channel=0))
        return path.read_bytes()


def write(name: str, data: bytes) -> Make:
    def make(folder: Path) -> None:
        (folder / name).write_bytes(data)

    return make


def in_session(sound: Sound, change: Make) -> Make:
    def make(folder: Path) -> None:
        shutil.copytree(sound.session, folder / SESSION)
        change(folder / SESSION)

    return make
