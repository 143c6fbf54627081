"""Whether a fitted pendulum describes its record: residual, waveform and steadiness, each with its figure.

A wrong number that looks confident is the worst a tool can print, so a swing must pass three tests. Their
limits stand between the two public records that cfid is checked with: a sound rig passes each of them by a
factor of three or more, and one with a soft arm and a dragging cable fails.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.estimate.blocks import block_means
from cfid.swing.model import OutputError, sample

Array = npt.NDArray[np.float64]

BELIEVED_MISFIT = 0.02
BELIEVED_DISTORTION = 0.0015
BELIEVED_DRIFT = 0.01

_BLOCKS_A_PERIOD = 12


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Figures, each relative, and what they mean.

    `misfit`: rms of the residual's block means over the start angle. `distortion`: the same after each
    period's own amplitude, phase and zero have been taken out, that is the waveform alone. `drift`: change
    of W from the first to the second half of the window, with one standard deviation `drift_std`.
    """

    misfit: float
    distortion: float
    distortion_limit: float
    drift: float
    drift_std: float

    @property
    def doubts(self) -> tuple[str, ...]:
        """Return the reasons, as sentences, why the model does not describe the data; none if it does."""
        doubts = []
        if not self.misfit <= BELIEVED_MISFIT:
            doubts.append(
                f"the best pendulum misses the record by {_percent(self.misfit)} of the start angle "
                f"(believed up to {_percent(BELIEVED_MISFIT)})."
            )
        if not self.distortion <= self.distortion_limit:
            doubts.append(
                f"within a period the motion differs from any pendulum's by {_percent(self.distortion)} of the "
                f"start angle (believed up to {_percent(self.distortion_limit)}): something else moves it too, "
                "a soft arm, a cable, a loose mount or a hand."
            )
        if abs(self.drift) > max(BELIEVED_DRIFT, 4 * self.drift_std):
            doubts.append(
                f"the natural frequency squared changes by {100 * self.drift:+.2g} % from the first half of the "
                f"window to the second (believed up to {_percent(BELIEVED_DRIFT)}): this is not one pendulum."
            )
        return tuple(doubts)


def judge(fit: OutputError, time_s: Array, *, resolution_rad: float, drift: float, drift_std: float) -> Verdict:
    """Judge a fit to samples at `time_s` (n,) of an angle with the given resolution."""
    start = float(np.max(np.abs(fit.trajectory.angle_rad)))
    period = 2 * math.pi / math.sqrt(max(fit.coefficients.natural_frequency_squared_s2, 1e-9))
    block = max(int(len(time_s) * period / (time_s[-1] - time_s[0])) // _BLOCKS_A_PERIOD, 1)
    residual = fit.residual_rad
    noise_variance = float(np.mean(np.diff(residual) ** 2)) / 2
    distorted = block_means(_waveform_residual(fit, time_s, period), length=block)
    # What noise and the encoder's steps alone leave in the block means is no distortion.
    allowed = (BELIEVED_DISTORTION * start) ** 2 + 2 * noise_variance / block + resolution_rad**2 / 12
    return Verdict(
        misfit=_rms(block_means(residual, length=block)) / start,
        distortion=_rms(distorted) / start,
        distortion_limit=math.sqrt(allowed) / start,
        drift=drift,
        drift_std=drift_std,
    )


def _waveform_residual(fit: OutputError, time_s: Array, period: float) -> Array:
    """Return the residual less, in each period, its best fit by the model's angle, speed and a constant."""
    trajectory = fit.trajectory
    model = sample(trajectory, time_s)
    nodes_s = trajectory.start_s + trajectory.step_s * np.arange(len(trajectory.speed_rad_per_s))
    speed = np.interp(time_s, nodes_s, trajectory.speed_rad_per_s)
    left = fit.residual_rad.copy()
    edges = np.searchsorted(time_s, np.arange(time_s[0], time_s[-1], period))
    for first, last in zip(edges, [*edges[1:], len(time_s)], strict=True):
        part = slice(first, last)
        local = np.stack([model[part], speed[part], np.ones(last - first)], axis=1)
        if last - first > 2 * local.shape[1]:
            left[part] -= local @ np.linalg.lstsq(local, left[part], rcond=None)[0]
    return left


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _percent(fraction: float) -> str:
    return f"{100 * fraction:.2g} %"
