"""Recognise the columns of tables of motors by the header alone: quantity, unit and factor to SI."""

import functools
import re
from collections.abc import Container, Mapping, Sequence
from typing import NamedTuple

from cfid.errors import DataError
from cfid.records.tables.column_units import spelt
from cfid.records.tables.force_units import FORCES_N, TORQUES_NM
from cfid.records.tables.speed_units import PER_MINUTE, PER_SECOND, SPEEDS_RAD_S
from cfid.records.tables.stand_scales import command_called
from cfid.records.tables.table import CsvTable
from cfid.records.tables.times import OTHER_UNIT, TIME_COLUMN, unit_at_end
from cfid.units import FULL_COMMAND, RPM

HEADS = (
    "cmd, command or pwm (0 to 65535), pwm_percent, command_fraction (0 to 1), ESC signal (us); thrust_n, Thrust (N), "
    "(gf) or (kgf), weight[g], thrust_total_g (of four motors); torque_nm, Torque (N.m); grams (scales); speed_rad_s, "
    "rpm, Motor Optical Speed (RPM), rpm_1, rpm_2, ... (series of one rotor), rpm1 to rpm4 (four rotors), rpm_mean; "
    "vbat_v, vbat[V], voltage_V, Voltage (V); t"
)
MEASURED = ("thrust_n", "torque_nm", "speeds_rad_s", "grams")

_EXAMPLES = {"command": "cmd", "speeds_rad_s": "rpm", "time_s": "t"}
_TAKE_UNITS = {
    "command": "esc",
    "thrust_n": "thrust",
    "torque_nm": "torque",
    "vbat_v": "voltage",
    "speeds_rad_s": "motorspeed",
}
_UNIT = re.compile(r"[(\[]([^()\[\]]+)[)\]]")  # in a name without spaces, as in Speed[1/min](filtered)
_LAST_WORD = re.compile(r".*[^\s_][\s_]+(?P<unit>[^\s_]+)")  # where a unit without brackets is, as in thrust_gf
_MANGLED = re.compile(r"[A-Za-z]\w*_+[A-Za-z](?:\w*[A-Za-z]|\w*__1)?_", re.ASCII)
# Units of these quantities, some of which are not read, such as uN, kV and eRPM; other words in brackets are no units.
_OTHER = re.compile(
    r"[mukcd]?(?:n|gf?|v|hz|lbf?s?|ozf?)(?:[.u-]*(?:[mc]?m|in|ft))?|[ke]rpm|rps|ms|ns|%"
    # And anything per time, such as rad/min and s^-1.
    r"|[^/]+/(?:s|ms|sec|min|m|h|hour)|(?:[a-z]+\.)?(?:s|ms|sec|min|h)\^?-1"
)
# As in Powertrain 1 - force Fz (thrust) (N), whose first part the operator chooses; and as in Thrust A (N).
_OF_POWERTRAIN = re.compile(
    r"(?P<side>.+)-(?P<column>(?:escthrottle|forcefz\(thrust\)|torquemz\(torque\)|rotationspeed|voltage)\(.+\))"
)
_LETTERED = re.compile(r"(?:esc|escsignal|escthrottle|thrust|torque|voltage|motor\w*speed)(?P<side>[ab])[(\[].+[)\]]")
_BARE_COMMAND = re.compile("cmd|command|pwm")  # known names that state no unit
_ELECTRICAL = re.compile("e[-_]?rpm")  # turns of the field: as many as pairs of poles in one turn of the rotor
_TOTAL = re.compile("total|sum|gesamt")
_SEVERAL = ("series", "rotors")
_STEMS = {
    # An esc_count is not a command.
    "command": ("cmd", "command", "pwm", "esc(", "escms", "escpwm", "escsignal", "escthrottle", "throttle"),
    "thrust_n": ("thrust", "weight", "totalthrust", "schub", "kraft"),
    "torque_nm": ("torque", "drehmoment"),
    "vbat_v": ("vbat", "voltage", "spannung", "akkuspannung"),
    "speeds_rad_s": ("speed", "rpm", "omega", "ω", "motorelectrical", "motoroptical", "drehzahl"),
}


