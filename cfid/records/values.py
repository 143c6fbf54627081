"""A campaign's values: of all kept fits of a quantity, which one counts, and why.

The rule: of the fits that are accepted and current, the most certain counts. A fit is current while its runs and what
it took from rig.toml are unchanged, its method has the present revision, and no later accepted fit of the same or more
recordings has replaced it. A fit by the thesis' method or without standard uncertainties counts only where no other
fit has the quantity. What one fit gives jointly, such as a thrust map with its maximum, comes from one fit. A value
that `cfid set` stored counts before all fits.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from uncertainties import UFloat

from cfid.experiments import EXPERIMENTS
from cfid.quantities.registry import QUANTITIES, Shape, find, is_of_the_run
from cfid.records.covariances import Covariance, numbers_of
from cfid.records.fits import BY_HAND, Fit
from cfid.records.parameters import Parameter, Section, plain
from cfid.records.rig_file import Rig
from cfid.records.stale import Stale
from cfid.records.uncertain import number_of

_AIMED = [row for row in QUANTITIES if row.aim is not None]
_SMALL = 0.1  # of a value's largest number: smaller ones, such as products of inertia, do not show how certain it is


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A value of the campaign: its key, and the fit that it comes from.

    `rejection` is the reason why its fit, or a later fit of the same recordings, rejected it; `outdated` has the
    reasons why its fit is no longer current. Both are empty for a value that counts.
    """

    key: str
    fit: Fit
    rejection: str = ""
    outdated: tuple[str, ...] = ()

    @property
    def section(self) -> Section:
        """The section of the fit, which has covariances and causes."""
        return self.fit.section

    @property
    def parameter(self) -> Parameter:
        """The value with its standard uncertainty and unit."""
        return self.fit.section.parameters[self.key]

    @property
    def accepted(self) -> bool:
        """Whether no fit rejected it."""
        return not self.rejection

    def number(self, weights: Sequence[float] = (1.0,)) -> UFloat:
        """Return the sum of its numbers times `weights`, with its uncertainty by cause."""
        return number_of(self.section, self.key, weights)


class Candidate(NamedTuple):
    """A kept fit that has a quantity: whether it is taken and why, and its standard uncertainty over the aim."""

    fit: Fit
    taken: bool
    why: str
    over_aim: float | None


class _Place(NamedTuple):
    """What one fit gives jointly; `fit_name` is "" unless the quantities are of one recording, as those of a swing."""

    fit_name: str
    joint: str


