"""What a cell says: a date, a time of day, or neither."""

from __future__ import annotations

import pytest

from imufield.acquire.formats.table_cells import seconds_of_date


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1970-01-01T00:01:00.250Z", 60.25),
        ("1970-01-01 02:01:00.250+02:00", 60.25),
        ("1970/01/01 00:01:00,250", 60.25),
        ("01-Jan-1970 00:01:00.250", 60.25),
        ("02.01.1970 00:01:00,250", 86460.25),
        ("2.1.1970 0:01:00.250", 86460.25),
        ("1970.1.2 00:01:00.5", 86460.5),
        ("1970/1/2 1:01:00.5-2:00", 97260.5),
        ("1970/01/02T00:01:00.5Z", 86460.5),
        ("2.1.1970T0:01:00", 86460.0),
        ("02/Jan/1970 00:01:00", 86460.0),
        ("1970-W01-5", 86400.0),
        ("1-Jan-1970 0:01:00.5", 60.5),
        ("00:01:00.25", 60.25),
        ("0:01:00.25", 60.25),
        ("1:00.5", 60.5),
        ("13:00:00", 46800.0),
        ("13:00:00+01:00", 43200.0),
        # As Excel shows minutes and seconds.
        ("12:13.010", 733.01),
        ("01-Jan-1970 00:01:00", 60.0),
    ],
)
def test_dates_are_seconds(text: str, seconds: float) -> None:
    assert seconds_of_date(text) == pytest.approx(seconds, abs=1e-6)


@pytest.mark.parametrize("text", ["", "yesterday", "03/04/2023 11:12:13", "25:00:00", "-"])
def test_what_is_no_date_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        seconds_of_date(text)
