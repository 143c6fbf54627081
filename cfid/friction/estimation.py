"""Friction of the swing's axis and the inertia of its set-up, from all dropped weights together."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.estimate.linear import fit_linear, mean_of, std_of
from cfid.estimate.propagation import covariance_of_weights, widened
from cfid.findings import Finding, rejection, warning
from cfid.friction.drops import Drop

Array = npt.NDArray[np.float64]

VISCOUS, COULOMB = "friction.viscous_nms_per_rad", "friction.coulomb_nm"
SETUP_INERTIA = "friction.setup_inertia_kg_m2"
KEYS = VISCOUS, COULOMB, SETUP_INERTIA

_HEAVIER = 1.1  # friction may change the order of drops with more similar weights
_FEWEST = 2  # drops, from which Coulomb and viscous friction follow with none to spare
_FEWEST_LAYERED = 3
_LAYERED_STD = 4.0  # standard uncertainties, widened for the small number of drops
_BEYOND_STD = 2.5  # of a few drops' mean, widened for their number: a larger negative inertia is no noise
_LAYERED = 0.02  # of the radius, over a fall


@dataclass(frozen=True, kw_only=True)
class FrictionEstimate:
    """All weights together: torque = coulomb + viscous * speed, and the inertia of the set-up.

    Standard uncertainties come from the scatter of the runs about the line; they are None where no run is left to show
    scatter. A value is None where the runs do not determine it; a rejection states the reason.
    """

    viscous_nms_per_rad: float | None = None
    viscous_std: float | None = None
    coulomb_nm: float | None = None
    coulomb_std: float | None = None
    setup_inertia_kg_m2: float | None = None
    setup_inertia_std: float | None = None
    findings: tuple[Finding, ...] = ()


def fit_friction(
    drops: Sequence[Drop],
    *,
    radius_m: float,
    radius_std_m: float,
    gravity_mps2: float,
    gravity_std_mps2: float = 0.0,
    speed_scale_std: float = 0.0,
) -> FrictionEstimate:
    """Fit Coulomb and viscous friction to all settled drops, and the set-up's inertia to their starts.

    The model is m g r = M_c + c speed, with the speed that each fall tends to; the mean in a window, as the thesis has
    it, has not yet reached that speed. The start's time constant is (I + m r^2) / c, since the weight is accelerated as
    well, which eq. 2.12 leaves out. `speed_scale_std` is the relative standard uncertainty that all speeds share.
    """
    settled = [drop for drop in drops if drop.settled]
    if len({drop.weight_kg for drop in settled}) < 2:
        return FrictionEstimate(findings=(_ONE_WEIGHT if settled else _NEVER_SETTLED,))
    torque = gravity_mps2 * radius_m * np.array([drop.weight_kg for drop in settled])
    speed = np.array([drop.terminal_rad_per_s for drop in settled])
    weights = covariance_of_weights(*np.array([(drop.weight_kg, drop.weight_std_kg) for drop in settled]).T)
    coulomb, viscous, findings = _line(speed, torque, weights * (gravity_mps2 * radius_m) ** 2)
    findings += (*_order_finding(settled), *_layers_finding(settled, viscous.value, radius_m, gravity_mps2))
    # Radius and gravity are common to all runs: their errors do not average out.
    common = math.hypot(radius_std_m / radius_m, gravity_std_mps2 / gravity_mps2)
    with_speed = math.hypot(common, speed_scale_std)
    inertia = _setup_inertia(settled, viscous, radius_m, with_speed) if viscous.value > 0 else None
    findings += (*_negative_inertia(inertia), *([_NO_SCATTER] if len(settled) == _FEWEST else []))
    return FrictionEstimate(
        viscous_nms_per_rad=viscous.value,
        viscous_std=_with(viscous.std, viscous.value * with_speed),
        coulomb_nm=coulomb.value,
        coulomb_std=_with(coulomb.std, coulomb.value * common),
        setup_inertia_kg_m2=None if inertia is None else inertia.value,
        setup_inertia_std=None if inertia is None else inertia.std,
        findings=findings,
    )


def thesis_friction(drops: Sequence[Drop]) -> FrictionEstimate:
    """Return the mean coefficient of eq. 2.14, as table 2.2 takes it, and I = M_fr times the time constant."""
    settled = [drop for drop in drops if drop.settled]
    if not settled:
        return FrictionEstimate(findings=(_NEVER_SETTLED,))
    coefficients = np.array([drop.coefficient_nms_per_rad for drop in settled])
    inertias = coefficients * np.array([drop.time_constant_s for drop in settled])
    return FrictionEstimate(
        viscous_nms_per_rad=float(coefficients.mean()),
        viscous_std=_mean_std(coefficients),
        setup_inertia_kg_m2=float(inertias.mean()),
        setup_inertia_std=_mean_std(inertias),
        findings=_order_finding(settled),
    )


class _Value(NamedTuple):
    value: float
    std: float | None


_NEVER_SETTLED = rejection(
    "friction-never-settled",
    "the speed settled in no run (as in the thesis' of 10 g, figure 2.9): use heavier weights or a longer fall, or set "
    "another window by hand.",
    *KEYS,
)
_NO_SCATTER = warning(
    "friction-scatter-unknown",
    "two drops show no scatter, so that standard uncertainties are not known. Drop each weight twice, or a third one.",
    *KEYS,
)
_ONE_WEIGHT = rejection(
    "friction-one-weight",
    "one weight alone does not separate Coulomb from viscous friction, and so does not give the inertia of the set-up "
    "either: drop another weight too. The thesis method gives one coefficient for both.",
    *KEYS,
)


def _line(speed: Array, torque: Array, weights: Array) -> tuple[_Value, _Value, tuple[Finding, ...]]:
    """Fit torque = coulomb + viscous * speed, neither negative; return both, and findings.

    `weights` (n, n) is the covariance that the torques (n,) have from their weights.
    """
    coulomb, viscous = _least_squares([np.ones_like(speed), speed], torque, weights)
    if coulomb.value < 0:
        text = f"Coulomb friction came out at {coulomb.value:.2g} N m: it is set to zero. Drop more weights."
        through_zero = _least_squares([speed], torque, weights)[0]
        return _Value(0.0, None), through_zero, (warning("friction-coulomb-zero", text, COULOMB),)
    if viscous.value < 0:
        text = f"viscous friction came out at {viscous.value:.2g} N m s/rad: it is set to zero. Drop more weights."
        unknown = "without viscous friction the start of a fall does not give the inertia of the set-up."
        level = _least_squares([np.ones_like(speed)], torque, weights)[0]
        return (
            level,
            _Value(0.0, None),
            (
                warning("friction-viscous-zero", text, VISCOUS),
                rejection("friction-inertia-undetermined", unknown, SETUP_INERTIA),
            ),
        )
    return coulomb, viscous, ()


def _least_squares(columns: list[Array], torque: Array, weights: Array) -> list[_Value]:
    """Return each column's coefficient with its standard uncertainty from the scatter, None without degrees of freedom.

    The covariance of the weights (n, n) is added, since their errors need not scatter. What differs from drop to drop
    is the friction itself, so the residual is a torque.
    """
    found = fit_linear(np.stack(columns, axis=1), torque, noise_known=False)
    freedom, of_weights = found.degrees_of_freedom, std_of(found.gain @ weights @ found.gain.T)
    return [
        _Value(float(value), math.hypot(widened(float(std), freedom), weighed) if freedom else None)
        for value, std, weighed in zip(found.values, found.std, of_weights, strict=True)
    ]


def _order_finding(drops: Sequence[Drop]) -> tuple[Finding, ...]:
    """Reject drops in which a clearly heavier weight turns the axis more slowly than a lighter one."""
    pairs = [
        (light, heavy)
        for light in drops
        for heavy in drops
        if heavy.weight_kg > _HEAVIER * light.weight_kg and heavy.terminal_rad_per_s < light.terminal_rad_per_s
    ]
    if not pairs:
        return ()
    light, heavy = max(pairs, key=lambda pair: pair[0].terminal_rad_per_s - pair[1].terminal_rad_per_s)
    text = (
        f"{1000 * heavy.weight_kg:g} g turn the axis at {heavy.terminal_rad_per_s:.0f} rad/s, more slowly than "
        f"{1000 * light.weight_kg:g} g at {light.terminal_rad_per_s:.0f}. Check whether the weights of two runs were "
        "exchanged."
    )
    return (rejection("friction-weights-out-of-order", text, *KEYS),)


def _layers_finding(drops: Sequence[Drop], viscous: float, radius_m: float, gravity_mps2: float) -> tuple[Finding, ...]:
    """Reject drops if the speed of all changes from turn to turn as with a radius that grows or shrinks.

    A torque that changes by a share per turn changes the speed by that share of m g r / c. Friction that wanders within
    a fall gives changes that scatter about zero, so the mean over the drops is judged by their scatter.
    """
    if viscous <= 0 or len(drops) < _FEWEST_LAYERED:
        return ()
    torque = gravity_mps2 * radius_m * np.array([drop.weight_kg for drop in drops])
    speed, share, turns = (
        np.array([getattr(drop, name) for drop in drops]) for name in ("terminal_rad_per_s", "speed_per_turn", "turns")
    )
    radius_per_turn = share * viscous * speed / torque
    mean, std = float(radius_per_turn.mean()), _mean_std(radius_per_turn) or 0.0
    change = mean * float(turns.mean())
    if abs(mean) <= _LAYERED_STD * std or abs(change) <= _LAYERED:
        return ()
    text = (
        f"a radius that changes by {100 * mean:+.2g} % a turn, {100 * change:+.1f} % over a fall (limit "
        f"{100 * _LAYERED:g} %), explains the speeds better: the line was wound in layers. Wind it side by side."
    )
    return (rejection("friction-radius-changes", text, *KEYS),)


def _setup_inertia(drops: Sequence[Drop], viscous: _Value, radius_m: float, common: float) -> _Value:
    """Return the mean of c tau - m r^2 over the drops; c and the radius are common to all of them."""
    weights = np.array([drop.weight_kg for drop in drops])
    accelerated = viscous.value * np.array([drop.time_constant_s for drop in drops])
    values = accelerated - weights * radius_m**2
    scatter = _mean_std(values)
    if scatter is None or viscous.std is None:
        return _Value(float(values.mean()), None)
    shared = float(accelerated.mean()) * math.hypot(viscous.std / viscous.value, common)
    return _Value(float(values.mean()), math.hypot(scatter, shared))


def _negative_inertia(inertia: _Value | None) -> tuple[Finding, ...]:
    """Reject all that rests on the radius where the axis would have a negative inertia, beyond noise."""
    if inertia is None or inertia.std is None or inertia.value >= -_BEYOND_STD * inertia.std:
        return ()
    text = (
        f"what turns would have an inertia of {inertia.value:.2g} +- {inertia.std:.1g} kg m^2: the weights fall faster "
        "than on this radius they can. Check the radius and the weights."
    )
    return (rejection("friction-inertia-negative", text, *KEYS),)


def _mean_std(values: Array) -> float | None:
    if len(values) < 2:
        return None
    return widened(float(mean_of(values).std[0]), len(values) - 1)


def _with(std: float | None, common: float) -> float | None:
    return None if std is None else math.hypot(std, common)
