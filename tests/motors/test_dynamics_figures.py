"""Figures of command steps: speeds, the lag of each step, and the rotor model's time constants."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.colors import same_color
from matplotlib.figure import Figure

from cfid.drawing.style import ALERT
from cfid.motors.steps.estimation import StepFit, fit_steps
from cfid.motors.steps.figures import dynamics_figure
from cfid.motors.steps.model import command_steps
from cfid.motors.steps.rotor_model import RotorModel, fit_rotor_model

Array = npt.NDArray[np.float64]
Fits = tuple[Array, Array, tuple[StepFit, ...], RotorModel]

HOLD_S = 1.0


def fitted(levels: tuple[float, ...], *, time_constant_s: float = 0.1) -> Fits:
    """Return times, speeds that follow levels held for one second each, and the fits to them."""
    time = np.arange(0.0, HOLD_S * len(levels), 0.01)
    speed = np.full_like(time, levels[0])
    for place, level in enumerate(levels[1:], start=1):
        since = time - HOLD_S * place
        before = speed[since < 0][-1]
        speed = np.where(since >= 0, level + (before - level) * np.exp(-since / time_constant_s), speed)
    speed += 0.5 * np.random.default_rng(1).standard_normal(len(time))
    command = np.array(levels)[np.minimum((time / HOLD_S + 1e-9).astype(int), len(levels) - 1)]
    steps = command_steps(time_s=time, command=command)
    values: dict[str, Any] = {"time_s": time, "value": speed, "steps": steps}
    return time, speed, fit_steps(**values), fit_rotor_model(**values)


@pytest.fixture(scope="module")
def fits() -> Fits:
    return fitted((800.0, 1000.0, 1500.0, 2000.0, 1200.0, 900.0))


def test_each_step_has_its_lag_over_the_speeds_measured(look: Callable[[Figure], Any], fits: Fits) -> None:
    page = dynamics_figure(*fits, title="steps")
    measured, *lags = look(page).panel("(a)").get_lines()
    assert not look(page).overlapping()

    assert len(lags) == 5
    for line in lags:
        x, y = (np.asarray(part, float) for part in line.get_data())
        assert y[:-1] == pytest.approx(np.interp(x, *fits[:2])[:-1], abs=25)
    assert len(np.asarray(measured.get_xdata())) == 600


def test_time_constants_stand_over_the_speed_that_a_step_leads_to(look: Callable[[Figure], Any], fits: Fits) -> None:
    page = dynamics_figure(*fits, title="steps")
    marks = [line for line in look(page).panel("(b)").get_lines() if line.get_marker() in ("^", "v")]
    rising, falling = (np.asarray(line.get_ydata(), float) for line in marks)

    assert rising == pytest.approx([100] * 3, abs=5)
    assert falling == pytest.approx([100] * 2, abs=5)


def test_a_step_that_is_too_short_is_red_and_has_no_time_constant(look: Callable[[Figure], Any]) -> None:
    found = fitted((800.0, 1600.0), time_constant_s=1.2)
    page = dynamics_figure(*found, title="short")
    lower = look(page).panel("(b)")

    assert same_color(look(page).panel("(a)").get_lines()[-1].get_color(), ALERT)
    assert not lower.get_lines()
    assert [text.get_text() for text in lower.texts] == ["every step was rejected"]
