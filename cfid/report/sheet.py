"""The sheet of the thesis' appendix A for this vehicle: every parameter with deviation, interval, unit and origin.

What is missing is named with the command that gives it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import PurePath
from typing import NamedTuple

from cfid.records.campaign import RUNS_FOLDER
from cfid.records.parameters import Section
from cfid.records.stale import Stale
from cfid.report.known import Entry, Known, entries


@dataclass(frozen=True)
class Row:
    """One number: its symbol, value and standard deviation in its unit; None is unknown."""

    symbol: str
    value: float | None
    std: float | None
    unit: str

    @property
    def family(self) -> tuple[str, str]:
        """What it has in common with the numbers that it is printed beside in one power of ten."""
        return self.symbol.partition(" ")[0].partition("_")[0], self.unit


@dataclass(frozen=True)
class Origin:
    """How a quantity was found, and whether it is accepted: None for what was not fitted but stated by hand.

    `recordings` are runs of the campaign, `files` what was read beside them.
    """

    how: str
    found: datetime | None
    recordings: int
    files: int
    accepted: bool | None
    findings: tuple[str, ...]


@dataclass(frozen=True)
class Quantity:
    """A quantity of the sheet with its numbers and their origin, or with what gives it where it is missing."""

    keys: tuple[str, ...]
    title: str
    equation: str
    rows: tuple[Row, ...]
    origin: Origin | None
    missing: str


@dataclass(frozen=True)
class Group:
    """Quantities under one heading of the sheet."""

    title: str
    quantities: tuple[Quantity, ...]


Labels = Callable[[list[Entry], str], list[Row]]


class _Part(NamedTuple):
    key: str
    labels: Labels


class _Wanted(NamedTuple):
    title: str
    equation: str
    parts: tuple[_Part, ...]
    section: str
    gives: str


def sheet(known: Known, commands: Mapping[str, str], stale: Stale) -> tuple[Group, ...]:
    """Return the sheet. `commands` is what made the last fit of a section.

    `stale` tells why a section is no longer current.
    """
    groups = [("Inertia", _mass(known), _INERTIA), ("Motors: mappings", None, _MAPS)]
    groups += [("Motors: transfer function", None, _TRANSFER), ("Drag", None, _DRAG)]
    return tuple(
        Group(title, (*([first] if first else []), *(_quantity(known, one, commands, stale) for one in wanted)))
        for title, first, wanted in groups
    ) + _by_hand(known)


def _mass(known: Known) -> Quantity:
    vehicle = known.rig.vehicle
    origin = Origin("as rig.toml states", None, 0, 0, None, ())
    rows = (Row("m", vehicle.mass_kg, vehicle.mass_std_kg or None, "kg"),)
    return Quantity(("vehicle.mass_kg",), "Mass", "", rows, origin, "")


def _quantity(known: Known, wanted: _Wanted, commands: Mapping[str, str], stale: Stale) -> Quantity:
    """Return a quantity from what of its parts there is: all come from one fit."""
    found = [(part, one) for part in wanted.parts if (one := known.find(part.key)) is not None]
    rows = tuple(row for part, one in found for row in part.labels(list(entries(one.parameter)), one.parameter.unit))
    keys = tuple(part.key for part in wanted.parts)
    if not rows:
        return Quantity(keys, wanted.title, wanted.equation, (), None, _why_missing(known, wanted, commands))
    _, first = found[0]
    origin = origin_of(first.name, first.section, [part.key for part, _ in found], commands, stale)
    lacking = [part.key for part in wanted.parts if part not in [there for there, _ in found]]
    missing = f"not found: {', '.join(lacking)}" if lacking else ""
    return Quantity(keys, wanted.title, wanted.equation, rows, origin, missing)


def _why_missing(known: Known, wanted: _Wanted, commands: Mapping[str, str]) -> str:
    if wanted.section not in known.sections:
        return f"not measured yet: {wanted.gives}"
    command = commands.get(wanted.section, f"fit {wanted.section}")
    return f"the last `cfid {command}` did not find it: see its experiment"


def origin_of(name: str, section: Section, keys: Sequence[str], commands: Mapping[str, str], stale: Stale) -> Origin:
    """Return how quantities of a section of parameters.toml came about."""
    command = commands.get(name, f"fit {name}")
    method = "" if section.method == "default" else f", method {section.method}"
    paths = [PurePath(source.path) for source in section.sources]
    in_runs = [path for path in paths if path.parts[:1] == (RUNS_FOLDER,)]
    return Origin(
        how=f"cfid {command}{method}",
        found=section.found,
        recordings=len({path.parent for path in in_runs}),  # a run's devices have a file each
        files=len(set(paths)) - len(set(in_runs)),
        accepted=not any(key in section.rejected for key in keys),
        findings=(*dict.fromkeys(section.rejected[key] for key in keys if key in section.rejected), *stale(section)),
    )


def _by_hand(known: Known) -> tuple[Group, ...]:
    section = known.sections.get("set")
    if section is None:
        return ()
    origin = Origin("cfid set, by hand", section.found, 0, 0, None, ())
    return (
        Group(
            "Measured by hand",
            tuple(
                Quantity((key,), key, "", tuple(Row(key, e.value, e.std, one.unit) for e in entries(one)), origin, "")
                for key, one in section.parameters.items()
            ),
        ),
    )


def _one(symbol: str) -> Labels:
    return lambda found, unit: [Row(symbol, entry.value, entry.std, unit) for entry in found]


def _indexed(symbol: str) -> Labels:
    return lambda found, unit: [Row(f"{symbol}_{entry.place}", entry.value, entry.std, unit) for entry in found]


def _along(symbol: str) -> Labels:
    """Three numbers along the body's axes; a model with one number for all has one row."""

    def rows(found: list[Entry], unit: str) -> list[Row]:
        names = "xyz" if len(found) == 3 else [entry.place for entry in found]
        return [Row(f"{symbol}_{name}", e.value, e.std, unit) for name, e in zip(names, found, strict=True)]

    return rows


