"""Read tables of thrust, torque, speed and voltage over motor command, typed by hand or from thrust stands.

It resolves column names and units only; settling and the tachometer's markers are the fits' part.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.findings import Finding, of_recording
from cfid.records.parameters import Source
from cfid.records.tables.table import Array, CsvTable, open_table
from cfid.records.tables.times import CUT_LINE, times_of
from cfid.units import FULL_COMMAND, ROTORS, RPM, USUAL_GRAVITY_MPS2

Speeds = Literal["motor", "series", "rotors", "mean"]

STAND_RATE_HZ = 100.0  # of Bitcraze's thrust stand, whose files have no time
HEADS = (
    "cmd, command or pwm (0 to 65535), pwm_percent; thrust_n (of what ran), weight[g], thrust[g], thrust_total_g, "
    "thrust[N] (of four motors); torque_nm; grams (scales); speed_rad_s, rpm_1, rpm_2, ... (series of one rotor), "
    "rpm1 to rpm4 (four rotors), rpm_mean; vbat_v, vbat[V], voltage_V; t"
)

_HELD_ROWS = 5  # of one command, on average: from there on a table is a record over time
_TURNING_RAD_S = 100.0  # faster than any rotor that stands, slower than any that flies
_MOST_VOLTS = 60.0  # more than any battery that flies, and less than its millivolts


@dataclass(frozen=True, kw_only=True)
class StandTable:
    """A table's columns (n,) in SI units, None for absent ones; `columns` has the file's names of each.

    `thrust_n` is one motor's where the file has the sum of `motors` motors; where `motors` is None, it is as in the
    file. `command` is nan where the file has thrust and speed alone. `speeds_rad_s` (n, s) are as displayed, nan where
    a sensor was dead: a motor's ("motor"), one rotor's in several series ("series"), four
    rotors' at once ("rotors") or their mean ("mean"). `grams` is the reading of scales. `time_s` is None for settled
    points and an array for a record over time, whose `rate_hz` is None where a column gave the time.
    """

    path: Path
    source: Source
    columns: Mapping[str, tuple[str, ...]]
    command: Array
    thrust_n: Array | None
    motors: int | None
    torque_nm: Array | None
    vbat_v: Array | None
    grams: Array | None
    speeds_rad_s: Array | None
    speeds: Speeds | None
    time_s: Array | None
    rate_hz: float | None
    findings: tuple[Finding, ...]

    @property
    def mean_speed_rad_s(self) -> Array | None:
        """The mean over rotors or series (n,)."""
        return None if self.speeds_rad_s is None else _mean_of_known(self.speeds_rad_s)

    @property
    def square_mean_speed_rad_s(self) -> Array | None:
        """The speed at which every rotor would give the mean of their thrusts (n,), by k w^2."""
        return None if self.speeds_rad_s is None else np.sqrt(_mean_of_known(self.speeds_rad_s**2))


class _Head(NamedTuple):
    """A known name of a quantity's column, without spaces and case, and its factor to SI units."""

    quantity: str
    called: str
    factor: float = 1.0
    kind: str = ""


class _Column(NamedTuple):
    """The columns of one quantity as in the file, (n, s)."""

    head: _Head
    names: tuple[str, ...]
    raw: Array

    @property
    def value(self) -> Array:
        return self.raw * self.head.factor


_KNOWN = (
    _Head("command", r"cmd|command"),
    _Head("command", r"pwm", kind="pwm"),
    _Head("command", r"pwm_percent|pwm\[%\]", FULL_COMMAND / 100, "percent"),
    _Head("thrust_n", r"thrust_n"),
    _Head("thrust_n", r"thrust\[n\]", kind="total"),
    _Head("thrust_n", r"(?:weight|thrust)\[g\]|thrust_total_g", 1e-3, "total in grams"),
    _Head("torque_nm", r"torque_nm"),
    _Head("vbat_v", r"vbat_v|vbat\[v\]|voltage_v"),
    _Head("grams", r"grams"),
    _Head("speeds_rad_s", r"speed_rad_s", kind="motor"),
    _Head("speeds_rad_s", r"rpm_[1-9]\d*", RPM, "series"),
    _Head("speeds_rad_s", r"rpm[1-4]", RPM, "rotors"),
    _Head("speeds_rad_s", r"rpm_mean", RPM, "mean"),
    _Head("time_s", r"t|time|t_s|time_s|time\[s\]"),
)
_SEVERAL = ("series", "rotors")
_MEASURED = ("thrust_n", "torque_nm", "speeds_rad_s", "grams")
_STEMS = {
    "command": ("cmd", "command", "pwm"),
    "thrust_n": ("thrust", "weight"),
    "torque_nm": ("torque",),
    "vbat_v": ("vbat", "voltage"),
    "speeds_rad_s": ("speed", "rpm", "omega"),
}


