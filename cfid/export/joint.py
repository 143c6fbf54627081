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

_NEGATIVE = 1e-6  # of the largest eigenvalue of the correlations: smaller negative eigenvalues are rounding
_DIFFERENT = 0.01  # of a standard uncertainty: beyond it, a covariance contradicts the std


@dataclass(frozen=True, kw_only=True)
class Joint:
    """A normal distribution of the numbers of parameters: `mean` (n,), `covariance` (n, n) and n `names`.

    `values` contains the parameters as found, whose numbers are in this order. `exact` names parameters without a
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
        sizes, directions = np.linalg.eigh(self.covariance / np.outer(unit, unit))
        if sizes[0] < -_NEGATIVE * max(sizes[-1], 1.0):
            raise DataError(
                "the covariances and common causes of these fits contradict each other, no numbers can "
                "covary so: fit again."
            )
        factor = directions * np.sqrt(np.maximum(sizes, 0.0))
        return np.asarray(self.mean + unit * (rng.standard_normal((count, len(self.mean))) @ factor.T))

    def shaped(self, numbers: Array) -> dict[str, Any]:
        """Return the parameters of a draw (n,), each in its own shape."""
        found, begin, row = {}, 0, numbers.tolist()
        for key, value in self.values.items():
            count = len(numbers_of(key, value))
            found[key] = shaped_as(key, row[begin : begin + count], value)
            begin += count
        return found


def joint_of(fits: Sequence[tuple[Section, Sequence[str]]]) -> Joint:
    """Return the joint distribution of some parameters of fits; each parameter is taken from only one fit.

    Raises DataError for a covariance that contradicts the std of its parameter, and for a std whose square overflows.
    """
    values = {key: plain(section.parameters[key].value) for section, keys in fits for key in keys}
    places: dict[str, slice] = {}
    end = 0
    for key, value in values.items():
        places[key] = slice(end, end + len(numbers_of(key, value)))
        end = places[key].stop
    covariance = np.zeros((end, end))
    covered: set[str] = set()
    for section, keys in fits:
        for key in keys:
            covariance[places[key], places[key]] = np.diag(_variances(section, key))
    effects = _effects(fits, places, end)
    shared = sum((np.outer(effect, effect) for effect in effects), np.zeros((end, end)))
    for one in places.values():
        shared[one, one] = 0.0  # a parameter's own uncertainty contains this
    covariance += shared
    for section, keys in fits:
        for block in section.covariance:
            inside = [key for key in block.of if key in keys]
            covered.update(inside)
            own = _own_places(section, block.of, inside)
            there = np.concatenate([np.arange(end)[places[key]] for key in inside] or [np.arange(0)])
            covariance[np.ix_(there, there)] = np.array(block.matrix)[np.ix_(own, own)]
            for key in inside:
                _refuse_contradiction(section, key, np.diag(covariance)[places[key]])
    uncertain = [key for key in values if np.any(np.diag(covariance)[places[key]] > 0)]
    return Joint(
        values=values,
        names=tuple(name for key, value in values.items() for name in names_of(key, value)),
        mean=np.array([number for key, value in values.items() for number in numbers_of(key, value)], dtype=np.float64),
        covariance=covariance,
        exact=tuple(key for key in values if key not in uncertain),
        independent=tuple(key for key in uncertain if key not in covered and places[key].stop - places[key].start > 1),
    )


def _variances(section: Section, key: str) -> Array:
    with np.errstate(over="ignore"):
        found = _std(section, key) ** 2
    if not np.isfinite(found).all():
        raise DataError(f"the std of {key} is too large to be one: its square is no number.")
    return found


def _refuse_contradiction(section: Section, key: str, variances: Array) -> None:
    """Raise DataError if a parameter has a std that contradicts the diagonal of its covariance."""
    std = _std(section, key)
    if section.parameters[key].std is not None and not np.allclose(np.sqrt(variances), std, rtol=_DIFFERENT, atol=0):
        raise DataError(
            f"the std of {key} and the diagonal of its covariance contradict each other. Expected the "
            "square root of the diagonal: fit again."
        )


def _std(section: Section, key: str) -> Array:
    """Return a parameter's standard uncertainties, with zero for unknown ones."""
    parameter = section.parameters[key]
    std = plain(parameter.std)
    if std is None:
        return np.zeros(len(numbers_of(key, plain(parameter.value))))
    return np.array([number or 0.0 for number in numbers_of(key, std)])


def _effects(fits: Sequence[tuple[Section, Sequence[str]]], places: Mapping[str, slice], end: int) -> list[Array]:
    """Return the effect of one standard uncertainty of each common cause on all numbers (n,)."""
    found: dict[str, Array] = {}
    for section, keys in fits:
        for cause, effects in section.common.items():
            for key in keys:
                if key in effects:
                    found.setdefault(cause, np.zeros(end))[places[key]] = numbers_of("", effects[key])
    return list(found.values())


def _own_places(section: Section, of: Sequence[str], inside: Sequence[str]) -> Array:
    """Return the rows that the numbers of some parameters have in a covariance of several parameters."""
    own: list[int] = []
    begin = 0
    for key in of:
        count = len(numbers_of(key, plain(section.parameters[key].value)))
        own += range(begin, begin + count) if key in inside else ()
        begin += count
    return np.array(own, dtype=np.intp)
