"""How certain a quantity is compared with what its purpose requires, and the main cause of its uncertainty."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from cfid.estimate.differences import Compared, number_of
from cfid.guide.plan import Aim
from cfid.records.parameters import Parameter, Section
from cfid.records.rig_file import Rig
from cfid.records.values import find_parameter

_OWN = "noise and the inputs of its own fit"
_SMALL = 0.1  # of a value's largest number: smaller ones, such as products of inertia, are not judged


@dataclass(frozen=True, kw_only=True)
class Certainty:
    """The relative standard uncertainty of a quantity, None if it was not found, and the aim that it should meet.

    `bounded_by` names a value of rig.toml without whose uncertainty the quantity would meet its aim, which no recording
    can change. `mostly` is the largest part of the uncertainty: a cause that fits share, or the noise and inputs of its
    own fit.
    """

    key: str
    aim: Aim
    std: float | None
    bounded_by: str = ""
    mostly: str = ""

    @property
    def short_by(self) -> float:
        """The ratio of the quantity's uncertainty to the aim, 0 if unknown."""
        return 0.0 if self.std is None else self.std / self.aim.std


def certainty_of(sections: Mapping[str, Section], key: str, aim: Aim, rig: Rig) -> Certainty:
    """Judge a quantity by the least certain of its numbers, relative to itself; small ones do not count."""
    counting = find_parameter(sections, key)
    if counting is None or counting.rejected:
        return Certainty(key=key, aim=aim, std=None)
    numbers = list(_judged(counting.section, counting.parameter, key, aim, rig))
    largest = max((abs(one.value) for one in numbers), default=0.0)
    ratios = [(one.std / abs(one.value), one) for one in numbers if abs(one.value) > _SMALL * largest]
    if not ratios or not all(math.isfinite(ratio) for ratio, _ in ratios):
        return Certainty(key=key, aim=aim, std=None)
    ratio, least_sure = max(ratios, key=lambda one: one[0])
    bounded_by, mostly = _bounding(least_sure, aim, ratio), _mostly(least_sure)
    return Certainty(key=key, aim=aim, std=ratio, bounded_by=bounded_by, mostly=mostly)


def _judged(section: Section, parameter: Parameter, key: str, aim: Aim, rig: Rig) -> Iterator[Compared]:
    """Yield the numbers by which a quantity is judged, without those that have no standard uncertainty."""
    numbers = list(parameter.numbers(key))
    if aim.weights is not None:
        if all(one.std is not None for one in numbers):
            yield number_of(section, key, aim.weights(len(numbers), rig))
        return
    effects = {cause: moved[key] for cause, moved in section.common.items() if key in moved}
    for place, one in enumerate(numbers):
        if one.value is not None and one.std is not None:
            yield Compared(one.value, one.std, {cause: moved[place] for cause, moved in effects.items()})


def _bounding(found: Compared, aim: Aim, ratio: float) -> str:
    """Return the largest cause from rig.toml if a number would meet the aim without such causes, else ""."""
    shares = {cause: abs(effect / found.value) for cause, effect in found.effects.items()}
    enough = ratio <= aim.std or _own_std(found) / abs(found.value) > aim.std
    return "" if enough or not shares else max(shares, key=lambda cause: shares[cause])


def _mostly(found: Compared) -> str:
    """Return the largest part of a number's uncertainty: a cause that fits share, or its own fit's noise and inputs."""
    largest = max(found.effects, key=lambda cause: abs(found.effects[cause]), default="")
    return largest if largest and abs(found.effects[largest]) > _own_std(found) else _OWN


def _own_std(found: Compared) -> float:
    """Return the standard uncertainty that a number would have without the causes that fits share."""
    return math.sqrt(max(found.std**2 - sum(effect**2 for effect in found.effects.values()), 0.0))


def percent(std: float | None) -> str:
    """Return a relative standard uncertainty as text."""
    if std is None:
        return "-"
    return f"{100 * std:.2g} %" if std < 1 else f"{100 * std:.0f} %"
