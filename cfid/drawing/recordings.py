"""Draw recordings: an angle, forces and torques with their spectrum, and any device's columns over time."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import find_peaks, savgol_filter, welch

from cfid.drawing.numbers import plus_minus
from cfid.drawing.style import (
    ALERT,
    INK,
    MUTED,
    RECORDED,
    SERIES,
    draw_line,
    figure,
    legend,
    name_panel,
    styled,
    thinned,
    words,
)
from cfid.estimate.signals import GRID_S, block_means, resample
from cfid.large import PART_ROWS, differences, longest_step, parts, some_steps, usual_step
from cfid.recordings.angle import AngleRecord
from cfid.recordings.wrench import AXES, WrenchRecord

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

MEAN_S = 0.05  # duration of each drawn mean of forces: several turns of the slowest rotor

_TIME = "time (s)"
_GAP = 10  # usual intervals without a sample that count as a gap
_BINS = 60  # of the histogram of intervals
_TURNS_FROM = 2  # an angle that spans more turns than this is drawn in turns
_SMOOTHED = 9  # samples of the grid in each parabola of the speed
_MOST_MEANS = 1000

# Of times
_HOST_GAP_S = 0.1  # least gap between arrival times at a computer, which may be late by tens of milliseconds
_EVEN = 0.5  # of the usual interval: if no interval is shorter, the times are those of the box

# Of a spectrum
_RESOLUTION_S = 1.0  # length of the segments whose spectra are averaged; rotors do not hold a speed for longer
_SHORTEST = 16  # samples in a segment
_MOST_LINES = 5
_ABOVE_NOISE = 8.0  # least ratio of a line to the median of the spectrum around it
_AROUND_HZ = 100.0
_APART_HZ = 12.0  # between two labelled lines
_LEAST_SHARE = 0.02  # of the highest line: lower lines are not labelled
_SHOWN_RATIO = 350.0  # highest over lowest frequency shown: from 10 Hz at 7 kHz
_LEAST = 1e-5  # of the highest amplitude: lower amplitudes are not shown
_LABEL_DECADES = 0.9  # space for the labels above the highest line
_LABEL_WIDTH = 0.085  # of the panel's width, from one label to the next

# Of any device's columns
_PANEL_IN = 1.9
_MOST_PANELS = 8
_HELD = re.compile(r"m[1-4]")  # a command holds until the next one
_COUNTERS = ("vehicle_us", "vehicle_ms", "report", "sample")  # straight lines, useful only to programs
_WIDE = 40  # characters of names up to which title and legend fit next to each other
_FEW = 400  # rows: below this number, each row is marked


def _draw_intervals(axes: Axes, time_s: Array, *, usual_s: float, letter: str) -> None:
    """Draw the histogram of the intervals between times (n,) in s, of which `usual_s` is the usual one."""
    name_panel(axes, f"({letter}) sampling intervals", x="interval (ms)", y="count (-)")
    low = 1e3 * min(float(step.min()) for _, step in differences(time_s))
    high = 1e3 * max(float(step.max()) for _, step in differences(time_s))
    # With an even clock, the intervals differ only by rounding, and bins as narrow as that would show nothing.
    room = max(0.0, 0.1 * 1e3 * usual_s - (high - low)) / 2
    edges = np.histogram_bin_edges([], bins=_BINS, range=(low - room, high + room))
    counts = sum(np.histogram(1e3 * step, bins=edges)[0] for _, step in differences(time_s))
    axes.hist(edges[:-1], bins=edges.tolist(), weights=counts, color=RECORDED, lw=0)
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.7)


def _draw_gaps(axes: Axes, time_s: Array, gaps: Indices) -> None:
    pauses = [(time_s[after], time_s[after + 1] - time_s[after]) for after in gaps]
    axes.broken_barh(pauses, (0.0, 1.0), transform=axes.get_xaxis_transform(), color=ALERT, alpha=0.25, lw=0.8)


def _longest_interval(time_s: Array) -> tuple[str, str]:
    after = longest_step(time_s)
    return "longest interval", f"{1e3 * (time_s[after + 1] - time_s[after]):.4g} ms after {time_s[after]:.3f} s"


def _longer_steps(time_s: Array, least_s: float) -> Indices:
    """Return the samples after which a recording paused for longer than a time."""
    return np.concatenate([begin + np.flatnonzero(step > least_s) for begin, step in differences(time_s)])


# An angle


@styled
def recording_figure(record: AngleRecord, *, title: str) -> Figure:
    """Return angle, speed and sampling intervals of a record, with the reader's notes above."""
    time = record.time_s
    page, grid = figure(3, 2, heights_in=(2.3, 1.8, 1.9), title=title, notes=record.notes)
    gaps = _longer_steps(time, _GAP * usual_step(time))  # none if time never advances
    usual_s, span = float(np.median(some_steps(time))), float(np.ptp(record.angle_rad))
    in_turns = span > 2 * np.pi * _TURNS_FROM

    angle = page.add_subplot(grid[0, :])
    name_panel(angle, "(a) recording", x=_TIME, y="angle (turns)" if in_turns else "angle (°)")
    _draw_gaps(angle, time, gaps)
    factor = 1 / (2 * np.pi) if in_turns else 180 / np.pi
    draw_line(angle, time, record.angle_rad, factor=factor, color=RECORDED, lw=0.9)
    angle.margins(y=0.08)

    _draw_speed(page.add_subplot(grid[1, :]), record, step_s=max(GRID_S, usual_s))
    _draw_intervals(page.add_subplot(grid[2, 0]), time, usual_s=usual_s, letter="c")
    duration = float(time[-1])
    facts = [
        ("samples", f"{len(time)}"),
        ("duration", f"{duration:.2f} s"),
        ("mean rate", f"{(len(time) - 1) / duration:.5g} Hz" if duration > 0 else "-"),
        ("median interval", f"{1e3 * usual_s:.4g} ms"),
        _longest_interval(time),
        ("gaps", f"{len(gaps)} over {_GAP} median intervals" if len(gaps) else "none"),
        ("repeated times", f"{sum(int(np.count_nonzero(step == 0)) for _, step in differences(time))}"),
        ("angle's range", f"{span / (2 * np.pi):.4g} turns" if in_turns else f"{np.degrees(span):.4g}°"),
    ]
    words(page.add_subplot(grid[2, 1]), "in numbers", facts, red=("gaps",) if len(gaps) else ())
    page.align_ylabels()
    return page


