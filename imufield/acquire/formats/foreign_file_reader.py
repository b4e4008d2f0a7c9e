"""Program that reads a file of another program in a process of its own: ``python -P foreign_file_reader.py KIND FILE [TOPIC]``.

The libraries that read such files believe what a file says of its sizes and types: a damaged MATLAB file kills SciPy's reader,
a few hundred bytes of HDF5, Parquet or packed NumPy unpack to gigabytes, a damaged MF4 log exhausts the stack, and one of BLF
goes round for ever. Here that is the end of this process and not of the one that asked; what it hands over is limited, too.

Of arrays and recordings of ROS, standard output gets a line of JSON with the names and what the file states, or with what is
wrong, and then each array in NumPy's format. Of a log of a CAN bus it gets a line for each frame, and a line of JSON behind the
last. This file imports nothing of imufield, so that it runs wherever the libraries are found.
"""

from __future__ import annotations

import gzip
import importlib
import io
import json
import os
import re
import signal
import struct
import sys
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import IO, TYPE_CHECKING, Any, BinaryIO, TextIO, cast

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import can
    import pyarrow as pa
    from can.io.generic import MessageReader
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

# The type of the numbers is known when the file is read.
Array = NDArray[Any]
Arrays = dict[str, Array]
Content = tuple[Arrays, Mapping[str, object]]
"""Arrays by name, and the attributes of the file."""

MEMORY_LIMIT_BYTES = 192 << 20
"""Beside the loaded libraries: the pages and copies of a small file take a few times its numbers."""
UNPACKED_LIMIT_BYTES = 8 << 20
"""Of numbers, or of the text of a packed file, however small it is: a log of that size is read in some seconds."""
PER_BYTE = 64
"""For each byte of the file, to both: numbers of an instrument do not pack more tightly. A small file that unpacks to gigabytes
is a trap."""
LONGEST_S = 5
"""Of processor time, and a minute more for every 100 MB of the file; for a log from frame to frame. Small files take some
tenths of a second."""
MOST_ARRAYS = 4096
"""With a head each, which takes longer to read than its numbers where those are few."""
LONGEST_LINE = 1 << 16
"""Characters of a line of a log: a frame takes at most some 400, and comments stand there, too."""
NUMBERS = "iufb"
"""Kinds of data in NumPy that are numbers: whole, without sign, floating, truth values."""
DATES = "M"
TOO_LONG = -getattr(signal, "SIGPROF", 0)
"""How this process ends behind ``LONGEST_S``."""
IMU_TYPE = "sensor_msgs/msg/Imu"
_OWN = "imufield_"  # What our own exports state of their numbers begins with this.
_BATCH = 1 << 14
_FRAMES_A_LIMIT = 1 << 10  # It is a call to the system each time.


def damage(*own: type[Exception]) -> tuple[type[Exception], ...]:
    """Return what libraries raise on damaged files, besides ending the process, and the errors ``own`` of one library.

    Their own errors derive from ValueError, OSError and RuntimeError, the others come out of the parsing of sizes, names and
    (NumPy) a head written in Python; rosbags asserts.
    """
    # Imported late: most files need none of them.
    import sqlite3
    import tokenize
    import zipfile

    return (
        *(ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RuntimeError, OSError, EOFError),
        *(MemoryError, SyntaxError, RecursionError, struct.error, tokenize.TokenError, zlib.error, zipfile.BadZipFile),
        AssertionError,
        sqlite3.Error,
        *own,
    )