def read_stand_table(
    path: Path, *, gravity_mps2: float = USUAL_GRAVITY_MPS2, rate_hz: float | None = None, skip_lines: int = 0
) -> StandTable:
    """Read a table whose header names quantities and units, in any order; other columns are ignored with a note.

    Rows of a pwm that is held for long are a record over time, at `rate_hz` where no column gives the time.

    Raises DataError with file, line or column, and next step; ConfigError for an invalid rate.
    """
    table = open_table(path, skip_lines=skip_lines)
    found = _columns(table)
    _check(table, found)
    thrust, speeds = found.get("thrust_n"), found.get("speeds_rad_s")
    total = thrust is not None and thrust.head.kind.startswith("total")
    time_s, rate, time_notes = _times(table, found, rate_hz)
    cut = [CUT_LINE] if table.cut else []
    rows = len(next(iter(found.values())).raw)
    command = found["command"].value[:, 0] if "command" in found else np.full(rows, np.nan)
    speeds_rad_s, dead = (None, ()) if speeds is None else _alive(speeds, command, settled=time_s is None)
    notes = (*_total_note(thrust, gravity_mps2), *time_notes, *dead, *_unused_note(table, found), *cut)
    return StandTable(
        path=path,
        source=Source(str(path), table.sha256),
        columns={name: column.names for name, column in found.items()},
        command=command,
        thrust_n=None if thrust is None else _one_motors(thrust, gravity_mps2),
        motors=ROTORS if total else None,
        torque_nm=_single(found, "torque_nm"),
        vbat_v=_single(found, "vbat_v"),
        grams=_single(found, "grams"),
        speeds_rad_s=speeds_rad_s,
        speeds=None if speeds is None else cast(Speeds, speeds.head.kind),
        time_s=time_s,
        rate_hz=rate,
        findings=of_recording(path.name, notes),
    )


def _columns(table: CsvTable) -> dict[str, _Column]:
    """Return the columns of each quantity.

    Raises DataError when a quantity has several columns or no known unit, and when commands or measurements are
    missing.
    """
    if not table.has_head:
        raise DataError(f"{table.path}: no header for its {len(table.names)} columns. Known names: {HEADS}.")
    called: dict[str, list[tuple[_Head, str]]] = {}
    for name in table.names:
        bare = re.sub(r"\s", "", name).lower()
        for head in _KNOWN:
            if re.fullmatch(head.called, bare):
                called.setdefault(head.quantity, []).append((head, name))
    _check_heads(table, called)
    values = table.numbers([name for columns in called.values() for _, name in columns])
    found, begin = {}, 0
    for quantity, columns in called.items():
        end = begin + len(columns)
        found[quantity] = _Column(columns[0][0], tuple(name for _, name in columns), values[:, begin:end])
        begin = end
    return found


def _check_heads(table: CsvTable, called: Mapping[str, list[tuple[_Head, str]]]) -> None:
    for quantity, columns in called.items():
        names = ", ".join(name for _, name in columns)
        if len(columns) > 1 and (columns[0][0].kind not in _SEVERAL or len({head for head, _ in columns}) > 1):
            what = quantity.partition("_")[0]
            raise DataError(f"{table.path}: more than one column of {what}: {names}. Leave one, rename the others.")
    for name in table.names:
        bare = name.strip().lower()
        if any(bare.startswith(stems) and quantity not in called for quantity, stems in _STEMS.items()):
            raise DataError(f"{table.path}: column '{name}' has no known unit. Known names: {HEADS}.")
    without = {"thrust_n", "speeds_rad_s"} <= called.keys()  # thrust over speed needs no command
    if not ("command" in called or without) or not any(quantity in called for quantity in _MEASURED):
        lacks = "nothing measured" if "command" in called else "no motor command"
        raise DataError(f"{table.path}: {lacks} among {table.listing}. Known names: {HEADS}.")


