"""How certain a quantity is compared with what its purpose requires, and the main cause of its uncertainty."""

from dataclasses import dataclass

from uncertainties import UFloat

from cfid.quantities.registry import Aim, registered
from cfid.records.uncertain import OWN_FIT, parts_of
from cfid.records.values import Values, judged_numbers


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


def certainty_of(values: Values, key: str) -> Certainty:
    """Judge a quantity by the least certain of its numbers, relative to itself; small ones do not count."""
    aim, quantity = registered(key).aim, values.find(key)
    assert aim is not None
    numbers = judged_numbers(quantity.section, key, values.rig) if quantity is not None and quantity.accepted else []
    if not numbers:
        return Certainty(key=key, aim=aim, std=None)
    number = max(numbers, key=_relative_std)
    parts = parts_of(number)
    own_std = parts.pop(OWN_FIT, 0.0) / abs(number.nominal_value)
    ratio, largest = _relative_std(number), max(parts, key=lambda cause: parts[cause], default="")
    enough = ratio <= aim.std or own_std > aim.std
    return Certainty(
        key=key,
        aim=aim,
        std=ratio,
        bounded_by="" if enough else largest,
        mostly=largest if largest and parts[largest] > own_std * abs(number.nominal_value) else OWN_FIT,
    )


def _relative_std(number: UFloat) -> float:
    return float(number.std_dev / abs(number.nominal_value))


def percent(std: float | None) -> str:
    """Return a relative standard uncertainty as text."""
    if std is None:
        return "-"
    return f"{100 * std:.2g} %" if std < 1 else f"{100 * std:.0f} %"