def _polynomial(letter: str, y: str, x: str) -> Labels:
    """Coefficients, highest power first, each with its own unit."""

    def rows(found: list[Entry], unit: str) -> list[Row]:
        powers = range(len(found) - 1, -1, -1)
        return [
            Row(f"{letter}_{power}", e.value, e.std, _over(y, x, power)) for power, e in zip(powers, found, strict=True)
        ]

    return rows


def _over(y: str, x: str, power: int) -> str:
    if y == "N m" and x == "N":
        return ("N m", "m", "m/N")[power] if power < 3 else f"N m/N^{power}"
    return y if power == 0 else f"{y}/{x}" if power == 1 else f"{y}/{x}^{power}"


def _delayed(letter: str, first: int) -> Labels:
    """Coefficients of z^0, z^-1, ...; those that are no unknowns (the leading 1, a zero of the form) are left out."""

    def rows(found: list[Entry], unit: str) -> list[Row]:
        return [
            Row(f"{letter}_{i}", e.value, e.std, unit)
            for i, e in enumerate(found)
            if i >= first and not (e.value == 0 and not e.std)
        ]

    return rows


_INERTIA = (
    _Wanted(
        "Inertia matrix about the centre of mass, body frame",
        "",
        (_Part("inertia.matrix_kg_m2", _indexed("I")),),
        "inertia",
        "six swings or more with `cfid log encoder --axis MOUNT`, then `cfid fit inertia RUN ...`",
    ),
)
_MAPS = (
    _Wanted(
        "Input command to thrust, one motor",
        "f = Σ a_k cmd^k",
        (_Part("motor.thrust_poly", _polynomial("a", "N", "cmd")),),
        "thrust",
        "`cfid log thrust`, then `cfid fit thrust RUN`",
    ),
    _Wanted(
        "Input command to rotor speed",
        "ω = Σ b_k cmd^k",
        (_Part("motor.speed_poly", _polynomial("b", "rad/s", "cmd")),),
        "speed",
        "`cfid log speed`, then `cfid fit speed RUN`",
    ),
    _Wanted(
        "Thrust to torque, one motor",
        "τ = Σ c_k f^k",
        (_Part("motor.torque_poly", _polynomial("c", "N m", "N")),),
        "torque",
        "`cfid log thrust`, then `cfid fit torque RUN`",
    ),
)
_TRANSFER = (
    _Wanted(
        "Command to thrust, one motor",
        "H(z) = (n_0 + n_1 z⁻¹ + …) / (1 + d_1 z⁻¹ + …)",
        (
            _Part("tf.numerator", _delayed("n", 0)),
            _Part("tf.denominator", _delayed("d", 1)),
            _Part("tf.sample_time_s", _one("T (sample time)")),
            _Part("tf.time_constant_s", _one("τ (time constant)")),
            _Part("tf.static_gain_n", _one("K (static gain, per unit of the command)")),
            _Part("tf.delay_s", _one("δ (delay of the force behind its stamped command)")),
        ),
        "tf",
        "`cfid log sine`, then `cfid tf identify RUN ...`",
    ),
)
_WIND = "`cfid log wind`, then `cfid fit drag RUN ...`"
_DRAG = (
    _Wanted("Simple model", "f = diag(K) Σω v", (_Part("drag.simple_kg_per_rad", _along("K")),), "drag", _WIND),
    _Wanted(
        "Complex model",
        "f = K1 Σω v + K2 v² + K3 (Σω)² + K4 v + K5 Σω + K6, axis by axis",
        tuple(_Part(f"drag.complex.k{i}", _along(f"K{i}")) for i in range(1, 7)),
        "drag",
        _WIND,
    ),
    _Wanted(
        "Cross-coupling model", "f = K Σω v", (_Part("drag.cross_coupling_kg_per_rad", _indexed("K")),), "drag", _WIND
    ),
)
