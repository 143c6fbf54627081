"""Calculate as C.3.1 does: the simple model's coefficients as means of ratios, in groups, and normalised coefficients.

What C.3.1 calls least squares is the mean of force / (speed sum * velocity), so that weak winds count as much as strong
ones. Generalised least squares is the default elsewhere.
"""

from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from cfid.drag.model import DragExperiments
from cfid.errors import FitError

Array = npt.NDArray[np.float64]
Grouping = Literal["each", "lateral", "command", "wind", "angle"]

_ACROSS = 1e-6  # of the wind speed: a smaller component is rounding and determines nothing along that axis
# The groupings that C.3.1 calls kappa_orth_LS_allWinds, _allInputs and _all.
_GROUPED_BY = {"command": ["angle_deg", "command"], "wind": ["angle_deg", "wind_mps"], "angle": ["angle_deg"]}


def ratios_kg_per_rad(experiments: DragExperiments) -> Array:
    """Return force / (speed sum * velocity) of every experiment and axis (n, 3), NaN where the velocity is 0."""
    usable = _usable(experiments)
    return np.where(usable, experiments.force_n * _inverse(experiments, usable), np.nan)


def lateral_kg_per_rad(experiments: DragExperiments) -> Array:
    """Return the mean ratio (n,) of x and y, NaN for wind from straight above."""
    return np.asarray(pd.DataFrame(ratios_kg_per_rad(experiments)[:, :2]).mean(axis=1))


def means_gain(experiments: DragExperiments) -> Array:
    """Return eq. 4.8 as a gain (2, 3n) of forces: the mean over the angles for x and y, over all experiments for z.

    Raises FitError if no wind, or all wind, is from the side.
    """
    usable = _usable(experiments)
    if not (usable[:, :2].any() and usable[:, 2].any()):
        raise FitError("wind from one direction alone does not distinguish x and y from z: record another angle.")
    weights = np.zeros((2, *usable.shape))
    for angle in np.unique(experiments.angle_deg):
        same = usable[:, :2] & (experiments.angle_deg == angle)[:, np.newaxis]
        weights[0, :, :2] += same / max(same.sum(), 1)
    weights[1, :, 2] = usable[:, 2]
    flat = weights.reshape(2, -1)
    return np.asarray(flat / flat.sum(axis=1, keepdims=True) * _inverse(experiments, usable).reshape(-1))


def group_rows(experiments: DragExperiments, grouping: Grouping) -> list[dict[str, Any]]:
    """Return the simple model's coefficients in kg/rad in one of the groupings of C.3.1, one row each.

    `each` is by run and axis, and `lateral` has x and y together. The others are means of these over all winds of an
    angle and command, all commands of an angle and wind, and everything of an angle; they leave out wind from straight
    above.
    """
    settings = pd.DataFrame(
        {"angle_deg": experiments.angle_deg, "command": experiments.command, "wind_mps": experiments.wind_mps}
    )
    if grouping == "each":
        ratios = ratios_kg_per_rad(experiments).T
        groups = settings.assign(**{f"{axis}_kg_per_rad": ratio for axis, ratio in zip("xyz", ratios, strict=True)})
    else:
        groups = settings.assign(kg_per_rad=lateral_kg_per_rad(experiments))
    if grouping in _GROUPED_BY:
        rounded = groups.assign(wind_mps=groups["wind_mps"].round(6)).dropna()
        groups = rounded.groupby(_GROUPED_BY[grouping], as_index=False)["kg_per_rad"].mean()
    return [{str(name): value for name, value in row.items()} for row in groups.to_dict("records")]


def normalise(
    coefficients: Array, *, wind_mps: npt.ArrayLike, speed_sum_rad_s: npt.ArrayLike, squared: bool = False
) -> Array:
    """Return k1 to k6 (6, 3) of eq. 4.5, each times the mean of its regressor over the sum of these means.

    The third term's regressor is the square of the speed sum. C.3.1 weights it with the speed sum itself (norm3), which
    gives eq. 4.10; `squared` uses the square, which changes the sum and so all others. Winds and speed sums are (n,).
    """
    wind, speed = (float(np.asarray(given, dtype=np.float64).mean()) for given in (wind_mps, speed_sum_rad_s))
    means = np.array([speed * wind, wind**2, speed**2 if squared else speed, wind, speed, 1.0])
    return np.asarray(coefficients * (means / means.sum())[:, np.newaxis])


def _usable(experiments: DragExperiments) -> npt.NDArray[np.bool_]:
    return np.abs(experiments.velocity_mps) > _ACROSS * experiments.wind_mps[:, np.newaxis]


def _inverse(experiments: DragExperiments, usable: npt.NDArray[np.bool_]) -> Array:
    product = experiments.speed_sum_rad_s[:, np.newaxis] * experiments.velocity_mps
    return np.divide(1.0, product, out=np.zeros_like(product), where=usable)
