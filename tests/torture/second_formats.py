"""Hostile files of arrays and of ROS."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from random import Random

import numpy as np

from tests.torture.hostile_values import (
    DEEP,
    ESCAPES,
    FORGED,
    MEBIBYTE,
    SECRET,
    deflate_bomb,
    escaped,
    hostile_bytes,
    zip_bomb,
)
from tests.torture.second_sound import AXES, OUTSIDE, HostileFile, Make, Sound, write


def npy_head(shape: str, kind: str = "'<f8'", length: int | None = None, more: str = "") -> bytes:
    head = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, {more}}}\n".encode()
    return b"\x93NUMPY\x02\0" + struct.pack("<I", len(head) if length is None else length) + head


def arrays(sound: Sound, random: Random) -> HostileFile:
    """A hostile file of NumPy."""
    heads = (
        *(
            (f"shape {shape}", npy_head(shape))
            for shape in (
                "(1099511627776, 7)",
                "(-1, 7)",
                "(4611686018427387904,)",
                "(2,) * 99",
                "(1e308,)",
                "()",
                "(0, 7)",
                "(True, 7)",
            )
        ),
        ("as long as 4 GB", npy_head("(9, 7)", length=2**32 - 1)),
        ("objects", npy_head("(9, 7)", "'|O'") + b"\x80\x04cos\nsystem\n(S'touch FORGED'\ntR."),
        (f"{DEEP} brackets", npy_head("(" * DEEP + ")" * DEEP)),
        ("a head of expressions", npy_head("(9**9**9,)")),
        *(
            ("names of fields", npy_head("(9,)", repr([(escape, "<f8"), *((axis, "<f8") for axis in AXES)])) + bytes(504))
            for escape in ESCAPES[:6]
        ),
        ("a field of 2 GB", npy_head("(9,)", "[('t', '<f8', (268435456,))]")),
    )
    way = random.random()
    if way < 0.35:
        what, data = random.choice(heads)
        data, suffix = data + bytes(9 * 56), ".npy"
    elif way < 0.5:
        what, suffix, data = "a bomb", ".npz", zip_bomb(npy_head("(209715200,)"))
    else:
        suffix = random.choice((".npy", ".npz"))
        what, data = hostile_bytes(random, sound.bytes_of(sound.npy if suffix == ".npy" else sound.npz, suffix))
    return HostileFile(
        name=f"{suffix[1:]}: {what}", command=("import", f"t{suffix}", "-o", "o"), make=write(f"t{suffix}", data)
    )


def matlab(sound: Sound, random: Random) -> HostileFile:
    """A hostile file of MATLAB."""
    sizes = (2**31 - 1, 2**30, 0, -1, 7)
    heads = tuple(
        (f"version 4, {m} x {n}", struct.pack("<5i", 0, m, n, 0, 5) + b"data\0" + bytes(4096)) for m in sizes for n in sizes
    )
    way = random.random()
    if way < 0.25:
        what, data = random.choice(heads)
    elif way < 0.35:
        inside = _deep_cells(random.choice((100, 3000, 30000)))
        what, data = "cells in cells", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + inside
    elif way < 0.45:
        # An element that is packed, and says nothing of what comes out.
        bomb = b"\x78\x01" + deflate_bomb() + b"\0\0\0\0"
        what, data = "a bomb", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(bomb)) + bomb
    else:
        what, data = hostile_bytes(random, sound.bytes_of(random.choice((sound.mat, sound.mat_4, sound.mat_structure)), ".mat"))
    return HostileFile(name=f"mat: {what}", command=("import", "t.mat", "-o", "o"), make=write("t.mat", data))


def _deep_cells(depth: int) -> bytes:
    element = b""
    for _ in range(depth):
        content = struct.pack("<IIII", 6, 8, 1, 0) + struct.pack("<IIii", 5, 8, 1, 1) + struct.pack("<II", 1, 0) + element
        element = struct.pack("<II", 14, len(content)) + content
        # Beyond, the lengths alone would make it a large file.
        if len(element) > 4 * MEBIBYTE:
            break
    return element


def hdf5(sound: Sound, random: Random) -> HostileFile:
    """A hostile HDF5 file, or MATLAB 7.3."""
    doors: tuple[tuple[str, Make], ...] = (
        ("numbers outside", h5_external),
        ("bytes outside", lambda folder: h5_external(folder, "u1")),
        ("a virtual dataset", h5_virtual),
        ("a link to another file", _h5_link),
        ("a group in itself", _h5_cycle),
        ("soft links in a circle", _h5_soft),
        ("a shape of 2^40", lambda folder: _h5_shape(folder, (1 << 40, 7))),
        ("a shape of 2^62", lambda folder: _h5_shape(folder, (1 << 62,))),
        ("1.6 GB of one value", lambda folder: _h5_shape(folder, (30_000_000, 7))),
        ("names that are escapes", _h5_names),
        ("50,000 groups", _h5_many),
        ("groups 900 deep", _h5_deep),
        ("attributes that are ours", _h5_attributes),
        ("a filter that is not there", _h5_records),
    )
    if random.random() < 0.55:
        what, make = random.choice(doors)
    else:
        suffix = random.choice((".h5", ".mat"))
        what, data = hostile_bytes(random, sound.bytes_of(sound.hdf5, ".h5"))
        make = write("t.h5", data)
        if suffix == ".mat":
            return HostileFile(
                name=f"mat 7.3: {what}",
                command=("import", "t.mat", "-o", "o"),
                make=write("t.mat", b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(384) + data),
            )
    return HostileFile(name=f"hdf5: {what}", command=("import", "t.h5", "-o", "o"), make=make)


def _h5(folder: Path):  # type: ignore[no-untyped-def]
    import h5py

    return h5py.File(folder / "t.h5", "w")


def h5_external(folder: Path, kind: str = "f8") -> None:
    with _h5(folder) as file:
        for name in ("time", *AXES):
            path = str(OUTSIDE / "secret.bin") if kind == "f8" else str((folder.parent / "outside" / "secret.txt").resolve())
            file.create_dataset(name, (64,), dtype=kind, external=[(path, 0, 64 * np.dtype(kind).itemsize)])


def h5_virtual(folder: Path) -> None:
    import h5py

    with h5py.File(folder.parent / "outside" / "secret.h5", "w") as other:
        other["x"] = np.frombuffer(SECRET * 64)
    with _h5(folder) as file:
        for name in ("time", *AXES):
            layout = h5py.VirtualLayout((64,), dtype="f8")
            layout[:] = h5py.VirtualSource(str(OUTSIDE / "secret.h5"), "x", shape=(64,))
            file.create_virtual_dataset(name, layout)


def _h5_link(folder: Path) -> None:
    import h5py

    with h5py.File(folder.parent / "outside" / "secret.h5", "w") as other:
        for name in ("time", *AXES):
            other[name] = np.frombuffer(SECRET * 64)
    with _h5(folder) as file:
        for name in ("time", *AXES):
            file[name] = h5py.ExternalLink(str(OUTSIDE / "secret.h5"), f"/{name}")


def _h5_cycle(folder: Path) -> None:
    with _h5(folder) as file:
        group = file.create_group("a/b")
        group["c"] = file["a"]
        group["acc"] = np.ones((9, 3))


def _h5_soft(folder: Path) -> None:
    import h5py

    with _h5(folder) as file:
        file["x"], file["y"] = h5py.SoftLink("/y"), h5py.SoftLink("/x")
        file["acc"] = np.ones((9, 3))


def _h5_shape(folder: Path, shape: tuple[int, ...]) -> None:
    with _h5(folder) as file:
        file.create_dataset(
            "data", shape, dtype="f8", chunks=(1024,) * len(shape) if len(shape) == 1 else (1024, 7), compression="gzip"
        )


def _h5_names(folder: Path) -> None:
    with _h5(folder) as file:
        for number, escape in enumerate(each for each in ESCAPES if "\0" not in each and "/" not in each):
            file[f"{number}{escape}"] = np.ones(9 + number)
            file.attrs[f"imufield_{escape}"] = escape


def _h5_many(folder: Path) -> None:
    with _h5(folder) as file:
        for number in range(50_000):
            file.create_group(f"g{number}")


def _h5_deep(folder: Path) -> None:
    with _h5(folder) as file:
        group = file
        for _ in range(900):
            group = group.create_group("g")
        group["acc"] = np.ones((9, 3))


def _h5_attributes(folder: Path) -> None:
    with _h5(folder) as file:
        for name in ("time", *AXES):
            file[name] = np.arange(64) * 0.01
        for name, value in (
            ("imufield_accelerometer_unit", ESCAPES[0]),
            ("imufield_raw_zero", "9" * 5000),
            ("imufield_rate_hz", "1e400"),
            ("imufield_status", f"\n{FORGED}"),
        ):
            file.attrs[name] = value


def _h5_records(folder: Path) -> None:
    kind = np.dtype([(escape if escape.isprintable() else f"f{number}", "f8") for number, escape in enumerate(ESCAPES)])
    with _h5(folder) as file:
        file["imu"] = np.zeros(64, kind)


def parquet(sound: Sound, random: Random) -> HostileFile:
    """A hostile Parquet file."""
    way = random.random()
    make: Make
    if way < 0.1:
        what, make = "1.6 GB of one value", _parquet_bomb
    elif way < 0.3:
        what, make = "names of columns", lambda folder: _parquet_names(folder, random.choice(ESCAPES))
    else:
        what, data = hostile_bytes(random, sound.bytes_of(sound.parquet, ".parquet"))
        make = write("t.parquet", data)
    return HostileFile(name=f"parquet: {what}", command=("import", "t.parquet", "-o", "o"), make=make)


def _parquet_bomb(folder: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    piece = pa.table({"ax": np.zeros(5_000_000), "ay": np.zeros(5_000_000)})
    with parquet.ParquetWriter(folder / "t.parquet", piece.schema) as writer:
        for _ in range(20):
            writer.write_table(piece)


def _parquet_names(folder: Path, escape: str) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    names = [f"time{escape}", *(f"{axis}{escape}" for axis in AXES)]
    table = pa.table([np.arange(64) * 0.01] * 7, names=names).replace_schema_metadata({"imufield_accelerometer_unit": escape})
    parquet.write_table(table, folder / "t.parquet")


METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  relative_file_paths: [{path}]
  duration: {{nanoseconds: 1200000000}}
  starting_time: {{nanoseconds_since_epoch: 1000000000000000000}}
  message_count: 120
  compression_format: ''
  compression_mode: ''
  topics_with_message_count:
  - topic_metadata: {{name: {topic}, type: sensor_msgs/msg/Imu, serialization_format: cdr, offered_qos_profiles: ''}}
    message_count: 120
  files:
  - path: {path}
    starting_time: {{nanoseconds_since_epoch: 1000000000000000000}}
    duration: {{nanoseconds: 1200000000}}
    message_count: 120
"""
LAUGHS = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{each}: &{each} [{','.join([f'*{before}'] * 9)}]\n" for before, each in zip("abcdefgh", "bcdefghi", strict=True)
)