def _check(table: CsvTable, found: Mapping[str, _Column]) -> None:
    """Refuse impossible values of a quantity, naming their line."""
    if command := found.get("command"):
        percent = command.head.kind == "percent"
        _refuse(table, command, command.raw < 0, "a command is zero or more.")
        most = 100.0 if percent else FULL_COMMAND
        _refuse(table, command, command.raw > most, f"the largest is {most:g}{' per cent' if percent else ''}.")
        if command.head.kind == "pwm" and 0 < command.raw.max() <= 100:
            raise DataError(f"{table.path}: no pwm above 100: is it in per cent? Then name the column pwm_percent.")
    if speeds := found.get("speeds_rad_s"):
        _refuse(table, speeds, speeds.raw < 0, "a speed is zero or more.")
    if battery := found.get("vbat_v"):
        wrong = (battery.raw <= 0) | (battery.raw > _MOST_VOLTS)
        _refuse(table, battery, wrong, "no battery has that voltage. Is the column in millivolts?")


def _refuse(table: CsvTable, column: _Column, wrong: npt.NDArray[np.bool_], why: str) -> None:
    if wrong.any():
        row, place = (int(index) for index in np.argwhere(wrong)[0])
        here = f"{table.path}:{table.line_of_row(row)}: {column.raw[row, place]:g} in column '{column.names[place]}'"
        raise DataError(f"{here}: {why}")


def _one_motors(thrust: _Column, gravity_mps2: float) -> Array:
    """Return thrust in newtons, of one motor where the file has four motors' total."""
    value = thrust.value[:, 0]
    if thrust.head.kind == "total in grams":
        value = value * gravity_mps2
    return value / ROTORS if thrust.head.kind else value


def _alive(speeds: _Column, command: Array, *, settled: bool) -> tuple[Array, tuple[str, ...]]:
    """Return speeds (n, s) with nan for a sensor that shows 0 while rotors turn, and a note.

    They turn where another sensor shows it or, in a table of settled points, where one did at no larger command.
    """
    value = speeds.value
    turning = value.max(axis=1)
    if settled and np.isfinite(command).all():
        turning = np.array([value[command <= one].max() for one in command])
    dead = (value == 0) & (turning > _TURNING_RAD_S)[:, np.newaxis]
    notes = [
        f"'{name}' shows 0 in {count} rows in which rotors turn: its sensor is dead there, the values are missing."
        for name, count in zip(speeds.names, dead.sum(axis=0).tolist(), strict=True)
        if count
    ]
    return np.where(dead, np.nan, value), tuple(notes)


def _mean_of_known(values: Array) -> Array:
    """Return the mean of each row (n,) over what is known in it, nan for nothing."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(known, values, 0.0).sum(axis=1) / known.sum(axis=1))


def _single(found: Mapping[str, _Column], quantity: str) -> Array | None:
    return found[quantity].value[:, 0] if quantity in found else None


def _times(
    table: CsvTable, found: Mapping[str, _Column], rate_hz: float | None
) -> tuple[Array | None, float | None, tuple[str, ...]]:
    """Return times (n,) and the rate that made them, both None for settled points, and notes."""
    command, time = found.get("command"), found.get("time_s")
    if command is None:
        return None, None, ()
    held = len(command.raw) / (1 + np.count_nonzero(np.diff(command.raw[:, 0])))
    if rate_hz is None and (held < _HELD_ROWS or not command.head.kind):
        return None, None, ()
    if rate_hz is None and time is not None:
        times, notes = times_of(table, time.names[0], time.raw[:, 0], unit="s", rate_hz=None)
        return times, None, notes
    rate = STAND_RATE_HZ if rate_hz is None else rate_hz
    times, notes = times_of(table, None, command.raw[:, 0], unit=None, rate_hz=rate)
    assumed = f"a record over time without a time column: {rate:g} Hz is assumed (--rate-hz)."
    return times, rate, (*notes, *([assumed] if rate_hz is None else []))


def _total_note(thrust: _Column | None, gravity_mps2: float) -> tuple[str, ...]:
    if thrust is None or not thrust.head.kind:
        return ()
    by = f" and grams by {gravity_mps2:g} m/s^2" if thrust.head.kind == "total in grams" else ""
    return (f"'{thrust.names[0]}' is taken as the thrust of {ROTORS} motors: divided by {ROTORS}{by}.",)


def _unused_note(table: CsvTable, found: Mapping[str, _Column]) -> tuple[str, ...]:
    used = {name for column in found.values() for name in column.names}
    unused = [name for name in table.names if name and name not in used]
    return (f"not used: {', '.join(unused)}.",) if unused else ()
