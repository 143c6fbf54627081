"""Numbers of a fit with their uncertainties, where causes that fits share are variables that fits share.

A cause of error such as the gain of a load cell is one variable of the package `uncertainties`, the same for every fit.
So the difference of two numbers that it shifts alike hardly depends on it.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from uncertainties import UFloat, ufloat

from cfid.records.covariances import numbers_of
from cfid.records.parameters import Section, plain

OWN_FIT = "noise and the inputs of its own fit"  # the tag of what no other fit shares


@cache
def cause(name: str) -> UFloat:
    """Return the variable of a cause of error, in its standard uncertainties; it is one variable for all fits."""
    return ufloat(0.0, 1.0, tag=name)


def measured(value: float, std: float, effects: Mapping[str, float] | None = None) -> UFloat:
    """Return a number with the standard uncertainty `std`, of which `effects` are the parts of shared causes."""
    shared = {name: effect for name, effect in (effects or {}).items() if effect}
    own = math.sqrt(max(std**2 - sum(effect**2 for effect in shared.values()), 0.0))
    number = value + 0.0 * cause(OWN_FIT) if own == 0 else ufloat(value, own, tag=OWN_FIT)  # none has a std of zero
    return sum((effect * cause(name) for name, effect in shared.items()), number)


def number_of(section: Section, key: str, weights: Sequence[float] = (1.0,)) -> UFloat:
    """Return the sum of a parameter's values (n,) times `weights` (n,): 1 for a single value.

    A slope or a value of a polynomial is such a sum. Raises ValueError where values and weights differ in number.
    """
    weight = np.array(weights, dtype=np.float64)
    values = np.array(numbers_of(key, plain(section.parameters[key].value)), dtype=np.float64)
    if len(values) != len(weight):
        raise ValueError(f"{key} has {len(values)} numbers, and {len(weight)} weights were given.")
    effects = {name: float(weight @ moved[key]) for name, moved in section.common.items() if key in moved}
    return measured(float(weight @ values), math.sqrt(_variance(section, key, weight)), effects)


def parts_of(number: UFloat) -> dict[str, float]:
    """Return the parts of a number's standard uncertainty by cause; those of one name are combined."""
    parts: dict[str, float] = {}
    for variable, part in number.error_components().items():
        name = variable.tag or OWN_FIT
        parts[name] = math.hypot(parts.get(name, 0.0), part)
    return parts


def in_std(number: UFloat) -> float:
    """Return a number in its standard uncertainties, infinite where it has none."""
    value, std = number.nominal_value, number.std_dev
    return value / std if std > 0 else math.copysign(math.inf, value) if value else 0.0


def _variance(section: Section, key: str, weight: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    """Return the variance of a weighted sum: from the covariance that contains the key, else for independent values."""
    for block in section.covariance:
        if key in block.of:
            sizes = [len(numbers_of(one, plain(section.parameters[one].value))) for one in block.of]
            at = block.of.index(key)
            place = slice(sum(sizes[:at]), sum(sizes[: at + 1]))
            return max(float(weight @ np.array(block.matrix)[place, place] @ weight), 0.0)
    std = plain(section.parameters[key].std)
    stds = np.zeros(len(weight)) if std is None else np.array([one or 0.0 for one in numbers_of(key, std)])
    effects = [weight * moved[key] for moved in section.common.values() if key in moved]
    own_variance = (weight * stds) ** 2 - sum((each**2 for each in effects), np.zeros(len(weight)))
    return float(np.maximum(own_variance, 0.0).sum() + sum(float(each.sum()) ** 2 for each in effects))
