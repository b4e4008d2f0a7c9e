"""Guided sessions over simulated paths, for the tests of the guide."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from imufield.calibrate.model.models import predict
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide.events import Event, Rejected
from imufield.guide.hold.observe import Observation
from imufield.guide.hold.output import HoldOutput
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.unguided import StillIntervalFinder, StillIntervals
from imufield.guide.positions import scheme
from imufield.guide.refusals import Refusal, RefusalKind
from imufield.guide.stillness.cells import CellBuilder, Cells, join_cells
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import Samples, SampleUnits, make_samples
from imufield.sentences import Sentence
from imufield.simulate.truth.grades import GRADES, draw_truth

FACES = {"+x": [1, 0, 0], "-x": [-1, 0, 0], "+y": [0, 1, 0], "-y": [0, -1, 0], "+z": [0, 0, 1], "-z": [0, 0, -1]}
SHORT = GuideSettings(hold_s=3.0)
BUMPED = 16


def faces_session(
    make_path: Any, order: Any = ("+z", "+x", "-z", "+y", "-x", "-y"), hold_s: Any = 5.0, rate_hz: float = 100.0
) -> Any:
    path = make_path(rate_hz, lever_m=np.array([0.05, 0.02, -0.03])).hold(FACES[order[0]], hold_s + 1)
    for name in order[1:]:
        path.turn(FACES[name], 1.5).hold(FACES[name], hold_s)
    return path


def run(
    samples: Samples, name: str = "faces6", settings: Any = SHORT, marks: Any = (), blocks: Any = None, **options: Any
) -> Any:
    guide = Guide(scheme(name), samples.units, settings=settings, **options)
    events = []
    for action, time_s in marks:
        events += guide.mark(action, time_s)
    for block in blocks or [samples]:
        events += guide.feed(block)
    return guide, events + guide.flush()


def feed(
    samples: Samples, name: str = "faces6", cuts: int = 1, *, marks: Iterable[tuple[str, float]] = (), **settings: Any
) -> tuple[Guide, list[Event]]:
    """Return a guide that was given samples in some pieces, and what it said; holds of 3 s unless stated."""
    parts = np.array_split(np.arange(len(samples)), cuts)
    blocks = [samples[int(part[0]) : int(part[-1]) + 1] for part in parts]
    guide, events = run(samples, name, GuideSettings(**{"hold_s": 3.0, **settings}), marks, blocks)
    return guide, events


def cells_of(blocks: Iterable[Samples]) -> Iterator[Cells]:
    """Yield the cells of a whole recording, the last unfinished one included."""
    builder = CellBuilder()
    for cells in (*map(builder.feed, blocks), builder.flush()):
        if cells is not None:
            yield cells


def find_still_intervals(blocks: Iterable[Samples], *, scale: RoughScale | None = None) -> StillIntervals:
    """Return the still intervals of a recording; one block at least, cut anywhere."""
    finder: StillIntervalFinder | None = None
    for block in blocks:
        finder = finder or StillIntervalFinder(block.units, scale)
        finder.feed(block)
    assert finder is not None
    return finder.finish()


def noise_output() -> HoldOutput:
    """Return the outputs of a hold of white noise, for an observation whose mean is made up."""
    noise = np.random.default_rng(0).normal(size=(2, 300, 3))
    samples = make_samples(np.arange(300) / 100, *noise, units=SampleUnits())
    return HoldOutput.of(join_cells(list(cells_of([samples]))))


def observations(grade: str, seed: int, bump: float = 0.0, scatter: float = 2e-4) -> list[Observation]:
    """Return made-up observations of paper24 in the proposed order; that of ``BUMPED`` is longer by a share."""
    rng = np.random.default_rng(seed)
    instrument = draw_truth(GRADES[grade], rng)
    found = []
    for i, up in enumerate(scheme("paper24").directions()):
        placed = up + 0.1 * rng.normal(size=3)
        placed /= np.linalg.norm(placed)
        mean = predict(instrument.accelerometer, STANDARD_GRAVITY_M_S2 * placed) + rng.normal(0, scatter, 3)
        if i == BUMPED:
            mean = mean * (1 + bump)
        found.append(
            Observation(
                name=f"p{i}",
                direction=placed,
                mean_raw=mean,
                covariance_raw=np.eye(3) * scatter**2,
                gyroscope_mean_raw=np.zeros(3),
                gyroscope_covariance_raw=np.eye(3),
                gyroscope_rounding_raw=np.zeros(3),
                start_s=0.0,
                duration_s=10.0,
                temperature_degc=20.0,
                output=noise_output(),
            )
        )
    return found


def of(events: Any, kind: Any) -> Any:
    return [event for event in events if isinstance(event, kind)]


def is_said_by(kind: RefusalKind, told: Refusal | Rejected | None) -> bool:
    """Whether a refusal is of this row of the table, by the keys of its sentences."""
    if told is None:
        return False
    return (told.reason, key_of(told.words), key_of(told.remedy)) == (kind.reason, kind.words, kind.remedy)


def key_of(text: str) -> str:
    """Return the key of a sentence."""
    assert isinstance(text, Sentence), text
    return text.key


def values_of(text: str) -> dict[str, Any]:
    """Return what a sentence names."""
    assert isinstance(text, Sentence), text
    return text.values