class ColumnHead(NamedTuple):
    """A known name of a quantity's column, without spaces and case, and its factor to SI units."""

    quantity: str
    called: str
    factor: float = 1.0
    kind: str = ""


def _of_stand(quantity: str, stem: str, units: Mapping[str, float], kind: str) -> list[ColumnHead]:
    """Return the heads of RCbenchmark's and Tyto's programs: a name, a side of a double stand, a unit in brackets."""
    return [
        ColumnHead(quantity, rf"(?:{stem})[ab]?[(\[](?:{unit})[)\]]", factor, kind) for unit, factor in units.items()
    ]


_KNOWN = (
    ColumnHead("command", r"cmd|command"),
    ColumnHead("command", r"pwm", kind="pwm"),
    ColumnHead(
        "command",
        r"pwm_percent|pwm\[%\]|command_fraction\(%\)|(?:esc(?:signal|throttle)?|throttle|pwm)[ab]?[(\[]%[)\]]",
        FULL_COMMAND / 100,
        "percent",
    ),
    ColumnHead(
        "command", r"(?:stellgr(?:ö|oe)(?:ß|ss)e|tastverh(?:ä|ae)ltnis)[(\[]%[)\]]", FULL_COMMAND / 100, "percent"
    ),
    ColumnHead("command", r"command_fraction", FULL_COMMAND, "fraction"),
    ColumnHead("command", r"(?:esc(?:signal|throttle)?|throttle|pwm)(?:[ab]?\(us\)|\[us\]|_us)", kind="esc"),
    ColumnHead("thrust_n", r"thrust_n"),
    ColumnHead("thrust_n", r"(?:weight|thrust)[(\[]g[)\]]", 1e-3, "grams"),
    ColumnHead("thrust_n", r"thrust_total_g", 1e-3, "total in grams"),
    *_of_stand("thrust_n", r"thrust|forcefz\(thrust\)|schub|schubkraft|kraft", FORCES_N, ""),
    *_of_stand("thrust_n", "thrust_total", FORCES_N, "total"),
    ColumnHead("torque_nm", r"torque_nm|torque_z\[n\]"),  # so Bitcraze's stand calls its N m
    *_of_stand(
        "torque_nm",
        r"torque|torquemz\(torque\)|drehmoment",
        TORQUES_NM,
        "",
    ),
    ColumnHead("vbat_v", r"vbat_v|voltage_v"),
    ColumnHead("vbat_v", r"vbat_mv|voltage_mv", 1e-3),
    *_of_stand("vbat_v", "vbat|voltage|spannung|akkuspannung", {"v": 1.0, "mv": 1e-3}, ""),
    ColumnHead("grams", r"grams"),
    ColumnHead("speeds_rad_s", r"speed_rad_s|(?:omega|ω)_rad_s", kind="motor"),
    ColumnHead("speeds_rad_s", rf"(?:omega|ω)(?:\[rad/s\]|\(rad/s\)|{PER_SECOND.pattern})", kind="motor"),
    ColumnHead("speeds_rad_s", r"rpm|upm", RPM, "motor"),
    ColumnHead("speeds_rad_s", rf"drehzahl(?:in)?(?:{PER_MINUTE})", RPM, "motor"),
    ColumnHead("speeds_rad_s", r"rpm_[1-9]\d*", RPM, "series"),
    ColumnHead("speeds_rad_s", r"rpm[1-4]", RPM, "rotors"),
    ColumnHead("speeds_rad_s", r"rpm_mean", RPM, "mean"),
    *_of_stand(
        "speeds_rad_s",
        "motoropticalspeed|motorelectricalspeed|motorspeed|rotationspeed|rotationalspeed|speed|rpm|drehzahl|n",
        SPEEDS_RAD_S,
        "motor",
    ),
)


def _without_side(name: str) -> str:
    """Return a name without spaces and case, and without the powertrain that Tyto's Flight Stand writes before it."""
    of_one = _OF_POWERTRAIN.fullmatch(spelt(name))
    return of_one["column"] if of_one else spelt(name)