def read_mat(path: Path) -> Content:
    """Return the arrays of a MATLAB file of version 4 to 7."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        return dict(_of_structure(loadmat(path, simplify_cells=True))), {}
    except MatReadError as error:
        raise ValueError(str(error)) from error


def _of_structure(content: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, Array]]:
    """Yield the arrays of a MATLAB file, those in structures by their dotted names."""
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, np.ndarray) and value.dtype.kind in NUMBERS:
            yield prefix + name, value
        elif isinstance(value, dict):
            yield from _of_structure(value, f"{prefix}{name}.")


def read_hdf5(path: Path) -> Content:
    """Return the datasets and records of an HDF5 file and its attributes."""
    import h5py

    arrays: Arrays = {}
    with h5py.File(path, "r") as file:
        names: list[str] = []
        # Links to outside are not followed.
        file.visit(names.append)
        for name in names:
            item = file[name]
            # "#refs#" is where MATLAB keeps what has no name.
            if name.startswith("#") or not isinstance(item, h5py.Dataset):
                continue
            # Asked before its size: that of a virtual dataset may be looked up in the other files.
            if item.external or item.is_virtual:
                raise ValueError(f"the numbers of {name} are in other files, which are not read")
            if item.size == 0:
                continue
            if item.dtype.names:
                arrays |= {f"{name}.{part}": item[part] for part in item.dtype.names}
            elif item.dtype.kind in NUMBERS:
                arrays[name.replace("/", ".")] = item[()]
        return arrays, {name: str(value) for name, value in file.attrs.items() if name.startswith(_OWN)}


def read_parquet(path: Path) -> Content:
    """Return the columns of a Parquet file and what its writer says of it."""
    import pyarrow as pa
    import pyarrow.parquet as parquet

    # Each thread takes address space of its own; one that cannot start, or gets no memory, ends the process without a word.
    pa.set_cpu_count(1)
    pa.set_io_thread_count(1)
    with parquet.ParquetFile(path) as file:
        names = file.schema_arrow.names
        numbers = [name for name, kind in zip(names, file.schema_arrow.types, strict=True) if _holds_numbers(kind)]
        _check_sound(len(names), len(numbers) * file.metadata.num_rows, size_of(path))
        table = file.read(columns=numbers, use_threads=False)
    metadata = table.schema.metadata or {}
    stated = {key.decode(): text.decode() for key, text in metadata.items() if key.startswith(_OWN.encode())}
    # Of texts the names are enough: as objects of Python they would take many times the memory of the numbers.
    return {name: table.column(name).to_numpy() if name in numbers else np.empty(0, "U1") for name in names}, stated


def _holds_numbers(kind: pa.DataType) -> bool:
    """Whether a column of Parquet is of numbers, truth values or dates."""
    import pyarrow as pa

    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    of_numbers = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_timestamp, pa.types.is_date)
    return any(is_one(kind) for is_one in of_numbers)


def read_numpy(path: Path) -> Content:
    """Return what is in a .npy or .npz file."""
    # Opened here: NumPy leaves a damaged archive open.
    with path.open("rb") as file:
        content = np.load(file, allow_pickle=False)
        names = content.dtype.names if isinstance(content, np.ndarray) else content.files
        found = {name: content[name] for name in names} if names else {"": content}
        # Any ZIP archive begins as this one does: what else is in it comes as bytes.
        return {name: np.empty(0, "S1") if isinstance(each, bytes) else each for name, each in found.items()}, {}


def read_bag(path: Path, topic: str | None = None) -> Content:
    """Return rows of ``IMU_TYPE`` and which topics there are.

    Of a recording of ROS that is damaged come the rows before that, with what is wrong; of one with several such topics, or
    none, no rows.

    Returns
    -------
    arrays : dict
        ``rows``, shape (n, 10): stamp in s and ns, specific force, rate, whether either is missing.
    stated : dict
        ``topics``, each with its type, and ``cause``, empty for a whole recording.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.rosbag1 import ReaderError as Rosbag1Error
    from rosbags.rosbag2 import ReaderError as Rosbag2Error
    from rosbags.typesys import Stores, TypesysError, get_typestore

    batches: list[Array] = []
    connections: list[Connection] = []
    cause = ""
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            connections += reader.connections
            chosen = [each for each in connections if each.msgtype == IMU_TYPE and topic in (None, each.topic)]
            if len({each.topic for each in chosen}) == 1:
                _collect(reader, chosen, batches)
    except damage(AnyReaderError, Rosbag1Error, Rosbag2Error, TypesysError) as error:
        cause = _cause(error, path)
    rows = np.concatenate(batches) if batches else np.empty((0, 10))
    return {"rows": rows}, {"topics": sorted({(each.topic, each.msgtype) for each in connections}), "cause": cause}


def _collect(reader: AnyReader, connections: list[Connection], batches: list[Array]) -> None:
    """Append the rows of a topic."""
    rows: list[tuple[float, ...]] = []
    try:
        for connection, bag_ns, raw in reader.messages(connections):
            # Its class is made from the definition in the file.
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp, force, rate = message.header.stamp, message.linear_acceleration, message.angular_velocity
            second, nanosecond = stamp.sec, stamp.nanosec
            if not (second or nanosecond):
                # Nobody stamped it; the recorder did.
                second, nanosecond = divmod(bag_ns, 1_000_000_000)
            no_force = message.linear_acceleration_covariance[0] == -1
            no_rate = message.angular_velocity_covariance[0] == -1
            rows.append((second, nanosecond, force.x, force.y, force.z, rate.x, rate.y, rate.z, no_force, no_rate))
            if len(rows) == _BATCH:
                batches.append(np.array(rows))
                rows = []
    finally:
        # What was read before a damage counts, too.
        if rows:
            batches.append(np.array(rows))


READERS: dict[str, tuple[str, Callable[..., Content]]] = {
    "mat": ("scipy.io.matlab", read_mat),
    "hdf5": ("h5py", read_hdf5),
    "parquet": ("pyarrow.parquet", read_parquet),
    "numpy": ("numpy", read_numpy),
    "ros": ("rosbags.highlevel", read_bag),
}
"""By the name of the kind on the command line, with the module that is loaded before the memory is limited."""


