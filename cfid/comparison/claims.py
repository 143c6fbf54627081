"""What sources claim of a vehicle: each quantity in one unit and along forward, left and up, beside the campaign's.

A claim is excluded where it is further from the campaign's value than the 95 % interval of their difference.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from statistics import median
from typing import Any, NamedTuple

from cfid.errors import ConfigError, DataError
from cfid.export.derived import Derived
from cfid.export.vehicle import ExportQuantity, ExportVehicle, collect, collect_published
from cfid.published import PublishedSet, published_sets
from cfid.quantities.registry import Platform
from cfid.quantities.values import evaluate
from cfid.records.campaign import Campaign
from cfid.records.values import Values
from cfid.units import COVERAGE_95

_BRUSHED: frozenset[Platform] = frozenset(("cf2", "cf21", "crazyflie"))
_INERTIA, _TORQUE, _TF, _DRAG = "inertia.matrix_kg_m2", "motor.torque_poly", "tf.time_constant_s", "drag.complex.k4"
_POINTS = "motor.table"
_HALF, _MOTOR_V = 32768.0, 3.0
_AXES, _WAYS = ("roll", "pitch", "yaw"), ("forward", "left", "up")

Stated = tuple[float, float | None]  # a value and its standard uncertainty, None where none is stated


class Claim(NamedTuple):
    """What one source states of a quantity; `remark` is what is known against it, or how it was found."""

    value: float
    std: float | None
    who: str
    vehicle: str = ""
    source: str = ""
    remark: str = ""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """The claims of one quantity, and the campaign's own, None where it has none that was accepted."""

    quantity: str
    unit: str
    own: Claim | None
    claims: tuple[Claim, ...]

    @property
    def reference(self) -> float:
        """The value that others are compared with: the campaign's own, else the median of the claims."""
        return median(claim.value for claim in self.claims) if self.own is None else self.own.value

    def ratio(self, claim: Claim) -> float | None:
        """Return a claim over the reference, None where the reference is zero."""
        return claim.value / self.reference if self.reference else None

    def deviations(self, claim: Claim) -> float | None:
        """Return how far a claim is from the campaign's value in standard uncertainties of their difference.

        None stands where the campaign states no uncertainty. A source that states none is taken as exact.
        """
        if self.own is None or not self.own.std:
            return None
        return abs(claim.value - self.own.value) / math.hypot(self.own.std, claim.std or 0.0)

    def excluded(self, claim: Claim) -> bool:
        """Return whether the campaign's measurement excludes a claim."""
        far = self.deviations(claim)
        return far is not None and far > COVERAGE_95

    @property
    def spread(self) -> float:
        """The largest over the smallest claim; infinite where signs differ or one is zero."""
        values = sorted(abs(claim.value) for claim in self.claims)
        alike = len({math.copysign(1.0, claim.value) for claim in self.claims}) == 1
        return values[-1] / values[0] if alike and values[0] else math.inf


class _Vehicle:
    """The quantities of a campaign or of a set, for which `collect` and `collect_published` are the same."""

    def __init__(self, vehicle: ExportVehicle) -> None:
        self.derived, self._find = Derived(vehicle), vehicle.find

    def parts(self, keys: Sequence[str]) -> list[ExportQuantity]:
        """Return the known quantities among keys."""
        return [quantity for key in keys if (quantity := self._find(key)) is not None]

    def value(self, key: str) -> Any:
        """Return a value. Raises DataError where it is unknown."""
        return self.derived[key]

    def std(self, key: str) -> Any:
        """Return a standard uncertainty, None where it is unknown."""
        quantity = self._find(key)
        return None if quantity is None else quantity.std


class ClaimedQuantity(NamedTuple):
    """A quantity that sources state: its name, its unit, the keys that it may come from, and how it does."""

    name: str
    unit: str
    keys: tuple[str, ...]
    of: Callable[[_Vehicle], Stated]


def _number(name: str, unit: str, key: str) -> ClaimedQuantity:
    return ClaimedQuantity(name, unit, (key,), lambda vehicle: (float(vehicle.value(key)), vehicle.std(key)))


