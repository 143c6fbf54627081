"""Panels for the motors' records: a thrust staircase with its steps and their means."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cfid.drawing.numbers import plus_minus
from cfid.drawing.recordings import MEAN_S
from cfid.drawing.style import ALERT, INK, MODEL, RECORDED, RECORDED_BELOW, WINDOW, draw_line, name_panel
from cfid.estimate.polynomials import PolynomialFit
from cfid.estimate.staircase import Level, Point, Staircase
from cfid.units import FULL_COMMAND

Array = npt.NDArray[np.float64]

COMMAND = f"command (0 to {FULL_COMMAND})"

_MOST_BINS = 2000  # of the band: two for every dot of a screen
_FEWEST = 10  # samples in a mean that excludes the lowest and the highest
_USUAL = 0.995  # share of the band that lies within its usual limits, without spikes
_BESIDE = 1.0  # share of the means' range by which the band may extend above and below it
_HEAD = 0.19  # share of the panel for the names of unused steps
_EDGE = 0.05
_NAME_WIDTH = 0.02  # of the panel, from one such name to the next
_MOST_REASONS = 6
_THRUST = "thrust (N)"
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_WINDOW: dict[str, Any] = {"fc": to_rgba(WINDOW, 0.2), "ec": WINDOW, "lw": 0.4}
_UNUSED: dict[str, Any] = {"fc": to_rgba(ALERT, 0.15), "ec": ALERT, "hatch": "////", "lw": 0.8}


def scientific(value: float, std: float, *, unit: str = "") -> str:
    """Return a value with its standard uncertainty, both with one power of ten where the value is far from 1."""
    exponent = int(np.floor(np.log10(abs(value)))) if value else 0
    if -2 <= exponent <= 3:
        return plus_minus(value, std, unit=unit)
    number = plus_minus(value / 10.0**exponent, std / 10.0**exponent)
    return f"{f'({number})' if ' ' in number else number}·10{str(exponent).translate(_SUPERSCRIPTS)} {unit}".rstrip()


def power(name: str, exponent: int) -> str:
    """Return a power of a named quantity as text, such as x²."""
    return name if exponent == 1 else f"{name}{str(exponent).translate(_SUPERSCRIPTS)}"


def coefficients(fit: PolynomialFit, x: str, units: Sequence[str]) -> list[tuple[str, str]]:
    """Return the coefficients of the powers of x as rows of text, highest first."""
    names = [power(x, n) if n else "constant" for n in range(fit.order, -1, -1)]
    values = zip(names, fit.coefficients.tolist(), fit.std.tolist(), units, strict=True)
    return [(name, scientific(value, std, unit=unit)) for name, value, std, unit in values]


class Bins(NamedTuple):
    """Mean, lowest and highest sample (n,) of segments of equal length about times (n,).

    With enough samples, the mean excludes the lowest and the highest, so that a single outlier does not move it.
    """

    time_s: Array
    mean: Array
    low: Array
    high: Array


def binned(time_s: Array, value: Array, *, length_s: float) -> Bins:
    """Gather samples (n,) at non-decreasing times (n,) in segments of `length_s`; empty segments are left out."""
    edges = np.arange(time_s[0], time_s[-1] + length_s, length_s)
    first = np.unique(np.searchsorted(time_s, edges[edges <= time_s[-1]]))
    count = np.diff(np.append(first, len(time_s)))
    time, total, low, high = (
        fold.reduceat(column, first)
        for fold, column in ((np.add, time_s), (np.add, value), (np.minimum, value), (np.maximum, value))
    )
    many = count >= _FEWEST
    return Bins(time / count, (total - many * (low + high)) / (count - 2 * many), low, high)


def unused_steps(steps: Sequence[Point]) -> list[str]:
    """Return a sentence for each unused step, with the reason; of many steps, only the first few are named."""
    sentences = [
        f"Not used: {_name(i, step)}, {step.begin_s:.4g} to {step.end_s:.4g} s: {step.reason}"
        for i, step in enumerate(steps)
        if not step.settled
    ]
    more = len(sentences) - _MOST_REASONS
    return sentences if more <= 0 else [*sentences[:_MOST_REASONS], f"Not used either: {more} more steps."]


def staircase_key(steps: Sequence[Point]) -> list[Artist]:
    """Return the legend of thrust over time."""
    return [
        Patch(color=RECORDED_BELOW, alpha=0.5, lw=0, label="range of samples"),
        Line2D([], [], color=RECORDED, lw=1.0, label=f"mean over {1e3 * MEAN_S:.0f} ms"),
        Patch(label="steady window", **_WINDOW),
        *([] if all(step.settled for step in steps) else [Patch(label="not used", **_UNUSED)]),
        Line2D([], [], color=MODEL, lw=2.0, label="mean in it"),
        Line2D([], [], color=INK, lw=1.0, ls="--", label="tare"),
    ]


def draw_thrust(axes: Axes, time_s: Array, thrust_n: Array, staircase: Staircase, *, thrust: int) -> None:
    """Draw thrust over time with the steps, their means and the tare below them.

    The band is the range of the samples. The panel cuts it off at spikes, and where it is much wider than the range of
    the means.
    """
    name_panel(axes, "(a) thrust over time", x="time (s)", y=_THRUST)
    means = binned(time_s, thrust_n, length_s=MEAN_S)
    band = binned(time_s, thrust_n, length_s=max(MEAN_S, float(time_s[-1] - time_s[0]) / _MOST_BINS))
    axes.fill_between(band.time_s, band.low, band.high, color=RECORDED_BELOW, alpha=0.5, lw=0, gid="range")
    draw_line(axes, means.time_s, means.mean, color=RECORDED, lw=0.8, label="means")
    _limit(axes, means.mean, band, named=not all(step.settled for step in staircase.points))
    axes.plot(*_tares(staircase, thrust), color=INK, lw=0.9, ls="--", label="tare")
    for settled in (True, False):
        if steps := [step for step in staircase.points if step.settled == settled]:
            _draw_steps(axes, steps, thrust=thrust)
    _name_unused(axes, staircase.points)


def draw_means(value: Axes, deviation: Axes, steps: Sequence[Point], *, thrust: int) -> None:
    """Draw the means of the steps, less tare, over their commands, and their standard uncertainties.

    Without a command log, the numbers of the steps take the place of commands.
    """
    known = all(step.command is not None for step in steps)
    place = np.array([step.command if known else i for i, step in enumerate(steps, start=1)], dtype=np.float64)
    x = COMMAND if known else "step (-)"
    mean, std = (np.array([getattr(step, name)[thrust] for step in steps]) for name in ("mean", "std_of_mean"))
    settled = np.array([step.settled for step in steps])
    name_panel(value, "(b) mean less tare, ± standard uncertainty", x=x, y=_THRUST)
    name_panel(deviation, "(c) uncertainty of each mean", x=x, y="uncertainty (mN)")
    value.errorbar(place[settled], mean[settled], std[settled], fmt="o", ms=3, lw=1.0, capsize=1.5, color=RECORDED)
    deviation.plot(place[settled], 1e3 * std[settled], "o", ms=3, color=RECORDED)
    for axes, shown in ((value, mean[settled]), (deviation, 1e3 * std[settled])):
        axes.set_ylim(1.1 * shown.min(initial=0.0), 1.1 * shown.max(initial=0.0) or 1.0)
        axes.plot(
            place[~settled], np.full((~settled).sum(), 0.04), "x", color=ALERT, ms=4.5, mew=1.2,
            transform=axes.get_xaxis_transform(), label="not used",
        )  # fmt: skip
        if known:
            axes.set_xlim(-0.02 * FULL_COMMAND, 1.02 * FULL_COMMAND)


def staircase_counts(staircase: Staircase) -> list[tuple[str, str]]:
    """Return the counts as rows of text."""
    steps = staircase.points
    settled = sum(step.settled for step in steps)
    motors = sorted({step.motors for step in steps if step.motors})
    commands = [step.command for step in steps if step.command is not None]
    return [
        ("steps", f"{len(steps)}"),
        ("settled", "all" if settled == len(steps) else f"{settled} of {len(steps)}"),
        ("commands", " to ".join(map(str, sorted({min(commands), max(commands)}))) if commands else "not known"),
        ("motors", "; ".join(" and ".join(map(str, each)) for each in motors) or "not known"),
        ("spikes", f"{staircase.spikes}" if staircase.spikes else "none"),
    ]


def staircase_levels(staircase: Staircase, *, thrust: int) -> list[tuple[str, str]]:
    """Return the load cell's baseline and how thrust followed, as rows of text."""
    lag_s = np.median([step.lag_s for step in staircase.points])
    drift, after = staircase.drift, staircase.tare_after
    return [
        ("tare before", _tare_told(staircase.tare_before, thrust)),
        ("tare after", "no pause: not known" if after is None else _tare_told(after, thrust)),
        ("drift", "not known" if drift is None else f"{60e3 * drift[thrust]:.2g} mN/min".replace("-", "−")),
        ("time constant", f"{1e3 * lag_s:.0f} ms (median)"),
    ]


