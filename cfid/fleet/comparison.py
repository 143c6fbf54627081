"""Compare each number across campaigns: mean, scatter against what the uncertainties explain, outliers and drift."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri, stdtrit

from cfid.estimate.propagation import Repeats, repeats
from cfid.fleet.summary import KnownValue, Summary

Array = npt.NDArray[np.float64]

FEWEST = 5  # values, for one of them to be called an outlier
_FALSE = 0.01  # share of tables without outliers in which one is named
_CERTAIN = 0.995  # confidence in a drift on one side: 99 % for both sides
_OF_NORMAL = 1.4826  # standard deviation over median absolute deviation


@dataclass(frozen=True, kw_only=True)
class ComparedNumber:
    """One number in all campaigns: its value in each, None if missing, and how well the accepted values agree.

    `expected_scatter` is the standard deviation that the stated uncertainties alone would cause, None if unknown.
    `outliers` names the campaigns that lie apart from the others, `rejected` those whose number was rejected, and
    `unstated` those whose number has no uncertainty. Numbers without an uncertainty do not count if at least two others
    have one.
    """

    name: str
    unit: str
    values: tuple[KnownValue | None, ...]
    repeats: Repeats | None
    expected_scatter: float | None
    outliers: tuple[str, ...]
    rejected: tuple[str, ...]
    unstated: tuple[str, ...]

    @property
    def used(self) -> int:
        """The number of values that count."""
        accepted = sum(known is not None and known.accepted for known in self.values)
        return accepted if self.expected_scatter is None else accepted - len(self.unstated)

    @property
    def drifts(self) -> bool:
        """Whether the drift is significant at 99 % confidence."""
        found = self.repeats
        if found is None or found.drift_per_day is None or not found.drift_std_per_day:
            return False
        limit = ndtri(_CERTAIN) if found.probability is not None else stdtrit(self.used - 2, _CERTAIN)
        return bool(abs(found.drift_per_day) > limit * found.drift_std_per_day)


def compare(summaries: Sequence[Summary]) -> list[ComparedNumber]:
    """Compare the numbers of campaigns; numbers of the same name in different units are different numbers."""
    names = [summary.name for summary in summaries]
    tables = [{(known.name, known.unit): known for known in summary.known} for summary in summaries]
    keys = dict.fromkeys(key for table in tables for key in table)
    units = Counter(name for name, _ in keys)
    return [
        _compared(name if units[name] == 1 else f"{name}, {unit}", [table.get((name, unit)) for table in tables], names)
        for name, unit in keys
    ]


def _compared(name: str, values: Sequence[KnownValue | None], campaigns: Sequence[str]) -> ComparedNumber:
    accepted = [(place, known) for place, known in zip(campaigns, values, strict=True) if known and known.accepted]
    value = np.array([known.value for _, known in accepted])
    std = np.array([known.std or np.nan for _, known in accepted], dtype=float)
    stated = np.isfinite(std)
    counts = stated if stated.sum() > 1 else np.full(len(std), fill_value=True)
    time_s = np.array([known.recorded.timestamp() for _, known in accepted])
    found = repeats(time_s=time_s[counts], value=value[counts], std=std[counts]) if counts.sum() > 1 else None
    return ComparedNumber(
        name=name,
        unit=next(known.unit for known in values if known is not None),
        values=tuple(values),
        repeats=found,
        expected_scatter=float(np.sqrt(np.mean(std[stated] ** 2))) if stated.sum() > 1 else None,
        outliers=tuple(accepted[place][0] for place in outliers(value, std)),
        rejected=tuple(
            place for place, known in zip(campaigns, values, strict=True) if known is not None and not known.accepted
        ),
        unstated=tuple(place for (place, _), one in zip(accepted, stated, strict=True) if not one),
    )


def outliers(value: Array, std: Array) -> list[int]:
    """Return the indices of outliers among values (n,) with standard uncertainties (n,), nan for unknown ones.

    A value is an outlier if its distance from the median exceeds a limit that only one in a hundred tables without
    outliers would exceed. The unit of the distance is the scatter of the values, or the value's own uncertainty if that
    is larger. The scatter is the median absolute deviation (F. R. Hampel, The influence curve and its role in robust
    estimation, JASA 69, 1974), which outliers hardly widen. Student's t with half the degrees of freedom allows for the
    median of few values. Among fewer than five values, none is called an outlier.
    """
    count = len(value)
    if count < FEWEST:
        return []
    distance = np.abs(value - np.median(value))
    scale = np.fmax(_OF_NORMAL * np.median(distance), std)
    limit = stdtrit((count - 1) / 2, 1 - _FALSE / (2 * count))
    apart = np.flatnonzero(distance > limit * scale)
    return [int(place) for place in apart[np.argsort(-distance[apart])]]
