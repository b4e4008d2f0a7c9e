"""What the counts of a decoder do not show is said."""

from __future__ import annotations

import pytest

from imufield.acquire.decode.statistics import DecoderStatistics, remarks


@pytest.mark.parametrize(
    ("nominal_hz", "rate_hz", "sigma", "ratio"),
    [
        (100.0, 200.0, 1e-4, 2.0),
        (100.0, 50.0, 1e-4, 0.5),
        # The worst oscillators are within 5 %, and a short stretch tells little.
        (100.0, 105.0, 1e-4, None),
        (100.0, 200.0, 0.5, None),
        (100.0, None, None, None),
        (None, None, None, None),
    ],
)
def test_a_clock_that_runs_at_another_speed_than_the_computers(
    nominal_hz: float | None, rate_hz: float | None, sigma: float | None, ratio: float | None
) -> None:
    part = DecoderStatistics(samples=1000, nominal_rate_hz=nominal_hz, rate_hz=rate_hz, rate_sigma=sigma)
    said = remarks([part, part])
    assert [float(sentence.values["ratio"]) for sentence in said] == ([] if ratio is None else [ratio])
