"""Files that somebody cut, damaged or edited by hand: a typed error or a right result, and nothing else."""

from __future__ import annotations

import gzip
import importlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, Phase, given, seed, settings

from imufield.acquire.instrument.can_map import parse_map, protocol_from_dbc
from imufield.acquire.recording.reader import RecordedBlock, read_blocks
from imufield.acquire.recording.session import Session
from imufield.cli.run import run
from imufield.guide.positions import scheme
from tests.acquire import array_files
from tests.acquire.formats.conftest import fork_readers, forked
from tests.commands import forks
from tests.commands.conftest import simulated_session
from tests.commands.test_import import DBC, MAP, write_log
from tests.torture.conftest import Campaign
from tests.torture.mutations import binary_edits, damaged, text_edits
from tests.torture.watch import Outcome, attempt

PROTOCOL = Path(__file__).resolve().parents[2] / "protocols" / "stim300.toml"


@dataclass(frozen=True)
class Corpus:
    """A kind of file: a sound one, and the commands that read it, with ``{}`` for the file and ``{session}``."""

    name: str
    file: str
    make: Callable[[Path], bytes]
    commands: tuple[str, ...]
    is_text: bool = True
    short: int = 6
    """Damaged files of the short form; fewer where reading one starts a process."""


def _observations(_: Path) -> bytes:
    up = 9.81 * scheme("paper24").directions()
    rows = [",".join(f"{value:.6f}" for value in (*row, 0.001, 0.002, -0.003)) for row in up]
    return "\n".join(["ax,ay,az,gx,gy,gz", *rows, ""]).encode()


def _table(_: Path) -> bytes:
    rng = np.random.default_rng(5)
    rows = rng.normal([0, 0, 9.81, 0, 0, 0], 0.01, (600, 6))
    lines = [",".join(f"{value:.6f}" for value in (0.01 * number, *row)) for number, row in enumerate(rows)]
    return "\n".join(["time,ax,ay,az,gx,gy,gz", *lines, ""]).encode()


def _matrix(folder: Path) -> bytes:
    path = folder / "made.mat"
    scipy.io.savemat(path, {"imu": np.loadtxt(_table(folder).decode().splitlines()[1:], delimiter=",")})
    return path.read_bytes()


def _array_file(write: array_files.Writer) -> Callable[[Path], bytes]:
    """Return what makes a file of arrays."""

    def make(folder: Path) -> bytes:
        with TemporaryDirectory(dir=folder.parent) as place:
            return array_files.written(Path(place), write).read_bytes()

    return make


def _bag(kind: str) -> Callable[[Path], bytes]:
    """Return what makes a recording of ROS in one file."""

    def make(folder: Path) -> bytes:
        from tests.acquire.formats import test_ros_bags

        with TemporaryDirectory(dir=folder.parent) as place:
            path = test_ros_bags.write(Path(place), kind)
            return (next(path.glob("*.db3")) if path.is_dir() else path).read_bytes()

    return make


def _dump(folder: Path) -> bytes:
    session = Session.open(folder / "session")
    blocks = (item.data for item in read_blocks(session) if isinstance(item, RecordedBlock))
    return b"".join(blocks)[:20_000]


def _positions(_: Path) -> bytes:
    entries = [f'[[position]]\nname = "{one.name}"\nup = {one.direction.tolist()}\n' for one in scheme("faces6").positions]
    return "".join(entries).encode()


def _defaults(_: Path) -> bytes:
    return b'port = "/dev/ttyUSB0"\nlatitude_deg = 48.1\nheight_m = 520.0\n'


MAPPED = " ".join(f"--map {one}" for one in MAP)
READ_DRIVE = f"import {{}} --dbc mine.dbc {MAPPED} -o new"


def _copy(name: str) -> Callable[[Path], bytes]:
    return lambda folder: (folder / "session" / name).read_bytes()


