"""The simple model of drag, f = K speed_sum v with diagonal K (eq. 4.2), in all groupings of C.3.1.

What C.3.1 calls least squares is the mean of force / (speed sum * velocity), so that weak winds count as much as
strong ones. `fit_drag` with the model SIMPLE is the honest one, and the default elsewhere.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.drag.estimation import flat_rows, gained
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import SIMPLE
from cfid.errors import FitError

Array = npt.NDArray[np.float64]

_ACROSS = 1e-6  # of the wind speed: a component below is rounding, and tells nothing of that axis


class Group(NamedTuple):
    """A coefficient of x and y together, None for what it is a mean over."""

    angle_deg: float
    command: float | None
    wind_mps: float | None
    kg_per_rad: float


@dataclass(frozen=True, kw_only=True)
class SimpleGroupings:
    """Coefficients in kg/rad, as C.3.1 groups them; x and y of wind from straight above are left out.

    `each` (n, 3) is that of every experiment and axis (kappa_orth, kappa_par; nan where left out), `lateral` (n,)
    that of x and y together (kappa_orth_LS). `by_command` takes all winds of an angle and command
    (kappa_orth_LS_allWinds), `by_wind` all commands of an angle and wind (kappa_orth_LS_allInputs), `by_angle`
    everything of an angle (kappa_orth_LS_all). `value` (3,) is eq. 4.8: the mean over the angles for x and y, over
    all experiments for z. The thesis states no deviation; `std` (3,) and `covariance` (3, 3) are those of noise,
    references and wind.
    """

    each: Array
    lateral: Array
    by_command: tuple[Group, ...]
    by_wind: tuple[Group, ...]
    by_angle: tuple[Group, ...]
    value: Array
    std: Array
    covariance: Array


def group_simple(experiments: DragExperiments) -> SimpleGroupings:
    """Return the thesis' coefficients of the simple model.

    Raises FitError without wind from the side, or when all of it comes from there.
    """
    told = np.abs(experiments.velocity_mps) > _ACROSS * experiments.wind_mps[:, np.newaxis]
    if not (told[:, :2].any() and told[:, 2].any()):
        raise FitError("wind from one direction alone does not tell x and y from z: record another angle.")
    product = experiments.speed_sum_rad_s[:, np.newaxis] * experiments.velocity_mps
    inverse = np.divide(1.0, product, out=np.zeros_like(product), where=told)
    each = np.where(told, experiments.force_n * inverse, np.nan)
    found = gained(
        experiments, SIMPLE, flat_rows(experiments, SIMPLE), _weights(experiments, told) * inverse.reshape(-1)
    )
    angle, command, wind = experiments.angle_deg, experiments.command, experiments.wind_mps.round(6)
    lateral = each[:, :2]
    return SimpleGroupings(
        each=each,
        lateral=np.array([_mean(pair) for pair in lateral]),
        by_command=_grouped(lateral, [angle, command], lambda a, c: (a, c, None)),
        by_wind=_grouped(lateral, [angle, wind], lambda a, w: (a, None, w)),
        by_angle=_grouped(lateral, [angle], lambda a: (a, None, None)),
        value=found.values[SIMPLE.layout],
        std=np.sqrt(np.diag(found.covariance))[SIMPLE.layout],
        covariance=found.covariance[np.ix_(SIMPLE.layout, SIMPLE.layout)],
    )


def _weights(experiments: DragExperiments, told: npt.NDArray[np.bool_]) -> Array:
    """Return the weight of each ratio (2, 3n): every angle the same in x and y, every experiment in z."""
    weights = np.zeros((2, *told.shape))
    for angle in np.unique(experiments.angle_deg):
        belongs = told[:, :2] & (experiments.angle_deg == angle)[:, np.newaxis]
        weights[0, :, :2] += belongs / max(belongs.sum(), 1)
    weights[1, :, 2] = told[:, 2]
    flat = weights.reshape(2, -1)
    return np.asarray(flat / flat.sum(axis=1, keepdims=True))


def _grouped(
    lateral: Array, keys: list[Array], named: Callable[..., tuple[float, float | None, float | None]]
) -> tuple[Group, ...]:
    groups, place = np.unique(np.stack(keys, axis=1), axis=0, return_inverse=True)
    means = [_mean(lateral[place.reshape(-1) == i]) for i in range(len(groups))]
    return tuple(
        Group(*named(*group), mean) for group, mean in zip(groups.tolist(), means, strict=True) if np.isfinite(mean)
    )


def _mean(ratios: Array) -> float:
    there = ratios[np.isfinite(ratios)]
    return float(there.mean()) if len(there) else np.nan