class SoundGzip(gzip.GzipFile):
    """A packed file that is read as long as it unpacks to no more than a sound one."""

    def read(self, size: int | None = -1) -> bytes:
        """Return bytes; OverflowError where they are too many."""
        return self._sound(super().read(size))

    def read1(self, size: int = -1) -> bytes:
        """Return bytes; OverflowError where they are too many."""
        return self._sound(super().read1(size))

    def _sound(self, data: bytes) -> bytes:
        limit = unpacked_limit_bytes(cast("IO[bytes]", self.fileobj).tell())
        if self.tell() > limit:
            raise OverflowError(f"it unpacks to more than {limit >> 20} MiB, which is more than {PER_BYTE} times its size")
        return data


def open_log(path: Path) -> IO[bytes]:
    """Open a log that may be packed."""
    return cast("IO[bytes]", SoundGzip(path)) if path.suffix == ".gz" else path.open("rb")


def text_lines(file: IO[bytes]) -> Iterator[str]:
    """Yield the lines of a text; ValueError where one is too long."""
    with io.TextIOWrapper(file, encoding="utf-8", errors="replace") as text:
        while line := text.readline(LONGEST_LINE + 1):
            if len(line) > LONGEST_LINE:
                raise ValueError(f"a line of more than {LONGEST_LINE} characters")
            yield line


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of the files in a folder."""
    return sum(each.stat().st_size for each in path.iterdir()) if path.is_dir() else path.stat().st_size


def memory_limit_bytes(size: int) -> int:
    """Return what a process may take, beyond itself and its libraries, that reads a file of ``size`` bytes."""
    return MEMORY_LIMIT_BYTES + PER_BYTE * size


def unpacked_limit_bytes(size: int) -> int:
    """Return how many bytes of numbers, or of text, a file of ``size`` bytes may hold."""
    return UNPACKED_LIMIT_BYTES + PER_BYTE * size


def longest_s(size: int) -> float:
    """Return the processor time that a file of ``size`` bytes may take."""
    return LONGEST_S + 60 * size / 100_000_000


def limit_memory(size: int) -> None:
    """Keep this process to the memory that a sound file of this size may need, where the system can."""
    damage()  # What it names cannot be imported once the memory is full.
    present_bytes = 0
    # The address space that this process has taken already, where the system says.
    with suppress(OSError, ValueError):
        present_bytes = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")
    _limit("RLIMIT_AS", present_bytes + memory_limit_bytes(size))
    # rosbags unpacks some recordings into a file.
    _limit("RLIMIT_FSIZE", memory_limit_bytes(size))
    # A reader that dies on purpose leaves no image of its memory beside the user's files.
    _limit("RLIMIT_CORE", 0)


def _limit(name: str, most: int) -> None:
    """Lower a limit of this process, where the system has it and it is not lower yet."""
    with suppress(ImportError, AttributeError, ValueError, OSError):
        import resource

        soft, hard = resource.getrlimit(getattr(resource, name))
        if soft == resource.RLIM_INFINITY or soft > most:
            resource.setrlimit(getattr(resource, name), (most, hard))


def limit_time(size: int) -> None:
    """End this process by a signal when it computes for longer than that from here, where the system can."""
    with suppress(AttributeError):
        signal.setitimer(signal.ITIMER_PROF, longest_s(size))


def write_arrays(kind: str, path: Path, *topic: str) -> None:
    """Read, and write names and arrays, or what is wrong."""
    warnings.simplefilter("ignore")
    output = sys.stdout.buffer
    arrays: Arrays = {}
    head: Mapping[str, object]
    try:
        module, read = READERS[kind]
        _load(module)
        size = size_of(path)
        limit_memory(size)
        limit_time(size)
        arrays, stated = read(path, *topic)
        numbers = [name for name, array in arrays.items() if array.dtype.kind in NUMBERS + DATES]
        _check_sound(len(arrays), sum(arrays[name].size for name in numbers), size)
        head = {"names": numbers, "others": [name for name in arrays if name not in numbers], "stated": stated}
    except ImportError as error:
        numbers, head = [], {"missing": first_line(error)}
    except damage() as error:
        numbers, head = [], {"error": _cause(error, path)}
    output.write(json.dumps(head).encode() + b"\n")
    # An object with this method alone: NumPy would seek in a real file.
    pipe = cast("IO[bytes]", SimpleNamespace(write=output.write))
    for name in numbers:
        np.lib.format.write_array(pipe, arrays[name], allow_pickle=False)
    output.flush()


def _load(module: str) -> None:
    """Import what reads a file; ImportError whatever that raises, which says nothing of the file."""
    try:
        importlib.import_module(module)
    except damage() as error:
        raise ImportError(first_line(error)) from error


def _check_sound(arrays: int, numbers: int, size: int) -> None:
    """Refuse more arrays or numbers than a sound file has: who reads them makes float64 of all."""
    if arrays > MOST_ARRAYS:
        raise ValueError(f"it holds {arrays} arrays, the limit is {MOST_ARRAYS}")
    memory, limit = 8 * numbers, unpacked_limit_bytes(size)
    if memory > limit:
        raise ValueError(
            f"its numbers need {memory >> 20} MiB of memory, the limit for a file of its size is {limit >> 20} MiB"
        )


def first_line(error: BaseException) -> str:
    """Return what an error says, in a line; its kind where it says nothing."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def _cause(error: BaseException, path: Path) -> str:
    """Return why a file cannot be read."""
    if isinstance(error, MemoryError):
        limit = memory_limit_bytes(size_of(path)) >> 20
        return f"it asks for more than {limit} MiB of memory, the limit for a file of its size"
    return first_line(error)


