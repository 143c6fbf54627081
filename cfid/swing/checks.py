"""Check whether a fitted pendulum describes its record: misfit, waveform and drift against limits, and other findings.

The limits lie between the two public records that cfid is checked with: a good rig stays below each limit by a factor
of three or more, and a rig with a soft arm and a dragging cable exceeds the limit of the waveform.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.estimate.blocks import block_means
from cfid.findings import Finding, note, rejection, warning
from cfid.swing.free_swing import FreeSwing
from cfid.swing.model import OutputError, sample
from cfid.swing.uncertainty import FrictionProbe, chosen_terms

Array = npt.NDArray[np.float64]

MISFIT_LIMIT = 0.02
DISTORTION_LIMIT = 0.0015
DRIFT_LIMIT = 0.01
_UNUSUAL_STD = 4.0  # of the standard uncertainty that data sheets state for the scale of a gyro
SPRING_LIMIT = 0.03  # of gravity's stiffness
_UNCERTAIN_LIMIT = 0.1  # of W: with more, the pendulum may have followed noise

IDENTIFIABLE_BIC = 10.0  # [KR]: a smaller difference is not strong evidence
_SPRING_THAT_MISLEADS = 4e-3  # of gravity: more than all other uncertainties together
_SPRING_THAT_MATTERS = 1e-3  # of gravity: as much as the uncertainties of mass and distance
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
    """Return the residual minus its best fit in each period by the model's angle, its speed and a constant."""
    trajectory = fit.trajectory
    model = sample(trajectory, time_s)
    nodes_s = trajectory.start_s + trajectory.step_s * np.arange(len(trajectory.speed_rad_per_s))
    speed = np.interp(time_s, nodes_s, trajectory.speed_rad_per_s)
    if fit.setup.gyro_per_s is not None:  # the recorded quantity is a rate: use it and its derivative
        model = np.sin(model)
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


def eccentricity_finding(fit: OutputError) -> tuple[Finding, ...]:
    """Note that an encoder's disc is eccentric."""
    if not fit.eccentric:
        return ()
    degrees = math.degrees(math.hypot(*fit.eccentricity))
    text = (
        f"the encoder's disc reads {degrees:.2g} degrees off within a turn, as an eccentric one: its first harmonic is "
        "taken out. Centre the disc on the axis."
    )
    return (note("swing-encoder-eccentric", text),)


def eccentricity_or_noise_finding(degrees: float | None, moves: float) -> tuple[Finding, ...]:
    """Note an eccentricity in degrees that noise may have caused, and its relative effect on W, `moves`."""
    if degrees is None:
        return ()
    text = (
        f"an eccentric disc of {degrees:.2g} degrees shows, too little to tell it from noise: {_percent(moves)} of the "
        "natural frequency squared depends on which it is, and is added to the uncertainty. Swing longer."
    )
    return (note("swing-eccentric-or-noise", text),)


def uncertain_finding(fit: OutputError, std_s2: float) -> tuple[Finding, ...]:
    """Reject a natural frequency squared that the record hardly determines."""
    relative = std_s2 / fit.coefficients.natural_frequency_squared_s2
    if relative <= _UNCERTAIN_LIMIT:
        return ()
    text = (
        f"the natural frequency squared is uncertain by {_percent(relative)} (limit {_percent(_UNCERTAIN_LIMIT)}): the "
        "record is too short or too noisy. Release higher, swing longer; look at it with `cfid show`."
    )
    return (rejection("swing-uncertain", text, _ALL),)


