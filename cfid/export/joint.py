"""The joint distribution of several fits' parameters, and draws from it.

Within a fit, its covariances apply, and numbers without a covariance are independent. The covariance between fits with
a common cause is the product of their changes per standard uncertainty of the cause.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.records.covariances import names_of, numbers_of, shaped_as
from cfid.records.parameters import Section, plain

Array = npt.NDArray[np.float64]

_ROUNDING = 1e-6  # of the correlations' eigenvalues: smaller negative ones are none
_DIFFERENT = 0.01  # of a standard uncertainty: beyond it, a covariance contradicts the std


@dataclass(frozen=True, kw_only=True)
class Joint:
    """A normal distribution of the numbers of parameters: `mean` (n,), `covariance` (n, n) and n `names`.

    `values` contains the parameters as measured, whose numbers are in this order. `exact` names parameters without a
    standard uncertainty, `independent` those with several numbers but no covariance between them.
    """

    values: Mapping[str, Any]
    names: tuple[str, ...]
    mean: Array
    covariance: Array
    exact: tuple[str, ...]
    independent: tuple[str, ...]

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Return draws (count, n), whether or not a vehicle can have them.

        Raises DataError when no distribution can have these covariances.
        """
        std = np.sqrt(np.diag(self.covariance))
        unit = np.where(std > 0, std, 1.0)
        correlation = self.covariance / np.outer(unit, unit)
        try:
            draws = rng.multivariate_normal(
                np.zeros(len(std)), correlation, count, check_valid="raise", tol=_ROUNDING, method="eigh"
            )
        except ValueError:
            raise DataError(
                "the covariances and common causes of these fits contradict each other, no numbers can covary so: fit "
                "again."
            ) from None
        return np.asarray(self.mean + unit * draws)

    def shaped(self, numbers: Array) -> dict[str, Any]:
        """Return the parameters of a draw (n,), each in its own shape."""
        parameters, row = {}, numbers.tolist()
        for key, value in self.values.items():
            count = len(numbers_of(key, value))
            parameters[key] = shaped_as(key, row[:count], value)
            row = row[count:]
        return parameters


def joint_of(fits: Sequence[tuple[Section, Sequence[str]]]) -> Joint:
    """Return the joint distribution of some parameters of fits; each parameter is taken from only one fit.

    Raises DataError for a covariance that contradicts the std of its parameter, and for a std whose square overflows.
    """
    values = {key: plain(section.parameters[key].value) for section, keys in fits for key in keys}
    stds = {key: _std(section, key) for section, keys in fits for key in keys}
    ends = np.cumsum([len(std) for std in stds.values()])
    places = {key: np.arange(end - len(stds[key]), end) for key, end in zip(stds, ends, strict=True)}
    size = int(ends[-1]) if stds else 0
    covariance = _shared(fits, places, size)
    for key, rows in places.items():  # a parameter's own uncertainty contains its causes
        with np.errstate(over="ignore"):
            covariance[np.ix_(rows, rows)] = np.diag(stds[key] ** 2)
        if not np.isfinite(covariance[np.ix_(rows, rows)]).all():
            raise DataError(f"the std of {key} is too large to be one: its square is no number.")
    covered: set[str] = set()
    for section, keys in fits:
        for block in section.covariance:
            counts = [len(numbers_of(key, plain(section.parameters[key].value))) for key in block.of]
            taken = np.repeat([key in keys for key in block.of], counts)
            rows = np.concatenate([places[key] for key in block.of if key in keys] or [np.arange(0)])
            covariance[np.ix_(rows, rows)] = np.array(block.matrix)[np.ix_(taken, taken)]
            for key in (key for key in block.of if key in keys):
                covered.add(key)
                diagonal = np.sqrt(np.diag(covariance)[places[key]])
                known = section.parameters[key].std is not None
                if known and not np.allclose(diagonal, stds[key], rtol=_DIFFERENT, atol=0):
                    raise DataError(
                        f"the std of {key} and the diagonal of its covariance contradict each other. Expected the "
                        "square root of the diagonal: fit again."
                    )
    uncertain = [key for key in values if np.any(np.diag(covariance)[places[key]] > 0)]
    return Joint(
        values=values,
        names=tuple(name for key, value in values.items() for name in names_of(key, value)),
        mean=np.array([number for key, value in values.items() for number in numbers_of(key, value)], dtype=np.float64),
        covariance=covariance,
        exact=tuple(key for key in values if key not in uncertain),
        independent=tuple(key for key in uncertain if key not in covered and len(places[key]) > 1),
    )


def _shared(fits: Sequence[tuple[Section, Sequence[str]]], places: Mapping[str, Array], size: int) -> Array:
    """Return the covariance (n, n) by common causes: the sum of the products of their effects on all numbers."""
    effects: dict[str, Array] = {}
    for section, keys in fits:
        for cause, changes in section.common.items():
            for key in (key for key in keys if key in changes):
                effects.setdefault(cause, np.zeros(size))[places[key]] = numbers_of("", changes[key])
    return sum((np.outer(effect, effect) for effect in effects.values()), np.zeros((size, size)))


def _std(section: Section, key: str) -> Array:
    """Return a parameter's standard uncertainties, with zero for unknown ones."""
    parameter = section.parameters[key]
    if parameter.std is None:
        return np.zeros(len(numbers_of(key, plain(parameter.value))))
    return np.array([number or 0.0 for number in numbers_of(key, plain(parameter.std))])
