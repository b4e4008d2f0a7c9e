"""A damaged stream and its exact account: what was sent, what arrived whole, what was decoded, what is known to be lost.

Every form that an emulated instrument can send is a *wire*. Random samples go through its encoder, bits flip, bytes and
stretches get lost, and the decoder's samples are held against those of the undamaged stream. Every sample has values of its
own, so each decoded one is found again or is false.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import Protocol, load_protocol
from imufield.acquire.registry import load_driver, shipped_names
from imufield.samples import FloatArray, IntArray, Samples, Status, concatenate, make_samples
from imufield.simulate.emulator.emulate import OWN_RATE_HZ, Emulation, WireChoice, choose_wire, make_device
from imufield.simulate.instruments.device import Device, Frames
from imufield.simulate.wire.forms import wire_forms

BIT_FLIPS, LOST_BYTES = 1e-4, 1e-5
"""Chances of each byte."""
_STRETCH_S, _STRETCHES_PER_S = 0.02, 0.1
"""Longest stretch of the stream that is lost at once, and how often: below every wrap of a counter."""
_READ_S = 0.02
_SEGMENT_S = 10.0
"""Damage is drawn for so much at once: bounds memory."""


@dataclass(frozen=True, slots=True)
class Wire:
    """One form of one driver."""

    driver: str
    form: str

    def __str__(self) -> str:
        return f"{self.driver}-{self.form}" if self.form else self.driver

    def choose(self) -> WireChoice:
        """Return protocol, settings and rate."""
        return choose_wire(Emulation(device=self.driver, form=self.form or None))

    def device(self) -> Device:
        """Return a new instrument."""
        return make_device(Emulation(device=self.driver, form=self.form or None), self.choose())


def serial_wires() -> list[Wire]:
    """Return every form of every driver that ships, those on CAN left out."""
    found = []
    for name in shipped_names():
        driver = load_driver(name)
        if driver.wire == "serial":
            forms = [""] if name in OWN_RATE_HZ else [form.name for form in wire_forms(load_protocol(driver.protocol))]
            found += [Wire(name, form) for form in forms]
    return found


def has_checksum(protocol: Protocol) -> bool:
    """Return whether damage to a frame can be seen."""
    if protocol.frame is not None:
        return all(form.checksum is not None for form in protocol.frame.forms)
    return bool(protocol.lines and protocol.lines.checksums)


def random_samples(protocol: Protocol, rate_hz: float, first: int, count: int, seed: int = 0) -> Samples:
    """Return samples of random values in the units of a protocol, numbered from ``first``."""
    rng = np.random.default_rng([seed, first])
    number = np.arange(first, first + count)
    values = rng.uniform(-1, 1, (count, 6)) * np.repeat([15.0, 3.0], 3)
    units = protocol.units
    values[:, :3] /= rate_hz if units.accelerometer_is_increment else 1
    values[:, 3:] /= rate_hz if units.gyroscope_is_increment else 1
    return make_samples(
        number / rate_hz,
        values[:, :3],
        values[:, 3:],
        units=units,
        temperature_degc=rng.uniform(10, 40, count),
        counter=number,
    )


@dataclass(slots=True)
class Account:
    """What became of a stream."""

    frames_sent: int = 0
    frames_intact: int = 0
    """Frames none of whose bytes were hit."""
    frames_decoded: int = 0
    samples_sent: int = 0
    samples_decoded: int = 0
    samples_missed: int = 0
    """Intact, yet not decoded."""
    samples_false: int = 0
    """Decoded, yet never sent so."""
    missing: int = 0
    """Samples between the first and the last decoded one that were not decoded."""
    counted_lost: int = 0
    """What the decoder says is lost by counter or time stamp."""
    estimated_lost: int = 0
    """What it says is lost by the host's clock."""
    flagged_estimated: int = 0
    """Samples that say that time or number of losses before them is estimated."""
    bits_flipped: int = 0
    bytes_lost: int = 0


@dataclass(frozen=True, slots=True)
class _Damaged:
    reads: list[tuple[bytes, float]]
    """Bytes of each read and its time of arrival, s."""
    intact: NDArray[np.bool_]
    """By frame."""
    flips: int
    lost: int