def write_frames(suffix: str, path: Path) -> None:
    """Write a line for each frame of a log, and one that says how it ended."""
    end: Mapping[str, object]
    try:
        _load("asammdf" if suffix == ".mf4" else "can")
        end = _write_each_frame(suffix, path)
    except ImportError as error:
        end = {"missing": first_line(error)}
    sys.stdout.write(json.dumps(end) + "\n")
    sys.stdout.flush()


def _write_each_frame(suffix: str, path: Path) -> Mapping[str, object]:
    """Write a line for each frame, and return what there is to say of the end."""
    import logging

    import can
    from can.io.blf import BLFParseError

    # The package logs tracebacks besides.
    logging.disable()
    size = size_of(path)
    limit_memory(size)
    limit_time(size)
    try:
        with open_log(path) as file:
            reader = _log_reader(suffix, file)
            for number, message in enumerate(reader):
                if number % _FRAMES_A_LIMIT == 0:
                    limit_time(size)
                sys.stdout.write(_frame_line(message, suffix))
            if isinstance(reader, can.BLFReader):
                return {"frames": reader.object_count, "bytes": reader.file_size}
    except damage(can.CanError, BLFParseError) as error:
        return {"cause": _cause(error, path)}
    return {}


def _log_reader(suffix: str, file: IO[bytes]) -> MessageReader:
    """Return the reader of python-can for a kind of log."""
    import can

    class BlfReader(can.BLFReader):
        """Reader that ends where an object has no size, behind which the other finds the same object for ever."""

        def _parse_data(self, data: bytes) -> Iterator[can.Message]:
            at = 0
            while at + 16 <= len(data) and (at := data.find(b"LOBJ", at, at + 8)) >= 0:
                (size,) = struct.unpack_from("<L", data, at + 8)
                if size == 0:
                    yield from super()._parse_data(data[:at])
                    raise ValueError("an object in it has a size of 0 bytes")
                at += size
            yield from super()._parse_data(data)

    if suffix in (".blf", ".mf4"):
        return (BlfReader if suffix == ".blf" else can.MF4Reader)(cast("BinaryIO", file))
    lines = text_lines(file)
    if suffix == ".asc":
        # It counts from its start unless told otherwise; the date in its head makes it a time of day.
        return can.ASCReader(cast("TextIO", _from_the_start(lines)), relative_timestamp=False)
    return (can.TRCReader if suffix == ".trc" else can.CSVReader)(cast("TextIO", lines))


def _from_the_start(lines: Iterator[str]) -> Iterator[str]:
    """Yield the lines of an ASC file with times from its start, where its head says that each counts from the line before."""
    is_relative, time_s = False, 0.0
    for line in lines:
        is_relative |= re.match(r"\s*base\s.*timestamps\s+relative", line, re.IGNORECASE) is not None
        step = re.match(r"\s*(\d+\.\d+)(?=\s)", line) if is_relative else None
        if step is None:
            yield line
            continue
        # Lines that are no frames move the time, too.
        time_s += float(step[1])
        yield f"{time_s:.9f}{line[step.end() :]}"


def _frame_line(message: can.Message, suffix: str) -> str:
    """Return a frame as time stamp, identifier, flags, data and bus."""
    flags = [message.is_extended_id, message.is_error_frame, message.is_remote_frame, message.is_rx]
    flags += [message.is_fd, message.bitrate_switch, message.error_state_indicator]
    # The buses of MF4 have had these names since it is read.
    bus = f"can{message.channel}" if suffix == ".mf4" else message.channel
    marks = "".join("01"[bool(flag)] for flag in flags)
    return f"{float(message.timestamp)!r} {message.arbitration_id} {marks} {message.data.hex()} {bus}\n"


if __name__ == "__main__":
    kind, path, *more = sys.argv[1:]
    if kind.startswith("."):
        write_frames(kind, Path(path))
    else:
        write_arrays(kind, Path(path), *more)
