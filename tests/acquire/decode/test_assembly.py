"""Blocks of samples without a time: cut, joined, and frames sorted into samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.acquire.decode.assembly import NO_FRAME, RawBlock, frame_table, join


def bus_block(first: int, count: int) -> RawBlock:
    numbers = np.arange(first, first + count)
    return RawBlock(
        accelerometer=np.column_stack([numbers, numbers, numbers]).astype(np.float64),
        gyroscope=np.zeros((count, 3)),
        temperature_degc=numbers.astype(np.float64),
        counter=numbers,
        status=np.zeros(count, dtype=np.uint32),
        stamp_s=np.asarray(numbers * 0.01, dtype=np.float64),
    )


def test_what_a_wire_does_not_have_stays_an_empty_array() -> None:
    joined = join([bus_block(0, 3), bus_block(3, 4)])
    assert len(joined) == 7
    assert joined.counter.tolist() == list(range(7))
    part = joined[np.array([5, 1])]
    assert part.accelerometer[:, 2].tolist() == [5, 1]
    assert part.stamp_s.tolist() == [0.05, 0.01]
    for block in (joined, part, joined[:2]):
        assert len(block.ticks) == len(block.lost_before) == len(block.skipped_before) == len(block.stream_end) == 0
        assert block.stream_end.dtype == np.int64


def test_the_last_frame_given_of_a_kind_stays() -> None:
    kinds, sample, places = np.array([0, 1, 1, 0, 2]), np.array([0, 0, 0, 1, 1]), np.arange(5)
    assert frame_table(kinds, sample, places, shape=(2, 3)).tolist() == [[0, 2, NO_FRAME], [3, NO_FRAME, 4]]
    backwards = frame_table(kinds[::-1], sample[::-1], places[::-1], shape=(2, 3))
    assert backwards.tolist() == [[0, 1, NO_FRAME], [3, NO_FRAME, 4]]


def test_frames_without_temperatures_of_the_axes_have_none_of_them_among_others() -> None:
    with_own = replace(bus_block(3, 2), sensor_temperature_degc=np.full((2, 6), 21.0))
    for blocks, lacking in (([bus_block(0, 3), with_own], slice(0, 3)), ([with_own, bus_block(0, 3)], slice(2, 5))):
        own_degc = join(blocks).sensor_temperature_degc
        assert own_degc.shape == (5, 6)
        assert np.isnan(own_degc[lacking]).all()
        assert np.count_nonzero(own_degc == 21.0) == 12
    assert join([bus_block(0, 3), bus_block(3, 4)]).sensor_temperature_degc.shape == (0,)