class Values:
    """The values of a campaign, found by the rule from its kept fits; recordings are read when a value is asked for."""

    def __init__(self, fits: Iterable[Fit], rig: Rig, stale: Stale) -> None:
        """Take the kept fits that were not withdrawn, the present rig, and a function that knows outdated sections."""
        self.rig = rig
        self.fits = tuple(sorted(fits, key=lambda fit: fit.order))
        self._stale = stale
        self._outdated: dict[Fit, tuple[str, ...]] = {}
        self._taken: dict[_Place, Fit | None] = {}
        self._by_hand = {key: fit for fit in self.fits if fit.name == BY_HAND for key in fit.section.parameters}
        self._giving: dict[_Place, list[Fit]] = {}
        for fit in self.fits:
            if fit.name != BY_HAND:
                for place in dict.fromkeys(
                    _place(fit, key) for key in (*fit.section.parameters, *fit.section.rejected)
                ):
                    self._giving.setdefault(place, []).append(fit)

    def find(self, key: str) -> Quantity | None:
        """Return the value of a key, None where no kept fit has one."""
        if key in self._by_hand:
            return Quantity(key=key, fit=self._by_hand[key])
        places = {_place(fit, key) for fit in self.fits if key in fit.section.parameters}
        giving = [fit for place in places if (fit := self._fit_giving(place, key)) is not None]
        return self._quantity(key, max(giving, key=lambda fit: fit.order)) if giving else None

    def accepted(self, key: str) -> Quantity | None:
        """Return the value of a key if it is accepted and has a standard uncertainty, else None."""
        quantity = self.find(key)
        return quantity if quantity is not None and quantity.accepted and quantity.parameter.std is not None else None

    def __iter__(self) -> Iterator[Quantity]:
        """Yield every value: those set by hand, then those of fits in the order of the fits' names."""
        for key, fit in self._by_hand.items():
            yield Quantity(key=key, fit=fit)
        giving: list[tuple[Fit, str]] = []
        for place, fits in self._giving.items():
            keys = [key for fit in fits for key in fit.section.parameters if _place(fit, key) == place]
            for key in dict.fromkeys(keys):
                given = None if key in self._by_hand else self._fit_giving(place, key)
                giving += [] if given is None else [(given, key)]
        for fit, key in sorted(giving, key=lambda each: (each[0].name, each[0].order)):
            yield self._quantity(key, fit)

    @cached_property
    def by_fit(self) -> dict[Fit, list[Quantity]]:
        """The values by the fit that they come from."""
        quantities: dict[Fit, list[Quantity]] = {}
        for quantity in self:
            quantities.setdefault(quantity.fit, []).append(quantity)
        return quantities

    @cached_property
    def in_force(self) -> dict[str, Fit]:
        """By the name of a kind of fit, the fit that most of the values come from, else the last with numbers."""
        places = [place for place in self._giving if not _is_of_the_run(place)]
        counts = Counter(
            fit
            for place in places
            if (fit := self._fit_for(place)) is not None
            for key in fit.section.parameters
            if _place(fit, key) == place
        )
        fits = [fit for fit in self.fits if fit.section.parameters and fit.name != BY_HAND]
        return {fit.name: fit for fit in sorted(fits, key=lambda fit: (counts[fit], self._is_sound(fit), fit.order))}

    def sections(self) -> dict[str, Section]:
        """Return the values by the name of their fit, each with its covariances and causes.

        Where the values of one kind come from several fits, the names of those that give fewer end with their counter.
        """
        sections: dict[str, Section] = {}
        for fit, quantities in self.by_fit.items():
            section = part_of(fit.section, [quantity.key for quantity in quantities])
            rejected = {quantity.key: quantity.rejection for quantity in quantities if quantity.rejection}
            if fit.name == BY_HAND and BY_HAND in sections:
                section = replace(section, parameters={**sections[BY_HAND].parameters, **section.parameters})
            sections[self.label(fit)] = replace(section, rejected={**section.rejected, **rejected})
        return dict(sorted(sections.items()))

    def label(self, fit: Fit) -> str:
        """Return the name under which `sections` has a fit's values."""
        return fit.name if fit.name == BY_HAND or self.in_force[fit.name] is fit else f"{fit.name} ({fit.number})"

    def rejected(self, key: str) -> str:
        """Return why the last fit that looked for a key rejected it, "" where none did or a value is accepted."""
        quantity = self.find(key)
        if quantity is not None:
            return quantity.rejection
        return next((fit.section.rejected[key] for fit in reversed(self.fits) if key in fit.section.rejected), "")

    def outdated(self, fit: Fit) -> tuple[str, ...]:
        """Return the reasons why a fit is no longer current; none for a value set by hand."""
        if fit not in self._outdated:
            kind = EXPERIMENTS.get(fit.name.partition(" ")[0])
            old = kind is not None and fit.revision != kind.revision
            changed = ("Made by another revision of its method: fit again.",) if old else ()
            self._outdated[fit] = (*self._stale(fit.section), *changed)
        return self._outdated[fit]

    def candidates(self, key: str) -> tuple[Candidate, ...]:
        """Return the kept fits that have or rejected a key, the one that is taken first, then the latest first."""
        by_hand = self._by_hand.get(key)
        quantity = self.find(key)
        candidates = (
            [] if by_hand is None else [Candidate(by_hand, True, "set by hand, which counts before fits", None)]
        )
        for place, fits in self._giving.items():
            for fit in (fit for fit in fits if key in (*fit.section.parameters, *fit.section.rejected)):
                if _place(fit, key) == place:
                    taken = quantity is not None and quantity.fit is fit
                    ratio = None if _is_of_the_run(place) else self._over_aims(fit, place)
                    finite = ratio if ratio is not None and math.isfinite(ratio) else None
                    candidates.append(Candidate(fit, taken, self._why(key, fit, place, taken=taken), finite))
        return tuple(sorted(candidates, key=lambda each: (each.taken, each.fit.order), reverse=True))

    def _why(self, key: str, fit: Fit, place: _Place, *, taken: bool) -> str:
        """Return why a fit is taken for a key or why not, as the end of a sentence."""
        objection = self._objection(fit, place, key)
        if key in self._by_hand:
            return objection or f"{self._by_hand[key].stem} was set by hand"
        chosen = self._fit_giving(place, key) or self._fit_for(place)
        if taken and objection:
            return f"no fit is better, but: {objection}"
        if taken:
            return "the most certain of the accepted and current fits"
        if objection or chosen is None:
            return objection or "its quantities were rejected"
        if _is_of_the_run(place):
            return f"{chosen.stem} counts for the quantities of its recording"
        return f"{chosen.stem} is more certain{'' if place.joint == key else ', and gives this jointly with others'}"

    def _quantity(self, key: str, fit: Fit) -> Quantity:
        later = self._replacing(fit, _place(fit, key))
        rejection = fit.section.rejected.get(key) or (later.section.rejected.get(key, "") if later is not None else "")
        return Quantity(key=key, fit=fit, rejection=rejection, outdated=self.outdated(fit))

    def _fit_for(self, place: _Place) -> Fit | None:
        """Return the fit that counts for a place, None where no fit has a number."""
        if place not in self._taken:
            self._taken[place] = self._chosen(place)
        return self._taken[place]

    def _fit_giving(self, place: _Place, key: str) -> Fit | None:
        """Return the fit that a key of a place comes from, None for none: the one that counts for the place.

        Quantities with an aim are parts of one result. Of others, such as test bodies about two axes, one that the fit
        does not give comes from the most certain fit that does.
        """
        taken = self._fit_for(place)
        having = [fit for fit in self._giving[place] if key in fit.section.parameters and _place(fit, key) == place]
        sound = [fit for fit in having if not self._objection(fit, place, key)]
        if taken in sound or not sound or _is_of_the_run(place) or any(row.joint == place.joint for row in _AIMED):
            return taken if taken in having else None
        return min(reversed(sound), key=lambda fit: self._over_aims(fit, place))

    def _chosen(self, place: _Place) -> Fit | None:
        if _is_of_the_run(place):
            return self.in_force.get(place.fit_name)
        fits = self._giving[place]
        sound = [fit for fit in fits if not self._objection(fit, place)]
        if sound:
            return min(reversed(sound), key=lambda fit: self._over_aims(fit, place))
        numbers = [fit for fit in fits if any(_place(fit, key) == place for key in fit.section.parameters)]
        return max(numbers, key=lambda fit: self._rank_of_unsound(fit, place), default=None)

    def _rank_of_unsound(self, fit: Fit, place: _Place) -> tuple[bool, bool, bool, tuple[object, ...]]:
        keys = [key for key in fit.section.parameters if _place(fit, key) == place]
        accepted = any(key not in fit.section.rejected for key in keys)
        return accepted, self._replacing(fit, place) is None, not self.outdated(fit), fit.order

    def _objection(self, fit: Fit, place: _Place, key: str = "") -> str:
        """Return why a fit does not count for a place, "" where it may; `key` selects the rejection that is named."""
        keys = [each for each in fit.section.parameters if _place(fit, each) == place]
        accepted = [each for each in keys if each not in fit.section.rejected]
        if not fit.section.accepted or not accepted or (key and key in fit.section.rejected):
            reasons = fit.section.rejected
            return f"rejected: {reasons.get(key) or next(iter(reasons.values()), 'kept by force')}"
        if fit.section.method == "thesis":
            return "found by the thesis' method, which counts only where no other fit has it"
        if not _is_of_the_run(place) and all(fit.section.parameters[each].std is None for each in accepted):
            return "its standard uncertainty is not stated"
        if outdated := self.outdated(fit):
            return outdated[0].rstrip(".")
        later = self._replacing(fit, place)
        return "" if later is None else f"replaced by {later.stem}, a later fit of the same or more recordings"

    def _replacing(self, fit: Fit, place: _Place) -> Fit | None:
        """Return the last accepted and current fit of the same recordings, or more, that looked for a place."""
        later = (other for other in self._giving[place] if other.name == fit.name and other.order > fit.order)
        same = [other for other in later if fit.recordings <= other.recordings and self._is_sound(other)]
        return same[-1] if same else None

    def _is_sound(self, fit: Fit) -> bool:
        stated = any(parameter.std is not None for parameter in fit.section.parameters.values())
        return fit.section.accepted and fit.section.method != "thesis" and stated and not self.outdated(fit)

    def _over_aims(self, fit: Fit, place: _Place) -> float:
        """Return the worst standard uncertainty of a place's quantities over its aim, infinite where one is unknown.

        Of quantities without aims, the mean of the relative standard uncertainties counts, each at most 1, which is
        also that of a quantity that another fit gives and this one does not.
        """
        section = fit.section
        keys = [key for key in section.parameters if key not in section.rejected and _place(fit, key) == place]
        aims = {row.key: row.aim.std for row in _AIMED if row.joint == place.joint and row.aim is not None}
        if aims and not place.fit_name:
            ratios = [relative_std(section, key, self.rig) if key in keys else None for key in aims]
            return max(
                math.inf if ratio is None else ratio / aim for ratio, aim in zip(ratios, aims.values(), strict=True)
            )
        known = {key: relative_std(section, key, self.rig) for key in keys}
        given = {
            key
            for other in self._giving[place]
            for key in other.section.parameters
            if key not in other.section.rejected and _place(other, key) == place
        }
        if all(ratio is None for ratio in known.values()):
            return math.inf
        return sum(1.0 if (ratio := known.get(key)) is None else min(ratio, 1.0) for key in given) / len(given)


