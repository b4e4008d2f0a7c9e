"""The static path: bias from the Earth's rate at any heading, and the latitude checked."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.calibrate.gyroscope.stills_alone import (
    StaticData,
    fit_static,
    latitude_words,
    sees_earth,
)
from imufield.earth import EARTH_RATE_RAD_S
from imufield.samples import FloatArray

pytestmark = pytest.mark.numerical

DEG_PER_HOUR = np.radians(1.0) / 3600
FACES = np.concatenate([np.eye(3), -np.eye(3)])
EDGES = np.array([[a, b, 0.0] for a in (1, -1) for b in (1, -1)])
UP = np.concatenate([FACES, *(np.roll(EDGES, k, axis=1) for k in range(3)), FACES])


def stills(seed: int, seconds: float, latitude_deg: float = 45.0) -> tuple[StaticData, FloatArray, FloatArray]:
    """24 positions at random headings, 0.003 deg/sqrt(h); K E and bias."""
    rng = np.random.default_rng(seed)
    up = UP / np.linalg.norm(UP, axis=1)[:, None]
    north = np.cross(up, rng.standard_normal(up.shape))
    north /= np.linalg.norm(north, axis=1)[:, None]
    latitude = np.radians(latitude_deg)
    rate = EARTH_RATE_RAD_S * (np.sin(latitude) * up + np.cos(latitude) * north)
    M: FloatArray = np.eye(3) + 1e-4 * rng.standard_normal((3, 3))
    bias = 0.01 * DEG_PER_HOUR * rng.standard_normal(3)
    sigma = 0.003 * np.radians(1.0) / 60 / np.sqrt(seconds)
    raw = rate @ M.T + bias + sigma * rng.standard_normal(up.shape)
    time_s: FloatArray = np.asarray(np.arange(len(up)) * (seconds + 10.0))
    return StaticData(raw, sigma**2 * np.eye(3 * len(up)), up, time_s), M, bias


def bias_errors(seconds: float, *, known: bool) -> tuple[FloatArray, FloatArray]:
    errors, over_sigma = [], []
    for seed in range(40):
        data, M, bias = stills(seed, seconds)
        A = np.asarray(np.linalg.inv(M)) if known else np.eye(3)
        fitted = fit_static(data, A, 45.0, "bias" if known else "all")
        assert fitted.converged
        found = np.linalg.solve(fitted.x[:9].reshape(3, 3), fitted.x[9:])
        errors.append((found - bias) / DEG_PER_HOUR)
        covariance = sum(fitted.shares.values(), np.zeros((12, 12)))
        over_sigma.append((found - bias) / np.sqrt(np.diag(covariance)[9:]))
    return np.array(errors), np.array(over_sigma)


def test_bias_with_known_scale_after_10_s() -> None:
    errors, over_sigma = bias_errors(10.0, known=True)
    assert np.sqrt(np.mean(errors**2)) <= 0.02
    assert 0.8 < np.sqrt(np.mean(over_sigma**2)) < 1.25


def test_everything_free_after_60_s() -> None:
    errors, over_sigma = bias_errors(60.0, known=False)
    assert np.sqrt(np.mean(errors**2)) <= 0.03
    assert 0.8 < np.sqrt(np.mean(over_sigma**2)) < 1.25


@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 30.0, 80.0])
def test_any_latitude(latitude_deg: float) -> None:
    data, M, bias = stills(3, 60.0, latitude_deg)
    fitted = fit_static(data, np.asarray(np.linalg.inv(M)), latitude_deg)
    assert np.abs(np.linalg.solve(fitted.x[:9].reshape(3, 3), fitted.x[9:]) - bias).max() < 0.05 * DEG_PER_HOUR


def test_a_wrong_latitude_is_seen() -> None:
    for seed in range(10):
        data, M, _ = stills(seed, 10.0)
        fitted = fit_static(data, np.asarray(np.linalg.inv(M)), 45.5)
        off, right = (latitude_words(deg, fitted.vertical_rad_s, fitted.vertical_sigma_rad_s) for deg in (45.5, 45.0))
        assert [off.key, right.key] == ["stills_alone.latitude_contradicted", "stills_alone.latitude_seen"]
        assert right.values["observed_deg"] == pytest.approx(45.0, abs=0.2)


@pytest.mark.parametrize("latitude_deg", [-90.0, -70.0, 0.0, 48.1, 84.0, 90.0])
@pytest.mark.parametrize("found_deg_h", [-15.4, 0.1, 11.0, 14.9, 15.5])
def test_the_numbers_that_are_told_make_the_contradiction(latitude_deg: float, found_deg_h: float) -> None:
    """A sigma of latitude is none near a pole: 84.0 deg with a sigma of 26 deg does not contradict 48.1 deg."""
    said = latitude_words(latitude_deg, found_deg_h * DEG_PER_HOUR, 0.7 * DEG_PER_HOUR)
    told = said.values
    assert told["found_deg_h"] == pytest.approx(found_deg_h)
    assert told["sigma_deg_h"] == pytest.approx(0.7)
    is_far = abs(told["found_deg_h"] - told["expected_deg_h"]) > 4 * told["sigma_deg_h"]
    assert said.key == ("stills_alone.latitude_contradicted" if is_far else "stills_alone.latitude_seen")


def test_only_fine_instruments_see_the_earth() -> None:
    data, *_ = stills(0, 10.0)
    of_a_still = data.covariance_raw[np.newaxis, :3, :3]
    assert sees_earth(of_a_still, np.eye(3))
    assert not sees_earth(1e4 * of_a_still, np.eye(3))