def _moment(i: int, j: int) -> ClaimedQuantity:
    def of(vehicle: _Vehicle) -> Stated:
        std = vehicle.std(_INERTIA)
        value = vehicle.derived.inertia_kg_m2[i][j]
        if i != j and not value:
            raise DataError("a diagonal matrix states no products of inertia.")
        return value, None if std is None else vehicle.derived.turned_tensor(std, signed=False)[i][j]

    name = f"moment about {_AXES[i]}" if i == j else f"product {_AXES[i]}-{_AXES[j]}"
    return ClaimedQuantity(name, "kg m^2", (_INERTIA,), of)


def _drag(place: int) -> ClaimedQuantity:
    """Return the force against a velocity, by the rotors' speed while hovering, or where a source states no other."""

    def of(vehicle: _Vehicle) -> Stated:
        if not vehicle.derived.has("drag"):
            if vehicle.parts(["drag.complex.k1"]):
                raise DataError("k4 is one of six terms.")
            return -vehicle.derived.turned_tensor(vehicle.value(_DRAG))[place], None
        by_k = vehicle.derived.has("motor.thrust_per_speed_squared_n_s2")
        speed_rad_s = vehicle.derived.hover_speed_rad_s if by_k else vehicle.derived.hover_command_speed_rad_s
        drag, std = vehicle.derived.drag_kg_per_rad[place], vehicle.std("drag")
        if not drag:
            raise DataError("no drag is known along this axis.")
        stds = None if std is None or isinstance(std[0], list) else vehicle.derived.turned_tensor(std)
        return 4 * speed_rad_s * drag, None if stds is None or stds[place] is None else 4 * speed_rad_s * stds[place]

    return ClaimedQuantity(f"drag {_WAYS[place]}", "kg/s", ("drag", _DRAG), of)


def _at(name: str, unit: str, key: str, place: float, column: str = "") -> ClaimedQuantity:
    """Return a map's value, or a column of measured points; without covariances of a map, it has no uncertainty."""

    def of(vehicle: _Vehicle) -> Stated:
        quantity = vehicle.parts([key, _POINTS])[0]
        if quantity.key == _POINTS:
            known = [row[column] for row in quantity.value if row["cmd"] == place and column in row]
        else:
            least, most = quantity.commands or (place, place)
            known = [evaluate(key, quantity.value, place)] if least <= place <= most else []
        if not known:
            raise DataError(f"{key} is not known at {place:g}.")
        return known[0], None

    return ClaimedQuantity(name, unit, (key, _POINTS) if column else (key,), of)


def _torque(vehicle: _Vehicle) -> Stated:
    std = vehicle.std(_TORQUE)
    linear = len(vehicle.value(_TORQUE)) == 2
    return vehicle.derived.moment_per_thrust_m, std[0] if linear and std is not None else None


def _lag(vehicle: _Vehicle) -> Stated:
    if vehicle.parts([_TF]):
        return float(vehicle.value(_TF)), vehicle.std(_TF)
    return vehicle.derived.mean_lag_s, None


QUANTITIES = (
    _number("mass", "kg", "mass_kg"),
    _number("arm", "m", "arm_m"),
    *(_moment(i, j) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))),
    _number("thrust over squared speed", "N s^2/rad^2", "motor.thrust_per_speed_squared_n_s2"),
    _number("largest thrust", "N", "motor.max_thrust_n"),
    _at("thrust at half command", "N", "motor.thrust_poly", _HALF, "thrust_n"),
    _at("thrust at 3 V", "N", "motor.thrust_voltage_poly", _MOTOR_V),
    _at("rotor speed at half command", "rad/s", "motor.speed_poly", _HALF, "speed_rad_s"),
    ClaimedQuantity("torque over thrust", "m", (_TORQUE,), _torque),
    _number("rotor inertia", "kg m^2", "rotor_inertia_kg_m2"),
    ClaimedQuantity("time constant", "s", (_TF, "dynamics.rising", "dynamics.falling"), _lag),
    _number("gain of thrust over command", "N", "tf.static_gain_n"),
    *map(_drag, range(3)),
    *(_number(f"moment of air about {axis}", "N s", f"flight.moment_per_velocity_ns.{axis}") for axis in _AXES[:2]),
)


