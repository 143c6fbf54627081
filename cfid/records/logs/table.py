"""Read logs that are tables: of the Crazyflie's client, NanoBench, Crazyswarm2's simulator, and any other with times.

The header shows which program wrote it. Variables of the firmware keep their names; `imu_acc_x` becomes `acc.x` again.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cfid.errors import DataError
from cfid.large import usual_step
from cfid.recordings.wrench import AXES
from cfid.records.logs.crazyflie_names import (
    assumptions,
    crazyflie_channel,
    is_variable,
    stated_channel,
    taken_for_granted,
    with_dot,
)
from cfid.records.logs.log import Array, Channel, FlightLog, Series, printable
from cfid.records.logs.usd_clock import RATES, correction
from cfid.records.parameters import Source
from cfid.records.tables.angle import SCHEMA as ANGLE_COLUMNS
from cfid.records.tables.blocks import open_table
from cfid.records.tables.column_units import unit_of, unit_word
from cfid.records.tables.interleaved import refuse_interleaved
from cfid.records.tables.line_faults import REPAIR
from cfid.records.tables.matlab import is_matlab
from cfid.records.tables.schema import TIME, Foreign, TableSchema, refuse_clock
from cfid.records.tables.stand_heads import heads_of, shows_stand
from cfid.records.tables.table import CsvTable
from cfid.records.tables.times import TIME_COLUMN, known_rows, line_notes, pauses, seconds_of, time_unit_of, times_of
from cfid.units import split_unit

_SCHEMA = TableSchema(columns=(TIME_COLUMN,), words=("TIME",))
_VARIABLE = re.compile(r"\w+\.\w+")  # of the firmware
_BLOCK_NAME = re.compile(r"[a-z]+_(?P<group>[A-Za-z]+)_(?P<variable>\w+.*)")  # NanoBench: log block and variable
_NANOBENCH = {
    **dict.fromkeys(("px", "py", "pz"), "m"),
    **dict.fromkeys(("vx", "vy", "vz"), "m/s"),
    **dict.fromkeys(("qx", "qy", "qz", "qw"), "1"),
    **dict.fromkeys(("roll", "pitch", "yaw"), "rad"),
    **dict.fromkeys(("wx_vicon", "wy_vicon", "wz_vicon"), "rad/s"),
}
_NANOBENCH |= {f"imu_gyro_{axis}": "rad/s" for axis in "xyz"}  # as its motion capture shows; the firmware's are deg/s
_OF_NANOBENCH = {"wx_vicon", "motor_motor_m1", "imu_gyro_x", "imu_acc_x"}  # one is enough: not all parts have all
_CRAZYSWARM = {**dict.fromkeys("xyz", "m"), **dict.fromkeys(("qw", "qx", "qy", "qz"), "1")}
_EMPTY = " is empty."
_EXACT_BELOW = 2.0**53
_IN_BRACKETS = re.compile(r"[(\[](?P<unit>N-m|[A-Za-zµμ°%][\w/^·⋅.*°% ]{0,7})[)\]]\s*$")
_SPELT = {"rpm": "rpm", "n·m": "N m", "n⋅m": "N m", "n-m": "N m", "n.m": "N m", "nm": "N m", "n*m": "N m", "°": "deg"}
_CLIENT = "CSV log of the Crazyflie client"
_LEAST_STEP_MS = 0.5  # between rows of the client, which writes one per ms at most
_UNITS = {1.0: "s", 1e-3: "ms", 1e-6: "us"}


def read_table_log(path: Path, source: Source, reading: Foreign) -> FlightLog:
    """Read a table with a time column, or with a rate, as one series; columns that are not numbers are left out.

    Raises DataError for a file that is not a table of numbers, or whose times fit no unit; ConfigError where an
    option contradicts the file.
    """
    table = open_table(path, sha256=source.sha256, skip_lines=reading.skip_lines, columns=reading.columns)
    time = _by_name(table, _SCHEMA.places(table, named=reading.columns[:1], rate_hz=reading.rate_hz).get(TIME))
    raw, left_out = np.zeros(2), tuple[str, ...]()
    if time is not None:
        refuse_interleaved(table, time, [name for name in table.names if name != time and _is_label(name, table)])
        table, values, left_out = known_rows(table, [time], timed=True)
        raw = values[:, 0]
    repeated = _repeated(table, time)
    named = [
        name
        for name in table.names
        if name and name != time and name not in repeated and not _is_replaced(name, table, reading)
    ]
    program, channels = (
        ("table of a MATLAB file" if is_matlab(path) else "CSV log"),
        tuple(map(_firmware, with_dot(named))),
    )
    assumed: tuple[str, ...] = ()
    of_vehicle = False
    if table.names[0] == "Timestamp" and named and all(map(_VARIABLE.fullmatch, named)):
        program = _CLIENT
        if time is not None and reading.time_unit is None:
            _refuse_seconds(table, raw)
            reading = replace(reading, time_unit="ms")
            assumed = ("Timestamp is in ms, as that program writes it",)
    elif _OF_NANOBENCH & {*named}:
        program = "CSV log of NanoBench"
        channels = tuple(Channel(name, _NANOBENCH[name]) if name in _NANOBENCH else _nanobench(name) for name in named)
    elif set(named) == set(_CRAZYSWARM):
        program = "CSV file of Crazyswarm2's simulator"
        channels = tuple(Channel(name, _CRAZYSWARM[name]) for name in named)
    elif of_vehicle := any(map(is_variable, with_dot(named))):
        assumed = taken_for_granted(named)
    if table.units:
        channels, assumed = tuple(stated_channel(printable(name), table.units[name]) for name in named), ()
    stated = reading.time_unit is not None or bool(table.units) or _is_slow_stand(table, time)
    time_s, notes = times_of(table, time, raw, unit=reading.time_unit, rate_hz=reading.rate_hz, own=stated)
    if time is not None:
        notes += pauses(table, time_s)
        reading = replace(reading, time_unit=time_unit_of(table, time, raw, unit=reading.time_unit))
    if time is None or not of_vehicle:
        refuse_clock(path, reading)
    second_s, clock = _clock(table, time, reading)
    faults, missing, inexact, rows = _checked(table, time, named)
    if len(faults) == len(named):
        raise DataError(next(iter({**faults, **repeated}.values()), f"{path}: no column but the time."))
    kept = [(name, channel) for name, channel in zip(named, channels, strict=True) if name not in faults]
    found = tuple(channel for _, channel in kept)
    blocks = partial(_blocks, table, reading, time, [name for name, _ in kept], second_s=second_s, own=raw)
    return FlightLog(
        path=path,
        source=source,
        program=program,
        clock=clock,
        series=(Series(name="log", rows=rows, channels=found, blocks=blocks),),
        assumed=(*assumed, *assumptions(found)),
        notes=(
            *left_out,
            *notes,
            *(f"left out: {fault}" for fault in (*repeated.values(), *_merged(faults))),
            *(
                f"column '{printable(name)}' has no finite number in {count} of {rows} rows."
                for name, count in missing.items()
            ),
            *(
                f"column '{printable(name)}' has numbers above 2^53, which lose their last digits here."
                for name in inexact
            ),
            *line_notes(table),
        ),
    )


def _by_name(table: CsvTable, time: str | None) -> str | None:
    """Return the name of a time column that may be given by number, unless another column has it, too."""
    name = None if time is None else table.names[table.place(time)]
    return time if name is None or table.names.count(name) > 1 else name


def _is_label(name: str, table: CsvTable) -> bool:
    """Return whether a column may show which of several recordings a row is of: it is not a vehicle's variable."""
    return bool(name) and table.has_head and table.names.count(name) == 1 and not is_variable(name)


