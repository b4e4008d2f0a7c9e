"""Fixtures that every room's tests use."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# As the program itself does it: the matrices are small, and threads of the linear algebra only get in each other's way.
for _library in ("OPENBLAS", "MKL", "OMP"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

# A shell lets what it runs in the background ignore Ctrl-C, nohup a closed terminal, and what the tests start would do the
# same. A handler is not handed on to programs: they hear every signal, while the tests go on ignoring it.
for _signal in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(_signal) == signal.SIG_IGN:
        signal.signal(_signal, lambda number, frame: None)

# The same examples in every run, however slow the machine: what fails once fails always, and nothing fails by chance.
settings.register_profile("same", derandomize=True, database=None, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("same")

PROJECT = Path(__file__).resolve().parent.parent


@pytest.fixture(autouse=True, scope="session")
def own_places(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep secret and indexes of the tests out of the person's own folders."""
    for name in ("XDG_CACHE_HOME", "XDG_STATE_HOME"):
        os.environ[name] = str(tmp_path_factory.mktemp(name.lower()))
    write_secret(Path(os.environ["XDG_STATE_HOME"]))


def write_secret(state_home: Path) -> None:
    """Make the secret that of all tests: what one process keeps of a replay, the others and their programs believe."""
    path = state_home / "imufield" / "secret"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"of the tests".ljust(32))
    path.chmod(0o600)


# Files of half a minute and more, mostly the longest first, or one process works on alone when the others are done. Most wait
# for ports and browsers: with others between them there is work meanwhile.
OTHERS_BETWEEN = 15
BEGIN_WITH = 5
LONG = (
    "commands/test_can.py",
    "study/test_studies.py",
    "commands/test_probe.py",
    "torture/test_sequences.py",
    "commands/test_desk.py",
    "web/test_page_looks.py",
    "commands/test_bad_input.py",
    "torture/test_claims.py",
    "test_all_drivers.py",
    "commands/test_capture.py",
    "torture/test_second_corpus.py",
    "drivers/test_control.py",
    "web/test_workbench_page.py",
    "torture/test_killed.py",
    "commands/test_text_streams.py",
    "web/test_workbench.py",
    "calibrate/accelerometer/test_f_tests.py",
    "commands/test_guided.py",
    "torture/test_faults.py",
    "web/test_guide_page.py",
    "web/test_server.py",
    "test_honesty.py",
)


# Seven thousand tests and two thousand modules stay to the end: the collector need not go through them, now or later.
gc.disable()


def pytest_collection_finish() -> None:
    """Let the collector look at what the tests make, and at nothing else; rarely, as most of it goes without cycles."""
    gc.freeze()
    gc.set_threshold(200_000)
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spread the long files, from the beginning on; within a file and among the others the order stays."""
    files = {item.path: None for item in items}
    long = [path for path in (PROJECT / "tests" / name for name in LONG) if path in files]
    others = iter([path for path in files if path not in long])
    order = long[:BEGIN_WITH]
    for path in long[BEGIN_WITH:]:
        order += [*islice(others, OTHERS_BETWEEN), path]
    places = {path: place for place, path in enumerate([*order, *others])}
    items.sort(key=lambda item: places[item.path])


@pytest.fixture(scope="session")
def shared_folder() -> Path:
    """Return the folder of real recordings and test vectors beside the project; skip where it is absent."""
    folder = PROJECT.parent / "shared"
    if not folder.is_dir():
        pytest.skip(f"needs the real recordings and vectors in {folder.name}/ beside the project")
    return folder


@pytest.fixture(scope="session", autouse=True)
def one_copy_of_each_driver() -> Iterator[None]:
    """Fail the run if something imported ``drivers`` instead of ``imufield.drivers``."""
    yield
    assert "drivers" not in sys.modules
