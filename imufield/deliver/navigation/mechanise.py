"""Strapdown mechanisation over hours in bounded memory: the adapter of python-ins.

The integrator of python-ins keeps every step of attitude, so it is given pieces, each continued by a new one. In
between the attitude goes through roll, pitch and heading, which are singular at a pitch of 90 degrees; so the samples are
turned into a body frame that is level and heads north at the start, whatever way the instrument lies. The vertical channel is
off: it diverges by kilometres an hour.

Angular rate and specific force are taken as linear between samples. At rest that holds over gaps of lost samples too.
"""

from __future__ import annotations

import warnings
from functools import cache
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from imufield.deliver.navigation.drift import Drift
from imufield.errors import Reason, RecordingError, load_package
from imufield.samples import FloatArray
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from pandas import DataFrame

sentence = Sentences(__package__)

PIECE = 16384
"""Samples integrated at once: less makes more tables, more makes them larger."""
OUTPUT_INTERVAL_S = 1.0  # A Schuler oscillation takes 84 minutes: a second shows all of it.
_COLUMNS = ("lat", "lon", "VN", "VE")  # Of a trajectory of python-ins, in the order of ``Drift``.


@cache
def load_pyins() -> SimpleNamespace:
    """Return the modules of python-ins in use, as ``earth``, ``strapdown``, ``transform``, ``util`` and ``pandas``.

    Raises
    ------
    UsageError
        If it is not installed.
    """
    names = {"pandas": "pandas"} | {name: f"pyins.{name}" for name in ("earth", "strapdown", "transform", "util")}
    return SimpleNamespace(**{name: load_package(module, "navigation", "nav", "python-ins") for name, module in names.items()})


def integrate(state: FloatArray, start_s: float, increments: DataFrame) -> DataFrame:
    """Return the trajectory that increments make, both tables of python-ins; the vertical channel is off.

    Parameters
    ----------
    state : ndarray, shape (9,)
        Latitude, longitude (deg), height, velocity (north, east, down), roll, pitch and heading (deg).
    start_s : float
    increments : pandas.DataFrame
    """
    modules = load_pyins()
    start = modules.pandas.Series(state, index=modules.util.TRAJECTORY_COLS, name=start_s)
    with warnings.catch_warnings():
        # python-ins 1.0 uses a keyword that newer pandas does without.
        warnings.filterwarnings("ignore", "The copy keyword", DeprecationWarning)
        return modules.strapdown.Integrator(start, with_altitude=False).integrate(increments)


class Mechanisation:
    """Navigates from a known place at rest, sample by sample.

    Parameters
    ----------
    attitude : ndarray, shape (3, 3)
        C_nb at ``start_s``.
    start_s : float
    latitude_deg, height_m : float
    """

    def __init__(self, attitude: FloatArray, start_s: float, latitude_deg: float, height_m: float) -> None:
        self._pyins = load_pyins()
        self._level = attitude
        self._start_s = start_s
        self._latitude_deg = latitude_deg
        self._state = np.array([latitude_deg, 0.0, height_m, 0, 0, 0, 0, 0, 0])
        self._waiting: list[FloatArray] = []
        self._count = 0
        self._last = np.empty((0, 7))
        self._rows: list[FloatArray] = []
        self._attitudes: list[FloatArray] = []

    def feed(self, time_s: FloatArray, force: FloatArray, rate: FloatArray) -> None:
        """Take corrected samples of rising time, shape (n,), (n, 3), (n, 3), m/s^2 and rad/s."""
        self._waiting.append(np.column_stack([time_s, rate @ self._level.T, force @ self._level.T]))
        self._count += len(time_s)
        if self._count >= PIECE:
            self._integrate()

    def finish(self) -> None:
        """Integrate what is left."""
        self._integrate()

    @property
    def drift(self) -> Drift:
        """Errors so far, about once a second; from the start, where they are zero."""
        # At the start every error is zero, and the latitude the true one.
        rows = np.concatenate([np.zeros((1, 5)), *self._rows])
        rows[0, 1] = self._latitude_deg
        return Drift(
            time_s=rows[:, 0],
            latitude_deg=rows[:, 1] - self._latitude_deg,
            longitude_deg=rows[:, 2],
            north_velocity_m_s=rows[:, 3],
            east_velocity_m_s=rows[:, 4],
            true_latitude_deg=self._latitude_deg,
        )

    @property
    def attitudes(self) -> FloatArray:
        """C_nb at the times of ``drift``, shape (n, 3, 3)."""
        return np.asarray(np.concatenate([np.eye(3)[None], *self._attitudes]) @ self._level)

    def _integrate(self) -> None:
        if not self._count:
            return
        rows = np.concatenate([self._last, *self._waiting])
        self._waiting, self._count = [], 0
        # The next piece begins with the last sample of this one: increments are between samples.
        self._last = rows[-1:]
        if len(rows) < 2:
            return
        pandas, util = self._pyins.pandas, self._pyins.util
        imu = pandas.DataFrame(rows[:, 1:], index=rows[:, 0], columns=[*util.GYRO_COLS, *util.ACCEL_COLS])
        increments = self._pyins.strapdown.compute_increments_from_imu(imu, "rate")
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                trajectory = integrate(self._state, rows[0, 0], increments)
        except np.linalg.LinAlgError as error:
            raise RecordingError(sentence("mechanise.diverged"), Reason.NOT_FINITE) from error
        self._state = trajectory.iloc[-1].to_numpy()
        # The first row of each second is kept.
        time_s = trajectory.index.to_numpy() - self._start_s
        slot = np.floor(time_s / OUTPUT_INTERVAL_S)
        first = np.flatnonzero(np.diff(slot) > 0) + 1
        chosen = trajectory.iloc[first]
        self._rows.append(np.column_stack([time_s[first], chosen[list(_COLUMNS)].to_numpy()]))
        self._attitudes.append(self._pyins.transform.mat_from_rph(chosen[util.RPH_COLS].to_numpy()).reshape(-1, 3, 3))
