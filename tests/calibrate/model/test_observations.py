"""Rows of observations, and copies among them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imufield.calibrate.model.observation_files import parse_observations
from imufield.calibrate.model.observations import Observations, count_repeats_once
from imufield.dataclass import replace
from imufield.sentences import Sentence


def observations(rows: str) -> Observations:
    return parse_observations(rows.encode(), Path("means.csv"))


def test_some_rows_are_observations_again() -> None:
    whole = observations("name,ax,ay,az,sigma_ax,sigma_ay,sigma_az\na,1,2,3,1,1,1\nb,4,5,6,2,2,2\nc,7,8,9,3,3,3\n")
    some = whole[np.array([True, False, True])]
    assert some.name == ("a", "c")
    assert len(some) == 2
    assert some.mean_raw.tolist() == [[1, 2, 3], [7, 8, 9]]
    assert some.covariance_raw[1].diagonal().tolist() == [9, 9, 9]


def test_a_copy_counts_once_and_is_said() -> None:
    whole = observations("name,ax,ay,az\na,1,2,3\nb,4,5,6\nc,1,2,3\nd,1,2,3.5\ne,4,5,6\n")
    once, sentences = count_repeats_once(whole)
    assert once.name == ("a", "b", "d")
    (said,) = sentences
    assert isinstance(said, Sentence)
    assert said.key == "observations.repeated"
    assert said.values == {"count": 2, "rows": 5, "pairs": ["c is a", "e is b"]}


def test_where_only_the_gyroscope_differs_it_is_no_copy() -> None:
    whole = observations("ax,ay,az,gx,gy,gz\n1,2,3,0,0,1\n1,2,3,0,0,2\n")
    once, sentences = count_repeats_once(whole)
    assert len(once) == 2
    assert sentences == ()


def test_stills_that_read_alike_share_the_error_of_their_code() -> None:
    """Of a step of 0.5: the first two are one code, the third lies half a step off, the fourth is far away."""
    whole = observations("ax,ay,az,gx,gy,gz\n1,2,3,7,0,0\n2,3,1,7,0,0\n3,1,2,7.25,0,0\n3,2,1,9,0,0\n")
    rounding = np.zeros((4, 3))
    rounding[:, 0] = 0.5 / np.sqrt(12)
    coarse = replace(whole, gyroscope_rounding_raw=rounding, gyroscope_covariance_raw=np.tile(np.eye(3), (4, 1, 1)))
    found = coarse.gyroscope_rounding()
    shares = found[::3, ::3] * 12 / 0.25
    wanted = np.array([[1, 0.99, 0.495, 0], [0.99, 1, 0.495, 0], [0.495, 0.495, 1, 0], [0, 0, 0, 1]])
    assert shares == pytest.approx(wanted, abs=1e-12)
    assert np.count_nonzero(found) == np.count_nonzero(shares)
    assert coarse.gyroscope_unrounded_covariance[:, 0, 0] == pytest.approx(1 - 0.25 / 12)
    assert not whole.gyroscope_rounding().any()
