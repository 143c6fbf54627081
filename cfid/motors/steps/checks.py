"""Why the lag of a step is not accepted: noise, a step too short to end, or readings too rare to show it."""

from cfid.findings import Finding, rejection
from cfid.motors.steps.model import Part

EXPLAINED = 0.95  # of the variance, r^2

_LOOSE = 0.2  # the standard uncertainty over the time constant
_SEEN = 0.5  # of the interval between readings: of a faster lag the fit finds one of several, or none
_HELD = 1.5  # time constants that a step needs to show where it leads


def rejections(part: Part, tau_s: float, std_s: float, explained: float) -> tuple[Finding, ...]:
    """Return why the time constant of a step, one of the rows of the key, is rejected."""
    key, hold_s = "dynamics.time_constant_s", part.step.until_s - part.step.at_s
    found = []
    if explained < EXPLAINED:
        text = f"a first-order lag explains only {100 * explained:.0f} % of this step (limit {100 * EXPLAINED:.0f} %)."
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
        text = f"noise leaves the time constant open by {100 * std_s / tau_s:.0f} % (limit {100 * _LOOSE:.0f} %)."
        found.append(rejection("step-lag-noisy", text, key))
    return tuple(found)