def side_of(name: str) -> str | None:
    """Return to which motor of a double stand a column belongs: a powertrain, or side a or b; None for both."""
    if of_one := _OF_POWERTRAIN.fullmatch(spelt(name)):
        return of_one["side"]
    lettered = _LETTERED.fullmatch(spelt(name))
    return lettered["side"] if lettered else None


def _unmangled(name: str) -> list[tuple[str, str]]:
    """Return possible stems and units of a name whose brackets and signs MATLAB replaced by `_`.

    `Torque__N_m_` was Torque (N·m); other names do not end in an underscore. Both are without spaces and case.
    """
    if not _MANGLED.fullmatch(name):
        return []
    found = []
    for gap in re.finditer("_+", name[:-1]):
        stem, unit = spelt(name[: gap.start()]).replace("_", ""), spelt(name[gap.end() : -1]).replace("__1", "^-1")
        lost_sign = unit == "s" and len(gap[0]) > 1  # of (µs)
        found += [(stem, "us" if lost_sign else unit.replace("_", sign)) for sign in ("./" if "_" in unit else ".")]
    return found


@functools.cache
def _head_of(name: str) -> ColumnHead | None:
    """Return the head of a column with a known name; for a mangled name, only where all possible originals agree."""
    plain = next((head for head in _KNOWN if re.fullmatch(head.called, _without_side(name))), None)
    if plain is not None:
        return plain
    may_be = [f"{stem}{pair[0]}{unit}{pair[1]}" for stem, unit in _unmangled(name) for pair in ("[]", "()")]
    heads = [head for one in may_be for head in _KNOWN if re.fullmatch(head.called, one)]
    alike = len({(head.quantity, head.factor, head.kind) for head in heads}) == 1
    return heads[0] if alike else None


def heads_of(names: Sequence[str]) -> dict[str, list[tuple[ColumnHead, str]]]:
    """Return the known columns by quantity, each with the file's own name."""
    called: dict[str, list[tuple[ColumnHead, str]]] = {}
    for name in names:
        if (head := _head_of(name)) is not None:
            called.setdefault(head.quantity, []).append((head, name))
        if TIME_COLUMN.called.fullmatch(name.strip()):
            called.setdefault("time_s", []).append((ColumnHead("time_s", "", kind="time"), name))
    return called


def in_own_unit(name: str, own: str) -> str:
    """Return the name by which a column of a known `name` is read: that of its own header where the unit differs.

    The unit of an unknown header counts, too, as in Lift (gf), Lift__gf_ and lift_gf.
    """
    (quantity, ((head, _), *_)), *_ = heads_of([name]).items()
    if quantity == "time_s":
        named, unit = TIME_COLUMN.called.fullmatch(name.strip()), unit_at_end(own)
        return f"{name} [{unit}]" if named and unit and not named[1] else name
    units = _units_of(own)
    total = head.kind.startswith("total")
    if head.kind.endswith("grams") and "g" in units:
        return name
    whole = [] if total or _BARE_COMMAND.fullmatch(spelt(own)) else [own]
    called = "thrust_total" if total else _TAKE_UNITS.get(quantity)
    for known in (*whole, *(f"{called}({one})" for one in units)):
        for stated_head, _ in heads_of([known]).get(quantity, ()):
            other = stated_head.factor != head.factor or (stated_head.kind == "esc") != (head.kind == "esc")
            return known if other else name
    return name


def _units_of(own: str) -> list[str]:
    """Return possible units that a header states: in brackets, in what MATLAB made of them, or as the last word."""
    last = None if spelt(own).endswith((")", "]")) else _LAST_WORD.fullmatch(own.strip())
    others = [one for _, one in _unmangled(own)] or ([spelt(last["unit"])] if last else [])
    return [*reversed(_UNIT.findall(spelt(own))), *others]


def _is_unit(unit: str, quantity: str) -> bool:
    """Return whether a quantity is read in a unit."""
    return quantity in heads_of([f"{_TAKE_UNITS[quantity]}({unit})"])


