"""Rows of observations, and copies among them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imufield.calibrate.model.observation_files import parse_observations
from imufield.calibrate.model.observations import Observations, count_repeats_once
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
