"""What is collected beside a replay is what would be collected in it."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from imufield.pipeline.reading import Beside
from imufield.samples import Samples, SampleUnits, make_samples


def block(number: int) -> Samples:
    return make_samples(np.full(3, float(number)), np.zeros((3, 3)), units=SampleUnits())


def test_every_block_comes_once_in_order_and_from_another_thread() -> None:
    heard: list[tuple[float, bool]] = []

    def listen(samples: Samples) -> None:
        heard.append((float(samples.time_s[0]), threading.current_thread() is threading.main_thread()))

    with ThreadPoolExecutor(1) as threads:
        beside = Beside(listen, threads)
        beside.wait()
        for number in range(20):
            beside.feed(block(number))
        beside.wait()
        assert heard == [(float(number), False) for number in range(20)]


def test_what_the_listener_raises_is_raised_at_the_next_block() -> None:
    def refuse(samples: Samples) -> None:
        raise ValueError(f"block {samples.time_s[0]:g}")

    with ThreadPoolExecutor(1) as threads:
        beside = Beside(refuse, threads)
        beside.feed(block(1))
        with pytest.raises(ValueError, match="block 1"):
            beside.feed(block(2))