def comparisons_of(own: ExportVehicle | None, platform: Platform) -> list[Comparison]:
    """Return the comparisons of a campaign's vehicle with the sets of a platform, of all sets for `other`.

    They are in the order of `QUANTITIES`. Without a vehicle, quantities of fewer than two claims are left out.
    """
    alike = _BRUSHED if platform in _BRUSHED else {platform}
    sets = [each for each in published_sets().values() if platform == "other" or each.platform in alike]
    claims = [claim for each in sets for claim in _claims_of_set(each)]
    mine = {} if own is None else dict(_claims(own, "this campaign", own.name, lambda _: ""))
    compared = [
        Comparison(
            quantity=quantity.name,
            unit=quantity.unit,
            own=mine.get(quantity.name),
            claims=tuple(claim for name, claim in claims if name == quantity.name),
        )
        for quantity in QUANTITIES
    ]
    return [each for each in compared if len(each.claims) > (own is None)]


def comparisons_with(campaign: Campaign, values: Values, platform: Platform | None = None) -> list[Comparison]:
    """Return the comparisons of a campaign's values with the sets of a platform, by default its own."""
    try:
        own = collect(campaign.rig, values)
    except ConfigError:  # no frame, so that nothing can be turned
        own = None
    return comparisons_of(own, platform or campaign.rig.vehicle.platform)


def worst_first(comparisons: Sequence[Comparison]) -> list[tuple[Comparison, Claim]]:
    """Return every claim with its comparison: first what the campaign excludes, then by ratio."""

    def badness(pair: tuple[Comparison, Claim]) -> tuple[bool, bool, float]:
        comparison, claim = pair
        ratio = comparison.ratio(claim) or 0.0
        return comparison.own is not None, comparison.excluded(claim), abs(math.log(ratio)) if ratio > 0 else math.inf

    return sorted(((each, claim) for each in comparisons for claim in each.claims), key=badness, reverse=True)


def rows_of(comparisons: Sequence[Comparison]) -> list[dict[str, Any]]:
    """Return a row for every claim, the worst first, for programs and tables."""
    rows = []
    for each, claim in worst_first(comparisons):
        own, own_std = (None, None) if each.own is None else each.own[:2]
        verdict = {"ratio": each.ratio(claim), "deviations": each.deviations(claim), "excluded": each.excluded(claim)}
        rows.append(
            {"quantity": each.quantity, "unit": each.unit, "own": own, "own_std": own_std, **claim._asdict(), **verdict}
        )
    return rows


def _claims_of_set(published: PublishedSet) -> Iterator[tuple[str, Claim]]:
    """Yield the claims of a set: those that count, then what its variants state otherwise."""
    variants = dict.fromkeys(value.variant for value in published.values)
    seen = set[tuple[str, float]]()
    for variant in ("", *filter(None, variants)):
        first = [value for value in published.values if variant and value.variant == variant]
        ordered = (*first, *published.values)  # the first value of a key counts
        vehicle = collect_published(replace(published, values=ordered))
        places = {value.key: published.origin(value) for value in reversed(ordered)}
        who = f"{published.title} ({variant})" if variant else published.title
        for name, claim in _claims(vehicle, who, published.vehicle, places.__getitem__):
            if (name, claim.value) not in seen:
                seen.add((name, claim.value))
                yield name, claim


def _claims(vehicle: ExportVehicle, who: str, name: str, source: Callable[[str], str]) -> Iterator[tuple[str, Claim]]:
    """Yield what a vehicle's quantities state, each with its name; what no export would take of a campaign is none."""
    read = _Vehicle(vehicle)
    for quantity in QUANTITIES:
        parts = read.parts(quantity.keys)
        if not parts or (vehicle.published is None and any(part.objections() for part in parts)):
            continue
        with suppress(DataError):
            value, std = quantity.of(read)
            remark = "; ".join(dict.fromkeys(caveat.reason for part in parts for caveat in part.caveats))
            yield quantity.name, Claim(value, std or None, who, name, source(parts[0].key), remark)
