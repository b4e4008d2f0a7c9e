"""The six signals as strips of characters."""

import numpy as np
import pytest

from imufield.guide.lead.live import Signals
from imufield.guide.view.traces import draw_signals, signals_title


def signals(values: object, *, missing: tuple[int, ...] = (), blocks: int = 300) -> Signals:
    mean = np.tile(np.asarray(values, dtype=float), (blocks, 1))
    mean[:, list(missing)] = np.nan
    age_s = np.arange(float(blocks))[::-1] / 10
    return Signals(newest_s=0.0, age_s=age_s, mean=mean, low=mean - 0.01, high=mean + 0.01, units=("m/s^2", "rad/s"))


@pytest.mark.parametrize("ascii_only", [False, True])
@pytest.mark.parametrize(("width", "height"), [(60, 12), (116, 18), (300, 24)])
def test_the_strips_fit_and_name_every_signal_with_its_value(width: int, height: int, ascii_only: bool) -> None:
    lines = draw_signals(signals([0, 0, 9.81, 0.1, 0, 0]), width, height, ascii_only=ascii_only)
    assert len(lines) == height
    assert max(map(len, lines)) <= width
    assert not ascii_only or all(line.isascii() for line in lines)
    rows = height // 6
    assert [line[:6].rstrip() for line in lines[::rows]] == ["acc x", "acc y", "acc z", "gyro x", "gyro y", "gyro z"]
    assert lines[3 * rows - 1].startswith("+9.81")
    assert lines[4 * rows - 1].startswith("+5.73")


def test_a_rest_is_a_flat_line_and_a_step_is_joined() -> None:
    still = draw_signals(signals([0.0] * 6), 48, 6, ascii_only=True)
    assert [line[9:39].strip() for line in still] == ["." * 30] * 6
    step = signals([0.0] * 6)
    step.mean[150:, 0] = step.low[150:, 0] = step.high[150:, 0] = 5.0
    drawn = [line[9:39] for line in draw_signals(step, 48, 24, ascii_only=True)[:4]]
    assert drawn[0].strip() == "." * len(drawn[0].strip())
    assert all("." in line for line in drawn)
    assert drawn[3].rstrip().endswith(".")
    assert drawn[0].index(".") <= len(drawn[3].rstrip())


def test_a_signal_that_does_not_exist_has_no_strip_and_others_its_room() -> None:
    lines = draw_signals(signals([0, 0, 9.81, 0, 0, 0], missing=(3, 4, 5)), 60, 12)
    assert len(lines) == 12
    assert [line[:5] for line in lines[::4]] == ["acc x", "acc y", "acc z"]
    assert draw_signals(signals([0.0] * 6, missing=(0, 1, 2, 3, 4, 5)), 60, 12) == []


def test_the_heading_names_the_units() -> None:
    assert "deg/s" in signals_title(signals([0.0] * 6))
    assert "raw" not in signals_title(None)


def test_few_blocks_stand_at_the_right_end() -> None:
    line = draw_signals(signals([0.0] * 6, blocks=10), 60, 6, ascii_only=True)[0][9:-9]
    assert line.rstrip() == line
    assert line.strip() == "." * len(line.strip())
    assert len(line.strip()) <= 2
