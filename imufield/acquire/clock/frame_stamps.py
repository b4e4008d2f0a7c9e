"""The time stamps that an adapter or the kernel gives to frames, without the jumps of the clock that made them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.clock.clock import filled_in
from imufield.acquire.clock.stamp_clock import LONGEST_PAUSE_S, steps_between
from imufield.samples import FloatArray

_RESET_S = 1.0  # A stamp that runs back by more is another clock (the adapter's wrapped), by less frames out of order.


class FrameStamps:
    """Makes one continuous time of the stamps of frames."""

    def __init__(self) -> None:
        self._offset_s = 0.0
        self._last_s: float | None = None
        self._step_s = 0.0  # The last step of the stamps that was no jump.

    def continuous(self, stamp_s: FloatArray) -> tuple[FloatArray, NDArray[np.bool_] | None]:
        """Return the next n stamps without jumps, and where the clock was set: shape (n,) each, None where all are steady."""
        if self._last_s is None:
            self._last_s = float(stamp_s[0])
        step_s = steps_between(stamp_s, self._last_s)
        self._last_s = float(stamp_s[-1])
        before_s, self._step_s = self._step_s, max(float(step_s[-1]), 0.0)
        # A NaN counts as the least and as the most.
        if step_s[step_s.argmin()] >= -_RESET_S and step_s[step_s.argmax()] <= LONGEST_PAUSE_S:
            return stamp_s + self._offset_s if self._offset_s else stamp_s, None
        jumps = ~((step_s >= -_RESET_S) & (step_s <= LONGEST_PAUSE_S))
        # A stamp that is no number is bridged and tells of no clock.
        is_set = jumps & np.isfinite(step_s)
        step_s = np.where(np.isfinite(step_s), step_s, 0.0)
        # The last step that was none takes the place of a jump: it is the same in whatever pieces the frames come.
        usual_s = filled_in(np.maximum(step_s, 0.0), ~jumps, before_s, 0.0)
        self._step_s = float(usual_s[-1])
        moved_s = np.where(jumps, usual_s - step_s, 0.0)
        offset_s: FloatArray = np.cumsum(np.append(self._offset_s, moved_s))[1:]
        self._offset_s = float(offset_s[-1])
        return np.nan_to_num(stamp_s) + offset_s, is_set
