"""Check whether a fitted pendulum describes its record: misfit, waveform and drift against limits, and other findings.

The limits lie between the two public records that cfid is checked with: a good rig stays below each limit by a factor
of three or more, and a rig with a soft arm and a dragging cable exceeds the limit of the waveform.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cfid.estimate.signals import block_means
from cfid.findings import Finding, note, rejection, warning
from cfid.recordings.gyro import SCALE_STD
from cfid.swing.free_swing import FreeSwing
from cfid.swing.model import OutputError, motion_in_readings
from cfid.swing.uncertainty import CABLE_STD, DISC_STD_RAD

if TYPE_CHECKING:
    from cfid.swing.estimation import SwingFit

Array = npt.NDArray[np.float64]

MISFIT_LIMIT = 0.02
DISTORTION_LIMIT = 0.0015
DRIFT_LIMIT = 0.01
_UNUSUAL_STD = 4.0  # of the standard uncertainty that data sheets state for the scale of a gyro
_MOST_CABLE, _MOST_DISC_RAD = 2 * CABLE_STD, 5 * DISC_STD_RAD  # the latter is twice the worst data sheet's
_UNCERTAIN_LIMIT = 0.1  # of W: with more, the pendulum may have followed noise

_SHARE_THAT_MATTERS = 3e-4  # of W: far below the uncertainties of mass and distance
_LED_BY_HAND = 0.15  # of the release angle

_ALL = "swing.*"
_BLOCKS_A_PERIOD = 12


@dataclass(frozen=True, kw_only=True)
class FitQuality:
    """How well a pendulum describes its record; all figures are relative.

    `misfit` is the rms of the residual's block means over the start angle. `distortion` is the same after each period's
    own amplitude, phase and zero have been removed, which leaves the waveform. `drift` is the change of W from the
    first to the second half of the window, with its standard uncertainty `drift_std`.
    """

    misfit: float
    distortion: float
    distortion_limit: float
    drift: float
    drift_std: float

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The rejections, one for each exceeded limit."""
        found = []
        if not self.misfit <= MISFIT_LIMIT:
            found.append(
                rejection(
                    "swing-misfit",
                    f"the best pendulum misses the record by {_percent(self.misfit)} of the start angle (limit "
                    f"{_percent(MISFIT_LIMIT)}). Check the angle's unit, and that the body touched nothing.",
                    _ALL,
                )
            )
        if not self.distortion <= self.distortion_limit:
            found.append(
                rejection(
                    "swing-waveform-distorted",
                    f"within a period the motion differs from a pendulum's by {_percent(self.distortion)} of the "
                    f"start angle (limit {_percent(self.distortion_limit)}). Likely causes: a soft arm, a cable, a "
                    "loose mount, a hand; on threads, that they are not alike.",
                    _ALL,
                )
            )
        if not abs(self.drift) <= max(DRIFT_LIMIT, 4 * self.drift_std):
            found.append(
                rejection(
                    "swing-frequency-drift",
                    f"the natural frequency squared changes by {100 * self.drift:+.2g} % from the first half of the "
                    f"window to the second (limit {_percent(DRIFT_LIMIT)}). Tighten the mount, or use fewer peaks.",
                    _ALL,
                )
            )
        return tuple(found)


