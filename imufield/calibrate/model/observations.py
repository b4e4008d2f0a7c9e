"""Observations: what was measured at each position, the only input of the solvers."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from imufield.dataclass import dataclass, fields, replace
from imufield.errors import UsageError
from imufield.samples import FloatArray, SampleUnits
from imufield.sentences import Sentences

sentence = Sentences(__package__)

ROUNDING = 1 / math.sqrt(12)
"""1 sigma over a step of an output that was rounded: the value may be anywhere within it."""

_SHARED = 0.99  # Of the variance of rounding to one code: the values that it hides are not quite the same.
_NO_STEP = 1e-100  # Of any unit; what noise leaves of a rounding may be less.


@dataclass(frozen=True, slots=True, kw_only=True)
class Observations:
    """m observations.

    Attributes
    ----------
    name : tuple of str, length m
    mean_raw : ndarray, shape (m, 3)
        Mean accelerometer output as rate, raw unit.
    covariance_raw : ndarray, shape (m, 3, 3)
        Covariance of that mean, autocorrelation allowed for.
    gyroscope_mean_raw : ndarray, shape (m, 3)
        NaN where there is no gyroscope.
    gyroscope_covariance_raw : ndarray, shape (m, 3, 3)
    gyroscope_rounding_raw : ndarray, shape (m, 3)
        1 sigma of what rounding of the output leaves in that mean; in its covariance too.
    gyroscope_noise_raw : ndarray, shape (m, 3)
        White noise of its output per sqrt(Hz), where the covariance of the mean is that of a hand; else NaN.
    direction : ndarray, shape (m, 3)
        Planned direction of "up" in the body frame (unit vector); NaN where no position was planned.
    start_s, duration_s, temperature_degc : ndarray, shape (m,)
        Sample clock; NaN where not known.
    middle_s : ndarray, shape (m,)
        Of a unit in the hand, which sways: the time that moves begin and end at. NaN for one that lies still.
    middle_rad : ndarray, shape (m, 3)
        Turn from the attitude that the mean is of to that at ``middle_s``, rotation vector.
    units : SampleUnits
    left_out : tuple of str
        Names of those that were left out by name.
    """

    name: tuple[str, ...]
    mean_raw: FloatArray
    covariance_raw: FloatArray
    gyroscope_mean_raw: FloatArray
    gyroscope_covariance_raw: FloatArray
    gyroscope_rounding_raw: FloatArray
    gyroscope_noise_raw: FloatArray
    direction: FloatArray
    start_s: FloatArray
    duration_s: FloatArray
    middle_s: FloatArray
    middle_rad: FloatArray
    temperature_degc: FloatArray
    units: SampleUnits
    left_out: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.name)

    def __getitem__(self, rows: NDArray[np.bool_]) -> Observations:
        name = tuple(name for name, kept in zip(self.name, rows, strict=True) if kept)
        arrays = {array: getattr(self, array)[rows] for array in _ARRAYS}
        return Observations(name=name, units=self.units, left_out=self.left_out, **arrays)

    @property
    def gyroscope_unrounded_covariance(self) -> FloatArray:
        """The covariance of each gyroscope mean without what rounding leaves in it, shape (m, 3, 3)."""
        return np.asarray(self.gyroscope_covariance_raw - self.gyroscope_rounding_raw[:, :, None] ** 2 * np.eye(3))

    def gyroscope_rounding(self) -> FloatArray:
        """Return the covariance of what rounding leaves in the gyroscope means, shape (3 m, 3 m).

        A gyroscope at rest reads nearly the same in all positions, and what is read alike is rounded alike: one error for all.
        A step further the error is another. An accelerometer is turned, and reads another value in each position.
        """
        rounding, mean = self.gyroscope_rounding_raw, self.gyroscope_mean_raw.T
        step = np.maximum(rounding.max(axis=0, initial=0.0) / ROUNDING, _NO_STEP)
        # Positive definite whatever the means are. One size for all: by sizes that differ, weights would cancel the error.
        alike = np.maximum(1 - np.abs(mean[:, :, None] - mean[:, None]) / step[:, None, None], 0.0)
        alike = np.where(np.eye(len(self)), 1.0, _SHARED * alike) * np.mean(rounding**2, axis=0)[:, None, None]
        return np.asarray(np.einsum("kij,kl->ikjl", alike, np.eye(3)).reshape(3 * len(self), -1))


_ARRAYS = tuple(field.name for field in fields(Observations) if field.name not in ("name", "units", "left_out"))


def join_observations(first: Observations, second: Observations) -> Observations:
    """Return the rows of both, of the same units."""
    joined = {array: np.concatenate([getattr(first, array), getattr(second, array)]) for array in _ARRAYS}
    name, left_out = (*first.name, *second.name), (*first.left_out, *second.left_out)
    return Observations(name=name, units=first.units, left_out=left_out, **joined)


def leave_out(
    observations: Observations, names: Collection[str], *, may_lack: bool = False
) -> tuple[Observations, Observations]:
    """Return the observations without those of some names, and those; "free 3" names "free 3: near +x".

    Raises
    ------
    UsageError
        If there is no observation of a name, which may be one of another session where it ``may_lack``.
    """
    if not may_lack:
        require_named(observations.name, names)
    meant = [each for name in names for each in _named(observations.name, name)]
    out = np.array([name in meant for name in observations.name], dtype=np.bool_)
    return replace(observations[~out], left_out=(*observations.left_out, *meant)), observations[out]


def require_named(known: Iterable[str], names: Collection[str]) -> None:
    """Raise ``UsageError`` where one of the names is that of no position that is known."""
    known = list(dict.fromkeys(known))
    for name in names:
        if not _named(known, name):
            raise UsageError(sentence("observations.not_there", name=name, known=known), names=known)


def _named(known: Sequence[str], name: str) -> list[str]:
    # The name itself goes first.
    return [each for each in known if each == name] or [each for each in known if each.startswith(f"{name}: near ")]


def count_repeats_once(observations: Observations) -> tuple[Observations, tuple[str, ...]]:
    """Return the observations without those that repeat the numbers of an earlier one, and a sentence if there were any.

    Two means of a real sensor do not agree to the last digit in three axes: the second is a copy, and as evidence of its own
    would make every uncertainty too small.
    """
    numbers = np.hstack([observations.mean_raw, observations.gyroscope_mean_raw])
    # NaN where there is no gyroscope: the same in every row.
    _, first, group = np.unique(np.nan_to_num(numbers), axis=0, return_index=True, return_inverse=True)
    original = first[group.ravel()]
    # The first of equal rows stays.
    new = original == np.arange(len(observations))
    if new.all():
        return observations, ()
    names = observations.name
    pairs = [f"{names[row]} is {names[original[row]]}" for row in np.flatnonzero(~new)]
    return observations[new], (sentence("observations.repeated", count=len(pairs), rows=len(new), pairs=pairs),)