def _refuse_seconds(table: CsvTable, raw: Array) -> None:
    """Raise DataError for times (n,) of the Crazyflie's client, read in ms, that are closer than its rows can be."""
    step = usual_step(raw)
    if 0 < step < _LEAST_STEP_MS:
        raise DataError(
            f"{table.path}: Timestamp is read in ms, as the Crazyflie client writes it, and its rows would be "
            f"{step:.3g} ms apart (limit {_LEAST_STEP_MS:g} ms). If it is in s, give `time_unit` s."
        )


def _repeated(table: CsvTable, time: str | None) -> dict[str, str]:
    """Return, by name, why columns that share a name are left out."""
    places: dict[str, list[str]] = {}
    for place, name in enumerate(table.names, start=1):
        places.setdefault(name, []).append(str(place))
    return {
        name: f"{table.path}: the columns {', '.join(there)} are all named '{printable(name)}': rename them."
        for name, there in places.items()
        if name and name != time and len(there) > 1
    }


def _is_slow_stand(table: CsvTable, time: str | None) -> bool:
    """Return whether a thrust stand's time column names its unit: one row per step is then slow, not wrong."""
    named = time is not None and unit_of(table, TIME_COLUMN.called, time, None, "") is not None
    return named and table.has_head and shows_stand(heads_of(table.names))


def _is_replaced(name: str, table: CsvTable, reading: Foreign) -> bool:
    """Return whether a column is a time that the given rate replaces."""
    return reading.rate_hz is not None and table.has_head and TIME_COLUMN.called.fullmatch(name) is not None


def _firmware(name: str) -> Channel:
    """Return the channel of a column that may have the name of a variable of the firmware."""
    variable = crazyflie_channel(name)
    return variable if variable.own_unit else Channel(printable(name), _bracketed(name) or _suffixed(name))


