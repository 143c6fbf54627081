"""The page of a swing shows what the fit states."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

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


def test_the_windows_borders_are_the_swings(page: Any, swing: FreeSwing) -> None:
    (window,) = page.figure.findobj(lambda artist: artist.get_gid() == "window")
    assert isinstance(window, Rectangle)
    time, _ = swing.hands_off
    assert (window.get_x(), window.get_x() + window.get_width()) == pytest.approx((time[0], time[-1]))


def test_rest_and_peaks_stand_where_the_record_has_them(page: Any, swing: FreeSwing) -> None:
    lines = {line.get_label(): line for line in page.panel("(a)").get_lines()}
    assert lines["rest"].get_ydata()[0] == pytest.approx(np.degrees(swing.rest_rad))
    assert lines["7 peaks used"].get_xdata() == pytest.approx(swing.peak_time_s[:7])
    assert lines["not used"].get_xdata() == pytest.approx(swing.peak_time_s[7:])
    assert lines["release"].get_xdata() == pytest.approx([swing.release_s])
    assert lines["hand gone"].get_xdata() == pytest.approx([swing.time_s[swing.hand_gone]])


def test_recorded_less_fitted_is_the_residual(page: Any, fit: SwingFit) -> None:
    recorded, fitted = (line.get_ydata() for line in page.panel("(b)").get_lines())
    assert np.radians(recorded - fitted) == pytest.approx(fit.output_error.residual_rad, abs=1e-12)
    assert page.panel("(c)").get_lines()[1].get_ydata() == pytest.approx(1e3 * fit.output_error.residual_rad)


def test_a_rejected_swing_is_marked_in_red(shaken_page: Any, shaken: tuple[FreeSwing, SwingFit]) -> None:
    red = shaken_page.red()
    assert not shaken[1].accepted
    assert "Rejected" in red
    assert "NO" in red


def test_no_text_lies_over_another(page: Any, shaken_page: Any, thesis_page: Any) -> None:
    assert [each.overlapping() for each in (page, shaken_page, thesis_page)] == [[], [], []]
