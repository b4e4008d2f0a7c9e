"""Random and mutated bytes for every driver: a sample, a skip or a typed error, never another exception, never more memory.

Each driver gets the same rounds on every machine, and more of them for ``IMUFIELD_FUZZ_S`` seconds; ``make fuzz`` gives 60.
The rounds are seeded, so what one run finds the next one finds again.
"""

from __future__ import annotations

import itertools
import math
import os
import sys
import time
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.registry import load_driver, shipped_names
from imufield.errors import ProtocolError
from imufield.samples import Samples
from imufield.simulate.wire.can_frames import CanEncoder
from tests.acquire.plain_frames import pack_frames
from tests.simulate.accounting import random_samples, serial_wires

SECONDS = float(os.environ.get("IMUFIELD_FUZZ_S", "0"))
ROUNDS = 1
"""Behind the first one, after which memory is looked at."""
SAMPLES = 40
EXAMPLES_PER_ROUND = 25
GROWTH_LIMIT_MB = 160.0
"""Of the process over all rounds of one driver: tables for the longest frames (16 KiB) take up to 84 MB while they are made."""

Stream = tuple[Protocol, bytes]


@cache
def streams(name: str) -> list[Stream]:
    """Return protocol and good bytes of each form of a driver."""
    driver = load_driver(name)
    if driver.wire == "can":
        protocol = driver.load_protocol()
        samples = random_samples(protocol, 100.0, 0, SAMPLES)
        return [(protocol, pack_frames(CanEncoder(protocol).encode(samples)))]
    found = []
    for wire in serial_wires():
        if wire.driver == name:
            choice = wire.choose()
            samples = random_samples(choice.protocol, choice.rate_hz, 0, SAMPLES)
            found.append((choice.protocol, wire.device().encode(samples).data.tobytes()))
    return found


PLACE = st.integers(0, 1 << 16)
MUTATIONS = st.lists(
    st.tuples(
        st.sampled_from(["flip", "drop", "double", "insert", "cut", "set"]), PLACE, st.integers(1, 255), st.binary(max_size=40)
    ),
    max_size=12,
)


def mutate(data: bytes, mutations: list[tuple[str, int, int, bytes]]) -> bytes:
    for kind, place, number, some in mutations:
        at = place % (len(data) + 1)
        if kind == "flip" and at < len(data):
            data = data[:at] + bytes([data[at] ^ number]) + data[at + 1 :]
        elif kind == "drop":
            data = data[:at] + data[at + number :]
        elif kind == "double":
            data = data[:at] + data[at : at + number] + data[at:]
        elif kind == "insert":
            data = data[:at] + some + data[at:]
        elif kind == "set":
            data = data[:at] + bytes([number]) * len(some) + data[at + len(some) :]
        else:
            data = data[:at]
    return data


def feed(decoder: Decoder, data: bytes, cuts: list[int], arrival_s: float) -> int:
    """Feed in parts; count what comes out, check its form, let typed errors pass."""
    edges = sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    count = 0
    try:
        for begin, end in itertools.pairwise(edges):
            count += check(decoder.feed(data[begin:end], arrival_s + begin * 1e-5))
        count += check(decoder.flush())
    except ProtocolError:
        pass
    decoder.messages()
    return count


def check(samples: Samples) -> int:
    n = len(samples)
    assert samples.accelerometer.shape == samples.gyroscope.shape == (n, 3)
    assert len(samples.status) == len(samples.counter) == len(samples.temperature_degc) == n
    assert np.isfinite(samples.time_s).all()
    assert (np.diff(samples.time_s) >= 0).all()
    return n


def peak_mb() -> float:
    """Return the largest memory the process ever had; 0 on Windows, which has no ``resource`` to tell it."""
    if sys.platform == "win32":
        return 0.0
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024.0 if sys.platform != "darwin" else 1048576.0)


@pytest.mark.timeout(max(1200, 3 * SECONDS))
@pytest.mark.parametrize("name", shipped_names())
def test_any_bytes_give_samples_or_typed_errors(name: str) -> None:
    known = streams(name)
    arrivals = itertools.count()
    lasting = {id(protocol): Decoder(protocol) for protocol, _ in known}

    @given(st.sampled_from(range(len(known))), MUTATIONS, st.binary(max_size=300), st.lists(PLACE, max_size=6))
    @settings(
        max_examples=EXAMPLES_PER_ROUND,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        # Without shrinking, which takes minutes: the seeds find the same again.
        phases=(Phase.generate,),
    )
    def one_round(which: int, mutations: list[tuple[str, int, int, bytes]], noise: bytes, cuts: list[int]) -> None:
        protocol, good = known[which]
        data = mutate(good, mutations) + noise
        feed(Decoder(protocol), data, cuts, math.nan)
        # One that has seen everything before: its clock, its shapes and its unfinished frame are whatever they have become.
        try:
            lasting[id(protocol)].feed(data, 0.01 * next(arrivals))
        except ProtocolError:
            lasting[id(protocol)] = Decoder(protocol)

    assert feed(Decoder(known[0][0]), known[0][1], [], math.nan) == SAMPLES
    end_s = time.monotonic() + SECONDS
    seed(0)(one_round)()
    before_mb = peak_mb()
    for number in itertools.count(1):
        if number > ROUNDS and time.monotonic() > end_s:
            break
        seed(number)(one_round)()
    assert peak_mb() - before_mb < GROWTH_LIMIT_MB
