"""Rotor speed from the vibration in a load cell's record, without a tachometer (figure 3.4 of the thesis).

A rotor shakes the cell at its own frequency (unbalance), at blade pass and at further harmonics, in every channel.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

from cfid.errors import FitError
from cfid.estimate.propagation import widened
from cfid.findings import Finding, note, rejection, texts, warning
from cfid.motors.vibration.spectrum import Comb, Family, LineFit, even_times, fit_lines, fit_parts, spectrum

Array = npt.NDArray[np.float64]

PLAUSIBLE_RAD_PER_S = (200.0, 5000.0)  # of rotors on a vehicle of some ten grams
FRAME_S = 1.0  # in which a speed that drifts by 0.5 % in ten seconds still makes one line
FEWEST = 64
KEY = "rotor.speed_rad_s"
EVIDENCE_LIMIT, _LINE = (
    20.0,
    8.0,
)  # evidence that rules out noise, even over thousands of speeds tried; evidence of a line worth fitting
_SURE = 5.0  # log odds against another octave
_HUMS, _BESIDE = 1e-3, 3.0  # share of its frequency within which hum stays; resolutions within which it spoils a line
_OCTAVES = np.array([1, 1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 2, 2, 3, 4])
_SAME, _ASIDE = 0.02, 0.4  # shares of a speed: within one, another speed is the same; within the other, more are sought
_CHANCE, _UNSTEADY = 1e-6, 0.05  # probability that noise does it; change over the window as a share of the speed
_PARTS, _FEWEST_PARTS, _TURNS = 8, 4, 24  # most and fewest parts that a window is cut into, and fewest turns in each
_SPLITS = (0.35, 0.7, 1.4)  # resolutions at the highest harmonic by which one line is split
_DISTINCT = 5.0  # standard deviations between speeds


class Rotor(NamedTuple):
    """A rotor's mean speed over the window, and the lines (h,) that it makes in the channels Fx to Tz.

    Channel c moves as the sum of amplitude[h, c] cos(harmonics[h] angle + phase_rad[h, c]); the angle is 0 mid-window.
    """

    speed_rad_per_s: float
    std_rad_per_s: float
    harmonics: tuple[int, ...]
    amplitude: Array
    phase_rad: Array


@dataclass(frozen=True, kw_only=True)
class RotorSpeed:
    """The rotors found in the vibration of a window, in ascending order of speed, and the mean of their speeds.

    `resolved` is false where fewer rotors than expected were found: the mean's standard uncertainty then allows for
    those that hide in one line. `wander_rad_per_s` is how far the speed strays from a straight line between parts of
    the window, 0 where noise explains that. A rejection among the `findings` concerns the speed of this window.
    """

    speed_rad_per_s: float
    std_rad_per_s: float
    rotors: tuple[Rotor, ...]
    resolved: bool
    wander_rad_per_s: float
    findings: tuple[Finding, ...]

    @property
    def accepted(self) -> bool:
        """Whether lines of a rotor stand clear of the noise and are read in the right octave."""
        return not texts(self.findings, "rejection")


def rotor_speed(
    *,
    time_s: Array,
    wrench: Array,
    expected_rad_per_s: tuple[float, float] | None = None,
    blades: int = 2,
    rotors: int = 1,
    mains_hz: float | None = None,
    rest_wrench: Array | None = None,
) -> RotorSpeed:
    """Return the speed of the rotors that shake a load cell in one steady window.

    The inputs are `time_s` (n,) and `wrench` (n, 6), in any unit per channel. `expected_rad_per_s` bounds the search.
    Where several `rotors` run within 40 % of one speed, they are separated as far as the window allows. Lines at
    multiples of `mains_hz`, and those in `rest_wrench` (k, 6), sampled alike with the rotors at rest, are
    not taken for a rotor's.

    The evidence for each speed is summed over its lines in an averaged spectrum; the best speed is refined by least
    squares over ever longer parts of the window. The uncertainty is the Cramer-Rao bound in the noise around the lines
    or, where the speed wanders by more, its scatter between parts of the window; the clock of the samples is taken as
    exact. A speed is rejected if the blade pass of another expected speed would lie above half the sampling rate.

    Raises FitError when the window is too short, or sampled too slowly for any rotor.
    """
    if len(time_s) < FEWEST:
        raise FitError(f"a window of {len(time_s)} samples is too short for a rotor speed: it takes {FEWEST} or more.")
    time, interval_s, jitter_s = even_times(time_s)
    clean, hum_hz = _without_hum(time, wrench, mains_hz, rest_wrench)
    between = expected_rad_per_s or PLAUSIBLE_RAD_PER_S
    found = _search(clean, interval_s, rotor_comb(blades), between)
    found.rejections.extend(aliased(interval_s, blades, between[1]))
    own_hz = {h: h * found.family.rad_per_s / (2 * math.pi) for h in found.family.harmonics}
    apart = tuple(h for h in own_hz if all(abs(own_hz[h] - hz) * (time[-1] - time[0]) > _BESIDE for hz in hum_hz))
    if hum_hz and (found.rejections or not apart):
        text = "lines at the mains hum, or present at rest too, were removed: the rotor's may be among them."
        found.rejections.append(rejection("vibration-lines-on-hum", text, KEY))
    family = found.family._replace(harmonics=apart or found.family.harmonics)
    fit = fit_lines(time_s=time, signal=clean, families=[family], first_s=FRAME_S)
    result = _result(time, clean, _with_more(time, clean, fit, rotors), found, rotors)
    text = f"time stamps jitter by {1e3 * jitter_s:.2g} ms: samples are taken as evenly spaced."
    return replace(result, findings=(*((note("time-stamps-jitter", text, KEY),) if jitter_s else ()), *result.findings))


def aliased(interval_s: float, blades: int, largest_rad_per_s: float) -> list[Finding]:
    """Return a rejection where sampling may fold the lines of another speed onto those that are seen, else nothing."""
    clear_rad_per_s = math.pi / (blades * interval_s)
    if largest_rad_per_s <= clear_rad_per_s:
        return []
    text = (
        f"at {1 / interval_s:.0f} samples a second blade pass of a rotor above {clear_rad_per_s:.0f} rad/s folds back "
        "and passes for another rotor: record faster, or state what speed is expected."
    )
    return [rejection("vibration-aliased", text, KEY)]


class _ChosenFamily(NamedTuple):
    family: Family
    rejections: list[Finding]


def rotor_comb(blades: int) -> Comb:
    """Return a rotor's lines: its own and blade pass are expected, others up to twice blade pass are possible."""
    return Comb(tuple(range(1, 2 * blades + 1)), (1, blades))


