"""Compare values of different fits: their difference over its joint uncertainty, with shared causes counted once.

The variance of a - b is var(a) + var(b) - 2 sum(a_c b_c) over the causes c that both fits have, with a_c and b_c the
changes of a and b per standard uncertainty of c: a cause that changes both alike hardly changes their difference.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cfid.records.covariances import numbers_of
from cfid.records.parameters import Section, plain


@dataclass(frozen=True)
class Compared:
    """A value of a fit, its standard uncertainty, and its change per standard uncertainty of each common cause."""

    value: float
    std: float
    effects: Mapping[str, float]


class Difference(NamedTuple):
    """A difference and its standard uncertainty; `in_std` is their ratio, infinite where the latter is zero."""

    value: float
    std: float

    @property
    def in_std(self) -> float:
        """The difference in standard uncertainties."""
        return self.value / self.std if self.std > 0 else math.copysign(math.inf, self.value) if self.value else 0.0


def number_of(section: Section, key: str, weights: Sequence[float] = (1.0,)) -> Compared:
    """Return the sum of a parameter's values (n,) times `weights` (n,): 1 for a single value.

    A slope or a value of a polynomial is such a sum. Raises ValueError where values and weights differ in number.
    """
    parameter, weight = section.parameters[key], np.array(weights, dtype=np.float64)
    values = np.array(numbers_of(key, plain(parameter.value)), dtype=np.float64)
    if len(values) != len(weight):
        raise ValueError(f"{key} has {len(values)} numbers, and {len(weight)} weights were given.")
    effects = {cause: float(weight @ moved[key]) for cause, moved in section.common.items() if key in moved}
    return Compared(float(weight @ values), math.sqrt(_variance(section, key, weight)), effects)


def difference(first: Compared, second: Compared) -> Difference:
    """Return first - second of two fits that have only common causes in common."""
    shared = sum(effect * second.effects.get(cause, 0.0) for cause, effect in first.effects.items())
    return Difference(first.value - second.value, math.sqrt(max(first.std**2 + second.std**2 - 2 * shared, 0.0)))


def _variance(section: Section, key: str, weight: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    """Return the variance of a weighted sum: from the covariance that contains the key, else for independent values."""
    for block in section.covariance:
        if key in block.of:
            sizes = [len(numbers_of(one, plain(section.parameters[one].value))) for one in block.of]
            at = block.of.index(key)
            own = slice(sum(sizes[:at]), sum(sizes[: at + 1]))
            return max(float(weight @ np.array(block.matrix)[own, own] @ weight), 0.0)
    std = plain(section.parameters[key].std)
    stds = np.zeros(len(weight)) if std is None else np.array([one or 0.0 for one in numbers_of(key, std)])
    effects = [weight * moved[key] for moved in section.common.values() if key in moved]
    own_variance = (weight * stds) ** 2 - sum((each**2 for each in effects), np.zeros(len(weight)))
    return float(np.maximum(own_variance, 0.0).sum() + sum(float(each.sum()) ** 2 for each in effects))
