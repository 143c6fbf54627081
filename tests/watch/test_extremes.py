"""Decimation by extremes: no peak is lost at any zoom, and memory is bounded."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cfid.watch.extremes import Extremes

BINS = 64


def pyramid(values: np.ndarray, sizes: list[int]) -> Extremes:
    extremes, begin = Extremes(values.shape[1], bins=BINS), 0
    for size in [*sizes, len(values)]:
        part = slice(begin, begin + size)
        extremes.add(np.arange(len(values), dtype=float)[part], values[part])
        begin += size
    return extremes


@given(count=st.integers(1, 3000), sizes=st.lists(st.integers(1, 400), max_size=8), most=st.integers(10, 60))
def test_the_whole_run_has_its_extremes_however_it_arrived(count: int, sizes: list[int], most: int) -> None:
    values = np.random.default_rng(count).normal(size=(count, 2))

    seen = pyramid(values, sizes).view(0.0, count, most)
    time_s, line = seen.zigzag()

    assert np.array_equal(line.min(axis=0), values.min(axis=0))
    assert np.array_equal(line.max(axis=0), values.max(axis=0))
    assert len(time_s) == len(line) <= 2 * (most + 14)  # plus the bins without a partner, one per level
    assert seen.time_s[0] == 0
    assert np.all(np.diff(seen.time_s) > 0)


@given(count=st.integers(500, 3000), begin=st.floats(0, 1), width=st.floats(0.001, 1))
def test_a_peak_within_the_span_is_drawn(count: int, begin: float, width: float) -> None:
    first, last = begin * count, min((begin + width) * count, count - 1.0)
    values = np.full((count, 1), np.nan)  # values that are no numbers hide no others
    place = min(int(np.ceil(first)), count - 1)
    values[place] = 7.0

    seen = pyramid(values, [100] * 30).view(first, max(last, place), 40)

    assert np.nanmax(seen.high) == 7.0


def test_memory_grows_with_the_logarithm_of_the_duration() -> None:
    def levels(seconds: int) -> int:
        extremes, block = Extremes(1, bins=BINS), np.zeros((700, 1))
        for k in range(10 * seconds):
            extremes.add(0.1 * k + np.arange(700) / 7000, block)
        assert len(extremes.view(0, seconds, 50).time_s) <= 50 + 2 + len(extremes._levels)
        return len(extremes._levels)

    assert levels(32) - levels(2) == 4
