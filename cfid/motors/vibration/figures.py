"""Figure of a rotor's lines in the spectrum of the load cell."""

import numpy as np
from matplotlib.figure import Figure

from cfid.drawing.style import MODEL, RECORDED, SERIES, draw_line, figure, legend, name_panel, styled
from cfid.motors.vibration.spectrum import spectrum
from cfid.recordings.wrench import WrenchRecord

_DECADES = 4.0  # shown of a spectrum
_MARKED = (1, 2, 4)  # multiples of the rotor's frequency


@styled
def rotor_figure(record: WrenchRecord, window_s: tuple[float, float], *, speed_rad_per_s: float, title: str) -> Figure:
    """Return the spectrum of the force along z in a window as figure 3.4, with the lines of a rotor at a speed marked.

    The frequency axis is linear, so that harmonics are evenly spaced, and ends soon after the last marked line.
    """
    page, grid = figure(1, 1, heights_in=(3.7,), title=title)
    axes = page.add_subplot(grid[0, 0])
    name_panel(axes, "amplitude spectrum", x="frequency (Hz)", y="amplitude (N)")
    first, end = np.searchsorted(record.time_s, window_s)
    interval_s = float(np.median(np.diff(record.time_s[first:end])))
    seen = spectrum(signal=record.force_n[first:end], interval_s=interval_s)
    lines_hz = [(k, k * speed_rad_per_s / (2 * np.pi)) for k in _MARKED]
    lines_hz = [(k, hz) for k, hz in lines_hz if hz <= seen.frequency_hz[-1]]
    shown = (seen.frequency_hz > 0) & (seen.frequency_hz <= 1.1 * max((hz for _, hz in lines_hz), default=np.inf))
    amplitude = seen.amplitude[shown, 2]
    draw_line(axes, seen.frequency_hz[shown], amplitude, color=RECORDED, lw=0.8, label="amplitude")
    if (highest := float(amplitude.max())) > 0:
        axes.set_yscale("log")
        axes.set_ylim(max(highest / 10**_DECADES, float(np.median(amplitude)) / 3), 2 * highest)
    for (k, hz), color in zip(lines_hz, (MODEL, *SERIES[1:]), strict=False):
        axes.axvline(hz, color=color, lw=0.9, ls="--", zorder=1, label=f"{k}x {hz:.0f} Hz")
    legend(axes)
    return page
