"""Figure of rotors that follow steps of their command: speeds with the lag of each step, and the time constants."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cfid.drawing.style import ALERT, INK, MODEL, MUTED, RECORDED, draw_line, figure, legend, name_panel, styled, words
from cfid.findings import texts
from cfid.motors.panels import scientific
from cfid.motors.steps.estimation import StepFit
from cfid.motors.steps.rotor_model import RotorModel

Array = npt.NDArray[np.float64]

_CURVE = 200  # points of a drawn curve
_RISING: dict[str, Any] = {"color": RECORDED, "marker": "^", "label": "rising"}
_FALLING: dict[str, Any] = {"color": MODEL, "marker": "v", "label": "falling"}
_EARS: dict[str, Any] = {"ls": "", "ms": 5.0, "lw": 0.9, "capsize": 2.0}


@styled
def dynamics_figure(
    time_s: Array, speed_rad_s: Array, lags: Sequence[StepFit], model: RotorModel, *, title: str
) -> Figure:
    """Return speeds (n,) over times (n,) with the lag fitted to each step, and its time constant over the final speed.

    Rejected lags are red in the upper panel and left out of the lower one. The curves there are those of the rotor
    model.
    """
    rejections = [f"Rejected: {text}" for text in texts(model.findings, "rejection")]
    page, grid = figure(3, 2, heights_in=(2.9, 2.3, 0.95), title=title, rejections=rejections)
    _draw_steps(page.add_subplot(grid[0, :]), time_s, speed_rad_s, lags)
    _draw_constants(page.add_subplot(grid[1, :]), [lag for lag in lags if lag.accepted], model)
    words(page.add_subplot(grid[2, 0]), "rotor model", _told(model))
    accepted = sum(lag.accepted for lag in lags)
    counts = [
        ("steps", f"{len(lags)}, {accepted} accepted"),
        ("explained", f"{100 * model.explained:.1f} %"),
        ("residual", f"{model.rms:.3g} rad/s rms"),
    ]
    if np.isfinite([lag.delay_std_s for lag in lags]).any():
        counts.append(("delay", f"{1e3 * model.delay_s:.1f} ms"))
    words(page.add_subplot(grid[2, 1]), "all steps together", counts, red=() if model.accepted else ("explained",))
    return page


def _draw_steps(axes: Axes, time_s: Array, speed_rad_s: Array, lags: Sequence[StepFit]) -> None:
    name_panel(axes, "(a) speed and the lag of each step", x="time (s)", y="speed (rad/s)")
    draw_line(axes, time_s, speed_rad_s, color=RECORDED, lw=0.9, label="measured")
    labelled = set()
    for lag in lags:
        at_s = np.linspace(lag.step.at_s, lag.step.until_s, _CURVE)
        how = "lag" if lag.accepted else "rejected"
        axes.plot(
            at_s,
            lag.speed_at(at_s),
            color=MODEL if lag.accepted else ALERT,
            ls="-" if lag.accepted else ":",
            lw=1.1,
            label="_" if how in labelled else how,
        )
        labelled.add(how)
    legend(axes)


def _draw_constants(axes: Axes, lags: Sequence[StepFit], model: RotorModel) -> None:
    name_panel(axes, "(b) time constants", x="speed that a step leads to (rad/s)", y="time constant (ms)")
    for rising, how, rates in ((True, _RISING, model.rising), (False, _FALLING, model.falling)):
        own = [lag for lag in lags if lag.rising == rising]
        if not own:
            continue
        speed, constant, std = np.array([(g.to_rad_per_s, g.time_constant_s, g.time_constant_std_s) for g in own]).T
        axes.errorbar(speed, 1e3 * constant, 1e3 * std, **_EARS, **how)
        at = np.linspace(speed.min(), speed.max(), _CURVE)
        rate = rates[0] + 2 * rates[1] * at
        axes.plot(at, 1e3 / np.where(rate > 0, rate, np.nan), color=how["color"], lw=1.1, label="_")
    if lags:
        axes.plot([], [], color=INK, lw=1.1, label="rotor model")
        axes.set_ylim(bottom=0.0)
        legend(axes)
    else:
        axes.text(0.5, 0.5, "every step was rejected", transform=axes.transAxes, ha="center", color=MUTED)


def _told(model: RotorModel) -> list[tuple[str, str]]:
    ways = (("rising", model.rising, model.rising_std), ("falling", model.falling, model.falling_std))
    return [
        (f"{name}, {kind}", "no such step" if np.isnan(value[k]) else scientific(value[k], std[k], unit=unit))
        for name, value, std in ways
        for k, (kind, unit) in enumerate((("linear", "1/s"), ("quadratic", "1/rad")))
    ]
