"""Friction of the swing's axis, and the inertia of its set-up, from all dropped weights together."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.analysis.drops import Drop
from cfid.analysis.uncertainty import widened
from cfid.errors import FitError

Array = npt.NDArray[np.float64]

NEVER_SETTLED = (
    "in no run did the speed settle (as the thesis' 10 g, figure 2.9): use heavier weights or a longer fall, or "
    "set the window with --from and --to."
)


@dataclass(frozen=True, kw_only=True)
class Friction:
    """All weights together: torque = coulomb + viscous * speed, and the inertia of the set-up.

    Deviations come from how the runs scatter about the line. `coulomb_nm` is None when only one weight
    settled, which cannot tell the two frictions apart.
    """

    viscous_nms_per_rad: float
    viscous_std: float | None
    coulomb_nm: float | None
    coulomb_std: float | None
    setup_inertia_kg_m2: float
    setup_inertia_std: float | None
    warnings: tuple[str, ...]


def fit_friction(drops: Sequence[Drop], *, radius_m: float, radius_std_m: float, gravity_mps2: float) -> Friction:
    """Fit Coulomb and viscous friction to all settled drops, and the set-up's inertia to their starts.

    m g r = M_c + c speed, with the speed that each fall tends to; the windowed mean, as the thesis has it, is
    still on its way there. The start's time constant is (I + m r^2) / c: the weight is accelerated as well,
    which eq. 2.12 leaves out.

    Raises FitError when no drop settled.
    """
    settled = _settled(drops)
    torque = gravity_mps2 * radius_m * np.array([drop.weight_kg for drop in settled])
    speed = np.array([drop.terminal_rad_per_s for drop in settled])
    if len({drop.weight_kg for drop in settled}) == 1:
        said = ("one weight alone cannot tell Coulomb from viscous friction: drop another one too.",)
        return _one_coefficient(settled, torque / speed, radius_m, said)
    (coulomb, coulomb_std), (viscous, viscous_std), warnings = _line(speed, torque)
    slope = viscous if viscous > 0 else float(np.mean(torque / speed))
    inertia, inertia_std = _setup_inertia(settled, np.full(len(settled), slope), radius_m)
    # Radius and slope are common to all runs: what they are off by does not average out.
    common = radius_std_m / radius_m
    accelerated = inertia + radius_m**2 * float(np.mean([drop.weight_kg for drop in settled]))
    if inertia_std is not None and viscous_std is not None:
        inertia_std = math.hypot(inertia_std, accelerated * viscous_std / slope, accelerated * common)
    return Friction(
        viscous_nms_per_rad=viscous,
        viscous_std=_with(viscous_std, viscous * common),
        coulomb_nm=coulomb,
        coulomb_std=_with(coulomb_std, coulomb * common),
        setup_inertia_kg_m2=inertia,
        setup_inertia_std=inertia_std,
        warnings=warnings,
    )


def thesis_friction(drops: Sequence[Drop]) -> Friction:
    """Return the mean coefficient of eq. 2.14, as table 2.2 takes it, and I = M_fr times the time constant.

    Raises FitError when no drop settled.
    """
    settled = _settled(drops)
    return _one_coefficient(settled, np.array([drop.coefficient_nms_per_rad for drop in settled]), 0.0, ())


def _settled(drops: Sequence[Drop]) -> list[Drop]:
    settled = [drop for drop in drops if drop.settled]
    if not settled:
        raise FitError(NEVER_SETTLED)
    return settled


def _one_coefficient(
    settled: Sequence[Drop], coefficients: Array, radius_m: float, warnings: tuple[str, ...]
) -> Friction:
    inertia, inertia_std = _setup_inertia(settled, coefficients, radius_m)
    return Friction(
        viscous_nms_per_rad=float(coefficients.mean()),
        viscous_std=_mean_deviation(coefficients),
        coulomb_nm=None,
        coulomb_std=None,
        setup_inertia_kg_m2=inertia,
        setup_inertia_std=inertia_std,
        warnings=warnings,
    )


def _line(
    speed: Array, torque: Array
) -> tuple[tuple[float, float | None], tuple[float, float | None], tuple[str, ...]]:
    """Fit torque = coulomb + viscous * speed; deviations from the scatter about the line.

    What scatters from drop to drop is the friction itself, so the residual is a torque.
    """
    rows = np.stack([np.ones_like(speed), speed], axis=1)
    coulomb, viscous = (float(value) for value in np.linalg.lstsq(rows, torque, rcond=None)[0])
    freedom = len(speed) - 2
    if freedom == 0:
        return (coulomb, None), (viscous, None), ()
    if coulomb < 0:
        said = ("Coulomb friction came out negative and is set to zero.",)
        return (0.0, None), (float(torque @ speed / (speed @ speed)), None), said
    if viscous < 0:
        said = ("viscous friction came out negative and is set to zero.",)
        return (float(torque.mean()), None), (0.0, None), said
    residual = torque - coulomb - viscous * speed
    deviations = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)) * (residual @ residual) / freedom)
    coulomb_std, viscous_std = (widened(float(std), freedom) for std in deviations)
    return (coulomb, coulomb_std), (viscous, viscous_std), ()


def _setup_inertia(drops: Sequence[Drop], slope: Array, radius_m: float) -> tuple[float, float | None]:
    total = np.array([drop.time_constant_s for drop in drops]) * slope
    values = total - np.array([drop.weight_kg for drop in drops]) * radius_m**2
    return float(values.mean()), _mean_deviation(values)


def _mean_deviation(values: Array) -> float | None:
    if len(values) < 2:
        return None
    return widened(float(values.std(ddof=1) / math.sqrt(len(values))), len(values) - 1)


def _with(std: float | None, common: float) -> float | None:
    return None if std is None else math.hypot(std, common)
