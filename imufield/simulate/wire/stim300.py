"""Samples to STIM300 normal datagrams, for whole blocks at once.

Written from the facts of the wire alone and independently of the decoder, so that each can test the other.

STIM300 normal datagram (datasheet TS1524, section "Normal Mode"), all numbers big-endian: id; clusters of three 24-bit
values and a status byte (gyroscope, accelerometer, inclinometer); clusters of 16-bit temperatures and a status byte; AUX or
PPS of 24 bits and a status byte; counter u8; latency u16; CRC-32/MPEG-2 over all of it, filled up with zero bytes to a
multiple of four that are not sent; CR LF if configured.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imufield.acquire.protocol.checksum import make_checksum
from imufield.dataclass import dataclass
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import UsageError
from imufield.samples import FloatArray, IntArray, Samples, Status
from imufield.sentences import Sentences
from imufield.simulate.wire.frames import Bytes, bytes_of

sentence = Sentences(__package__)

INTERNAL_RATE_HZ = 2000
"""The datagram counter counts samples of this rate, modulo 256."""
CRLF = b"\r\n"
ACCELEROMETER_BITS = {2: 21, 5: 20, 10: 19, 30: 18, 80: 16}
"""Range in g -> binary places of acceleration in g; velocity increments in m/s have three more."""
GYROSCOPE_RANGE_DEG_S = 400.0
INCLINOMETER_RANGE_G = 1.7

Auxiliary = Literal["none", "aux", "pps"]
OutputUnit = Literal["rate", "increment", "average"]

# By accelerometer + 2 inclinometer + 4 temperatures, without AUX or PPS; with AUX it is 8 more, with PPS 0xF0 + index.
_PLAIN_IDS = (0x90, 0x91, 0x92, 0x93, 0x94, 0xA5, 0xA6, 0xA7)
# Status byte: bits of the whole cluster; the lowest three name the axes x, y, z.
_STATUS_INTEGRITY = 0x80
_STATUS_START_UP = 0x40
_STATUS_OVERLOAD = 0x10
_STATUS_CHANNEL = 0x08
_CRC = make_checksum("CRC-32/MPEG-2", pad_to=4)
_INT24 = (-(2**23), 2**23 - 1)
_INT16 = (-(2**15), 2**15 - 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stim300Format:
    """What a STIM300 is configured to send."""

    rate_hz: float = 2000.0
    accelerometer: bool = True
    inclinometer: bool = True
    temperature: bool = False
    auxiliary: Auxiliary = "none"
    crlf: bool = True
    accelerometer_range_g: int = 10
    gyroscope_output: OutputUnit = "rate"
    accelerometer_output: OutputUnit = "rate"
    latency_us: int = 506

    @property
    def datagram_id(self) -> int:
        """First byte of the datagram, which tells its content."""
        index = self.accelerometer + 2 * self.inclinometer + 4 * self.temperature
        return {"none": _PLAIN_IDS[index], "aux": _PLAIN_IDS[index] + 8, "pps": 0xF0 + index}[self.auxiliary]

    @property
    def counter_step(self) -> int:
        """Increase of the counter from datagram to datagram."""
        return round(INTERNAL_RATE_HZ / self.rate_hz)


@dataclass(frozen=True, slots=True)
class Cluster:
    """Integers of one cluster of n datagrams as they go on the wire."""

    values: IntArray
    """Shape (n, 3); of AUX or PPS (n, 1)."""
    status: ArrayLike = 0
    """Shape (n,) or one number."""
    size: int = 3
    """Bytes of a value."""


def stim300_frames(datagram_id: int, clusters: Iterable[Cluster], counter: IntArray, latency_us: int, *, crlf: bool) -> Bytes:
    """Return n datagrams of the clusters that they have, shape (n, length)."""
    count = len(counter)
    columns = [np.full((count, 1), datagram_id, dtype=np.uint8)]
    for cluster in clusters:
        columns += [bytes_of(cluster.values, cluster.size, True), _column(cluster.status, count)]
    columns += [_column(counter & 0xFF, count), bytes_of(np.full((count, 1), latency_us), 2, True)]
    return close_datagrams(np.concatenate(columns, axis=1), crlf=crlf)


def close_datagrams(body: Bytes, *, crlf: bool) -> Bytes:
    """Append CRC (and CR LF) to n datagram bodies, shape (n, length)."""
    end = [np.broadcast_to(np.frombuffer(CRLF, dtype=np.uint8), (len(body), 2))] if crlf else []
    return np.concatenate([body, bytes_of(_CRC.of_rows(body)[:, np.newaxis].astype(np.int64), 4, True), *end], axis=1)


class Stim300Encoder:
    """Samples to bytes as a STIM300 of a given configuration sends them.

    The inclinometer, a second accelerometer of 1.7 g, shows what the accelerometer does. Samples are in m/s^2 and rad/s
    (increments: m/s and rad); the counter is taken from ``Samples.counter``, the number of the sample.

    Raises
    ------
    UsageError
        If the range is not one of the instrument's.
    """

    def __init__(self, settings: Stim300Format) -> None:
        if settings.accelerometer_range_g not in ACCELEROMETER_BITS:
            found_g, ranges_g = settings.accelerometer_range_g, [*ACCELEROMETER_BITS]
            raise UsageError(sentence("stim300.range", accelerometer_range_g=found_g, ranges_g=ranges_g))
        self.format = settings
        self.counter_offset = 0  # Added to the counter: where it stood at the first sample, and jumps of a faulty unit.

    def encode(self, samples: Samples) -> Bytes:
        """Return the datagrams of a block, shape (n, length)."""
        use, places = self.format, ACCELEROMETER_BITS[self.format.accelerometer_range_g]
        rate_m_s2, rate_deg_s = samples.accelerometer_rate(), np.degrees(samples.gyroscope_rate())
        rate_g = rate_m_s2 / STANDARD_GRAVITY_M_S2
        # Binary places of one step (TS1524, table of output units): 2^-14 deg/s or 2^-21 deg; 2^-22 g of the inclinometer,
        # which stops at its own range; 2^-8 degree C.
        if use.gyroscope_output == "increment":
            gyroscope = _to_integer(rate_deg_s / use.rate_hz, 21, _INT24)
        else:
            gyroscope = _to_integer(rate_deg_s, 14, _INT24)
        if use.accelerometer_output == "increment":
            accelerometer = _to_integer(rate_m_s2 / use.rate_hz, places + 3, _INT24)
        else:
            accelerometer = _to_integer(rate_g, places, _INT24)
        inclinometer = _to_integer(np.clip(rate_g, -INCLINOMETER_RANGE_G, INCLINOMETER_RANGE_G), 22, _INT24)
        # An axis counts as saturated from 99.9 % of its range on.
        fast = np.abs(rate_deg_s) >= 0.999 * GYROSCOPE_RANGE_DEG_S
        strong = np.abs(rate_m_s2) >= 0.999 * use.accelerometer_range_g * STANDARD_GRAVITY_M_S2
        clusters = [Cluster(gyroscope, _status(samples, Status.GYROSCOPE_SATURATED, Status.GYROSCOPE_INVALID, fast))]
        if use.accelerometer:
            status = _status(samples, Status.ACCELEROMETER_SATURATED, Status.ACCELEROMETER_INVALID, strong)
            clusters.append(Cluster(accelerometer, status))
        if use.inclinometer:
            clusters.append(Cluster(inclinometer, _start_up(samples)))
        if use.temperature:
            # Each triad has its thermometers; those of the inclinometer are not simulated apart.
            one_degc = np.repeat(samples.temperature_degc[:, np.newaxis], 3, axis=1)
            own_degc = samples.sensor_temperature_degc
            triads_degc = [one_degc, one_degc] if own_degc is None else [own_degc[:, 3:], own_degc[:, :3]]
            sent_degc = [*triads_degc[: 1 + use.accelerometer], *[one_degc] * use.inclinometer]
            clusters += [Cluster(_to_integer(each_degc, 8, _INT16), size=2) for each_degc in sent_degc]
        if use.auxiliary != "none":
            clusters.append(Cluster(np.zeros((len(samples), 1), dtype=np.int64)))
        counter = samples.counter * use.counter_step + self.counter_offset
        return stim300_frames(use.datagram_id, clusters, counter, use.latency_us, crlf=use.crlf)


def _status(samples: Samples, saturated: Status, invalid: Status, at_limit: NDArray[np.bool_]) -> Bytes:
    """Return status bytes; where no axis is at the limit all three are named."""
    status = _start_up(samples)
    if not np.any(samples.status):
        return status
    axes = (at_limit @ np.array([1, 2, 4])).astype(np.uint8)
    axes[axes == 0] = 7
    status |= np.where(_has(samples, saturated), _STATUS_OVERLOAD | axes, 0).astype(np.uint8)
    status |= np.where(_has(samples, invalid), np.uint8(_STATUS_CHANNEL | 7), np.uint8(0))
    return status | np.where(_has(samples, Status.INSTRUMENT_FAULT), np.uint8(_STATUS_INTEGRITY), np.uint8(0))


def _start_up(samples: Samples) -> Bytes:
    return np.where(_has(samples, Status.START_UP), np.uint8(_STATUS_START_UP), np.uint8(0))


def _has(samples: Samples, flag: Status) -> NDArray[np.bool_]:
    flagged: NDArray[np.bool_] = (samples.status & np.uint32(flag)) != 0
    return flagged


def _to_integer(values: FloatArray, binary_places: int, limits: tuple[int, int]) -> IntArray:
    return np.clip(np.rint(np.ldexp(values, binary_places)), *limits).astype(np.int64)


def _column(values: ArrayLike, count: int) -> Bytes:
    return np.broadcast_to(np.asarray(values).astype(np.uint8), (count,))[:, np.newaxis]