def _draw_speed(axes: Axes, record: AngleRecord, *, step_s: float) -> None:
    """Draw the speed as the slope of a parabola through neighbouring samples; plain differences are mostly noise."""
    name_panel(axes, f"(b) speed, smoothed over {1e3 * step_s * _SMOOTHED:.0f} ms", x=_TIME, y="speed (rad/s)")
    pieces = []
    for part in parts(len(record.time_s)):
        grid, angle = resample(record.time_s[part], record.angle_rad[part], step_s=step_s)
        if len(grid) >= _SMOOTHED:
            pieces.append(thinned(grid, savgol_filter(angle, _SMOOTHED, 2, deriv=1, delta=step_s)))
    if pieces:
        axes.axhline(0.0, color=MUTED, lw=0.8)
        axes.plot(*(np.concatenate(piece) for piece in zip(*pieces, strict=True)), color=INK, lw=0.7)
        axes.margins(y=0.08)


# Forces and torques


class AmplitudeSpectrum(NamedTuple):
    """Amplitudes (n,) in N of a sine wave at each frequency (n,)."""

    frequency_hz: Array
    amplitude_n: Array


@styled
def wrench_figure(record: WrenchRecord, *, title: str) -> Figure:
    """Return forces, torques, the spectrum of the main axis and sampling intervals, with the reader's notes above."""
    time, gaps = record.time_s, gaps_of(record.time_s)
    page, grid = figure(4, 2, heights_in=(2.1, 2.1, 2.3, 2.3), title=title, notes=record.notes)
    forces, torques = page.add_subplot(grid[0, :]), page.add_subplot(grid[1, :])
    _draw_axes(forces, record, record.force_n, names=AXES[:3], title="(a) forces", y="force (N)")
    _draw_axes(torques, record, record.torque_nm, names=AXES[3:], title="(b) torques", y="torque (mNm)", factor=1e3)
    for axes in (forces, torques):
        _draw_gaps(axes, time, gaps)
    spectrum = spectrum_of(time, record.values_of(record.main_axis))
    _draw_spectrum(page.add_subplot(grid[2, :]), spectrum, record.main_axis)
    _draw_intervals(page.add_subplot(grid[3, 0]), time, usual_s=usual_step(time), letter="d")
    lost_s = float(np.sum(time[gaps + 1] - time[gaps]))
    facts = [
        ("samples", f"{len(time)} in {time[-1]:.2f} s"),
        ("mean rate", f"{(len(time) - 1) / time[-1]:.5g} Hz"),
        _longest_interval(time),
        ("gaps", f"{len(gaps)}, {lost_s:.4g} s in all" if len(gaps) else "none"),
        ("lost", "unknown" if record.lost is None else f"{record.lost}"),
    ]
    for axis in record.axes:
        unit, factor = ("N", 1.0) if axis[0] == "F" else ("mNm", 1e3)
        mean, std = (factor * float(of(record.values_of(axis))) for of in (np.mean, np.std))
        facts.append((f"{axis}, mean ± std", plus_minus(mean, std, unit=unit)))
    red = [name for name, count in (("gaps", len(gaps)), ("lost", record.lost)) if count]
    words(page.add_subplot(grid[3, 1]), "in numbers", facts, red=red)
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
    time_s, value = time_s[first : first + count], value[first : first + count]
    step_s = float(np.polyfit(np.arange(len(time_s)), time_s, 1)[0])  # one late timestamp hardly changes the slope
    # The box samples evenly, so if a computer stamped the arrivals, the order of the samples is the better clock.
    even = resample(time_s, value, step_s=step_s)[1] if _is_even(time_s) else value
    length = min(len(even), max(_SHORTEST, round(_RESOLUTION_S / step_s)))
    frequency_hz, power = welch(even, 1 / step_s, window="hann", nperseg=length, detrend="constant", scaling="spectrum")
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
    """Return the samples of a load cell's record after which the recording paused."""
    least_s = _GAP * usual_step(time_s)
    return _longer_steps(time_s, least_s if _is_even(time_s) else max(least_s, _HOST_GAP_S))


