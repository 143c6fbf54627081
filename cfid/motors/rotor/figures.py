"""Figure of rotors that follow their commands: what was measured and the model, the residual, and the numbers."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cfid.drawing.style import ALERT, MODEL, RECORDED, draw_line, figure, legend, name_panel, styled, words
from cfid.motors.rotor.estimation import DELAY, FALL, FALL_SHARE, RISE, RISE_SHARE, RotorFit

_SHOWN_S = 20.0  # of a record, where it moves most: a longer one is a black band


@styled
def rotor_figure(fits: Mapping[str, RotorFit], reasons: Sequence[str], *, title: str) -> Figure:
    """Return a figure of the liveliest seconds of each rotor with the model and what is left, and of the numbers."""
    heights = (*(height for _ in fits for height in (2.2, 0.9)), 1.3 * -(-len(fits) // 2))
    rejections = [f"Rejected: {reason}" for reason in reasons]
    page, grid = figure(len(heights), 2, heights_in=heights, title=title, rejections=rejections)
    for place, (name, fit) in enumerate(fits.items()):
        rejected = any(reason.startswith(f"{name}:") for reason in reasons)
        speed = page.add_subplot(grid[2 * place, :])
        _draw(speed, page.add_subplot(grid[2 * place + 1, :], sharex=speed), f"({'abcd'[place]}) {name}", fit, rejected)
    cells = grid[2 * len(fits), :].subgridspec(-(-len(fits) // 2), 2)
    for place, (name, fit) in enumerate(fits.items()):
        words(page.add_subplot(cells[place // 2, place % 2]), name, _numbers(fit))
    return page


def _draw(speed: Axes, rest: Axes, name: str, fit: RotorFit, rejected: bool) -> None:
    name_panel(speed, name, x="", y="speed (rad/s)")
    name_panel(rest, "", x="time (s)", y="residual")
    begin_s = _liveliest_s(fit)
    seen = (fit.time_s >= begin_s) & (fit.time_s <= begin_s + _SHOWN_S)
    draw_line(speed, fit.time_s[seen], fit.measured[seen], color=RECORDED, lw=0.9, label="measured")
    color = ALERT if rejected else MODEL
    label, style = ("rejected", ":") if rejected else ("rotor model", "-")
    speed.plot(fit.time_s[seen], fit.shown[seen], color=color, ls=style, lw=1.1, label=label)
    draw_line(rest, fit.time_s[seen], (fit.measured - fit.shown)[seen], color=RECORDED, lw=0.7)
    legend(speed)


def _liveliest_s(fit: RotorFit) -> float:
    """Return when the part starts in which the model varies most."""
    begins = np.arange(fit.time_s[0], max(fit.time_s[-1] - _SHOWN_S, fit.time_s[0]) + 1e-9, _SHOWN_S / 2)
    parts = [fit.shown[(fit.time_s >= begin) & (fit.time_s <= begin + _SHOWN_S)] for begin in begins]
    return float(begins[int(np.argmax([np.var(part) if len(part) > 1 else 0.0 for part in parts]))])


def _numbers(fit: RotorFit) -> list[tuple[str, str]]:
    rows = []
    for name, rate, share, there in (
        ("rising", RISE, RISE_SHARE, fit.ways[0]),
        ("falling", FALL, FALL_SHARE, fit.ways[1]),
    ):
        tau_ms = 1e3 * math.exp(-fit.values[rate])
        part = f"{100 * fit.values[share]:.0f} ± {100 * fit.std[share]:.0f} % by drag"
        rows.append((name, f"{tau_ms:.1f} ± {tau_ms * fit.std[rate]:.2g} ms, {part}" if there else "no such change"))
    delay = f"{1e3 * fit.values[DELAY]:.1f} ± {1e3 * fit.std[DELAY]:.2g} ms"
    return [*rows, ("delay", delay), ("at", f"{fit.at_rad_s:.0f} rad/s"), ("explained", f"{100 * fit.explained:.2f} %")]
