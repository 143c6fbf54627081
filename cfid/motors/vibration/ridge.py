"""A rotor's speed over time, through steps and ramps, from the vibration in a load cell's record."""

import math
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from cfid.errors import FitError
from cfid.motors.vibration.estimation import (
    EVIDENCE_LIMIT,
    FEWEST,
    PLAUSIBLE_RAD_PER_S,
    aliased,
    clear_lines,
    rotor_comb,
)
from cfid.motors.vibration.spectrum import Family, even_times, fit_lines, spectrum

Array = npt.NDArray[np.float64]

_BENT = 0.1  # share of the change of speed within a window by which a straight line may miss its mean


class SpeedRidge(NamedTuple):
    """A rotor's speed at times (f,), the middles of windows; NaN where the evidence shows none."""

    time_s: Array
    speed_rad_per_s: Array
    std_rad_per_s: Array
    evidence: Array


def speed_ridge(
    *,
    time_s: Array,
    wrench: Array,
    window_s: float,
    step_s: float,
    expected_rad_per_s: tuple[float, float] | None = None,
    blades: int = 2,
    largest_rate_rad_per_s2: float = 4e4,
) -> SpeedRidge:
    """Return a rotor's speed over time, through steps and ramps, in windows of `window_s` every `step_s`.

    `time_s` (n,) and `wrench` (n, 6) are as for `rotor_speed`. Among all courses of speed that change no faster than
    `largest_rate_rad_per_s2`, dynamic programming (Viterbi) finds the one with the most evidence. Each window then
    gives its speed by least squares, with its own drift: a mean over the window, weighted with a parabola. Windows
    longer than a rotor's time constant blur its steps; windows that overlap share their noise.

    Raises FitError for windows that are too short, and where blade pass may lie above half the sampling rate.
    """
    time, interval_s, _ = even_times(time_s)
    length = round(window_s / interval_s)
    frames = [slice(begin, begin + length) for begin in range(0, len(time) - length + 1, round(step_s / interval_s))]
    if length < FEWEST or len(frames) < 2:
        raise FitError(f"{len(frames)} windows of {length} samples: it takes two or more, of {FEWEST} or more.")
    between = expected_rad_per_s or PLAUSIBLE_RAD_PER_S
    for finding in aliased(interval_s, blades, between[1]):
        raise FitError(finding.text)
    look, comb = partial(spectrum, interval_s=interval_s, length_s=window_s), rotor_comb(blades)
    grid = comb.candidates(look(signal=wrench[:length]), between)
    lines = [comb.lines(look(signal=wrench[frame]), grid) for frame in frames]
    score = np.array([comb.score(line) for line in lines])
    path = _path(score, reach=max(int(largest_rate_rad_per_s2 * step_s / (grid[1] - grid[0])), 1))
    drift_per_s = np.gradient(grid[path], step_s) / grid[path]
    speed, std = np.full((2, len(frames)), math.nan)
    for k, (frame, best) in enumerate(zip(frames, path, strict=True)):
        if score[k, best] > EVIDENCE_LIMIT:
            family = Family(grid[best], clear_lines(comb, lines[k][:, best]))
            own = time[frame] - (time[frame][0] + time[frame][-1]) / 2
            fit = fit_lines(time_s=own, signal=wrench[frame], families=[family], drift_per_s=drift_per_s[k])
            if abs(fit.families[0].rad_per_s - grid[best]) * window_s * max(family.harmonics) < math.pi:
                speed[k], std[k] = fit.families[0].rad_per_s, math.sqrt(fit.covariance[0, 0])
    change = np.gradient(np.where(np.isnan(speed), grid[path], speed), step_s) * window_s
    middles = np.array([(time_s[frame][0] + time_s[frame][-1]) / 2 for frame in frames])
    return SpeedRidge(middles, speed, np.hypot(std, _BENT * change), score[np.arange(len(path)), path])


def _path(score: Array, reach: int) -> npt.NDArray[np.intp]:
    """Return the candidates (f,) on the path with the most evidence (f, g) that moves by `reach` per frame at most."""
    hurry = np.log1p(np.arange(-reach, reach + 1.0) ** 2)
    best, came = score[0], []
    for here in score[1:]:
        moves = sliding_window_view(np.pad(best, reach, constant_values=-math.inf), 2 * reach + 1) - hurry
        came.append(moves.argmax(axis=1) + np.arange(len(best)) - reach)
        best = here + moves.max(axis=1)
    path = [int(best.argmax())]
    for step in reversed(came):
        path.append(int(step[path[-1]]))
    return np.array(path[::-1])