def _suffixed(name: str) -> str:
    """Return the unit in the name of an angle, force or torque, as in `theta_rad`, or the name rpm; "" for none."""
    if name.lower() == "rpm":
        return "rpm"
    axis, of_axis = split_unit(name)
    if axis.capitalize() in AXES:
        return {"n": "N", "nm": "N m"}.get(of_axis.lower(), of_axis.lower())
    for column in ANGLE_COLUMNS.columns:
        match = column.called.fullmatch(name)
        if match is not None and match.lastindex is not None:
            unit = unit_word(match[1]) or ""
            return {"n": "N", "nm": "N m"}.get(unit, unit)
    return ""


def _bracketed(name: str) -> str:
    """Return the unit in brackets at the end of a column's name, "" for none or for a g, which may be a gram."""
    found = _IN_BRACKETS.search(name)
    unit = found["unit"].replace("µ", "u").replace("μ", "u") if found else ""
    return "" if unit == "g" else _SPELT.get(unit.lower(), unit)


def _nanobench(name: str) -> Channel:
    """Return the channel of a column of NanoBench: `imu_acc_x` is `acc.x`."""
    match = _BLOCK_NAME.fullmatch(name)
    variable = crazyflie_channel(f"{match['group']}.{match['variable']}" if match else name)
    return variable if variable.own_unit else Channel(printable(name))


def _clock(table: CsvTable, time: str | None, reading: Foreign) -> tuple[float, str]:
    """Return how long a second of the table is in real time, and a text on what its times are."""
    if time is None:
        return 1.0, f"times are those of {reading.rate_hz:g} Hz"
    unit_s = float(seconds_of(table, time, np.ones(1), unit=reading.time_unit)[0])
    column = f"times are column {printable(time)} in {_UNITS[unit_s]}"
    if reading.clock is None:
        return 1.0, column
    return 1 / RATES[reading.clock], f"{column}, {correction(reading.clock)} (`clock` {reading.clock})"


class _Checked(NamedTuple):
    """Why columns are left out; rows without a number in the others; those of them that lose digits; number of rows."""

    faults: dict[str, str]
    missing: dict[str, int]
    inexact: list[str]
    rows: int


def _checked(whole: CsvTable, time: str | None, names: Sequence[str]) -> _Checked:
    faults: dict[str, str] = {}
    missing = dict.fromkeys(names, 0)
    inexact: dict[str, None] = {}
    rows = 0
    for table in whole.blocks():
        values = _numbers(table, time, names)
        known = np.isfinite(values[:, len(_given(time)) :])
        for name, there, value in zip(names, known.T, values[:, len(_given(time)) :].T, strict=True):
            if name not in inexact and np.abs(value).max(initial=0.0, where=there) > _EXACT_BELOW:
                inexact |= {name: None} if table.loses_digits(name) else {}
            missing[name] += int(np.count_nonzero(~there))
            if not rows and not there.any():
                faults[name] = _fault(table, name)
        rows += len(values)
    faults = {name: fault for name, fault in faults.items() if missing[name] == rows}
    missing = {name: count for name, count in missing.items() if count and name not in faults}
    return _Checked(faults, missing, list(inexact), rows)


def _numbers(table: CsvTable, time: str | None, names: Sequence[str]) -> Array:
    """Return time and columns, NaN where a column has no number."""
    try:
        return table.numbers([*_given(time), *names])
    except DataError:
        times = [table.numbers([time])] if time is not None else []
        return np.hstack([*times, table.known_numbers(names)])


def _fault(table: CsvTable, name: str) -> str:
    try:
        table.numbers([name])
    except DataError as fault:
        return str(fault).removesuffix(f" {REPAIR}")  # the whole column is wrong, not one line
    return ""


def _merged(faults: Mapping[str, str]) -> list[str]:
    """Return the faults, with one sentence for all columns whose first field is empty."""
    empty = [name for name, fault in faults.items() if _EMPTY in fault]
    if len(empty) < 2:
        return list(faults.values())
    listed = ", ".join(f"'{printable(name)}'" for name in empty)
    return [f"columns {listed} are empty.", *(fault for name, fault in faults.items() if name not in empty)]


def _blocks(
    whole: CsvTable, reading: Foreign, time: str | None, names: Sequence[str], *, second_s: float, own: Array
) -> Iterator[Array]:
    """Yield the times, whose raw values are `own` (n,), and the columns."""
    begun = 0
    for table in whole.blocks():
        values = _numbers(table, time, names)
        if time is None:
            assert reading.rate_hz is not None
            values = np.column_stack([(begun + np.arange(len(values))) / reading.rate_hz, values])
        else:
            rows = own[begun : begun + len(values)]
            time_s = second_s * seconds_of(table, time, rows, unit=reading.time_unit)
            values = np.column_stack([time_s, values[:, 1:]])
        begun += len(values)
        yield values


def _given(time: str | None) -> tuple[str, ...]:
    return () if time is None else (time,)