def _tare_told(tare: Level, thrust: int) -> str:
    return plus_minus(float(tare.mean[thrust]), float(tare.std[thrust]), unit="N")


def _name(place: int, step: Point) -> str:
    return f"step {place + 1}" if step.command is None else f"command {step.command}"


def _limit(axes: Axes, mean: Array, band: Bins, *, named: bool) -> None:
    """Set the y range to the means, as much of the band as leaves them readable, and space for names above."""
    low, high = float(mean.min()), float(mean.max())
    room = _BESIDE * ((high - low) or 1.0)
    usual = np.quantile(band.low, 1 - _USUAL), np.quantile(band.high, _USUAL)
    bottom, top = min(low, max(float(usual[0]), low - room)), max(high, min(float(usual[1]), high + room))
    edge = _EDGE * ((top - bottom) or 1.0)
    height = top - bottom + 2 * edge
    axes.set_ylim(bottom - edge, bottom - edge + height / (1 - _HEAD * named))


def _tares(staircase: Staircase, thrust: int) -> tuple[list[float], list[float]]:
    """Return the tare over time: the line that was subtracted, from the first pause to the last."""
    places = [(staircase.tare_before.time_s, staircase.tare_before.mean[thrust])]
    places += [((step.begin_s + step.end_s) / 2, step.tare[thrust]) for step in staircase.points]
    if staircase.tare_after is not None:
        places.append((staircase.tare_after.time_s, staircase.tare_after.mean[thrust]))
    return [float(time) for time, _ in places], [float(value) for _, value in places]


