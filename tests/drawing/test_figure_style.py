"""Features that all figures share: lines of any length, unchanged words, one page."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cfid.drawing.numbers import plus_minus
from cfid.drawing.style import thinned


@given(count=st.integers(1, 30_000), seed=st.integers(0, 9))
@settings(max_examples=30, deadline=None)
def test_a_thinned_line_keeps_its_ends_and_every_extreme(count: int, seed: int) -> None:
    time = np.arange(float(count))
    value = np.random.default_rng(seed).standard_normal(count).cumsum()
    x, y = thinned(time, value)
    assert len(x) <= 4002
    assert (x[0], x[-1]) == (0.0, count - 1.0)
    assert np.array_equal(y, value[x.astype(int)])
    assert np.all(np.diff(x) > 0)
    assert (y.min(), y.max()) == (value.min(), value.max())


@pytest.mark.parametrize(
    ("value", "std", "written"),
    [
        (206.99911, 0.00065, "206.99911 ± 0.00065"),
        (-0.045, 0.0048, "−0.0450 ± 0.0048"),
        (64.03, 1.25, "64.0 ± 1.2"),
        (1234.5, 150.0, "1234 ± 150"),
        (2.06999371234, 6.1e-9, "2.06999 ± 6e−09"),
        (7.3e-9, 1.2e-10, "7.3e−09 ± 1e−10"),
        (0.25, 0.0, "0.25"),
        (0.25, float("nan"), "0.25"),
    ],
)
def test_a_value_is_written_to_the_second_digit_of_its_deviation(value: float, std: float, written: str) -> None:
    assert plus_minus(value, std) == written
