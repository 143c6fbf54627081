"""Figure of rotors that follow a command that always changes: what was measured, the lag, and its numbers."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cfid.drawing.style import ALERT, MODEL, RECORDED, draw_line, figure, legend, name_panel, styled, words
from cfid.findings import texts
from cfid.motors.lag.estimation import LagFit

_SHOWN_S = 4.0  # of a record, where it moves most: a longer one is a black band


@styled
def lag_figure(fits: Mapping[str, LagFit], *, title: str) -> Figure:
    """Return a figure of the liveliest four seconds of each rotor with its lag, and of the lag's numbers."""
    rejections = [
        f"Rejected: {name}: {text}" for name, fit in fits.items() for text in texts(fit.findings, "rejection")
    ]
    heights = (2.4,) * len(fits) + (1.1 * -(-len(fits) // 2),)
    page, grid = figure(len(heights), 2, heights_in=heights, title=title, rejections=rejections)
    for place, (name, fit) in enumerate(fits.items()):
        _draw(page.add_subplot(grid[place, :]), f"({'abcd'[place]}) {name}", fit)
    cells = grid[len(fits), :].subgridspec(-(-len(fits) // 2), 2)
    for place, (name, fit) in enumerate(fits.items()):
        words(page.add_subplot(cells[place // 2, place % 2]), name, _numbers(fit))
    return page


def _draw(axes: Axes, name: str, fit: LagFit) -> None:
    name_panel(axes, name, x="time (s)", y="speed (rad/s)")
    begin_s = _liveliest_s(fit)
    seen = (fit.time_s >= begin_s) & (fit.time_s <= begin_s + _SHOWN_S)
    draw_line(axes, fit.time_s[seen], fit.measured[seen], color=RECORDED, lw=0.9, label="measured")
    how = "lag" if fit.accepted else "rejected"
    color = MODEL if fit.accepted else ALERT
    axes.plot(fit.time_s[seen], fit.shown[seen], color=color, ls="-" if fit.accepted else ":", lw=1.1, label=how)
    legend(axes)


def _liveliest_s(fit: LagFit) -> float:
    """Return when the part starts in which the model varies most."""
    begins = np.arange(fit.time_s[0], max(fit.time_s[-1] - _SHOWN_S, fit.time_s[0]) + 1e-9, _SHOWN_S / 2)
    parts = [fit.shown[(fit.time_s >= begin) & (fit.time_s <= begin + _SHOWN_S)] for begin in begins]
    return float(begins[int(np.argmax([np.var(part) if len(part) > 1 else 0.0 for part in parts]))])


def _numbers(fit: LagFit) -> list[tuple[str, str]]:
    values, stds = (1e3 * np.array(numbers) for numbers in (fit.lag, fit.std_s))
    each = zip(("rising", "falling", "delay"), values, stds, strict=True)
    rows = [(name, f"{value:.1f} ± {std:.1f} ms" if np.isfinite(std) else "not excited") for name, value, std in each]
    return [*rows, ("explained", f"{100 * fit.explained:.1f} %")]
