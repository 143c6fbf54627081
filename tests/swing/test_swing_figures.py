"""The page of a swing shows what the fit states."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from cfid.swing.estimation import SwingFit, fit_swing
from cfid.swing.figures import fitted_motion, swing_figure, thesis_swing_figure
from cfid.swing.pendulum import Coefficients, sample
from cfid.swing.thesis import fit_damped_cosine, fit_flexible
from cfid.swing.window import FreeSwing, find_swing

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


def test_a_window_set_by_hand_has_a_start_and_no_release(swing: FreeSwing, look: Look) -> None:
    cut = find_swing(swing.time_s, swing.angle_rad, from_s=1.6)
    labels = {line.get_label() for line in look(swing_figure(cut, fit_swing(cut), title="")).panel("(a)").get_lines()}
    assert "start" in labels
    assert not labels & {"release", "hand gone"}


def test_recorded_less_fitted_is_the_residual(page: Any, fit: SwingFit) -> None:
    recorded, fitted = (line.get_ydata() for line in page.panel("(b)").get_lines())
    assert np.radians(recorded - fitted) == pytest.approx(fit.output_error.residual_rad, abs=1e-12)
    assert page.panel("(c)").get_lines()[1].get_ydata() == pytest.approx(1e3 * fit.output_error.residual_rad)


def test_a_good_residual_is_white_noise(page: Any) -> None:
    panel = page.panel("(d)")
    correlation = panel.get_lines()[0].get_ydata()
    (band,) = panel.patches
    assert correlation[0] == pytest.approx(1.0)
    assert np.mean(np.abs(correlation[1:]) <= band.get_y() + band.get_height()) > 0.9


def test_an_accepted_swing_has_nothing_red(page: Any) -> None:
    assert page.red() == ""


def test_a_rejected_swing_is_marked_in_red(shaken_page: Any, shaken: tuple[FreeSwing, SwingFit]) -> None:
    red = shaken_page.red()
    assert not shaken[1].accepted
    assert "Rejected" in red
    assert "NO" in red


def test_no_text_lies_over_another(page: Any, shaken_page: Any, thesis_page: Any) -> None:
    assert [each.overlapping() for each in (page, shaken_page, thesis_page)] == [[], [], []]


def test_every_axis_has_its_quantity_and_unit(page: Any, thesis_page: Any) -> None:
    for axes in (*page.figure.axes, *thesis_page.figure.axes):
        # The right panel of a pair shares its quantity with the left one.
        if axes.axison and axes.get_title(loc="left"):
            assert "(" in axes.get_xlabel()
            assert "(" in axes.get_ylabel()


def test_a_window_of_many_periods_is_drawn_by_its_beginning_and_its_end(swing: FreeSwing, fit: SwingFit) -> None:
    many = replace(swing, period_s=swing.period_s / 8)
    (beginning,) = (a for a in swing_figure(many, fit, title="").axes if a.get_title(loc="left").startswith("(b)"))
    assert "its beginning, its end" in beginning.get_title(loc="left")
    assert np.asarray(beginning.get_lines()[0].get_xdata())[-1] == pytest.approx(
        swing.hands_off[0][0] + 5 * many.period_s, abs=0.005
    )


def test_the_motion_integrated_anew_is_the_fits(swing: FreeSwing, fit: SwingFit) -> None:
    time, _ = swing.hands_off
    assert fitted_motion(fit, time) == pytest.approx(sample(fit.output_error.trajectory, time), abs=1e-4)


def test_dry_friction_holds_the_motion_where_it_overcomes_gravity(fit: SwingFit) -> None:
    held = replace(fit, output_error=replace(fit.output_error, coefficients=Coefficients(150.0, 0.5, 4.0)))
    motion = fitted_motion(held, np.linspace(fit.output_error.trajectory.start_s, 30.0, 999))
    assert np.ptp(motion[-300:]) == 0.0
    assert abs(motion[-1]) <= np.arcsin(4.0 / 150.0)


def test_half_swings_within_a_gap_of_the_recording_are_passed(fit: SwingFit) -> None:
    held = replace(fit, output_error=replace(fit.output_error, coefficients=Coefficients(150.0, 0.5, 4.0)))
    dense = np.linspace(fit.output_error.trajectory.start_s, 30.0, 3001)
    sparse = dense[[0, 1, -1]]
    assert fitted_motion(held, sparse) == pytest.approx(fitted_motion(held, dense)[[0, 1, -1]])


def test_a_body_that_dry_friction_holds_from_the_start_stays_there(fit: SwingFit) -> None:
    start = replace(
        fit.output_error, coefficients=Coefficients(150.0, 0.5, 4.0), start_angle_rad=0.02, start_speed_rad_per_s=0.0
    )
    held = replace(fit, output_error=start)
    assert np.all(fitted_motion(held, np.linspace(start.trajectory.start_s, 9.0, 99)) == 0.02)


def test_the_thesis_page_works_without_the_flexible_function(swing: FreeSwing) -> None:
    assert len(thesis_swing_figure(swing, fit_damped_cosine(swing), None, title="").axes) == 2
