"""Find the segments where a thrust is steady: intervals and windows. Averages nothing.

An interval starts with a command, or where the thrust is seen to change. Thrust follows it after a delay, with a lag:
the onset (`onsets`). Five lags after that, it counts as steady if it also looks steady.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from cfid.counted import counted
from cfid.errors import DataError
from cfid.estimate.blocks import block_means
from cfid.estimate.signals import SMOOTHED_S, Runs, Slow, find_spikes, slowed
from cfid.large import PART_ROWS, differences, empty, stored
from cfid.lazy import later
from cfid.wire.rdt_status import Family, read_status

_find_peaks = later("scipy.signal", "find_peaks")  # imported only where no commands are known, because it takes long

Array = npt.NDArray[np.float64]
Words = npt.NDArray[np.uint32]
Four = tuple[int, int, int, int]

LAGS = 5  # after which 0.7 % of a step remains
CHANGE_SEEN_S = 0.25  # duration of the two means that are compared to find a change

_FEWEST, _SHORTEST_S = 64, 1.0
_THINNED_HZ, _SCREENED_S = 1000.0, 0.2  # the latter for spikes, at once
_FAMILIES: tuple[Family, ...] = ("netft", "axia")
_SLOWEST_READING_S = 1.0
_RESOLVED = 1e-6  # of a channel's range: otherwise, means of exact numbers would outweigh all others
_SURE = 6.0  # standard deviations of the noise
_OF_RANGE, _OF_LEVEL = 0.004, 0.02  # the least change, relative to the record's range and to its level
_PAUSE_OF_RANGE, _BACK, _BACK_TO = 0.015, 0.1, 0.5
_OWN_PEAK = 0.3  # of its height: a change that stands out less from its neighbours is a part of these
_FEWEST_BLOCKS, _MOST_BLOCKS = 3, 24


@dataclass(frozen=True, kw_only=True, eq=False)
class StandSignals:
    """Channels (k, m) without spikes at times (m,), averaged over `block` samples to about 1 kHz; smoothed thrust.

    `held` neighbours repeat one reading. `finest` (k,) is the least standard uncertainty of a mean.
    """

    time_s: Array
    value: Array
    rate_hz: float
    block: int
    slow: Slow
    thrust: int
    held: int
    finest: Array
    spikes: int


class Interval(NamedTuple):
    """Commands (None if unknown) that hold from one time to another; `pause` where no motor is on."""

    begin_s: float
    end_s: float
    pause: bool
    commands: Four | None = None


class Stretch(NamedTuple):
    """A steady window, or the reason why none was found between the two times."""

    begin_s: float
    end_s: float
    reason: str = ""


def prepared(time_s: Array, channels: Array, *, status: Words | None, thrust: int) -> StandSignals:
    """Check channels (n, k) at times (n,), whose `thrust` shows where motors run, and remove their spikes.

    Raises DataError for a record that is too short, out of order, not finite or faulty.
    """
    _check(time_s, channels, status)
    rate_hz = (len(time_s) - 1) / float(time_s[-1] - time_s[0])
    block = max(round(rate_hz / _THINNED_HZ), 1)
    time_s = stored(block_means(time_s, length=block))
    value = empty(channels.shape[1], len(time_s))
    spikes: set[int] = set()
    # One by one, because together they may not fit into memory.
    for means, channel in zip(value, channels.T, strict=True):
        spikes.update(_thin(channel, means, block=block, rate_hz=rate_hz))
    return StandSignals(
        time_s=time_s,
        value=value,
        rate_hz=rate_hz / block,
        block=block,
        slow=slowed(time_s, value[thrust], rate_hz=rate_hz / block),
        thrust=thrust,
        held=_held(value[thrust], rate_hz=rate_hz / block),
        finest=_RESOLVED * np.ptp(value, axis=1),
        spikes=len(spikes),
    )


def _thin(channel: Array, means: Array, *, block: int, rate_hz: float) -> list[int]:
    """Write the means (m,) of blocks of a channel (n,) without its spikes, and return the places of the spikes."""
    means[:] = block_means(channel, length=block)
    if not np.isfinite(means).all():
        raise DataError("the record has samples that are no numbers: cut those lines.")
    place, instead = _spikes(channel, length=max(round(_SCREENED_S * rate_hz), _FEWEST))
    whole = place < len(means) * block
    np.add.at(means, place[whole] // block, ((instead - channel[place]) / block)[whole])
    spikes: list[int] = np.unique(place).tolist()
    return spikes


def _spikes(channel: Array, *, length: int) -> tuple[npt.NDArray[np.intp], Array]:
    """Return places and replacements of a channel's spikes as `find_spikes` does, in parts if it is long.

    Parts overlap by two blocks of `length`, more than a limit depends on.
    """
    step = -(-PART_ROWS // length) * length
    found = []
    for begin in range(0, len(channel), step):
        low, end = max(begin - 2 * length, 0), begin + step
        part = np.ascontiguousarray(channel[low : end + 2 * length], np.float64)
        _, place, instead = find_spikes(part[np.newaxis], length=length)
        own = (low + place >= begin) & (low + place < end)
        found.append((low + place[own], instead[own]))
    places, values = zip(*found, strict=True)
    return np.concatenate(places), np.concatenate(values)


def _check(time_s: Array, channels: Array, status: Words | None) -> None:
    if len(time_s) != len(channels):
        raise DataError(f"{len(time_s)} times belong to {len(channels)} samples: they should be as many.")
    falls = next(
        (begin + int(np.argmin(step >= 0)) for begin, step in differences(time_s) if not np.all(step >= 0)), None
    )
    if falls is not None:
        raise DataError(f"after sample {falls + 1} the times do not rise: out of order, or two in one.")
    if len(time_s) < _FEWEST or np.ptp(time_s) < _SHORTEST_S:
        raise DataError(
            f"the record is too short: {counted(len(time_s), 'sample')}, where {_SHORTEST_S} s are the least."
        )
    if status is not None and status.any():
        _check_status(time_s, status)


def _check_status(time_s: Array, status: Words) -> None:
    """Raise DataError for words (n,) that state a fault in every known family of load cells."""
    bad = [word for word in np.unique(status).tolist() if all(read_status(word, family).faults for family in _FAMILIES)]
    faulty = np.flatnonzero(np.isin(status, bad))
    if len(faulty):
        raise DataError(
            f"{len(faulty)} of {len(status)} samples are saturated or faulty (status 0x{bad[0]:08x}), the first after "
            f"{time_s[faulty[0]] - time_s[0]:.3g} s: they are no forces. Load the cell less, or cut them off."
        )


def _held(value: Array, *, rate_hz: float) -> int:
    """Return the usual number of neighbours that repeat one reading, as for an instrument that is slower than its log.

    Values that repeat for longer than any instrument's reading are steady: simulated, or rounded by a coarse scale.
    """
    changes = np.concatenate([begin + np.flatnonzero(step) for begin, step in differences(value)])
    held = int(np.median(np.diff(changes))) if len(changes) > 1 else 1
    return held if held <= _SLOWEST_READING_S * rate_hz else 1


def commanded_intervals(command_time_s: Array, commands: Array, *, begin_s: float, end_s: float) -> list[Interval]:
    """Return the intervals of equal commands (m, 4), given from times (m,) on, within a record.

    Before the first command, all motors stand still; repeated commands count as one. Raises DataError for an invalid
    log.
    """
    if commands.shape != (len(command_time_s), 4):
        raise DataError(f"a command log of {len(command_time_s)} times needs as many rows of four: {commands.shape}.")
    if not (np.isfinite(commands).all() and (commands >= 0).all() and (np.diff(command_time_s) >= 0).all()):
        raise DataError("the command log has commands that are no numbers or below zero, or its times do not rise.")
    times = np.concatenate([[-math.inf], command_time_s])
    rows = np.vstack([np.zeros(4), commands]).astype(int)
    changes = np.flatnonzero(np.append(True, (np.diff(rows, axis=0) != 0).any(axis=1)))
    ends = pairwise(np.append(times[changes].clip(begin_s, end_s), end_s).tolist())
    fours = [(row[0], row[1], row[2], row[3]) for row in rows[changes].tolist()]
    return [Interval(*each, not any(four), four) for each, four in zip(ends, fours, strict=True) if each[1] > each[0]]


def changes_seen(slow: Slow) -> list[Interval]:
    """Return the intervals between fast changes of a smoothed thrust, without their commands.

    A change is a peak of the difference between the means of a quarter of a second after and before. It exceeds the
    noise and parts of the record's range and of its level there, which excludes a sagging battery, and stands out from
    its neighbours, which excludes a ramp.
    """
    step_s = (slow.time_s[-1] - slow.time_s[0]) / (len(slow.time_s) - 1)
    width, gap = max(round(CHANGE_SEEN_S / step_s), 2), math.ceil(SMOOTHED_S / step_s / 2)
    steps = median_filter(slow.value, size=4 * gap + 1, mode="nearest")  # the rest of a removed spike is not a change
    total = np.concatenate([[0.0], np.cumsum(steps)])
    mean = (total[width:] - total[:-width]) / width
    before, after = mean[: -width - 2 * gap], mean[width + 2 * gap :]
    change, noise, span = np.abs(after - before), _noise(slow, width, 2 * gap - 1), np.ptp(before)
    least = np.maximum(_OF_LEVEL * np.abs(before - before[0]), max(_SURE * noise, _OF_RANGE * span))
    peaks, shape = _find_peaks(change, height=least, prominence=_SURE * noise, distance=width)
    peaks = peaks[shape["prominences"] > _OWN_PEAK * change[peaks]]
    times = [float(slow.time_s[0]), *slow.time_s[peaks + width + gap].tolist(), float(slow.time_s[-1])]
    levels = [level(slow, begin, end) for begin, end in pairwise(times)]
    pauses = _pauses(levels, near=max(_SURE / 2 * noise, _PAUSE_OF_RANGE * span))
    return [Interval(begin, end, pause) for (begin, end), pause in zip(pairwise(times), pauses, strict=True)]


def level(slow: Slow, begin_s: float, end_s: float) -> float:
    """Return the median of the second half of an interval, or the nearest sample."""
    first, last = np.searchsorted(slow.time_s, ((begin_s + end_s) / 2, end_s))
    return float(np.median(slow.value[min(first, len(slow.value) - 1) : max(last, first + 1)]))


def _pauses(levels: Sequence[float], *, near: float) -> list[bool]:
    """Return which levels are of pauses: the first, and those that are close to the level of the last pause.

    The last level is also a pause where it undoes nine tenths of the one before, or falls to half of the lowest level
    of a staircase: the load cell may have drifted.
    """
    baseline, pauses = levels[0], [True]
    for here in levels[1:]:
        pauses.append(abs(here - baseline) < near)
        baseline = here if pauses[-1] else baseline
    *others, last = [abs(each - baseline) for each, pause in zip(levels, pauses, strict=True) if not pause] or [0.0]
    pauses[-1] |= bool(others) and last < max(_BACK * others[-1], _BACK_TO * min(others) * (len(others) > 2))
    return pauses


def _noise(slow: Slow, width: int, apart: int) -> float:
    """Return the standard deviation of the difference of two means of `width` samples, for white noise.

    It is estimated from second differences of samples `apart`, which are means over two thirds of that; steps and
    slopes hardly affect these.
    """
    bend = float(np.median(np.abs(np.diff(slow.value[::apart], n=2))))
    return 1.4826 * bend / math.sqrt(6) * math.sqrt(2 * max(apart * 2 / 3, 1) / width)


def steady_stretch(
    slow: Slow,
    window: tuple[float, float],
    *,
    drift: float,
    wave: float,
    hold_s: float,
    height: float | None = None,
    fewest: int = _FEWEST_BLOCKS,
) -> Stretch:
    """Return the longest steady segment in a window of a smoothed thrust whose samples repeat for `hold_s`.

    A segment is steady if it would change by at most `drift` over the whole window, and its variation about that line
    is at most `wave`. The whole window may also change as much as its noise explains, and vary if von Neumann's ratio
    [vN] identifies that as white; a part of it must be steady beyond noise, and at least a quarter of the window. A
    window shorter than three readings, or blocks of 50 ms, is not steady, unless `fewest` accepts it. The reason states
    parts of a step's `height` if that is given.
    """
    from_s, to_s = window
    block_s = max(SMOOTHED_S, hold_s, (to_s - from_s) / _MOST_BLOCKS)
    inside = slow.between(from_s, to_s)
    count = min(max(round((to_s - from_s) / block_s), 0), len(inside.value))
    if count < _FEWEST_BLOCKS:
        left = f"{len(inside.value)} samples in " if block_s * len(inside.value) < to_s - from_s else ""
        short = f"only {left}{max(to_s - from_s, 0):.2g} s of it are left after {LAGS} time constants"
        return Stretch(from_s, max(from_s, to_s), short if count < fewest else "")
    length = len(inside.value) // count
    runs = Runs.of(block_means(inside.value, length=length)[:count], fewest=_FEWEST_BLOCKS)
    whole = runs.size == count
    change, spread = np.abs(runs.slope) * count, runs.slope_std * count
    flat = np.where(whole, (change <= drift) | (change <= 3 * spread), change + 2 * spread <= drift)
    steady = flat & ((runs.wave <= wave) | whole & (runs.alike <= 3)) & (4 * runs.size >= count)
    if not steady.any():
        changed, waved = (_of_height(float(part[whole][0]), height) for part in (change, runs.wave))
        much = f"changes by {changed} in {to_s - from_s:.2g} s, {waved} about a line"
        return Stretch(from_s, to_s, f"{LAGS} time constants after its onset it still {much}")
    best = int(np.argmax(np.where(steady, runs.size * count + runs.first, -1)))
    first, last = runs.first[best], runs.first[best] + runs.size[best]
    end_s = to_s if last == count else float(inside.time_s[last * length])
    return Stretch(float(inside.time_s[first * length]), end_s)


def _of_height(value: float, height: float | None) -> str:
    return f"{value:.2g}" if height is None else f"{100 * value / height:.2g} % of its height"
