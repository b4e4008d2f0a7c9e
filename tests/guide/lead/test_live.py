"""The feed that live pictures are drawn from."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from imufield.guide.lead.guide import Guide
from imufield.guide.lead.live import SPAN_S, LiveFeed
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import Samples, SampleUnits, Status, concatenate
from tests.guide.guided import cells_of

SI = RoughScale(accelerometer=1.0, gyroscope=1.0)


def feed_of(*blocks: Samples) -> LiveFeed:
    feed = LiveFeed()
    for cells in cells_of(blocks):
        feed.add(cells)
    return feed


def test_it_holds_the_last_half_minute_however_it_was_cut(
    make_path: Any, cut_blocks: Callable[[Samples, Iterable[int]], Iterator[Samples]]
) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 50).turn([1, 0, 0], 1).hold([1, 0, 0], 9).samples()
    signals = feed_of(*cut_blocks(samples, [7] * 800)).signals(SI)
    whole = feed_of(samples).signals(SI)
    assert signals is not None
    assert whole is not None
    assert len(signals.age_s) == len(whole.age_s) == 300
    assert 0.0 == signals.age_s[-1] < signals.age_s[0] < SPAN_S
    newest = np.hstack([samples.accelerometer[-10:], samples.gyroscope[-10:]])
    for found in (signals, whole):
        np.testing.assert_allclose(found.mean[-1], newest.mean(axis=0))
        np.testing.assert_allclose(found.low[-1], newest.min(axis=0))
        np.testing.assert_allclose(found.high[-1], newest.max(axis=0))
    assert signals.units == ("m/s^2", "rad/s")
    feed = feed_of(samples)
    feed.hear(samples)
    np.testing.assert_allclose(feed.up(SI), [1, 0, 0], atol=0.01)


def test_up_is_the_same_of_increments(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0.6, 0.8], 2).samples()
    increments = replace(
        samples,
        accelerometer=samples.accelerometer / 100.0,
        units=SampleUnits("m/s", "rad/s", accelerometer_is_increment=True, interval_s=0.01),
    )
    # The offset of an instrument, as the guide has found it.
    scale = replace(SI, raw_zero=np.array([1.5, 0.0, 0.0]))
    ups = []
    for block in (samples, increments):
        feed = LiveFeed()
        feed.hear(block)
        ups.append(feed.up(scale))
    np.testing.assert_allclose(ups[1], ups[0])


def test_it_has_the_units_that_are_known(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 2).samples(scale=(100.0, 7.0), raw_zero=30.0)
    signals = feed_of(samples).signals(RoughScale(accelerometer=100.0, gyroscope=None, raw_zero=np.full(3, 30.0)))
    assert signals is not None
    assert signals.units == ("m/s^2", "raw unit")
    assert signals.mean[-1, 2] == pytest.approx(9.8, abs=0.05)
    assert signals.mean[-1, 3] == pytest.approx(0.014, abs=0.05)


def test_nothing_is_shown_before_the_first_sample_and_before_a_scale(make_path: Any) -> None:
    guide = Guide(scheme("faces6"), SampleUnits("count", "count"), settings=GuideSettings())
    assert guide.snapshot().signals is None
    assert guide.snapshot().direction is None
    guide.feed(make_path(100.0).hold([0, 0, 1], 1).samples())
    now = guide.snapshot()
    assert now.direction is None
    assert now.signals is not None
    assert now.signals.units == ("raw unit", "raw unit")


def test_missing_samples_leave_a_gap_and_a_clock_set_back_no_future(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 10).samples()
    gap = feed_of(concatenate([samples[:300], samples[700:]])).signals(SI)
    assert gap is not None
    np.testing.assert_allclose(np.diff(gap.age_s).min(), -4.1)
    earlier = feed_of(samples[700:], samples[:100]).signals(SI)
    assert earlier is not None
    assert len(earlier.age_s) == 10


def test_what_an_instrument_sends_before_it_is_ready_makes_no_scale(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 3).samples()
    samples.status[:55] |= np.uint32(Status.START_UP)
    samples.gyroscope[:55] = 8.4
    signals = feed_of(samples).signals(SI)
    assert signals is not None
    assert np.isnan(signals.high[:6]).all()
    assert np.nanmax(signals.high[:, 3:]) < 0.1
    assert np.isfinite(signals.low[6:]).all()
