"""pytest plugin: recorded captures replayed in tests, and emulated instruments on ports (docs/replay-in-pytest.md).

Installed with imufield; nothing heavy is imported before a fixture is used. Fixtures:

``imufield_replay(path)``
    Replay a session, or a raw byte dump with ``protocol=``; returns ``Replayed`` with samples, events, parameters.
``imufield_pty(driver, faults=...)``
    An emulated instrument on a pseudo-terminal; returns the running emulator, whose ``port`` can be opened.
``imufield_can_bus(driver, bus, faults=...)``
    An emulated instrument on a CAN bus, ``slcan`` on a pseudo-terminal unless told otherwise; returns the running emulator,
    whose ``bus`` can be opened.
``imufield_golden(name, values)``
    Compare numbers with a file beside the test; ``--imufield-update`` rewrites it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from imufield.dataclass import dataclass
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from imufield.acquire.recording.session import Session
    from imufield.deliver.parameters.file import Parameters
    from imufield.samples import Samples
    from imufield.simulate.emulator.can import CanEmulator
    from imufield.simulate.emulator.core import EmulatorCore
    from imufield.simulate.emulator.faults import WireFaults
    from imufield.simulate.emulator.serial import Emulator

sentence = Sentences(__package__)


@dataclass(frozen=True)
class Replayed:
    """A session replayed."""

    session: Session

    @cached_property
    def samples(self) -> Samples:
        """All samples, in one block on one sample clock."""
        from imufield.pipeline.chain import session_samples
        from imufield.samples import concatenate

        return concatenate(session_samples(self.session, []))

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        """What the guide says, as in JSON lines; empty for a session that nobody guided."""
        from imufield.pipeline.chain import Chain, ReadingPlan, replay_into

        events: list[dict[str, Any]] = []
        chain = Chain(ReadingPlan.of(self.session))
        replay_into(chain, self.session, [], lambda new: events.extend(event.to_dict() for event in new))
        return events

    @cached_property
    def parameters(self) -> Parameters:
        """The calibration with default options; see ``solve`` for others."""
        return self.solve()

    def solve(self, **options: Any) -> Parameters:
        """Solve with fields of ``commands.options.result_commands.SolveOptions``, and ``gravity_m_s2`` or ``latitude_deg``."""
        from imufield.commands.options.result_commands import SolveOptions
        from imufield.pipeline.site import SiteOptions
        from imufield.pipeline.solving import solve_session

        site = SiteOptions(
            gravity_m_s2=options.pop("gravity_m_s2", None),
            latitude_deg=options.pop("latitude_deg", None),
            height_m=options.pop("height_m", None),
        )
        # A recording that tests replay lies in a repository.
        return solve_session(self.session, SolveOptions(**options).settings(), site, keeps=False)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that rewrites golden results."""
    parser.addoption("--imufield-update", action="store_true", help="rewrite the golden results of imufield_golden")


@pytest.fixture
def imufield_replay(tmp_path: Path) -> Callable[..., Replayed]:
    """Return a function that replays a session folder, or a raw byte dump with ``protocol`` and ``settings``."""

    def replay(path: str | Path, protocol: str | None = None, settings: Mapping[str, str] | None = None) -> Replayed:
        from imufield.acquire.recording.session import Session
        from imufield.commands.import_files import import_session
        from imufield.commands.options.acquire_commands import ImportOptions

        if protocol is None:
            return Replayed(Session.open(path))
        # Numbered: a test may replay the same dump twice, and nothing is overwritten.
        folder = tmp_path / f"imufield-{len(list(tmp_path.glob('imufield-*')))}-{Path(path).stem}"
        options = ImportOptions(files=[Path(path)], output=folder, protocol=protocol, settings=dict(settings or {}))
        return Replayed(import_session(options)[0])

    return replay


@pytest.fixture
def imufield_pty() -> Iterator[Callable[..., Emulator]]:
    """Return a function that starts an emulated instrument on a pseudo-terminal; all are stopped after the test."""
    with ExitStack() as stack:

        def start(driver: str = "stim300", *, faults: Mapping[str, Any] | None = None, **options: Any) -> Emulator:
            from imufield.simulate.emulator.faults import Faults
            from imufield.simulate.emulator.serial import Emulator

            emulator = _make_emulator(driver, Faults(**(faults or {})), {"wait_for_reader": True, **options})
            if not isinstance(emulator, Emulator):
                pytest.fail(sentence("testing.on_bus", driver=driver))
            return stack.enter_context(emulator)

        yield start


@pytest.fixture
def imufield_can_bus() -> Iterator[Callable[..., CanEmulator]]:
    """Return a function that starts an emulated instrument on a CAN bus; all are stopped after the test."""
    with ExitStack() as stack:

        def start(driver: str, bus: str = "slcan", *, faults: Mapping[str, Any] | None = None, **options: Any) -> CanEmulator:
            from imufield.simulate.emulator.can import CanEmulator
            from imufield.simulate.emulator.faults import CanFaults

            emulator = _make_emulator(driver, CanFaults(**(faults or {})), {"bus": bus, **options})
            if not isinstance(emulator, CanEmulator):
                pytest.fail(sentence("testing.on_line", driver=driver))
            return stack.enter_context(emulator)

        yield start


def _make_emulator(driver: str, faults: WireFaults, options: dict[str, Any]) -> EmulatorCore:
    from imufield.simulate.emulator.core import EmulatorSettings
    from imufield.simulate.emulator.emulate import Emulation, make_emulator

    # What is of the run and not of the instrument, for a caller that should not need to know the difference.
    names = ("speed", "wait_for_reader", "duration_s")
    run = EmulatorSettings(**{name: options.pop(name) for name in names if name in options})
    return make_emulator(Emulation(device=driver, faults=faults, run=run, **options))


@pytest.fixture
def imufield_golden(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Return a function that compares numbers, lists and arrays with ``golden/<name>.json`` beside the test file."""

    def check(name: str, values: Mapping[str, Any], *, relative: float = 1e-9, absolute: float = 0.0) -> None:
        path = request.path.parent / "golden" / f"{name}.json"
        values = {key: value.tolist() if hasattr(value, "tolist") else value for key, value in values.items()}
        if request.config.getoption("--imufield-update"):
            path.parent.mkdir(exist_ok=True)
            path.write_text(json.dumps(values, indent=1, sort_keys=True) + "\n")
            return
        if not path.is_file():
            pytest.fail(sentence("testing.no_golden", path=path))
        expected = json.loads(path.read_text())
        differing = [
            key for key in sorted({*expected, *values}) if not _agree(expected.get(key), values.get(key), relative, absolute)
        ]
        if differing:
            key = differing[0]
            told = {"value": values.get(key), "expected": expected.get(key), "differing": len(differing)}
            pytest.fail(sentence("testing.golden", name=name, key=key, **told))

    return check


def _agree(expected: Any, value: Any, relative: float, absolute: float) -> bool:
    if isinstance(expected, list) and isinstance(value, list | tuple):
        return len(expected) == len(value) and all(
            _agree(golden, now, relative, absolute) for golden, now in zip(expected, value, strict=True)
        )
    if isinstance(expected, float) and isinstance(value, float | int):
        # A figure that cannot be known is NaN, and stays so: that is agreement, too.
        both_nan = math.isnan(expected) and math.isnan(value)
        return both_nan or math.isclose(expected, value, rel_tol=relative, abs_tol=absolute)
    return bool(expected == value)
