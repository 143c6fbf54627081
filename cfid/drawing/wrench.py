"""Draw a load cell's record: forces, torques, the spectrum of Fz and sampling intervals."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import find_peaks, welch

from cfid.drawing.intervals import GAP, draw_intervals
from cfid.drawing.numbers import plus_minus
from cfid.drawing.style import ALERT, MUTED, RECORDED, SERIES, draw_line, figure, legend, name_panel, styled, words
from cfid.estimate.blocks import block_means
from cfid.estimate.signals import resample
from cfid.large import PART_ROWS, differences, longest_step, usual_step
from cfid.recordings.wrench import AXES, WrenchRecord

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_TIME = "time (s)"
MEAN_S = 0.05  # duration of each drawn mean: several turns of the slowest rotor
_MOST_MEANS = 1000
_HOST_GAP_S = 0.1  # least gap between arrival times at a computer, which may be late by tens of milliseconds
_EVEN = 0.5  # of the median interval: if no interval is shorter, the times are those of the box
_RESOLUTION_S = 1.0  # length of the segments whose spectra are averaged; rotors do not hold a speed for longer
_MOST_LINES = 5
_ABOVE_NOISE = 8.0  # least ratio of a line to the median of the spectrum around it
_AROUND_HZ = 100.0
_APART_HZ = 12.0  # between two labelled lines
_LEAST_SHARE = 0.02  # of the highest line: lower lines are not labelled
_SHOWN_RATIO = 350.0  # highest over lowest frequency shown: from 10 Hz at 7 kHz
_LEAST = 1e-5  # of the highest amplitude: lower amplitudes are not shown
_SHORTEST = 16  # samples in a segment of the spectrum
_LABEL_DECADES = 0.9  # space for the labels above the highest line
_LABEL_WIDTH = 0.085  # of the panel's width, from one label to the next


class AmplitudeSpectrum(NamedTuple):
    """Amplitudes (n,) in N of a sine wave at each frequency (n,)."""

    frequency_hz: Array
    amplitude_n: Array


@styled
def wrench_figure(record: WrenchRecord, *, title: str) -> Figure:
    """Return forces, torques, the spectrum of the main axis and sampling intervals, with the reader's notes above."""
    page, grid = figure(4, 2, heights_in=(2.1, 2.1, 2.3, 2.3), title=title, notes=record.notes)
    forces, torques = page.add_subplot(grid[0, :]), page.add_subplot(grid[1, :])
    _draw_axes(forces, record, record.force_n, names=AXES[:3], title="(a) forces", y="force (N)")
    _draw_axes(torques, record, record.torque_nm, names=AXES[3:], title="(b) torques", y="torque (mNm)", factor=1e3)
    spectrum = spectrum_of(record.time_s, record.values_of(record.main_axis))
    _draw_spectrum(page.add_subplot(grid[2, :]), spectrum, record.main_axis)
    draw_intervals(page.add_subplot(grid[3, 0]), record.time_s, usual_s=usual_step(record.time_s), letter="d")
    wrong = {"gaps": len(gaps_of(record.time_s)), "lost": record.lost}
    red = [name for name, count in wrong.items() if count]
    words(page.add_subplot(grid[3, 1]), "in numbers", _facts(record), red=red)
    page.align_ylabels()
    return page


