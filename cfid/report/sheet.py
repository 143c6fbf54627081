"""The sheet of the thesis' appendix A for this vehicle: every parameter with uncertainty, interval, unit and origin.

A missing quantity is listed with the command that determines it.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import PurePath
from typing import NamedTuple

from cfid.experiments import EXPERIMENTS
from cfid.quantities.registry import Quantity, Shape, registered
from cfid.quantities.values import Number, coefficient_units
from cfid.records.files import RUNS_FOLDER
from cfid.records.fits import BY_HAND
from cfid.records.values import Quantity as Value
from cfid.records.values import Values

BARELY = 2.0  # standard uncertainties from zero; a nearer value is consistent with zero


@dataclass(frozen=True)
class Row:
    """One number: symbol, value, standard uncertainty and unit; None means unknown."""

    symbol: str
    value: float | None
    std: float | None
    unit: str

    @property
    def family(self) -> tuple[str, str]:
        """The key of the numbers that share a power of ten when printed."""
        return self.symbol.partition(" ")[0].partition("_")[0], self.unit

    @property
    def is_barely_there(self) -> bool:
        """Whether the number is consistent with zero."""
        return self.value is not None and self.std is not None and abs(self.value) < BARELY * self.std


@dataclass(frozen=True)
class ValueOrigin:
    """How a quantity was found, and whether it was accepted, which is None for values stated by hand.

    `recordings` counts runs of the campaign, and `files` counts the other files that were read.
    """

    how: str
    found: datetime | None
    recordings: int
    files: int
    accepted: bool | None
    findings: tuple[str, ...]


@dataclass(frozen=True)
class SheetEntry:
    """A quantity of the sheet: its numbers and their origin, or the command that determines it if it is missing."""

    keys: tuple[str, ...]
    title: str
    equation: str
    rows: tuple[Row, ...]
    origin: ValueOrigin | None
    missing: str

    @property
    def zeros(self) -> str:
        """A sentence that names which of several accepted numbers are consistent with zero, "" if none are."""
        if len(self.rows) < 2 or self.origin is None or self.origin.accepted is False:
            return ""
        terms: dict[str, list[Row]] = {}
        for row in self.rows:
            terms.setdefault(row.family[0], []).append(row)
        names: list[str] = []
        for term, rows in terms.items():
            whole = len(terms) > 1 and all(row.is_barely_there for row in rows)
            names += [term] if whole else [row.symbol.partition(" ")[0] for row in rows if row.is_barely_there]
        if not names:
            return ""
        return f"Consistent with zero, within {BARELY:g} standard uncertainties: {', '.join(names)}."


@dataclass(frozen=True)
class SheetGroup:
    """The quantities under one heading of the sheet."""

    title: str
    quantities: tuple[SheetEntry, ...]


class _Wanted(NamedTuple):
    """Quantities of one fit under one title, by default the title of the first quantity."""

    keys: tuple[str, ...]
    equation: str = ""
    title: str = ""


def sheet_of(known: Values, *, wanted: Collection[str]) -> tuple[SheetGroup, ...]:
    """Return the sheet; missing quantities are listed only for the `wanted` sections, those of the campaign's kind."""
    groups = {
        title: tuple(
            _quantity(known, one)
            for one in group
            if registered(one.keys[0]).section in wanted or any(known.find(key) for key in one.keys)
        )
        for title, group in _GROUPS
    }
    groups["Inertia"] = (_mass(known), *groups["Inertia"])
    shown = {title: quantities for title, quantities in groups.items() if quantities}
    return (*(SheetGroup(title, quantities) for title, quantities in shown.items()), *_by_hand(known))


def _mass(known: Values) -> SheetEntry:
    vehicle = known.rig.vehicle
    origin = ValueOrigin("as rig.toml states", None, 0, 0, None, ())
    mass = registered("mass_kg")  # the report's JSON has another key for the mass
    rows = (Row(mass.symbol, vehicle.mass_kg, vehicle.mass_std_kg or None, mass.unit),)
    return SheetEntry(("vehicle.mass_kg",), "Mass", "", rows, origin, "")


def _quantity(known: Values, wanted: _Wanted) -> SheetEntry:
    """Return an entry from those of its quantities that are known; all come from one fit."""
    first = registered(wanted.keys[0])
    title = wanted.title or first.title[0].upper() + first.title[1:]
    found = [(registered(key), one) for key in wanted.keys if (one := known.find(key)) is not None]
    rows = tuple(row for quantity, one in found for row in _rows(quantity, list(one.parameter.numbers(quantity.key))))
    if not rows:
        missing = _why_missing(known, first.section)
        return SheetEntry(wanted.keys, title, wanted.equation, (), None, missing)
    origin = origin_of([value for _, value in found])
    lacking = [key for key in wanted.keys if key not in [quantity.key for quantity, _ in found]]
    missing = f"not found: {', '.join(lacking)}" if lacking else ""
    return SheetEntry(wanted.keys, title, wanted.equation, rows, origin, missing)