def _without_hum(time: Array, wrench: Array, mains_hz: float | None, rest: Array | None) -> tuple[Array, list[float]]:
    """Remove lines at frequencies of the mains or of the record at rest; return the remainder and these frequencies."""
    interval_s = float(np.median(np.diff(time)))
    seen = spectrum(signal=wrench, interval_s=interval_s)
    known = [] if mains_hz is None else list(np.arange(mains_hz, seen.frequency_hz[-1], mains_hz))
    if rest is not None:
        known += list(spectrum(signal=rest, interval_s=interval_s).lines_hz(evidence=EVIDENCE_LIMIT))
    there = seen.lines_hz(evidence=EVIDENCE_LIMIT)
    off_hz = np.abs(np.subtract.outer(there, known)).min(axis=1, initial=math.inf)
    hum = [Family(2 * math.pi * hz, (1,)) for hz in there[off_hz < _HUMS * there + 0.5 / seen.length_s]]
    if not hum:
        return wrench, []
    fit = fit_lines(time_s=time, signal=wrench, families=hum, drifting=False, first_s=FRAME_S)
    return fit.residual, [family.rad_per_s / (2 * math.pi) for family in fit.families]


def clear_lines(comb: Comb, lines: Array) -> tuple[int, ...]:
    """Return which lines (h,) of a candidate are worth fitting: the strongest, and all that are clear."""
    return tuple(h for h, line in zip(comb.harmonics, lines, strict=True) if line >= min(_LINE, lines.max()))


