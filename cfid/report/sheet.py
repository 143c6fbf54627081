"""The sheet of the thesis' appendix A for this vehicle, and its main numbers in plain units.

Every parameter has its uncertainty, unit and origin; a missing one is listed with the command that determines it.
"""

import math
from collections.abc import Collection, Iterator, Sequence
from pathlib import PurePath
from typing import Any, NamedTuple

from cfid.experiments import EXPERIMENTS
from cfid.guide.certainty import percent
from cfid.quantities.registry import Quantity, Shape, registered
from cfid.quantities.rounding import value_and_std
from cfid.quantities.values import units_of
from cfid.records.covariances import numbers_of
from cfid.records.files import RUNS_FOLDER
from cfid.records.fits import BY_HAND
from cfid.records.parameters import Parameter, plain
from cfid.records.values import Quantity as Value
from cfid.records.values import Values, judging_weights
from cfid.wire.app import MIDDLE

Content = dict[str, Any]

_BARELY = 2.0  # standard uncertainties from zero; a nearer value is consistent with zero


class _Part(NamedTuple):
    """Quantities of one fit under one title, by default the title of the first quantity."""

    group: str
    keys: tuple[str, ...]
    equation: str = ""
    title: str = ""
    model: str = ""  # of drag


_TF_KEYS = ("numerator", "denominator", "sample_time_s", "time_constant_s", "static_gain_n", "delay_s")
_SHEET = (
    _Part("Inertia", ("inertia.matrix_kg_m2",)),
    _Part("Motors: mappings", ("motor.thrust_poly",), "f = Σ a_k cmd^k"),
    _Part("Motors: mappings", ("motor.speed_poly",), "ω = Σ b_k cmd^k"),
    _Part("Motors: mappings", ("motor.torque_poly",), "τ = Σ c_k f^k"),
    _Part(
        "Motors: transfer function",
        tuple(f"tf.{name}" for name in _TF_KEYS),
        "H(z) = (n_0 + n_1 z⁻¹ + …) / (1 + d_1 z⁻¹ + …)",
        "Command to thrust, one motor",
    ),
    _Part("Drag", ("drag.simple_kg_per_rad",), "f = diag(K) Σω v", model="simple"),
    _Part(
        "Drag",
        tuple(f"drag.complex.k{i}" for i in range(1, 7)),
        "f = K1 Σω v + K2 v² + K3 (Σω)² + K4 v + K5 Σω + K6, axis by axis",
        "Complex model",
        "complex",
    ),
    _Part("Drag", ("drag.cross_coupling_kg_per_rad",), "f = K Σω v", model="cross"),
)


class _Main(NamedTuple):
    """A main number: one of a quantity's numbers, by its `place`, or where None the value that it is judged by.

    `scale` converts it from the quantity's unit to the plain `unit`.
    """

    title: str
    key: str
    place: int | None
    scale: float
    unit: str


_MILLIONTH = "10⁻⁶ "
_MAIN = (
    *(_Main(f"Inertia about {axis}", "inertia.matrix_kg_m2", i, 1e6, "10⁻⁶ kg m²") for i, axis in enumerate("xyz")),
    _Main("Viscous friction of the axis", "friction.viscous_nms_per_rad", 0, 1e6, "10⁻⁶ N m s/rad"),
    _Main("Largest thrust of one motor", "motor.max_thrust_n", 0, 1e3, "mN"),
    _Main("Mass that hovers at most", "motor.hover_mass_kg", 0, 1e3, "g"),
    _Main(f"Speed at command {MIDDLE:.0f}", "motor.speed_poly", None, 1.0, "rad/s"),
    _Main("Torque over thrust, in hover", "motor.torque_poly", None, 1e3, "mN m/N"),
    _Main("Time constant of a motor", "tf.time_constant_s", 0, 1e3, "ms"),
    _Main("Round trip to the vehicle", "latency.rtt_mean_s", 0, 1e3, "ms"),
    *(_Main(f"Drag along {axis}", "drag.simple_kg_per_rad", i, 1e6, "10⁻⁶ kg/rad") for i, axis in enumerate("xyz")),
)