def _why_missing(known: Values, section: str) -> str:
    fit = known.in_force.get(section)
    if fit is None:
        return f"not measured yet: {EXPERIMENTS[section].measured_by}"
    return f"the last `cfid {fit.command}` did not find it: see its experiment"


def origin_of(values: Sequence[Value]) -> ValueOrigin:
    """Return the origin of values that come from one fit."""
    section = values[0].section
    method = "" if section.method == "default" else f", method {section.method}"
    paths = [PurePath(source.path) for source in section.sources]
    in_runs = [path for path in paths if path.parts[:1] == (RUNS_FOLDER,)]
    return ValueOrigin(
        how=f"cfid {values[0].fit.command}{method}",
        found=section.found,
        recordings=len({path.parent for path in in_runs}),  # a run has a file for each device
        files=len(set(paths)) - len(set(in_runs)),
        accepted=all(value.accepted for value in values),
        findings=(*dict.fromkeys(value.rejection for value in values if value.rejection), *values[0].outdated),
    )


def _by_hand(known: Values) -> tuple[SheetGroup, ...]:
    entries = [
        SheetEntry(
            (value.key,),
            value.key,
            "",
            tuple(Row(value.key, n.value, n.std, value.parameter.unit) for n in value.parameter.numbers(value.key)),
            ValueOrigin("cfid set, by hand", value.section.found, 0, 0, None, ()),
            "",
        )
        for value in known
        if value.fit.name == BY_HAND
    ]
    return (SheetGroup("Measured by hand", tuple(entries)),) if entries else ()


def _rows(quantity: Quantity, found: list[Number]) -> list[Row]:
    """Return the numbers of a quantity, each with its own symbol and unit."""
    symbol, unit = quantity.symbol, quantity.unit
    if quantity.shape is Shape.NUMBER:
        return [Row(f"{symbol} ({quantity.title})", e.value, e.std, unit) for e in found]
    places, units = [e.place for e in found], [unit] * len(found)
    if quantity.shape is Shape.POLYNOMIAL:
        units = coefficient_units(quantity.key, len(found))
        places = places if quantity.lowest_first else places[::-1]
    elif len(found) == 3:  # components along the body axes
        places = list("xyz")
    rows = zip(places, found, units, strict=True)
    return [Row(f"{symbol}_{place}", e.value, e.std, own) for place, e, own in rows if not _is_set(quantity, e)]


def _is_set(quantity: Quantity, number: Number) -> bool:
    """Return whether a number of a transfer function is fixed by its form: the leading 1, or a zero."""
    leading = quantity.key == "tf.denominator" and number.place == "0"
    return quantity.over == "z^-1" and (leading or (number.value == 0 and not number.std))


_GROUPS = (
    ("Inertia", (_Wanted(("inertia.matrix_kg_m2",)),)),
    (
        "Motors: mappings",
        (
            _Wanted(("motor.thrust_poly",), "f = Σ a_k cmd^k"),
            _Wanted(("motor.speed_poly",), "ω = Σ b_k cmd^k"),
            _Wanted(("motor.torque_poly",), "τ = Σ c_k f^k"),
        ),
    ),
    (
        "Motors: transfer function",
        (
            _Wanted(
                tuple(
                    f"tf.{name}"
                    for name in (
                        "numerator", "denominator", "sample_time_s", "time_constant_s", "static_gain_n", "delay_s",
                    )
                ),
                "H(z) = (n_0 + n_1 z⁻¹ + …) / (1 + d_1 z⁻¹ + …)",
                "Command to thrust, one motor",
            ),
        ),
    ),
    (
        "Drag",
        (
            _Wanted(("drag.simple_kg_per_rad",), "f = diag(K) Σω v"),
            _Wanted(
                tuple(f"drag.complex.k{i}" for i in range(1, 7)),
                "f = K1 Σω v + K2 v² + K3 (Σω)² + K4 v + K5 Σω + K6, axis by axis",
                "Complex model",
            ),
            _Wanted(("drag.cross_coupling_kg_per_rad",), "f = K Σω v"),
        ),
    ),
)  # fmt: skip