def _draw_steps(axes: Axes, steps: Sequence[Point], *, thrust: int) -> None:
    """Shade the windows of steps, settled or not, and draw their means where the load cell showed them: above the tare.

    All windows are one artist, and so are all means, since a day on a stand has thousands of steps.
    """
    windows = np.array([sorted((step.begin_s, step.end_s)) for step in steps])
    shown = np.array([float(step.mean[thrust] + step.tare[thrust]) for step in steps])
    settled = steps[0].settled
    how, height = ({"label": "window", **_WINDOW}, 1.0) if settled else ({"label": "not used", **_UNUSED}, 1 - _HEAD)
    spans = list(zip(windows[:, 0], windows[:, 1] - windows[:, 0], strict=True))
    axes.broken_barh(spans, (0, height), transform=axes.get_xaxis_transform(), **how)
    known = np.isfinite(shown)
    line: dict[str, Any] = {"color": MODEL, "lw": 1.8, "ls": "-" if settled else ":", "label": "mean"}
    axes.hlines(shown[known], *windows[known].T, **line)


def _name_unused(axes: Axes, steps: Sequence[Point]) -> None:
    """Write the command above each unused step, as far as space allows."""
    begin, end = axes.get_xlim()
    free = begin
    for i, step in enumerate(steps):
        middle = (step.begin_s + step.end_s) / 2
        if step.settled or middle < free:
            continue
        name = str(step.command if step.command is not None else i + 1)
        axes.text(
            middle, 0.985, name, transform=axes.get_xaxis_transform(), color=ALERT, size=7.5, rotation=90,
            ha="center", va="top",
        )  # fmt: skip
        free = middle + _NAME_WIDTH * (end - begin)
