"""Group a campaign's fits into measurements, and compare repeated ones: mean, drift and agreement of each quantity."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from cfid.estimate.propagation import repeats
from cfid.quantities.registry import is_of_the_run
from cfid.quantities.values import numbers
from cfid.records.covariances import shaped_as
from cfid.records.fits import Fit
from cfid.records.parameters import Section

_OWN = 1e-3  # of a standard uncertainty: at least this remains without common causes, since inputs are rounded


class Reading(NamedTuple):
    """One measured value of a quantity; `counts` is False if it was rejected or has no standard uncertainty.

    `effects` are the effects of one standard uncertainty of each cause that fits share, by the name of the cause.
    """

    value: float
    std: float | None
    counts: bool
    effects: Mapping[str, float] = {}


def measurements_of(fits: Iterable[Fit], in_force: Mapping[str, Fit]) -> dict[str, dict[Fit, int]]:
    """Return the valid fits of each kind's measurements, the oldest first, with how many other fits each replaces.

    Fits of one kind that share all source hashes are one measurement, of which the latest fit counts, or that in force.
    """
    same: dict[tuple[str, object], list[Fit]] = {}
    for fit in sorted(fits, key=lambda fit: fit.order):
        # A fit of numbers alone has no sources, and is a measurement by itself.
        same.setdefault((fit.name, fit.hashes or id(fit)), []).append(fit)
    valid = {
        next((fit for fit in group if fit is in_force.get(name)), group[-1]): len(group) - 1
        for (name, _), group in same.items()
    }
    measurements: dict[str, dict[Fit, int]] = {name: {} for name, _ in same}
    for fit in sorted(valid, key=lambda fit: fit.order):
        measurements[fit.name][fit] = valid[fit]
    return measurements


def repeats_of(name: str, fits: Sequence[Fit]) -> dict[str, Any] | None:
    """Return all quantities of one kind of fit, each from several recordings, None where no quantity is repeated.

    `shared` is a sentence on recordings that fits share, which weakens the test; "" if they share none.
    """
    readings: dict[tuple[str, str], list[Reading | None]] = {}
    for place, fit in enumerate(fits):
        section = fit.section
        for key, parameter in section.parameters.items():
            effects = _effects(section, key)
            for number in () if is_of_the_run(key) else parameter.numbers(key):
                row = readings.setdefault((f"{key} {number.place}".rstrip(), parameter.unit), [None] * len(fits))
                if number.value is not None:
                    counts = key not in section.rejected and bool(number.std)
                    row[place] = Reading(number.value, number.std, counts, effects.get(number.place, {}))
    quantities = [
        {"quantity": quantity, "unit": unit, **compared(row)}
        for (quantity, unit), row in readings.items()
        if sum(reading is not None for reading in row) > 1 and any(reading and reading.std for reading in row)
    ]
    if not quantities:
        return None
    hashes = [sha256 for fit in fits for sha256 in fit.hashes]
    twice = len({sha256 for sha256 in hashes if hashes.count(sha256) > 1})
    sources = "A file is a source" if twice == 1 else f"{twice} files are sources"
    shared = f"{sources} of more than one of these fits: they agree better than independent ones would."
    return {
        "name": name,
        "made": [
            {"found": fit.section.found.isoformat(), "method": fit.section.method, "accepted": fit.section.accepted}
            for fit in fits
        ],
        "quantities": quantities,
        "shared": shared if twice else "",
    }


def _effects(section: Section, key: str) -> dict[str, dict[str, float]]:
    """Return the effect of each cause that fits share on the numbers of a parameter, by their place in it."""
    effects: dict[str, dict[str, float]] = {}
    value = section.parameters[key].value
    for cause, moved in section.common.items():
        if key in moved:
            for number in numbers(key, value, shaped_as(key, moved[key], value)):
                effects.setdefault(number.place, {})[cause] = number.std or 0.0
    return effects


def compared(readings: Sequence[Reading | None]) -> dict[str, Any]:
    """Return readings of one quantity with the test of their agreement; results are None where fewer than two count.

    Mean, chi-squared and `probability` are those of `estimate.propagation`. A cause of error that all readings share,
    such as the gain of one load cell, causes no difference between them: test and drift leave it out, but the mean's
    uncertainty contains it. Drift is the last reading minus the first.
    """
    shown = [
        None if reading is None else {"value": reading.value, "std": reading.std, "counts": reading.counts}
        for reading in readings
    ]
    results: dict[str, Any] = dict.fromkeys(
        ("mean", "mean_std", "chi_squared", "freedom", "probability", "drift", "drift_std", "agrees")
    ) | {"freedom": 0}
    counting = [reading for reading in readings if reading is not None and reading.counts]
    if len(counting) >= 2:
        values = np.array([reading.value for reading in counting])
        stds = np.array([reading.std for reading in counting], dtype=np.float64)
        causes = sorted(set.intersection(*(set(reading.effects) for reading in counting)))
        shared = np.array([[reading.effects[cause] for cause in causes] for reading in counting])
        shared = shared.reshape(len(counting), -1)
        own_stds = np.sqrt(np.maximum(stds**2 - np.sum(shared**2, axis=1), (_OWN * stds) ** 2))
        test = repeats(time_s=np.arange(len(values), dtype=np.float64), value=values, std=own_stds)
        results = {
            "mean": test.mean,
            "mean_std": math.hypot(test.mean_std, *shared.mean(axis=0)),
            "chi_squared": test.chi_squared,
            "freedom": test.freedom,
            "probability": test.probability,
            "drift": float(values[-1] - values[0]),
            "drift_std": math.hypot(own_stds[0], own_stds[-1]),
            "agrees": test.agree,
        }
    return {"readings": shown, **results}
