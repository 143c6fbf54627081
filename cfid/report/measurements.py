"""Group a campaign's fits into measurements: repeated fits of the same recordings are one measurement."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from cfid.records.fits import Fit


@dataclass(frozen=True)
class Measurement:
    """The valid fit of a measurement, and the other fits of exactly the same recordings, which it replaces."""

    fit: Fit
    replaced: tuple[Fit, ...]


def measurements_of(fits: Iterable[Fit], held: Mapping[str, Fit]) -> dict[str, tuple[Measurement, ...]]:
    """Return the measurements of each kind of fit by the name of the kind, the oldest first.

    Fits of one kind that share all source hashes are one measurement, of which the latest fit counts, or that in
    `held`, which has the fits in force.
    """
    same: dict[tuple[str, object], list[Fit]] = {}
    for fit in sorted(fits, key=lambda fit: fit.order):
        # A fit of numbers alone has no sources, and is a measurement by itself.
        same.setdefault((fit.name, fit.hashes or id(fit)), []).append(fit)
    found = []
    for group in same.values():
        valid = next((fit for fit in group if fit is held.get(fit.name)), group[-1])
        found.append(Measurement(valid, tuple(fit for fit in group if fit is not valid)))
    found.sort(key=lambda one: one.fit.order)
    names = dict.fromkeys(one.fit.name for one in found)
    return {name: tuple(one for one in found if one.fit.name == name) for name in names}