def sheet_of(values: Values, *, wanted: Collection[str]) -> list[Content]:
    """Return the groups of the sheet; missing quantities are listed only for the `wanted` kinds of fit.

    Of the models of drag, only the one that the fit chose is listed.
    """
    vehicle, mass = values.rig.vehicle, registered("mass_kg")
    rows = [_row(mass.symbol, vehicle.mass_kg, vehicle.mass_std_kg or None, mass.unit)]
    groups = {"Inertia": [_entry(["vehicle.mass_kg"], "Mass", rows, _stated("as rig.toml states", None))]}
    chosen = values.in_force["drag"].quality.get("chosen") if "drag" in values.in_force else None
    for part in _SHEET:
        if part.model and chosen not in (None, part.model):
            continue
        if registered(part.keys[0]).section in wanted or any(values.find(key) for key in part.keys):
            groups.setdefault(part.group, []).append(_fitted(values, part))
    for value in values:
        if value.fit.name == BY_HAND:
            origin = _stated("cfid set, by hand", value.section.found.isoformat())
            entry = _entry([value.key], value.key, number_rows(value.key, value.parameter), origin)
            groups.setdefault("Measured by hand", []).append(entry)
    return [{"title": title, "quantities": entries} for title, entries in groups.items()]


def main_numbers(values: Values) -> Iterator[Content]:
    """Yield numbers in plain units as text: title, value with its standard uncertainty, and the relative one."""
    vehicle = values.rig.vehicle
    yield _main("Mass", vehicle.mass_kg, vehicle.mass_std_kg or None, 1e3, "g")
    arm, stated = values.rig.loadcell, values.find("arm_m")
    if stated is not None:
        yield _main("Arm", stated.parameter.value, stated.parameter.std, 1e3, "mm")
    elif arm.arm_mm is not None:
        yield _main("Arm", arm.arm_mm, arm.arm_std_mm or None, 1.0, "mm")
    for row in _MAIN:
        value = values.find(row.key)
        if value is None:
            continue
        if not value.accepted:
            yield {"title": row.title, "value": "rejected", "std": ""}
            continue
        count = len(numbers_of(row.key, plain(value.parameter.value)))
        weights: Sequence[float] | None = [float(place == row.place) for place in range(count)]
        if row.place is None:
            weights = judging_weights(row.key, count, values.rig)
        number = value.number(weights or [0.0] * count)
        if math.isfinite(number.nominal_value):
            yield _main(row.title, number.nominal_value, number.std_dev or None, row.scale, row.unit)


def number_rows(key: str, parameter: Parameter) -> list[Content]:
    """Return the numbers of a parameter under its key."""
    numbers = list(parameter.numbers(key))
    units = units_of(key, parameter.unit, len(numbers))
    return [_row(number.name, number.value, number.std, unit) for number, unit in zip(numbers, units, strict=True)]


def _main(title: str, value: float, std: float | None, scale: float, unit: str) -> Content:
    shown, spread = value_and_std(scale * value, None if std is None else scale * std)
    relative = "" if std is None or value == 0 else percent(std / abs(value))
    if _is_barely_there(value, std):
        relative = "consistent with zero"
    text = shown if spread == "-" else f"{shown} ± {spread}"
    if unit.startswith(_MILLIONTH):
        text = text if spread == "-" else f"({text})"
        return {"title": title, "value": f"{text}·{unit}", "std": relative}
    return {"title": title, "value": f"{text} {unit}", "std": relative}


def _is_barely_there(value: float | None, std: float | None) -> bool:
    """Return whether a number is consistent with zero."""
    return value is not None and std is not None and abs(value) < _BARELY * std


def _row(symbol: str, value: float | None, std: float | None, unit: str) -> Content:
    return {"symbol": symbol, "value": value, "std": std, "unit": unit}


def _stated(how: str, found: str | None) -> Content:
    return {"how": how, "found": found, "recordings": 0, "files": 0, "accepted": None, "findings": []}


