"""Propagate uncertainty linearly (GUM): one function, its inputs, and the contribution of each input."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri, stdtrit

Array = npt.NDArray[np.float64]

# Central differences of this width, in standard uncertainties, average over the function's curvature in the likely
# range of the input, and are far above rounding.
_WIDTH = 0.5


@dataclass(frozen=True, kw_only=True)
class Input:
    """An uncertain input: its value, its standard uncertainty, and the group that it belongs to in a budget."""

    name: str
    group: str
    value: float
    std: float


def contributions(function: Callable[[Array], Array], inputs: Sequence[Input]) -> Array:
    """Return the change of the outputs by each input's standard uncertainty, shape (outputs, inputs).

    `function` takes the vector of input values. Inputs are independent of each other; outputs that depend on the same
    input are correlated, and the product of the result with its transpose is their covariance.
    """
    values = np.array([given.value for given in inputs])
    outputs = np.asarray(function(values))
    columns = np.zeros((outputs.size, len(inputs)))
    for i, given in enumerate(inputs):
        if given.std == 0:
            continue
        step = np.zeros(len(inputs))
        step[i] = _WIDTH * given.std
        columns[:, i] = (function(values + step) - function(values - step)) / (2 * _WIDTH)
    return columns


def budget(columns: Array, inputs: Sequence[Input]) -> dict[str, Array]:
    """Add up contributions (outputs, inputs) in squares by group; the largest group comes first."""
    groups: dict[str, Array] = {}
    for i, given in enumerate(inputs):
        groups[given.group] = groups.get(given.group, 0.0) + columns[:, i] ** 2
    ordered = sorted(groups.items(), key=lambda item: -float(np.sum(item[1])))
    return {name: np.sqrt(squares) for name, squares in ordered if np.any(squares > 0)}


def covariance_of_weights(weight: Array, std: Array) -> Array:
    """Return the covariance (n, n) of weights (n,) with standard uncertainties (n,): equal ones are one weight."""
    return np.asarray(np.outer(std, std) * (weight[:, np.newaxis] == weight))


def widened(std: float, freedom: int) -> float:
    """Return a standard uncertainty whose 1.96-fold covers 95 %, from one estimated from few residuals (Student's t).

    Readers of a standard uncertainty multiply it by 1.96; with two degrees of freedom the factor would be 4.3.
    """
    return float(std * stdtrit(freedom, 0.975) / ndtri(0.975))