def _is_even(time_s: Array) -> bool:
    return bool(min(step.min() for _, step in differences(time_s)) > _EVEN * usual_step(time_s))


def _draw_axes(
    axes: Axes, record: WrenchRecord, values: Array, *, names: Sequence[str], title: str, y: str, factor: float = 1.0
) -> None:
    """Draw three axes (n, 3) times a factor: pale samples, and above them means that vibration does not hide."""
    time = record.time_s
    interval_s = usual_step(time) if _is_even(time) else float(time[-1] - time[0]) / (len(time) - 1)
    length = min(len(time), max(1, round(MEAN_S / interval_s), len(time) // _MOST_MEANS))
    name_panel(axes, f"{title}: samples (pale), and means over {1e3 * length * interval_s:.0f} ms", x=_TIME, y=y)
    measured = [axis for axis in zip(values.T, SERIES, names, strict=False) if axis[2] in record.axes]
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
    lines = lines_of(spectrum)
    wanted = np.log(frequency_hz[lines] / axes.get_xlim()[0]) / np.log(frequency_hz[-1] / axes.get_xlim()[0])
    leader = {"arrowstyle": "-", "color": MUTED, "lw": 0.6, "shrinkA": 0, "shrinkB": 2}
    for at, place in zip(lines, _spread(wanted), strict=True):
        peak = float(frequency_hz[at]), float(amplitude_n[at])
        axes.annotate("", peak, xytext=(place, 0.9), textcoords="axes fraction", arrowprops=leader)
        axes.text(place, 0.98, f"{peak[0]:.0f} Hz", transform=axes.transAxes, ha="center", va="top", size=8.5)


def _spread(wanted: Array) -> Array:
    """Return places along an axis, from 0 to 1, as near to the wanted places (n,) as the width of labels allows."""
    if not len(wanted):
        return wanted
    steps = _LABEL_WIDTH * np.arange(len(wanted))
    # Such places are steps plus a sequence that never falls; the nearest such sequence is midway between two bounds.
    free = wanted - steps
    level = (np.maximum.accumulate(free) + np.minimum.accumulate(free[::-1])[::-1]) / 2
    return np.asarray(np.clip(level, _LABEL_WIDTH / 2, 1 - _LABEL_WIDTH / 2 - steps[-1]) + steps)


# Any device


@styled
def device_figure(
    time_s: Array, columns: Mapping[str, Array], *, title: str, notes: Sequence[str], along: str = _TIME
) -> Figure:
    """Return a figure with a panel for each group of columns (n,) that differ only by a number, over times (n,) in s.

    Commands are steps; counters are drawn only if there is nothing else. `along` names the horizontal axis if it shows
    no times. A group with more columns than colours shows the first ones.
    """
    groups: dict[str, list[str]] = {}
    for name in [name for name in columns if name not in _COUNTERS] or columns:
        groups.setdefault(re.sub(r"\d", "", name), []).append(name)
    panels = list(groups.values())[:_MOST_PANELS]
    page, grid = figure(len(panels), 1, heights_in=[_PANEL_IN] * len(panels), title=title, notes=notes)
    since_s = time_s - time_s[0]
    for row, names in enumerate(panels):
        axes = page.add_subplot(grid[row, 0])
        drawn = names[: len(SERIES)]
        whole = ", ".join(drawn)
        # Of long names, only the numbers in which they differ.
        labels = drawn if len(whole) <= _WIDE else [" ".join(re.findall(r"\d+", name)) or name for name in drawn]
        for colour, name, label in zip(SERIES, drawn, labels, strict=False):
            how: dict[str, Any] = {"drawstyle": "steps-post"} if _HELD.fullmatch(name) else {}
            mark = "." if len(since_s) < _FEW and not how else ""
            draw_line(axes, since_s, columns[name], color=colour, label=label, marker=mark, **how)
        panel_title = whole if len(drawn) == 1 or len(whole) <= _WIDE else f"{drawn[0]} to {labels[-1]}"
        panel_title += "" if len(drawn) == len(names) else f", of {len(names)}"
        name_panel(axes, panel_title, x=along if row == len(panels) - 1 else "", y="")
        if len(names) > 1:
            legend(axes)
    page.align_ylabels()
    return page
