"""Figure of a rotor's lines in the spectrum of the load cell."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cfid.drawing.style import MODEL, RECORDED, draw_line, figure, name_panel, styled
from cfid.motors.vibration.spectrum import spectrum
from cfid.recordings.wrench import WrenchRecord

Array = npt.NDArray[np.float64]

_DECADES = 4.0  # shown of a spectrum
_ROW = 0.052  # of the panel, for a row of labels
_CHARACTER = 0.0112  # of the panel's width


def rotor_figure(record: WrenchRecord, window_s: tuple[float, float], *, speed_rad_per_s: float, title: str) -> Figure:
    """Return the spectrum of the force along z in a window, with the lines of a rotor at a speed."""
    first, end = np.searchsorted(record.time_s, window_s)
    interval_s = float(np.median(np.diff(record.time_s[first:end])))
    seen = spectrum(signal=record.force_n[first:end], interval_s=interval_s)
    lines = [(f"{k}x", k * speed_rad_per_s / (2 * np.pi)) for k in (1, 2, 4)]
    return rotor_spectrum_figure(seen.frequency_hz, seen.amplitude[:, 2], lines=lines, title=title)


@styled
def rotor_spectrum_figure(
    frequency_hz: Array, amplitude: Array, *, lines: Sequence[tuple[str, float]], title: str, unit: str = "N"
) -> Figure:
    """Return amplitudes (m,) over frequencies (m,) as figure 3.4 does, with the rotors' lines, (label, Hz), marked.

    The frequency axis is linear, so that harmonics are evenly spaced, and ends soon after the last marked line.
    """
    page, grid = figure(1, 1, heights_in=(3.7,), title=title)
    axes = page.add_subplot(grid[0, 0])
    name_panel(axes, "amplitude spectrum", x="frequency (Hz)", y=f"amplitude ({unit})")
    draw_spectrum(axes, frequency_hz, amplitude, lines=lines)
    return page


def draw_spectrum(axes: Axes, frequency_hz: Array, amplitude: Array, *, lines: Sequence[tuple[str, float]]) -> None:
    """Draw amplitudes (m,) on a logarithmic axis, and above them flags with the label and frequency of each line."""
    flags = sorted(((hz, f"{label} {hz:.0f} Hz") for label, hz in lines if hz <= frequency_hz[-1]), reverse=True)
    widths = [_CHARACTER * (len(text) + 1) for _, text in flags]
    ends = [hz / (1 - width) for (hz, _), width in zip(flags, widths, strict=True)]
    end_hz = 1.02 * max(ends) if ends else float(frequency_hz[-1])
    shown = (frequency_hz > 0) & (frequency_hz <= end_hz)
    highest = float(amplitude[shown].max())
    if highest <= 0:
        return
    lowest = max(highest / 10**_DECADES, float(np.median(amplitude[shown])) / 3)
    drawn = frequency_hz[shown], np.maximum(amplitude[shown], lowest)
    draw_line(axes, *drawn, color=RECORDED, lw=0.8, label="amplitude")
    axes.set_yscale("log")
    axes.set_xlim(0.0, end_hz)
    rows = flag_rows([hz / end_hz for hz, _ in flags], widths)
    decades = np.log10(highest / lowest) / (1 - _ROW * (max(rows, default=-1) + 1.5))
    axes.set_ylim(lowest, lowest * 10**decades)
    for (hz, text), row in zip(flags, rows, strict=True):
        foot = float(drawn[1][np.abs(drawn[0] - hz).argmin()])
        top = highest * 10 ** (decades * _ROW * (row + 1.2))
        axes.vlines(hz, foot, top, color=MODEL, lw=0.9, label=text)
        axes.annotate(
            text, (hz, top), xytext=(2, 1), textcoords="offset points", va="top", size=8, color=MODEL, parse_math=False
        )


def flag_rows(places: Sequence[float], widths: Sequence[float]) -> list[int]:
    """Return the row of each flag so that no two touch; flags go from right to left, each with its pole on its left.

    A flag that would reach its neighbour moves above it, to where no pole of a neighbour on its right passes.
    """
    begins: list[float] = []
    rows = []
    for place, width in zip(places, widths, strict=True):
        row = next((i for i, begin in enumerate(begins) if place + width <= begin), len(begins))
        begins[row:] = [place]
        rows.append(row)
    return rows