def account_for(wire: Wire, duration_s: float, seed: int = 1, *, outages: bool = False) -> Account:
    """Send, damage, decode and count.

    Parameters
    ----------
    wire : Wire
    duration_s : float
        Sample time.
    seed : int
    outages : bool
        Lose stretches of 0.3 s to 3 s too, beyond the wrap of a counter.
    """
    choice, device = wire.choose(), wire.device()
    rng = np.random.default_rng([seed, 501])
    account = Account()
    damaged, clean = Decoder(choice.protocol), Decoder(choice.protocol)
    sent: list[Samples] = []
    got: list[Samples] = []
    intact: list[NDArray[np.bool_]] = []
    for samples in _segments(choice, duration_s):
        frames = device.encode(samples)
        sent.append(clean.feed(frames.data.tobytes()))
        hit = _damage(frames, samples.time_s, rng, outages=outages)
        got += [damaged.feed(data, arrival_s) for data, arrival_s in hit.reads]
        intact.append(np.asarray(hit.intact.reshape(len(samples), -1).all(axis=1)))
        account.frames_sent += len(frames.ends)
        account.frames_intact += int(hit.intact.sum())
        account.bits_flipped += hit.flips
        account.bytes_lost += hit.lost
    sent.append(clean.flush())
    got.append(damaged.flush())
    account.frames_decoded = damaged.statistics.frames
    account.counted_lost = damaged.statistics.samples_lost
    account.estimated_lost = damaged.statistics.losses_estimated
    _compare(concatenate(sent), concatenate(got), np.concatenate(intact), account)
    return account


def _segments(choice: WireChoice, duration_s: float) -> Iterator[Samples]:
    total, step = round(duration_s * choice.rate_hz), round(_SEGMENT_S * choice.rate_hz)
    for first in range(0, total, step):
        yield random_samples(choice.protocol, choice.rate_hz, first, min(step, total - first))


def _damage(frames: Frames, time_s: FloatArray, rng: np.random.Generator, *, outages: bool) -> _Damaged:
    data = frames.data.copy()
    per_sample = len(frames.ends) // len(time_s)
    lost = _lost_bytes(data, rng)
    ends = frames.ends[per_sample - 1 :: per_sample]
    lost |= _lost_stretches(ends, time_s, rng, outages=outages)
    flips = np.flatnonzero(rng.random(len(data)) < BIT_FLIPS)
    data[flips] ^= (1 << rng.integers(0, 8, len(flips))).astype(np.uint8)
    changed = lost.copy()
    changed[flips] = True
    intact = np.add.reduceat(changed, np.append(0, frames.ends[:-1])) == 0
    places = np.searchsorted(time_s, np.arange(time_s[0] + _READ_S, time_s[-1], _READ_S))
    edges = np.unique(np.concatenate([[0], ends[places], [len(data)]]))
    arrivals = np.append(time_s, time_s[-1])[np.searchsorted(ends, edges[1:])]
    reads = [
        (data[begin:end][~lost[begin:end]].tobytes(), float(arrival_s))
        for (begin, end), arrival_s in zip(pairwise(edges.tolist()), arrivals, strict=True)
    ]
    return _Damaged([read for read in reads if read[0]], intact, len(flips), int(lost.sum()))


def _lost_bytes(data: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which single bytes get lost: only such as differ from their neighbours, or nobody could say which was."""
    lost = rng.random(len(data)) < LOST_BYTES
    lost[1:] &= data[1:] != data[:-1]
    lost[:-1] &= data[:-1] != data[1:]
    return lost


def _lost_stretches(ends: IntArray, time_s: FloatArray, rng: np.random.Generator, *, outages: bool) -> NDArray[np.bool_]:
    lost = np.zeros(int(ends[-1]), dtype=np.bool_)
    span_s = float(time_s[-1] - time_s[0])
    lengths_s = rng.uniform(0, _STRETCH_S, rng.poisson(_STRETCHES_PER_S * span_s))
    if outages:
        lengths_s = np.append(lengths_s, rng.uniform(0.3, 3.0))
    bytes_per_s = len(lost) / span_s
    for length_s in lengths_s.tolist():
        begin = int(rng.integers(len(lost)))
        lost[begin : begin + 1 + int(length_s * bytes_per_s)] = True
    return lost


def _compare(sent: Samples, got: Samples, intact: NDArray[np.bool_], account: Account) -> None:
    number = {row: place for place, row in enumerate(_rows(sent))}
    found = np.array([number.get(row, -1) for row in _rows(got)])
    decoded = np.zeros(len(sent), dtype=np.bool_)
    decoded[found[found >= 0]] = True
    account.samples_sent, account.samples_decoded = len(sent), len(got)
    account.samples_missed = int(np.count_nonzero(intact & ~decoded))
    account.samples_false = int(np.count_nonzero(found < 0)) + int(np.count_nonzero(np.diff(found[found >= 0]) <= 0))
    known = np.flatnonzero(decoded)
    account.missing = int(known[-1] - known[0] + 1 - len(known)) if len(known) else 0
    account.flagged_estimated = int(np.count_nonzero(got.status & np.uint32(Status.GAP_ESTIMATED | Status.TIME_ESTIMATED)))


def _rows(samples: Samples) -> list[bytes]:
    values = np.ascontiguousarray(np.hstack([samples.accelerometer, samples.gyroscope]))
    return [row.tobytes() for row in values]
