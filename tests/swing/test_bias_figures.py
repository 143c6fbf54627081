"""The documentation's figures of the bias of the damped cosine."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.docs.test_explanations import figures_script

Look = Callable[[Figure], Any]


def test_biases_are_drawn_in_per_cent_with_their_theory(look: Look) -> None:
    amplitude = np.array([10.0, 30.0, 60.0])
    theory = (1 + np.radians(amplitude) ** 2 / 16 + 11 * np.radians(amplitude) ** 4 / 3072) ** 2 - 1
    page = look(figures_script().bias_figure(amplitude, theory / 2, np.array([1e-5, 0.0, -1e-5]), theory))
    drawn = [line.get_ydata() for line in page.panel("(a)").get_lines()]
    assert any(len(values) == 3 and values == pytest.approx(100 * theory) for values in drawn)
    assert page.panel("(b)").get_yscale() == "log"
    assert page.overlapping() == []


def test_the_truth_is_drawn_beside_what_each_number_of_peaks_gives(look: Look) -> None:
    peaks = np.arange(4.0, 12.0)
    page = look(figures_script().peaks_figure(peaks, 3.2e-5 - 1e-7 * peaks, np.full(8, 3.1e-5), 3.1e-5))
    truth = page.panel("(a)").get_lines()[-1].get_ydata()
    assert truth[0] == pytest.approx(31.0)
    assert page.overlapping() == []
