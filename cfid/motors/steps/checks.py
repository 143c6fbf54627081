"""Why the lag of a step is rejected: noise, a step that was held too short, readings too far apart, a wrong speed."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from cfid.findings import Finding, rejection
from cfid.motors.steps.model import CommandStep, Lag, Part

EXPLAINED = 0.95  # of the variance, r^2

_LOOSE = 0.2  # the standard uncertainty over the time constant
_SEEN = 0.5  # of the interval between readings: for a faster lag the fit finds one of several solutions, or none
_ODD, _USUAL = (
    0.1,
    0.03,
)  # shares of the largest speed: far off the other commands' speeds, and the scatter that a sagging battery causes
_FEWEST, _MOST_ODD, _SETTLED = 6, 0.3, 5.0  # fewest steps that show a map, largest share of them off it; time constants
_HELD = 1.5  # time constants that a step needs to show where it leads


def rejections(part: Part, tau_s: float, std_s: float, explained: float) -> tuple[Finding, ...]:
    """Return why the time constant of a step, one of the rows of the key, is rejected."""
    key, hold_s = "dynamics.time_constant_s", part.step.until_s - part.step.at_s
    found = []
    if explained < EXPLAINED:
        share = f"only {100 * explained:.0f} %" if explained > 0 else "nothing"
        text = f"a first-order lag explains {share} of this step (limit {100 * EXPLAINED:.0f} %)."
        found.append(rejection("step-lag-misfit", text, key))
    if hold_s < _HELD * tau_s:
        text = f"it held for only {hold_s / tau_s:.1f} time constants (limit {_HELD:g}): its final speed is not known."
        found.append(rejection("step-held-too-short", text, key))
    if tau_s < _SEEN * part.interval_s:
        text = (
            f"the speed settled between two readings, {1e3 * part.interval_s:.0f} ms apart: they do not show how fast. "
            "Record speeds faster."
        )
        found.append(rejection("step-lag-unseen", text, key))
    elif not std_s < _LOOSE * tau_s:
        by = f"by {100 * std_s / tau_s:.0f} % (limit {100 * _LOOSE:.0f} %)" if np.isfinite(std_s) else "altogether"
        text = f"noise leaves the time constant open {by}."
        found.append(rejection("step-lag-noisy", text, key))
    return tuple(found)


def off_the_map(steps: Sequence[CommandStep], lags: Sequence[Lag], accepted: Sequence[bool]) -> npt.NDArray[np.bool_]:
    """Return which steps (n,) begin or end at a speed far off that of the others' commands, as with a faulty sensor.

    The accepted steps show the map, and only they are judged. The speed at which a step begins counts where the
    previous command held until the rotor followed it. No step is returned where few steps show a map, or where many are
    off it.
    """
    settled = [step.at_s - step.since_s > _SETTLED / lag.linear for step, lag in zip(steps, lags, strict=True)]
    ends = np.array([[step.command_to, lag.end] for step, lag in zip(steps, lags, strict=True)])
    begins = np.array([[step.command_from, lag.begin] for step, lag in zip(steps, lags, strict=True)])
    driven = ends[(ends[:, 0] > 0) & accepted]
    none = np.zeros(len(steps), bool)
    if len(driven) < _FEWEST:
        return none
    largest = float(driven[:, 1].max())
    order = min(2, len(np.unique(driven[:, 0])) - 1)

    def misses(points: npt.NDArray[np.float64], p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return np.asarray(np.polyval(p, points[:, 0] / driven[:, 0].max()) - points[:, 1] / largest)

    start = np.append(np.zeros(order), 0.5)
    fit = least_squares(lambda p: misses(driven, p), start, loss="cauchy", f_scale=_USUAL)
    off = (ends[:, 0] > 0) & (np.abs(misses(ends, fit.x)) > _ODD)
    off |= (begins[:, 0] > 0) & settled & (np.abs(misses(begins, fit.x)) > _ODD)
    off &= np.array(accepted)
    return off if np.sum(off) <= _MOST_ODD * np.sum(accepted) else none