def relative_std(section: Section, key: str, rig: Rig) -> float | None:
    """Return the relative standard uncertainty of a parameter by its least certain number; None where it is unknown."""
    numbers = judged_numbers(section, key, rig)
    return max((number.std_dev / abs(number.nominal_value) for number in numbers), default=None)


def judged_numbers(section: Section, key: str, rig: Rig) -> list[UFloat]:
    """Return the numbers that show how certain a parameter is, small ones left out; none where one is unknown."""
    parameter = section.parameters[key]
    known = list(parameter.numbers(key))
    if any(number.value is None or not math.isfinite(number.value) for number in known):
        return []
    weights = judging_weights(key, len(known), rig)
    if weights is not None:
        numbers = [number_of(section, key, weights)] if all(number.std is not None for number in known) else []
    else:
        units: Any = np.eye(len(numbers_of(key, plain(parameter.value)))) if known else []
        stated = [place for place, number in enumerate(known) if number.std is not None]
        numbers = [number_of(section, key, units[place]) for place in stated if len(units) == len(known)]
    largest = max((abs(number.nominal_value) for number in numbers), default=0.0)
    counting = [number for number in numbers if abs(number.nominal_value) > _SMALL * largest]
    return counting if all(math.isfinite(number.std_dev) for number in counting) else []


