"""Arrays larger than the memory: arrays on disk contain the same numbers, and a full disk is reported."""

import tempfile

import numpy as np
import pytest

from cfid.errors import ConfigError
from cfid.large import chosen_rows, differences, empty, joined, side_by_side, stored, usual_step

ROWS = 5_000_000  # 40 MB, too large to stay in memory


def test_blocks_are_joined_whether_they_stay_in_memory_or_not() -> None:
    for rows in (10, ROWS):
        blocks = np.split(np.arange(2.0 * rows).reshape(rows, 2), [3, 7])
        found = joined(iter(blocks))
        assert found.shape == (rows, 2)
        assert np.array_equal(found, np.arange(2.0 * rows).reshape(rows, 2))


def test_a_large_array_holds_what_is_written_to_it() -> None:
    array = empty(ROWS)
    array[:] = 3.0
    array[-1] = 4.0
    assert array.sum() == 3.0 * ROWS + 1


@pytest.mark.parametrize("rows", [10, ROWS])
def test_what_is_stored_is_what_was_given(rows: int) -> None:
    value = np.arange(2.0 * rows).reshape(rows, 2)
    assert np.array_equal(stored(value), value)
    assert np.array_equal(side_by_side([value[:, 0], value[:, 1]]), value)
    assert np.array_equal(side_by_side([value[:, 0]]), value[:, :1])
    assert chosen_rows(value, np.ones(rows, bool)) is value
    assert np.array_equal(chosen_rows(value, np.arange(rows) % 3 > 0), value[np.arange(rows) % 3 > 0])


def test_the_usual_step_of_a_long_series_is_that_of_its_parts() -> None:
    time_s = np.repeat(np.arange(ROWS // 5) * 0.005, 5)  # repeated timestamps
    assert usual_step(time_s) == pytest.approx(0.005)
    assert sum(len(step) for _, step in differences(time_s)) == ROWS - 1


def test_no_room_for_a_large_array_is_an_error_that_names_the_folder() -> None:
    before, tempfile.tempdir = tempfile.tempdir, "/dev/full"
    try:
        with pytest.raises(ConfigError, match=r"/dev/full: no room for the numbers .* TMPDIR"):
            empty(ROWS)
    finally:
        tempfile.tempdir = before