def spectrum_of(time_s: Array, value: Array) -> AmplitudeSpectrum:
    """Return the amplitude spectrum of a record (n,) without its mean, up to half its sampling rate.

    Welch's method uses Hann windows of one second with half overlap. If a record has gaps, its longest segment without
    a gap is used; of a long segment, only the middle is used.
    """
    gaps = gaps_of(time_s)
    begins, ends = np.append(0, gaps + 1), np.append(gaps, len(time_s) - 1)
    longest = int(np.argmax(time_s[ends] - time_s[begins]))
    middle, count = (begins[longest] + ends[longest]) // 2, min(ends[longest] + 1 - begins[longest], PART_ROWS)
    first = max(begins[longest], middle - count // 2)
    segment = slice(first, first + count)
    even, rate_hz = _evenly(time_s[segment], value[segment])
    length = min(len(even), max(_SHORTEST, round(_RESOLUTION_S * rate_hz)))
    frequency_hz, power = welch(even, rate_hz, window="hann", nperseg=length, detrend="constant", scaling="spectrum")
    return AmplitudeSpectrum(frequency_hz[1:], np.sqrt(2 * power[1:]))


def lines_of(spectrum: AmplitudeSpectrum) -> Indices:
    """Return the indices of the highest lines that exceed the noise around them, at most five, by frequency."""
    step_hz, amplitude_n = float(spectrum.frequency_hz[0]), spectrum.amplitude_n
    around = max(1, round(_AROUND_HZ / step_hz))
    blocks = np.arange(0, len(amplitude_n), around)
    noise = [np.median(amplitude_n[begin : begin + around]) for begin in blocks]
    floor = np.interp(np.arange(len(amplitude_n)), blocks + around / 2, noise)
    least = np.maximum(_ABOVE_NOISE * floor, _LEAST_SHARE * amplitude_n.max())
    peaks, _ = find_peaks(amplitude_n, height=least, distance=max(1, round(_APART_HZ / step_hz)))
    peaks = peaks[spectrum.frequency_hz[peaks] > _lowest_hz(spectrum)]
    return np.sort(peaks[np.argsort(amplitude_n[peaks])[::-1][:_MOST_LINES]])


def _lowest_hz(spectrum: AmplitudeSpectrum) -> float:
    """Return the lowest frequency to show; below it are only drift and steps of the command."""
    return max(float(spectrum.frequency_hz[0]), float(spectrum.frequency_hz[-1]) / _SHOWN_RATIO)


def gaps_of(time_s: Array) -> Indices:
    """Return the samples after which the recording paused."""
    least = GAP * usual_step(time_s)
    least = least if _is_even(time_s) else max(least, _HOST_GAP_S)
    return np.concatenate([begin + np.flatnonzero(step > least) for begin, step in differences(time_s)])


def _is_even(time_s: Array) -> bool:
    return bool(min(step.min() for _, step in differences(time_s)) > _EVEN * usual_step(time_s))


def _evenly(time_s: Array, value: Array) -> tuple[Array, float]:
    """Return a segment on an even grid, and its rate in Hz.

    The box samples evenly, so if a computer stamped the arrivals, the order of the samples is the better clock.
    """
    step_s = float(np.polyfit(np.arange(len(time_s)), time_s, 1)[0])  # one late timestamp hardly changes the slope
    if _is_even(time_s):
        _, value = resample(time_s, value, step_s=step_s)
    return value, 1 / step_s


def _draw_axes(
    axes: Axes, record: WrenchRecord, values: Array, *, names: Sequence[str], title: str, y: str, factor: float = 1.0
) -> None:
    """Draw three axes (n, 3) times a factor: pale samples, and above them means that vibration does not hide."""
    time = record.time_s
    interval_s = usual_step(time) if _is_even(time) else float(time[-1] - time[0]) / (len(time) - 1)
    length = min(len(time), max(1, round(MEAN_S / interval_s), len(time) // _MOST_MEANS))
    name_panel(axes, f"{title}: samples (pale), and means over {1e3 * length * interval_s:.0f} ms", x=_TIME, y=y)
    pauses = [(time[after], time[after + 1] - time[after]) for after in gaps_of(time)]
    axes.broken_barh(pauses, (0.0, 1.0), transform=axes.get_xaxis_transform(), color=ALERT, alpha=0.25, lw=0.8)
    measured = [one for one in zip(values.T, SERIES, names, strict=False) if one[2] in record.axes]
    for column, colour, _ in measured:
        # The samples form a band of thousands of strokes; rasterizing it reduces the SVG to a third of the size.
        draw_line(axes, time, column, factor=factor, color=colour, alpha=0.3, lw=0.5, rasterized=True)
    for column, colour, name in measured:
        means = block_means(time, length=length), factor * block_means(column, length=length)
        axes.plot(*means, color=colour, lw=1.2, label=name)
    if measured:
        legend(axes)


def _draw_spectrum(axes: Axes, spectrum: AmplitudeSpectrum, axis: str) -> None:
    """Draw the spectrum on logarithmic axes, since rotors are in the lowest tenth of the range of a fast box."""
    frequency_hz, amplitude_n = spectrum
    title = f"(c) amplitude spectrum of {axis}, Hann windows of {1 / frequency_hz[0]:.2g} s"
    name_panel(axes, title, x="frequency (Hz)", y=f"amplitude ({'N' if axis.startswith('F') else 'Nm'})")
    highest = float(amplitude_n.max())
    if highest <= 0:
        return
    axes.loglog(frequency_hz, np.maximum(amplitude_n, _LEAST * highest), color=RECORDED, lw=0.7)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlim(_lowest_hz(spectrum), float(frequency_hz[-1]))
    axes.set_ylim(max(_LEAST * highest, float(np.median(amplitude_n)) / 3), highest * 10**_LABEL_DECADES)
    found = lines_of(spectrum)
    wanted = np.log(frequency_hz[found] / axes.get_xlim()[0]) / np.log(frequency_hz[-1] / axes.get_xlim()[0])
    for at, place in zip(found, _spread(wanted), strict=True):
        _label_line(axes, float(frequency_hz[at]), float(amplitude_n[at]), place)


def _label_line(axes: Axes, frequency_hz: float, amplitude_n: float, place: float) -> None:
    leader = {"arrowstyle": "-", "color": MUTED, "lw": 0.6, "shrinkA": 0, "shrinkB": 2}
    axes.annotate("", (frequency_hz, amplitude_n), xytext=(place, 0.9), textcoords="axes fraction", arrowprops=leader)
    axes.text(place, 0.98, f"{frequency_hz:.0f} Hz", transform=axes.transAxes, ha="center", va="top", size=8.5)


def _spread(wanted: Array) -> Array:
    """Return places along an axis, from 0 to 1, as near to the wanted places (n,) as the width of labels allows."""
    if not len(wanted):
        return wanted
    steps = _LABEL_WIDTH * np.arange(len(wanted))
    # Such places are steps plus a sequence that never falls; the nearest such sequence is midway between two bounds.
    free = wanted - steps
    level = (np.maximum.accumulate(free) + np.minimum.accumulate(free[::-1])[::-1]) / 2
    return np.asarray(np.clip(level, _LABEL_WIDTH / 2, 1 - _LABEL_WIDTH / 2 - steps[-1]) + steps)


def _facts(record: WrenchRecord) -> list[tuple[str, str]]:
    time, gaps = record.time_s, gaps_of(record.time_s)
    longest = longest_step(time)
    lost_s = float(np.sum(time[gaps + 1] - time[gaps]))
    rows = [
        ("samples", f"{len(time)} in {time[-1]:.2f} s"),
        ("mean rate", f"{(len(time) - 1) / time[-1]:.5g} Hz"),
        ("longest interval", f"{1e3 * (time[longest + 1] - time[longest]):.4g} ms after {time[longest]:.3f} s"),
        ("gaps", f"{len(gaps)}, {lost_s:.4g} s in all" if len(gaps) else "none"),
        ("lost", "unknown" if record.lost is None else f"{record.lost}"),
    ]
    for axis in record.axes:
        unit, factor = ("N", 1.0) if axis[0] == "F" else ("mNm", 1e3)
        mean, std = (factor * float(of(record.values_of(axis))) for of in (np.mean, np.std))
        rows.append((f"{axis}, mean ± std", plus_minus(mean, std, unit=unit)))
    return rows