def _entry(
    keys: Sequence[str],
    title: str,
    rows: Sequence[Content],
    origin: Content | None,
    *,
    equation: str = "",
    missing: str = "",
) -> Content:
    return {
        "keys": list(keys),
        "title": title,
        "equation": equation,
        "rows": rows,
        "origin": origin,
        "zeros": _zeros(rows) if origin is not None and origin["accepted"] else "",
        "missing": missing,
    }


def _fitted(values: Values, part: _Part) -> Content:
    """Return an entry from those of its quantities that are known; all come from one fit."""
    first = registered(part.keys[0])
    known = [value for key in part.keys if (value := values.find(key)) is not None]
    rows = [row for value in known for row in _rows(registered(value.key), value.parameter)]
    fit = values.in_force.get(first.section)
    if rows:
        lacking = [key for key in part.keys if key not in [value.key for value in known]]
        missing = f"not found: {', '.join(lacking)}" if lacking else ""
    elif fit is None:
        missing = f"not measured yet: {EXPERIMENTS[first.section].measured_by}"
    else:
        missing = f"the last `cfid {fit.command}` did not find it: see its experiment"
    title = part.title or first.title[0].upper() + first.title[1:]
    return _entry(part.keys, title, rows, _origin(known) if rows else None, equation=part.equation, missing=missing)


def _origin(known: Sequence[Value]) -> Content:
    """Return how values of one fit were found: from how many runs of the campaign, and from how many other files."""
    section = known[0].section
    method = "" if section.method == "default" else f", method {section.method}"
    paths = {PurePath(source.path) for source in section.sources}
    in_runs = {path for path in paths if path.parts[:1] == (RUNS_FOLDER,)}
    return {
        "how": f"cfid {known[0].fit.command}{method}",
        "found": section.found.isoformat(),
        "recordings": len({path.parent for path in in_runs}),  # a run has a file for each device
        "files": len(paths - in_runs),
        "accepted": all(value.accepted for value in known),
        "findings": [*dict.fromkeys(value.rejection for value in known if value.rejection), *known[0].outdated],
    }


def _zeros(rows: Sequence[Content]) -> str:
    """Return a sentence that names which of several numbers are consistent with zero, "" if none are."""
    terms: dict[str, list[Content]] = {}
    for row in rows if len(rows) > 1 else ():
        terms.setdefault(row["symbol"].partition(" ")[0].partition("_")[0], []).append(row)
    names: list[str] = []
    for term, numbers in terms.items():
        barely = [row for row in numbers if _is_barely_there(row["value"], row["std"])]
        is_whole = len(terms) > 1 and len(barely) == len(numbers)
        names += [term] if is_whole else [row["symbol"].partition(" ")[0] for row in barely]
    return f"Consistent with zero, within {_BARELY:g} standard uncertainties: {', '.join(names)}." if names else ""


def _rows(quantity: Quantity, parameter: Parameter) -> list[Content]:
    """Return the numbers of a quantity, each with its own symbol and unit.

    Numbers of a transfer function that its form fixes, the leading 1 and zeros, are left out.
    """
    symbol, unit, numbers = quantity.symbol, quantity.unit, list(parameter.numbers(quantity.key))
    if quantity.shape is Shape.NUMBER:
        is_late = quantity.key == "tf.delay_s" and any((number.value or 0.0) < 0 for number in numbers)
        title = f"{quantity.title}: below zero, that stamp is late" if is_late else quantity.title
        return [_row(f"{symbol} ({title})", number.value, number.std, unit) for number in numbers]
    places, units = [number.place for number in numbers], units_of(quantity.key, unit, len(numbers))
    if quantity.shape is Shape.POLYNOMIAL:
        places = places if quantity.lowest_first else places[::-1]
    elif len(numbers) == 3:  # components along the body axes
        places = list("xyz")
    return [
        _row(f"{symbol}_{place}", number.value, number.std, own_unit)
        for place, number, own_unit in zip(places, numbers, units, strict=True)
        if quantity.over != "z^-1"
        or not ((number.value == 0 and not number.std) or (quantity.key == "tf.denominator" and number.place == "0"))
    ]