def _search(wrench: Array, interval_s: float, comb: Comb, between: tuple[float, float]) -> _ChosenFamily:
    """Find the best candidate in the whole window, and its speed in the middle, where the fit starts."""
    seen = spectrum(signal=wrench, interval_s=interval_s)
    grid = comb.candidates(seen, between)
    multiples = grid[np.argmax(comb.score(comb.lines(seen, grid)))] * _OCTAVES
    multiples = multiples[(grid[0] <= multiples) & (multiples <= grid[-1])]
    lines = comb.lines(seen, multiples)
    score = comb.score(lines)
    best, *rivals = np.argsort(score)[::-1]
    margin = float(score[best] - score[rivals[0]]) if rivals else math.inf
    rejections: list[Finding] = []
    if score[best] < EVIDENCE_LIMIT:
        text = f"no rotor shows in the vibration: the evidence is {score[best]:.0f} (limit {EVIDENCE_LIMIT:.0f})."
        rejections.append(rejection("vibration-no-rotor", text, KEY))
    elif margin < _SURE:
        other, one = multiples[[rivals[0], best]]
        text = f"the lines fit {other:.0f} rad/s as well as {one:.0f}: state what speed is expected."
        rejections.append(rejection("vibration-octave-ambiguous", text, KEY))
    length = round(len(wrench) / seen.windows)
    centre = spectrum(signal=wrench[(len(wrench) - length) // 2 :][:length], interval_s=interval_s)
    around = comb.candidates(seen, (multiples[best] * (1 - _SAME), multiples[best] * (1 + _SAME)))
    start = around[np.argmax(comb.score(comb.lines(centre, around)))]
    return _ChosenFamily(Family(float(start), clear_lines(comb, lines[:, best])), rejections)


def _with_more(time: Array, wrench: Array, fit: LineFit, rotors: int) -> LineFit:
    """Add rotors up to the requested number, as long as each lowers the residual by more than noise would."""
    freedom = 1 + 2 * len(fit.families[0].harmonics) * wrench.shape[1]
    for _ in range(1, rotors):
        starts = _more(time, fit)
        trials = [fit_lines(time_s=time, signal=wrench, families=s, drift_per_s=fit.drift_per_s) for s in starts]
        best = min(trials, key=lambda trial: fit.weight @ np.sum(trial.residual**2, axis=0))
        gain = best.weight @ np.sum(fit.residual**2 - best.residual**2, axis=0)
        speed = np.array([family.rad_per_s for family in best.families])
        gaps = np.diff(np.eye(len(speed) + 1)[np.argsort(speed)], axis=0)  # between neighbours; the drift has none
        distinct = gaps[:, :-1] @ speed > _DISTINCT * np.sqrt(np.diag(gaps @ best.covariance @ gaps.T))
        if chdtrc(freedom, gain) > _CHANCE or not distinct.all():
            break
        fit = best
    return fit


def _more(time: Array, fit: LineFit) -> Iterator[tuple[Family, ...]]:
    """Yield starts of a fit: with another rotor where the residual has its lines, or with two in place of one."""
    span_s, first = float(time[-1] - time[0]), fit.families[0]
    left = spectrum(signal=fit.residual, interval_s=span_s / (len(time) - 1), length_s=math.inf)
    comb = Comb(first.harmonics, first.harmonics)
    grid = comb.candidates(left, (first.rad_per_s * (1 - _ASIDE), first.rad_per_s * (1 + _ASIDE)))
    yield (first._replace(rad_per_s=grid[np.argmax(comb.score(comb.lines(left, grid)))]), *fit.families)
    for k, family in enumerate(fit.families):
        for split in _SPLITS:
            aside = math.pi * split / (span_s * max(first.harmonics))
            pair = [family._replace(rad_per_s=family.rad_per_s + way * aside) for way in (-1, 1)]
            yield (*fit.families[:k], *pair, *fit.families[k + 1 :])


def _result(time: Array, wrench: Array, fit: LineFit, found: _ChosenFamily, expected: int) -> RotorSpeed:
    rotors = [_rotor(fit, k) for k in range(len(fit.families))]
    count, span_s, wander = len(rotors), float(time[-1] - time[0]), 0.0
    speed = float(np.mean([rotor.speed_rad_per_s for rotor in rotors]))
    std = math.sqrt(fit.covariance[:count, :count].sum()) / count
    findings = list(found.rejections)
    parts = min(int(speed * span_s / (2 * math.pi * _TURNS)), _PARTS)
    if count < expected:
        hidden = 2 * math.pi / (span_s * max(rotors[0].harmonics))
        std = math.hypot(std, hidden / 6)  # the rotors' distance and their shares of the line are taken as uniform
        text = (
            f"{count} of {expected} rotors are resolved: the standard uncertainty allows for others in the same lines."
        )
        findings.append(warning("vibration-rotors-unresolved", text, KEY))
    elif count == 1 and parts >= _FEWEST_PARTS:
        departure, parts_std, evidence = fit_parts(time_s=time, signal=wrench, fit=fit, parts=parts)
        # Two things would pass for a change of speed: noise that is less flat than one part shows, as the whole window
        # reveals; and a part that locks onto noise, by chance or because it is too short for an estimate.
        parts_std = np.maximum(parts_std, std * parts**1.5)
        apart = np.sort((departure / parts_std) ** 2)[:-1].sum()
        if evidence.min() > EVIDENCE_LIMIT and chdtrc(parts - 3, apart) < _CHANCE:
            wander = float(np.std(departure, ddof=2))
            speed, std = speed + float(np.mean(departure)), widened(wander / math.sqrt(parts), parts - 2)
            rotors = [rotors[0]._replace(speed_rad_per_s=speed, std_rad_per_s=std)]
            text = f"the speed wanders by {wander:.2g} rad/s within the window, more than noise explains."
            findings.append(warning("vibration-speed-wanders", text, KEY))
    if abs(fit.drift_per_s) * span_s > _UNSTEADY:
        text = f"the speed changes by {100 * abs(fit.drift_per_s) * span_s:.0f} % within the window."
        findings.append(rejection("vibration-speed-drifts", text, KEY))
    return RotorSpeed(
        speed_rad_per_s=speed,
        std_rad_per_s=std,
        rotors=tuple(sorted(rotors, key=lambda rotor: rotor.speed_rad_per_s)),
        resolved=count == expected,
        wander_rad_per_s=wander,
        findings=tuple(findings),
    )


def _rotor(fit: LineFit, k: int) -> Rotor:
    speed, lines, std = fit.families[k].rad_per_s, fit.amplitude[k], math.sqrt(fit.covariance[k, k])
    return Rotor(speed, std, fit.families[k].harmonics, np.abs(lines), np.angle(lines))