def spring_finding(fit: OutputError, uncertain_s2: float, unseen_s2: float) -> tuple[Finding, ...]:
    """Warn of a spring in addition to gravity, reject a stiff one, or state which springs the record cannot show.

    A fitted spring adds the uncertainty `uncertain_s2` to W; springs up to `unseen_s2` raise W by as much and do not
    show.
    """
    frequency, spring = fit.coefficients.natural_frequency_squared_s2, fit.setup.spring_per_s2
    if spring > SPRING_LIMIT * frequency:
        text = (
            f"a spring pulls with {_percent(spring / frequency)} of gravity's stiffness (limit "
            f"{_percent(SPRING_LIMIT)}): free the cable, and check the angle's unit."
        )
        return (rejection("swing-spring-stiff", text, _ALL),)
    if spring:
        text = (
            f"a spring, as of a cable or a bearing, pulls with {_percent(spring / frequency)} of gravity's stiffness. "
            "It is taken out, which leaves the natural frequency squared uncertain by "
            f"{_percent(uncertain_s2 / frequency)}. Free the cable and swing again."
        )
        return (warning("swing-spring", text),)
    if unseen_s2 < _SPRING_THAT_MATTERS * frequency:
        return ()
    text = (
        f"this swing does not show a spring, as of a cable or a bearing, below {_percent(unseen_s2 / frequency)} of "
        "gravity's stiffness, which would raise the natural frequency squared by as much. Release higher, swing longer."
    )
    if unseen_s2 < _SPRING_THAT_MISLEADS * frequency:
        return (note("swing-spring-unseen", text),)
    return (warning("swing-spring-hidden", text),)


def spring_or_friction_finding(spring: float, moves: float) -> tuple[Finding, ...]:
    """Warn of a spring, relative to gravity's stiffness, that may be noise or friction instead.

    `moves` is its relative effect on W, 0 for no spring.
    """
    if not moves:
        return ()
    text = (
        f"a spring of {_percent(spring)} of gravity's stiffness shows, too little to tell it from noise or from dry "
        f"friction that varies: {_percent(moves)} of the natural frequency squared depends on which it is, and is "
        "added to the uncertainty. Free the cable, clean the bearing, release higher and swing again."
    )
    return (warning("swing-spring-or-friction", text, "swing.*"),)


def unfinished_finding(unfinished: OutputError | None, shares: Mapping[str, float]) -> tuple[Finding, ...]:
    """Warn of a better model whose fit did not converge."""
    if unfinished is None:
        return ()
    terms = ", ".join(chosen_terms(unfinished)) or "none"
    text = (
        f"a model with other terms ({terms}) follows the record better, but its fit did not converge: its natural "
        f"frequency squared differs by {shares['model that did not converge']:.2g} 1/s^2, which is added to the "
        "uncertainty. Use another window."
    )
    return (warning("swing-better-model-open", text, "swing.*"),)


def varying_finding(varying: FrictionProbe | None) -> tuple[Finding, ...]:
    """Warn of dry friction that varies in a way that the model does not describe."""
    if varying is None:
        return ()
    consequence = "taken off" if varying.varies_with == "angle" else "added to the uncertainty"
    text = (
        f"dry friction varies with {varying.varies_with} ({varying.shown_std:.1f} standard uncertainties), which moves "
        f"the natural frequency squared by {varying.moved_s2:.2g} 1/s^2: this is {consequence}. Clean or replace the "
        "bearing (on threads, see that nothing rubs), or end the window at a higher peak."
    )
    return (warning("swing-friction-varies", text, "swing.*"),)


def gyro_scale_finding(error: float, usual_std: float) -> tuple[Finding, ...]:
    """Warn of a gyro's scale error beyond those of working gyros, whose standard uncertainty is `usual_std`."""
    if abs(error) <= _UNUSUAL_STD * usual_std:
        return ()
    text = (
        f"the gyro's scale is {_percent(error)} off, by how the period depends on the angle (usual: "
        f"{_percent(usual_std)}, limit {_percent(_UNUSUAL_STD * usual_std)}): another range or unit than the log "
        "states, or no pendulum. Compare with a swing from another angle."
    )
    return (warning("swing-gyro-scale", text, "swing.*"),)


def split_finding(terms: tuple[str, ...], split_bic: float) -> tuple[Finding, ...]:
    """Note that another choice of damping terms is equally likely."""
    if split_bic >= IDENTIFIABLE_BIC:
        return ()
    chosen = ", ".join(terms) or "none"
    text = (
        f"the damping terms ({chosen}) are not identifiable: another choice is as likely "
        f"(BIC {split_bic:.1f} apart). The inertia does not depend on it."
    )
    damping = ("swing.viscous_nms_per_rad", "swing.coulomb_nm", "swing.quadratic_nms2_per_rad2")
    return (note("swing-damping-split-unresolved", text, *damping),)


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
