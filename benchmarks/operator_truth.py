"""What is true of a simulated operator's holds: edges of stillness, what a bump does to a mean; see ``bench_operators``."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.model.models import recover
from imufield.guide.events import Accepted
from imufield.guide.hold.hand_mean import mean_in_hand
from imufield.guide.hold.observe import Observation, knocks_of, observe
from imufield.guide.stillness.cells import CellBuilder, Cells, join_cells
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.limits import Limits
from imufield.guide.stillness.noise_floor import NoiseFloor
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.stillness.turn_fit import minimum_jerk
from imufield.samples import CELL_S, Samples, concatenate
from imufield.simulate.truth.imu import Imu
from imufield.simulate.truth.motion_pieces import Piece
from imufield.simulate.truth.operator import Operator


@dataclass(frozen=True, slots=True)
class Edges:
    """A still interval as it truly is: the first and the last moment at which it may be said to begin, and to end."""

    begin_s: tuple[float, float]
    end_s: tuple[float, float]
    bumped: bool
    held: bool


def outside(value: float, allowed: tuple[float, float]) -> float:
    """Return by how much a value lies above (positive) or below (negative) a range."""
    return max(value - allowed[1], 0.0) + min(value - allowed[0], 0.0)


def true_edges(operator: Operator, imu: Imu) -> list[Edges]:
    """Return the true still intervals, on the sample clock."""
    clock = imu.to_sample_clock
    found = []
    for still in operator.stills:
        hand = still.kind == "held"
        before = _piece_ending(operator, still.start_s)
        after = _piece_beginning(operator, still.end_s)
        begin_s, end_s = still.start_s, still.end_s
        first = begin_s if before is None else _faded(before, rising=False)
        last = end_s if after is None else _faded(after, rising=True)
        found.append(Edges((clock(first), clock(begin_s)), (clock(end_s), clock(last)), still.bumped, hand))
    return found


def _piece_ending(operator: Operator, time_s: float) -> Piece | None:
    return next((piece for piece in operator._pieces if abs(piece.end_s - time_s) < 1e-9), None)  # noqa: SLF001


def _piece_beginning(operator: Operator, time_s: float) -> Piece | None:
    return next((piece for piece in operator._pieces if abs(piece.start_s - time_s) < 1e-9), None)  # noqa: SLF001


def _faded(piece: Piece, *, rising: bool) -> float:
    """Return when what is left of a turn (what is made of it, if rising) is as large as the hand's own movement, rms angle."""
    edge_s = piece.start_s if rising else piece.end_s
    turn = float(np.linalg.norm(piece.turn_rad))
    if piece.hand is None or turn == 0:
        return edge_s
    stray = math.sqrt(float(np.sum(piece.hand.rotation_rad**2)) / 2)
    if stray >= turn:
        return piece.end_s if rising else piece.start_s
    u = np.linspace(0, 1, 10001)
    share = float(u[np.searchsorted(minimum_jerk(u), stray / turn)]) * (piece.end_s - piece.start_s)
    return edge_s + share if rising else edge_s - share


class EdgeWatch:
    """A detector of its own beside the guide's; keeps begin and end of every stretch.

    Parameters
    ----------
    scale : RoughScale
    """

    def __init__(self, scale: RoughScale) -> None:
        self._detector = StillnessDetector(scale, hand=True)
        self._builder = CellBuilder()
        self.found: list[tuple[float, float]] = []

    def feed(self, samples: Samples) -> None:
        """Take the next samples."""
        finished = self._builder.feed(samples)
        for judgement in () if finished is None else self._detector.judge(finished):
            if judgement.ended is not None:
                cells = judgement.ended.cells()
                self.found.append((float(cells.start_s[0]), float(cells.end_s[-1])))


@dataclass(frozen=True, slots=True)
class Standards:
    """What a session measured its holds with."""

    scale: RoughScale
    floor: NoiseFloor
    limits: Limits


def bump_shares(operator: Operator, imu: Imu, taken: list[tuple[Accepted, Observation]], standards: Standards) -> list[float]:
    """Return what bumps did to the norms of accepted holds, m/s^2: measured with the bump less without, same noise.

    Parameters
    ----------
    operator, imu
        As they are after the session.
    taken : list of pairs
        Accepted holds with a bump in them, and their observations.
    standards : Standards
    """
    if not taken:
        return []
    calm = _without_bumps(operator)
    fresh = Imu(imu.instrument, imu_seed(operator), imu.settings)
    until_s = max(event.start_s + event.duration_s for event, _ in taken) + 1.0
    blocks = [(event.start_s - 0.5, event.start_s + event.duration_s + 0.5) for event, _ in taken]
    played = _play(calm, fresh, until_s)
    samples = concatenate(
        [block for block in played if any(block.time_s[0] < end and block.time_s[-1] > begin for begin, end in blocks)]
    )
    return [_norm(imu, with_it) - _norm(imu, _measure(samples, event, with_it, standards)) for event, with_it in taken]


def imu_seed(operator: Operator) -> int:
    """Return the seed, which operator and instrument share here."""
    return operator._seed  # noqa: SLF001


def _play(operator: Operator, imu: Imu, until_s: float) -> Iterator[Samples]:
    size = max(1, round(2.0 * imu.settings.rate_hz))
    for first in range(0, round(until_s * imu.settings.rate_hz), size):
        yield imu.feed(operator.block(first, size, imu.interval_s))


def _without_bumps(operator: Operator) -> Operator:
    """Return the same motion with every bump taken out; after a shift the unit stays where it was until the next turn."""
    calm = copy.copy(operator)
    bumps = [move for move in operator.moves if move.kind != "turn"]
    pieces: list[Piece] = []
    quaternion = None
    for piece in operator._pieces:  # noqa: SLF001
        if any(abs(move.start_s - piece.start_s) < 1e-9 for move in bumps):
            quaternion = piece.quaternion_nb if quaternion is None else quaternion
            pieces.append(replace(piece, quaternion_nb=quaternion, turn_rad=np.zeros(3), shocks=()))
        elif quaternion is not None and not np.any(piece.turn_rad):
            pieces.append(replace(piece, quaternion_nb=quaternion))
        else:
            quaternion = None
            pieces.append(piece)
    calm._pieces = pieces  # noqa: SLF001
    calm._heard = type(operator._heard)()  # noqa: SLF001
    return calm


def _measure(samples: Samples, event: Accepted, with_it: Observation, standards: Standards) -> Observation:
    """Measure the accepted interval in other samples, as the guide does."""
    end_s = event.start_s + event.duration_s
    rows = (samples.time_s >= event.start_s - 1e-9) & (samples.time_s <= end_s + 1e-9)
    inside = samples[rows]
    builder = CellBuilder()
    cells: Cells = join_cells([part for part in (builder.feed(inside), builder.flush()) if part is not None])
    in_hand = None
    if with_it.hand_mean is not None:
        density = standards.floor.cell_sigma[:3] * math.sqrt(CELL_S)
        in_hand = mean_in_hand(inside, standards.scale, density, knocks_of(cells, standards.limits))
    return observe(cells, standards.limits, event.position, with_it.direction, hand_mean=in_hand)


def _norm(imu: Imu, observation: Observation) -> float:
    return float(np.linalg.norm(recover(imu.instrument.accelerometer, observation.mean_raw[None, :])[0]))