def ros(sound: Sound, random: Random) -> HostileFile:
    """A hostile recording of ROS."""
    way = random.random()
    if way < 0.3:
        escape = random.choice(ESCAPES)
        what, text = random.choice(
            (
                ("a path outside", METADATA.format(path="../../outside/secret.db3", topic="/imu")),
                ("a path that is a FIFO", METADATA.format(path="fifo.db3", topic="/imu")),
                ("a path that is a link outside", METADATA.format(path="link.db3", topic="/imu")),
                ("a topic that is an escape", METADATA.format(path="t.db3", topic=escaped(escape))),
                ("laughs", LAUGHS),
                ("brackets", "[" * 5000),
                ("a YAML object", "!!python/object/apply:os.system ['touch FORGED']\n"),
                ("numbers", METADATA.format(path="t.db3", topic="/imu").replace("120", "9" * 5000)),
                ("a YAML date", METADATA.format(path="t.db3", topic="2026-99-99")),
            )
        )
        data = sound.bytes_of(sound.db3, ".db3")

        def make(folder: Path) -> None:
            (folder / "t").mkdir()
            (folder / "t" / "metadata.yaml").write_text(text)
            (folder / "t" / "t.db3").write_bytes(data)
            os.mkfifo(folder / "t" / "fifo.db3")
            (folder / "t" / "link.db3").symlink_to(Path("..") / OUTSIDE / "secret.db3")

        return HostileFile(name=f"ROS folder: {what}", command=("import", "t", "-o", "o"), make=make)
    if way < 0.4:
        what, statement = random.choice(
            (
                (
                    "a view without an end",
                    (
                        "CREATE VIEW messages AS WITH RECURSIVE r(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM r) "
                        "SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM r"
                    ),
                ),
                (
                    "a view of blobs of 900 MB",
                    "CREATE VIEW messages AS SELECT 1 AS id, 1 AS topic_id, 1 AS timestamp, zeroblob(900000000) AS data",
                ),
                ("a view of another", "CREATE VIEW messages AS SELECT id, topic_id, 'x' AS timestamp, data FROM was"),
            )
        )
        data = sound.bytes_of(sound.db3, ".db3")
        return HostileFile(
            name=f"db3: {what}", command=("import", "t.db3", "-o", "o"), make=lambda folder: _sql(folder, data, statement)
        )
    suffix, writer = random.choice(((".bag", sound.bag), (".db3", sound.db3), (".mcap", sound.ros_mcap)))
    what, data = hostile_bytes(random, sound.bytes_of(writer, suffix))
    return HostileFile(
        name=f"ROS {suffix}: {what}", command=("import", f"t{suffix}", "-o", "o"), make=write(f"t{suffix}", data)
    )


def _sql(folder: Path, data: bytes, statement: str) -> None:
    import sqlite3
    from contextlib import closing

    (folder / "t.db3").write_bytes(data)
    with closing(sqlite3.connect(folder / "t.db3")) as base:
        base.execute("ALTER TABLE messages RENAME TO was")
        base.execute(statement)
        base.commit()
