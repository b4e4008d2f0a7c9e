"""Samples to CAN frames, by the same description that decodes them; cantools packs the bits."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from imufield.acquire.protocol.can_dbc import COUNTER_BITS, CanSignal
from imufield.acquire.protocol.can_frame import FD, Frame
from imufield.acquire.protocol.can_protocol import ANY_ADDRESS, TEMPERATURE, CanKind, Column
from imufield.acquire.protocol.protocol import Protocol
from imufield.errors import UsageError
from imufield.samples import FloatArray, IntArray, Samples, Status
from imufield.sentences import Sentences

sentence = Sentences(__package__)

DEFAULT_ADDRESS = 0x80
FRAME_SPACING_S = 0.00025
"""Between the frames of one sample: one frame takes about this long at 500 kbit/s."""


class CanEncoder:
    """Encodes samples as an instrument on a bus sends them.

    Values outside the range of a signal stop at its end; what is not available (NaN, or flagged invalid) becomes the
    signal's code for that, where it has one.

    Parameters
    ----------
    protocol : Protocol
        Of kind "can". J1939 frames come from its ``source_address``, or from ``DEFAULT_ADDRESS`` where it takes any.

    Raises
    ------
    UsageError
        The protocol is not one of a CAN bus.
    """

    def __init__(self, protocol: Protocol) -> None:
        if protocol.can is None:
            raise UsageError(sentence("can_frames.no_bus", protocol=protocol.name))
        self._rule = protocol.can
        self._ticks_per_s = protocol.clock.time_ticks_per_s
        self._counter_modulus, self._time_modulus = protocol.clock.counter_modulus, protocol.clock.time_modulus
        self._counter_step = protocol.clock.counter_steps[0]
        self._address = DEFAULT_ADDRESS if self._rule.source_address == ANY_ADDRESS else self._rule.source_address
        # The order in which frames win the bus; sorted() keeps the forms of one multiplexed message as they are.
        self._kinds = sorted(self._rule.kinds, key=lambda kind: self._rule.dbc.identifier(kind.message.name))
        self.counter_offset = 0  # Added to the counter: jumps of a faulty unit.

    def encode(self, samples: Samples) -> list[Frame]:
        """Return the frames of a block in the order of the bus; a frame's time is that of its sample and a little more."""
        columns = [self._raw(kind, samples) for kind in self._kinds]
        frames = []
        for sample, time_s in enumerate(samples.time_s.tolist()):
            for place, kind in enumerate(self._kinds):
                raw = {name: values[sample].item() for name, values in columns[place].items()}
                frames.append(self.frame(kind.message.name, raw, time_s + place * FRAME_SPACING_S))
        return frames

    def frame(self, message: str, raw: Mapping[str, float], time_s: float = 0.0) -> Frame:
        """Return one message with raw values by signal, 0 for those not given."""
        dbc = self._rule.dbc
        flags = FD if dbc.is_fd(message) else 0
        return Frame(dbc.identifier(message, self._address), dbc.encode(message, raw), time_s, flags)

    def _raw(self, kind: CanKind, samples: Samples) -> dict[str, FloatArray | IntArray]:
        """Return the raw values of one kind of frame, by signal, for all samples."""
        n = len(samples)
        raw: dict[str, FloatArray | IntArray] = {
            signal.name: np.full(n, allowed[0]) for signal, allowed in kind.message.selectors
        }
        for column in kind.columns:
            raw[column.signal.name] = _to_raw(column, _values(samples, column.place), _invalid(samples, column.place))
        for signal, flag in kind.flags:
            is_set = ((samples.status & np.uint32(flag.flag)) != 0) ^ flag.when_clear
            value = flag.values[0] if flag.values else flag.mask & -flag.mask
            before = raw.get(signal.name, np.zeros(n, dtype=np.int64)).astype(np.int64)
            raw[signal.name] = before | np.where(is_set, value, 0)
        count = samples.counter * self._counter_step + self.counter_offset
        for counter, modulus in ((kind.group, 0), (kind.counter, self._counter_modulus)):
            if counter is not None:
                raw[counter.name] = _wrapped(counter, count % modulus if modulus else count)
        if kind.time is not None:
            ticks = np.rint(samples.time_s * self._ticks_per_s).astype(np.int64)
            raw[kind.time.name] = _wrapped(kind.time, ticks % self._time_modulus if self._time_modulus else ticks)
        return raw


def _wrapped(signal: CanSignal, ticks: IntArray) -> IntArray:
    """Return counts as a signal sends them; a float has all of them."""
    turn = min(signal.modulus, 1 << COUNTER_BITS)
    low = -(turn // 2) if signal.is_signed else 0
    return (ticks - low) % turn + low if turn else ticks


def _values(samples: Samples, place: int) -> FloatArray:
    if place == TEMPERATURE:
        return samples.temperature_degc
    return samples.accelerometer[:, place] if place < 3 else samples.gyroscope[:, place - 3]


def _invalid(samples: Samples, place: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    flag = Status.ACCELEROMETER_INVALID if place < 3 else Status.GYROSCOPE_INVALID
    invalid: np.ndarray[tuple[int], np.dtype[np.bool_]] = np.isnan(_values(samples, place))
    return invalid if place == TEMPERATURE else invalid | ((samples.status & np.uint32(flag)) != 0)


def _to_raw(column: Column, values: FloatArray, invalid: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> FloatArray | IntArray:
    signal = column.signal
    scaled = (np.nan_to_num(values) - column.offset) / column.factor
    if signal.is_float:
        return np.where(invalid, np.nan, scaled)
    low, high = _limits(signal)
    raw = np.clip(np.rint(scaled), low, high).astype(np.int64)
    codes = [code for code in signal.codes if not code.is_error]
    return np.where(invalid, int(codes[-1].high), raw) if codes else raw


def _limits(signal: CanSignal) -> tuple[int, int]:
    """Return the least and the largest raw value that is a measurement."""
    if signal.is_signed:
        return -(1 << signal.length - 1), (1 << signal.length - 1) - 1
    top = (1 << signal.length) - 1
    codes = [int(code.low) for code in signal.codes if code.high >= top]
    reserved = [int(code.low) for code in signal.codes if code.low > top // 2]
    return 0, min([top + 1, *codes, *reserved]) - 1