CORPORA = (
    Corpus(
        "recording", "session/part-001.mcap", _copy("part-001.mcap"), ("solve session", "export-data session -o out.csv"), False
    ),
    Corpus("session.toml", "session/session.toml", _copy("session.toml"), ("solve session", "replay session")),
    Corpus(
        "parameter file",
        "session/parameters.toml",
        _copy("parameters.toml"),
        (
            "export {} --to c -o out.h",
            "export {} --to px4 -o out.params",
            "history session --json",
            "apply {} session -o out.csv",
            "report session",
        ),
    ),
    Corpus("protocol", "mine.toml", lambda _: PROTOCOL.read_bytes(), ("import dump.bin --protocol {} -o new",)),
    Corpus("byte dump", "dump.bin", _dump, ("import {} --protocol stim300 -o new",), False),
    Corpus("DBC file", "mine.dbc", lambda _: DBC.encode("ascii"), (f"import drive.log --dbc {{}} {MAPPED} -o new",)),
    Corpus("text log of a CAN bus", "drive.log", lambda folder: (folder / "drive.log").read_bytes(), (READ_DRIVE,)),
    Corpus("binary log of a CAN bus", "drive.blf", lambda folder: (folder / "drive.blf").read_bytes(), (READ_DRIVE,), False),
    Corpus("position means", "means.csv", _observations, ("solve --observations {} -o out.toml",)),
    Corpus("table", "table.csv", _table, ("import {} -o new",)),
    Corpus("packed table", "table.csv.gz", lambda folder: gzip.compress(_table(folder), mtime=0), ("import {} -o new",), False),
    Corpus("MATLAB file", "table.mat", _matrix, ("import {} -o new",), False),
    Corpus("list of positions", "mine.toml", _positions, ("emulate stim300 --positions {} --duration-s 0.1 --json",)),
    Corpus("defaults", "imufield.toml", _defaults, ("devices", "solve session --json")),
    Corpus("HDF5 file", "table.h5", _array_file(array_files.hdf5_groups), ("import {} -o new",), False, 4),
    Corpus("MATLAB 7.3 file", "table.mat", _array_file(array_files.mat_7_3), ("import {} -o new",), False, 4),
    Corpus("Parquet file", "table.parquet", _array_file(array_files.parquet_columns), ("import {} -o new",), False, 4),
    Corpus("NumPy file", "table.npy", _array_file(array_files.numpy_table), ("import {} -o new",), False, 4),
    Corpus("NumPy archive", "table.npz", _array_file(array_files.numpy_names), ("import {} -o new",), False, 4),
    Corpus("ROS 1 bag", "drive.bag", _bag("ros1"), ("import {} -o new",), False, 4),
    Corpus("ROS 2 bag, MCAP", "drive.mcap", _bag("mcap alone"), ("import {} -o new",), False, 4),
    Corpus("ROS 2 bag, SQLite", "drive.db3", _bag("sqlite"), ("import {} -o new",), False, 4),
)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a solved session of six faces, a byte dump of it, and logs of a CAN bus."""
    folder = tmp_path_factory.mktemp("sound")
    simulated_session(folder / "session", "faces6")
    assert run(["solve", str(folder / "session"), "--latitude", "48"]) == 0
    (folder / "dump.bin").write_bytes(_dump(folder))
    (folder / "mine.dbc").write_text(DBC, encoding="ascii")
    for name in ("drive.log", "drive.blf"):
        write_log(folder / name, protocol_from_dbc(folder / "mine.dbc", parse_map(MAP)))
    return folder


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("corpus", CORPORA, ids=lambda corpus: corpus.name)
def test_damaged_files(
    corpus: Corpus, sound: Path, tmp_path: Path, campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Once in a home folder Matplotlib asks the system for its fonts and keeps the answer there: no file leads to that.
    importlib.import_module("matplotlib.font_manager")
    content = corpus.make(sound)
    if not campaign.full:
        # The same reader without an interpreter's start; what they are forked from starts before anybody watches.
        forks.server("reader")
        fork_readers(monkeypatch, forked)
    ends: list[Outcome] = []
    folder = tmp_path / "place"

    @seed(8)
    @settings(
        max_examples=campaign.times(corpus.short, 200),
        deadline=None,
        database=None,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    @given(text_edits if corpus.is_text else binary_edits)
    def survive(edits: list[Callable[[bytes], bytes]]) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(sound, folder)
        (folder / corpus.file).write_bytes(damaged(content, edits))
        monkeypatch.chdir(folder)
        ends.extend(attempt(command.format(corpus.file).split(), folder) for command in corpus.commands)

    survive()
    refused = sum(outcome.code != 0 for outcome in ends)
    campaign.tell(
        f"{corpus.name}: damaged and edited at random, read by `{corpus.commands[0].split()[0]}` and others",
        len(ends),
        "commands",
        "{refused} refused in a sentence, {read} read; no traceback, no hang, nothing written outside",
        refused=refused,
        read=len(ends) - refused,
    )
