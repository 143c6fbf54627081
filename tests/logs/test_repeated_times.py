"""Logs whose rows repeat times: rounded times, several recordings that take turns, or rows that are written twice."""

from pathlib import Path

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.records.logs.repeated_times import refuse_repeated_times

EVERY_2_MS = 0.002 * np.arange(3000)


@pytest.mark.parametrize(("digits", "step"), [(2, "0.01"), (1, "0.1")])
def test_times_that_are_rounded_are_refused_with_their_step_and_the_rate(digits: int, step: str) -> None:
    with pytest.raises(DataError, match=rf"rounded to {step} s, .* `rate_hz` \(50\d"):
        refuse_repeated_times(Path("log"), np.floor(EVERY_2_MS * 10**digits) / 10**digits)


def test_recordings_that_take_turns_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="Where several recordings take turns, write the rows of each into a file"):
        refuse_repeated_times(tmp_path, np.repeat(EVERY_2_MS, 2))


def test_rows_that_were_written_twice_are_named_where_they_are_many(tmp_path: Path) -> None:
    rows = np.random.default_rng(1).integers(1, 4, len(EVERY_2_MS)) ** 2
    with pytest.raises(DataError, match="Delete rows that were written twice"):
        refuse_repeated_times(tmp_path, np.repeat(EVERY_2_MS, rows))
    refuse_repeated_times(tmp_path, np.repeat(EVERY_2_MS, np.where(np.arange(len(EVERY_2_MS)) % 20, 1, 2)))
