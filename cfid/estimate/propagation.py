"""Linear propagation of uncertainty (GUM): one function, its inputs, and what each input contributes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri, stdtrit

Array = npt.NDArray[np.float64]

# Central differences this wide, in standard deviations, average over the bend of the function where the
# input really lies, and are far above rounding.
_WIDTH = 0.5


@dataclass(frozen=True, kw_only=True)
class Input:
    """An uncertain input: its value, one standard deviation and the quantity it belongs to in a budget."""

    name: str
    group: str
    value: float
    std: float


def contributions(function: Callable[[Array], Array], inputs: Sequence[Input]) -> Array:
    """Return by how much each input's standard deviation moves the outputs, shape (outputs, inputs).

    `function` takes the vector of input values. Inputs are independent of each other; what two outputs
    share through one input is kept, so the outputs' covariance is the product with its transpose.
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
    """Add up contributions (outputs, inputs) in squares by group; the largest group first."""
    groups: dict[str, Array] = {}
    for i, given in enumerate(inputs):
        groups[given.group] = groups.get(given.group, 0.0) + columns[:, i] ** 2
    ordered = sorted(groups.items(), key=lambda item: -float(np.sum(item[1])))
    return {name: np.sqrt(squares) for name, squares in ordered if np.any(squares > 0)}


def widened(std: float, freedom: int) -> float:
    """Return the deviation whose 1.96-fold covers 95 %, for one estimated from few residuals (Student's t).

    Whoever reads a standard deviation takes 1.96 of it; with two residuals to spare it takes 4.3.
    """
    return float(std * stdtrit(freedom, 0.975) / ndtri(0.975))
