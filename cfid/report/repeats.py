"""Compare repeated measurements of a quantity: values, drift and agreement."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from cfid.estimate.propagation import LEAST_PROBABILITY, repeats
from cfid.quantities.registry import is_of_the_run
from cfid.quantities.values import numbers
from cfid.records.covariances import shaped_as
from cfid.records.parameters import Section
from cfid.report.measurements import Measurement

Effects = Mapping[str, float]  # by the name of a cause that fits share: the effect of one standard uncertainty of it

_OWN = 1e-3  # of a standard uncertainty: at least this remains without common causes, since inputs are rounded


@dataclass(frozen=True)
class RepeatReading:
    """One measured value of a quantity; `counts` is False if it was rejected or has no standard uncertainty."""

    value: float
    std: float | None
    counts: bool


@dataclass(frozen=True)
class Made:
    """When and how one of several measurements was fitted, and whether the fit was accepted."""

    found: datetime
    method: str
    accepted: bool


@dataclass(frozen=True)
class Repeat:
    """A quantity's readings, one for each measurement (None if it lacks the quantity), and the test of their agreement.

    Mean, chi-squared and `probability` are those of `estimate.propagation`. A cause of error that all readings share,
    such as the gain of one load cell, causes no difference between them: test and drift leave it out, but the mean's
    uncertainty contains it. Drift is the last reading minus the first. The results are None where fewer than two
    readings count.
    """

    quantity: str
    unit: str
    readings: tuple[RepeatReading | None, ...]
    mean: float | None
    mean_std: float | None
    chi_squared: float | None
    freedom: int
    probability: float | None
    drift: float | None
    drift_std: float | None

    @property
    def agrees(self) -> bool | None:
        """Whether the readings agree within their uncertainties, None if unknown."""
        return None if self.probability is None else self.probability >= LEAST_PROBABILITY


@dataclass(frozen=True)
class RepeatedFit:
    """All quantities of one kind of fit, each from several recordings, the oldest first.

    `shared` is a sentence on recordings that fits share, which weakens the test; "" if they share none.
    """

    name: str
    made: tuple[Made, ...]
    quantities: tuple[Repeat, ...]
    shared: str


def repeated_fits(measured: Mapping[str, Sequence[Measurement]]) -> tuple[RepeatedFit, ...]:
    """Return the kinds of fit with more than one measurement."""
    found = []
    for name, several in measured.items():
        quantities = _quantities(several) if len(several) > 1 else ()
        if quantities:
            sections = [measurement.fit.section for measurement in several]
            made = tuple(Made(section.found, section.method, section.accepted) for section in sections)
            found.append(RepeatedFit(name, made, quantities, _shared(several)))
    return tuple(found)


def _quantities(several: Sequence[Measurement]) -> tuple[Repeat, ...]:
    readings: dict[tuple[str, str], list[RepeatReading | None]] = {}
    effects: dict[str, list[Effects]] = {}
    for place, measurement in enumerate(several):
        section = measurement.fit.section
        for key, parameter in section.parameters.items():
            moved = _effects(section, key)
            for entry in () if is_of_the_run(key) else parameter.numbers(key):
                name = f"{key} {entry.place}".rstrip()
                row = readings.setdefault((name, parameter.unit), [None] * len(several))
                if entry.value is not None:
                    row[place] = RepeatReading(entry.value, entry.std, key not in section.rejected and bool(entry.std))
                    effects.setdefault(name, [{}] * len(several))[place] = moved.get(entry.place, {})
    return tuple(
        compared(quantity, unit, tuple(row), tuple(effects[quantity]))
        for (quantity, unit), row in readings.items()
        if _is_repeated(row)
    )


def _effects(section: Section, key: str) -> Mapping[str, Effects]:
    """Return the effect of each cause that fits share on the numbers of a parameter, by their place in it."""
    found: dict[str, dict[str, float]] = {}
    value = section.parameters[key].value
    for cause, moved in section.common.items():
        if key in moved:
            for number in numbers(key, value, shaped_as(key, moved[key], value)):
                found.setdefault(number.place, {})[cause] = number.std or 0.0
    return found


def _is_repeated(row: Sequence[RepeatReading | None]) -> bool:
    there = [reading for reading in row if reading is not None]
    return len(there) > 1 and any(reading.std for reading in there)


def compared(
    quantity: str, unit: str, readings: tuple[RepeatReading | None, ...], effects: tuple[Effects, ...] = ()
) -> Repeat:
    """Return readings of one quantity with mean, drift and chi-squared; `effects` has the causes' effects on each."""
    changes = effects or ({},) * len(readings)
    counting = [
        (one.value, one.std, own)
        for one, own in zip(readings, changes, strict=True)
        if one is not None and one.counts and one.std
    ]
    if len(counting) < 2:
        return Repeat(quantity, unit, readings, None, None, None, 0, None, None, None)
    values, whole = np.array([one[:2] for one in counting]).T
    shared = set.intersection(*(set(own) for *_, own in counting))
    moved = np.array([[own[cause] for cause in sorted(shared)] for *_, own in counting]).reshape(len(values), -1)
    stds = np.sqrt(np.maximum(whole**2 - np.sum(moved**2, axis=1), (_OWN * whole) ** 2))
    found = repeats(time_s=np.arange(len(values), dtype=np.float64), value=values, std=stds)
    return Repeat(
        quantity=quantity,
        unit=unit,
        readings=readings,
        mean=found.mean,
        mean_std=math.hypot(found.mean_std, *moved.mean(axis=0)),
        chi_squared=found.chi_squared,
        freedom=found.freedom,
        probability=found.probability,
        drift=float(values[-1] - values[0]),
        drift_std=math.hypot(stds[0], stds[-1]),
    )


def _shared(several: Sequence[Measurement]) -> str:
    """Return a sentence if measurements share recordings and are thus not independent, else ""."""
    seen: set[str] = set()
    twice: set[str] = set()
    for measurement in several:
        twice |= seen & measurement.fit.hashes
        seen |= measurement.fit.hashes
    if not twice:
        return ""
    many = "A file is a source" if len(twice) == 1 else f"{len(twice)} files are sources"
    return f"{many} of more than one of these fits: they agree better than independent ones would."