def _states_other(own: str, quantity: str) -> bool:
    """Return whether a header states a unit, but none in which its quantity is read.

    Without brackets, a single letter, as in rotor_n, is a symbol, and known names keep what they state.
    """
    units = _units_of(own)
    if quantity == "speeds_rad_s" and _ELECTRICAL.match(spelt(own)):
        return True
    if any(_is_unit(one, quantity) for one in units):
        return False
    bare = not (_UNIT.search(spelt(own)) or _unmangled(own))
    return any(_OTHER.fullmatch(one) for one in units if not bare or (len(one) > 1 and not heads_of([own])))


def _unknown(name: str, quantity: str) -> str:
    """Return what is unknown about a column: its name, where that states a known unit, or its unit."""
    known = any(_is_unit(one, quantity) for one in _units_of(name))
    return "has a known unit, but no known name" if known else "has no known unit"


def _remedy(table: CsvTable, name: str, quantity: str) -> str:
    """Return what to do about an unknown column: no option overrides a unit that the header states."""
    place = 1 + table.names.index(name)
    if _states_other(name, quantity):
        return f"Convert it to a unit that is read, and state that in its header, as in {called_as(quantity)}"
    if quantity == "command":
        return f"Name it by `columns`, as in {command_called(table.known_numbers([name]))}={place}"
    if quantity != "thrust_n":
        return f"Name it by `columns`, as in {called_as(quantity)}={place}"
    several = ", and state by `motors` how many it is of" if _TOTAL.search(spelt(name)) else ""
    return f"Name it by `columns`, as in thrust_n={place} in newtons, or Thrust (gf)={place} in grams{several}"


def has_unread_unit(name: str, own: str) -> bool:
    """Return whether a column's `own` header states a unit that does not fit the quantity of its known name."""
    quantity, *_ = heads_of([name])
    if quantity == "time_s":
        return OTHER_UNIT.search(own) is not None
    return quantity in _TAKE_UNITS and _states_other(own, quantity)


def called_as(quantity: str) -> str:
    """Return a name by which a quantity's column is known, with its unit."""
    return _EXAMPLES.get(quantity, quantity)


def shows_stand(called: Container[str]) -> bool:
    """Return whether known quantities make a table of motors: a measured one, and a command or thrust over speed."""
    driven = "command" in called or ("thrust_n" in called and "speeds_rad_s" in called)
    return driven and any(quantity in called for quantity in MEASURED)


def check_heads(table: CsvTable, called: Mapping[str, Sequence[tuple[ColumnHead, str]]]) -> tuple[str, ...]:
    """Refuse several columns of a quantity and a table without measurements; note columns of unknown unit."""
    for quantity, columns in called.items():
        names = ", ".join(name for _, name in columns)
        if len(columns) > 1 and (columns[0][0].kind not in _SEVERAL or len({head for head, _ in columns}) > 1):
            what = quantity.partition("_")[0]
            raise DataError(
                f"{table.path}: more than one column of {what}: {names}. Name one by `columns`, as in "
                f"{columns[0][1]}={1 + table.names.index(columns[0][1])}."
            )
    unknown = {
        name: quantity
        for name in table.names
        for quantity, stems in _STEMS.items()
        if not heads_of([name]) and spelt(name).replace("_", "").startswith(stems) and quantity not in called
    }
    if shows_stand(called):
        return tuple(
            f"column '{name}' {_unknown(name, quantity)}: it is not used. {_remedy(table, name, quantity)}."
            for name, quantity in unknown.items()
        )
    if unknown:
        name, quantity = next(iter(unknown.items()))
        raise DataError(
            f"{table.path}: column '{name}' {_unknown(name, quantity)}. {_remedy(table, name, quantity)}. Known names, "
            f"which state the unit: {HEADS}."
        )
    lacks = "nothing measured" if "command" in called else "no motor command"
    raise DataError(
        f"{table.path}: {lacks} among {table.listing}. Name columns by `columns`, as in cmd=1,thrust_n=2. Known names: "
        f"{HEADS}."
    )