def judging_weights(key: str, count: int, rig: Rig) -> list[float] | None:
    """Return the weights by which a polynomial's coefficients sum to the number that it is judged by, else None.

    This is its value at the place of its aim or of its plausible range, or its slope, in hover if the aim states that.
    """
    row = find(key)
    if row is None or row.shape is not Shape.POLYNOMIAL:
        return None
    powers = range(count) if row.lowest_first else range(count - 1, -1, -1)
    if row.aim is not None and row.aim.slope_in_hover:
        thrust_n = rig.vehicle.mass_kg * rig.site.gravity_mps2 / 4
        return [power * thrust_n ** max(power - 1, 0) for power in powers]
    at = row.aim.at if row.aim is not None else row.plausible.at if row.plausible is not None else None
    return None if at is None else [at**power for power in powers]


def part_of(section: Section, keys: Sequence[str]) -> Section:
    """Return a section with some of its parameters, and what it states about them."""
    if len(keys) == len(section.parameters):
        return section
    common = {
        cause: {key: effect for key, effect in effects.items() if key in keys}
        for cause, effects in section.common.items()
    }
    return replace(
        section,
        parameters={key: parameter for key, parameter in section.parameters.items() if key in keys},
        covariance=tuple(part for block in section.covariance if (part := _block_of(block, section, keys)).of),
        common={cause: effects for cause, effects in common.items() if effects},
    )


def _block_of(block: Covariance, section: Section, keys: Sequence[str]) -> Covariance:
    places = [key in keys for key in block.of for _ in numbers_of(key, plain(section.parameters[key].value))]
    matrix = np.array(block.matrix)[np.ix_(places, places)]
    return Covariance(tuple(key for key in block.of if key in keys), tuple(map(tuple, matrix.tolist())))


def _place(fit: Fit, key: str) -> _Place:
    row = find(key)
    joint = key if row is None else row.joint or key
    if is_of_the_run(key):
        return _Place(fit.name, "")
    return _Place(fit.name if " " in fit.name else "", joint)


def _is_of_the_run(place: _Place) -> bool:
    return place.joint == ""
