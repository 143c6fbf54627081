"""The page of a swing shows what the fit states."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from cfid.swing.estimation import SwingFit
from cfid.swing.figures import swing_figure, thesis_swing_figure
from cfid.swing.thesis import fit_damped_cosine, fit_flexible
from cfid.swing.window import FreeSwing

Look = Callable[[Figure], Any]


@pytest.fixture(scope="module")
def page(swing: FreeSwing, fit: SwingFit, look: Look) -> Any:
    return look(swing_figure(swing, fit, title="swing_$x$"))


@pytest.fixture(scope="module")
def shaken_page(shaken: tuple[FreeSwing, SwingFit], look: Look) -> Any:
    return look(swing_figure(*shaken, title="swing_x"))


@pytest.fixture(scope="module")
def thesis_page(swing: FreeSwing, look: Look) -> Any:
    return look(thesis_swing_figure(swing, fit_damped_cosine(swing), fit_flexible(swing), title="swing_x"))


def test_recorded_less_fitted_is_the_residual(page: Any, fit: SwingFit) -> None:
    recorded, fitted = (line.get_ydata() for line in page.panel("(b)").get_lines())
    assert np.radians(recorded - fitted) == pytest.approx(fit.output_error.residual_rad, abs=1e-12)
    assert page.panel("(c)").get_lines()[1].get_ydata() == pytest.approx(1e3 * fit.output_error.residual_rad)


def test_a_rejected_swing_is_marked_in_red(shaken_page: Any, shaken: tuple[FreeSwing, SwingFit]) -> None:
    red = shaken_page.red()
    assert not shaken[1].accepted
    assert "Rejected" in red
    assert "NO" in red


def test_no_text_of_the_thesis_page_lies_over_another(thesis_page: Any) -> None:
    assert thesis_page.overlapping() == []