def judge(fit: OutputError, time_s: Array, *, resolution_rad: float, drift: float, drift_std: float) -> FitQuality:
    """Judge a fit to samples at `time_s` (n,) of an angle with the given resolution."""
    start = float(np.max(np.abs(fit.trajectory.angle_rad)))
    period = 2 * math.pi / math.sqrt(max(fit.coefficients.natural_frequency_squared_s2, 1e-9))
    block = max(int(len(time_s) * period / (time_s[-1] - time_s[0])) // _BLOCKS_A_PERIOD, 1)
    residual = fit.residual_rad
    noise_variance = float(np.mean(np.diff(residual) ** 2)) / 2
    distorted = block_means(_waveform_residual(fit, time_s, period), length=block)
    # Noise and the encoder's steps also contribute to the block means.
    allowed = (DISTORTION_LIMIT * start) ** 2 + 2 * noise_variance / block + resolution_rad**2 / 12
    return FitQuality(
        misfit=_rms(block_means(residual, length=block)) / start,
        distortion=_rms(distorted) / start,
        distortion_limit=math.sqrt(allowed) / start,
        drift=drift,
        drift_std=drift_std,
    )


def _waveform_residual(fit: OutputError, time_s: Array, period: float) -> Array:
    """Return the residual minus its best fit in each period by the model's reading, its derivative and a constant."""
    reading, slope = motion_in_readings(fit, time_s)
    left = fit.residual_rad.copy()
    edges = np.searchsorted(time_s, np.arange(time_s[0], time_s[-1], period))
    for first, last in zip(edges, [*edges[1:], len(time_s)], strict=True):
        part = slice(first, last)
        local = np.stack([reading[part], slope[part], np.ones(last - first)], axis=1)
        if last - first > 2 * local.shape[1]:
            left[part] -= local @ np.linalg.lstsq(local, left[part], rcond=None)[0]
    return left


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _percent(fraction: float) -> str:
    return f"{100 * fraction:.2g} %"


def findings_of(fit: "SwingFit") -> tuple[Finding, ...]:
    """Report a natural frequency squared that the record hardly determines, and what the rig adds to a pendulum."""
    frequency, std = fit.coefficients.natural_frequency_squared_s2, fit.std.natural_frequency_squared_s2
    found = []
    if std > _UNCERTAIN_LIMIT * frequency:
        text = (
            f"the natural frequency squared is uncertain by {_percent(std / frequency)} (limit "
            f"{_percent(_UNCERTAIN_LIMIT)}): the record is too short or too noisy. Release higher, swing longer; "
            "look at it with `cfid show`."
        )
        found.append(rejection("swing-uncertain", text, _ALL))
    if fit.output_error.setup.gyro_per_s is not None:
        return (*found, *_gyro_finding(*fit.instrument[:1]))
    push, disc_rad = fit.push_s2 / frequency, math.hypot(*fit.instrument)
    stiffness = max(fit.coefficients.spring_per_s2 / frequency, push)
    spring = f"{'a spring that pushes with' if push else 'a cable of'} {_percent(stiffness)} of gravity's stiffness"
    disc = f"an encoder that reads {math.degrees(disc_rad):.2g} degrees off within a turn"
    share = fit.budget_s2.get("cable or encoder", 0.0) / frequency
    limits = ((spring, stiffness > _MOST_CABLE), (disc, disc_rad > _MOST_DISC_RAD))
    if beyond := [what for what, exceeds in limits if exceeds]:
        text = (
            f"the period depends on the angle as with {' and '.join(beyond)} (limits {_percent(_MOST_CABLE)}, "
            f"{math.degrees(_MOST_DISC_RAD):.2g} degrees): check the angle's unit and the counts per turn; free the "
            "cable, centre the disc."
        )
        found.append(rejection("swing-no-gravity-pendulum", text, _ALL))
    elif share > _SHARE_THAT_MATTERS:
        text = (
            f"the period depends on the angle as with {spring} and {disc}: the record cannot separate the two, which "
            f"leaves the natural frequency squared uncertain by {_percent(share)}. Free the cable, centre the disc; "
            "release higher, swing longer."
        )
        found.append(warning("swing-cable-or-encoder", text, _ALL))
    return tuple(found)


def _gyro_finding(error: float) -> tuple[Finding, ...]:
    """Reject a gyro's scale error beyond those of working gyros."""
    limit = _UNUSUAL_STD * SCALE_STD
    if abs(error) <= limit:
        return ()
    text = (
        f"the gyro's scale is {_percent(error)} off, by how the period depends on the angle (usual: "
        f"{_percent(SCALE_STD)}, limit {_percent(limit)}): another range or unit than the log states, or no pendulum. "
        "Compare with a swing from another angle."
    )
    return (rejection("swing-gyro-scale", text, _ALL),)


def hand_finding(swing: FreeSwing, fit: OutputError) -> tuple[Finding, ...]:
    """Report motion just after the release that is not the pendulum's own."""
    measured = float(swing.angle_rad[swing.release])
    missed = abs(fit.start_angle_rad - measured)
    if swing.hand_gone == swing.release or missed < _LED_BY_HAND * abs(measured):
        return ()
    text = (
        f"between {swing.release_s:.2f} and {swing.time_s[swing.hand_gone]:.2f} s the body did not fall freely "
        f"(the pendulum would have started from {math.degrees(fit.start_angle_rad):.0f} degrees, "
        f"it stood at {math.degrees(measured):.0f}): this segment is left out. Release without a push."
    )
    return (note("swing-led-by-hand", text, "swing.start_angle_rad", "swing.start_speed_rad_per_s"),)
