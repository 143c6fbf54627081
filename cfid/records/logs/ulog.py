"""Read ULog files of PX4 with pyulog: a series for every topic.

Motors, their speeds, the battery's voltage and the acceleration along z get the names, numbers and units of a Crazyflie
in addition to their own.
"""

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.large import stored_together
from cfid.records.extras import optional_library
from cfid.records.logs.crazyflie_names import crazyflie_channel
from cfid.records.logs.log import BLOCK_ROWS, Array, Channel, FlightLog, Series, printable
from cfid.records.logs.motor_numbers import PX4_QUAD_X, by_geometry, numbering, off_square
from cfid.records.logs.spin import by_moments
from cfid.records.logs.ulog_parts import UlogParts
from cfid.records.parameters import Source
from cfid.units import MOTORS, USUAL_GRAVITY_MPS2

Rows = npt.NDArray[np.void]

BEGIN = b"ULog\x01\x12\x35"

# From PX4's message definitions, by topic: a field that is missing here has no certain unit.
_UNITS = (
    (r"vehicle_angular_velocity\.xyz\[\d\]|sensor_combined\.gyro_rad\[\d\]|sensor_gyro\.[xyz]", "rad/s"),
    (r"vehicle_angular_velocity\.xyz_derivative\[\d\]", "rad/s^2"),
    (r"vehicle_acceleration\.xyz\[\d\]|sensor_combined\.accelerometer_m_s2\[\d\]|sensor_accel\.[xyz]", "m/s^2"),
    (r"actuator_motors\.control\[\d+\]|vehicle_attitude\.q\[\d\]", "1"),
    (r"vehicle_local_position\.[xyz]", "m"),
    (r"vehicle_local_position\.v[xyz]", "m/s"),
    (r"vehicle_local_position\.a[xyz]", "m/s^2"),
    (r"battery_status\.voltage(?:_filtered)?_v", "V"),
    (r"battery_status\.current(?:_filtered)?_a", "A"),
    (r"actuator_outputs\.output\[\d+\]", "1"),
    (r"esc_status\.esc\[\d\]\.esc_rpm", "rpm"),
)
_MOTORS, _CONTROLLERS = "actuator_motors", "esc_status"
_FILLING = re.compile(r"(?:^|\.)_padding\d*")  # bytes by which definitions make records longer
_BATTERY = "battery_status"  # a topic for each possible battery; one that is not connected shows 0 V
_FIRST_MOTOR = 101  # PX4's `actuator_function` of Motor1
_PATTERNS = tuple((re.compile(pattern), unit) for pattern, unit in _UNITS)


class _Column(NamedTuple):
    """A channel, and the field that it is taken from."""

    channel: Channel
    field: str
    divisor: float = 1.0


def read_ulog(path: Path, source: Source) -> FlightLog:
    """Read a ULog file.

    Raises ConfigError without pyulog, DataError for a file that it cannot read, or that has no data.
    """
    pyulog = optional_library("pyulog", extra="ulog", what="a ULog file")
    topics: dict[tuple[str, int], list[Rows]] = {}
    dropped_ms: list[int] = []
    info: dict[str, Any] = {}
    parameters: dict[str, float] = {}
    damaged, back = False, 0
    parts = UlogParts(path)
    for part in parts:
        try:
            with redirect_stdout(io.StringIO()), part:  # pyulog prints what it finds damaged
                log = pyulog.ULog(part)
        except Exception as fault:  # a damaged file may make it raise anything
            raise DataError(
                f"{path}: not readable as a ULog file: pyulog cannot read it ({type(fault).__name__}). Copy it from "
                "the autopilot again."
            ) from None
        timed = [topic for topic in log.data_list if _is_number(topic.data.get("timestamp"))]
        ordered = [_in_order(_rows(topic.data)) for topic in timed]
        back += sum(len(topic.data["timestamp"]) - len(rows) for topic, rows in zip(timed, ordered, strict=True))
        for topic, rows in zip(timed, stored_together(ordered), strict=True):
            topics.setdefault((topic.name, topic.multi_id), []).append(rows)
        dropped_ms += [each.duration for each in log.dropouts]
        info, damaged = log.msg_info_dict | info, damaged or log.file_corruption
        parameters = {name: value for name, value in log.initial_parameters.items() if _is_number(value)}
    stated = by_geometry(parameters)
    series = [
        _series(*topic, rows, stated or PX4_QUAD_X, is_battery=topic == _battery_of(topics))
        for topic, rows in sorted(topics.items())
    ]
    if not series:
        raise DataError(f"{path}: a ULog file without data.")
    notes = [f"{counted(len(dropped_ms), 'dropout')}, of {sum(dropped_ms) / 1e3:.3f} s together."] if dropped_ms else []
    if back:
        notes.append(f"{counted(back, 'row')} with a time that is not between those of the neighbours left out.")
    notes += [*_of_damages(parts, others=damaged), *off_square(parameters, _driven(topics))]
    return FlightLog(
        path=path,
        source=source,
        program=f"ULog of PX4 ({printable(str(info.get('ver_hw', 'unknown hardware')))})",
        clock="times are the autopilot's, since it started; axes are PX4's: x forward, y right, z down",
        series=tuple(series),
        assumed=(*_assumed(series, stated), *by_moments(parameters, stated or PX4_QUAD_X)),
        notes=tuple(notes),
    )


def _of_damages(parts: UlogParts, *, others: bool) -> Iterator[str]:
    """Yield a sentence on what is damaged: segments without whole messages, or `others`."""
    if parts.damages:
        first, end = parts.damages[0]
        size = sum(end - first for first, end in parts.damages)
        lost = f"{counted(size, 'byte')} in {counted(len(parts.damages), 'place')} left out."
        missing = "what follows may be missing." if end == len(parts) else lost
        yield f"the file is damaged or cut after {100 * first / len(parts):.1f} % of it: {missing}"
    elif others:
        yield "parts of the file are damaged and left out."


def _assumed(series: Sequence[Series], stated: tuple[int, ...] | None) -> tuple[str, ...]:
    names = {name for one in series for name in one.names}
    why = "by the rotors' places in its parameters" if stated else "as in PX4's quad X"
    numbers = (numbering(stated or PX4_QUAD_X, "control[{}]", why=why),) if "control.m1" in names else ()
    return (*numbers, *((f"acc.z is -xyz[2] over {USUAL_GRAVITY_MPS2:g} m/s^2",) if "acc.z" in names else ()))


def _rows(fields: Mapping[str, Any]) -> Rows:
    """Return a topic's fields of numbers as records (n,)."""
    numbers = {name: np.asarray(value) for name, value in fields.items() if _is_number(value)}
    rows = np.empty(len(numbers["timestamp"]), [(name, value.dtype) for name, value in numbers.items()])
    for name, value in numbers.items():
        rows[name] = value
    return rows


def _in_order(rows: Rows) -> Rows:
    """Return a topic's rows (n,) without those of damaged times: later than the next, or earlier than one before."""
    time = rows["timestamp"].astype(np.int64)
    above = np.zeros(len(time), bool)
    above[:-1] = time[:-1] > time[1:]
    above[1:-1] &= time[:-2] <= time[2:]
    kept = np.where(above, np.iinfo(np.int64).min, time)
    return rows[~above & (kept >= np.maximum.accumulate(kept))]


def _battery_of(topics: Mapping[tuple[str, int], Sequence[Rows]]) -> tuple[str, int] | None:
    """Return the topic of the battery that feeds the vehicle: the first of those that are connected, else the first."""
    batteries = [topic for topic in sorted(topics) if topic[0] == _BATTERY]
    shown = (topic for topic in batteries if any(np.any(_volts(rows) > 0) for rows in topics[topic]))
    return next(shown, batteries[0] if batteries else None)


def _volts(rows: Rows) -> Array:
    return rows["voltage_v"] if "voltage_v" in (rows.dtype.names or ()) else np.zeros(len(rows))


def _series(topic: str, number: int, rows: Sequence[Rows], motors: tuple[int, ...], *, is_battery: bool) -> Series:
    fields = [field for field in rows[0].dtype.names or () if field != "timestamp" and not _FILLING.search(field)]
    columns = [_Column(Channel(printable(field), _unit(topic, field)), field) for field in fields]
    if topic != _BATTERY or is_battery:
        named = [column for column in _as_a_crazyflie_s(topic, _numbered(rows, motors)) if column.field in fields]
        columns += [_forwards(column, rows) if topic == _CONTROLLERS else column for column in named]
    return Series(
        name=printable(f"{topic}_{number}" if number else topic),
        rows=sum(map(len, rows)),
        channels=tuple(column.channel for column in columns),
        blocks=partial(_blocks, rows, columns),
    )


def _driven(topics: Mapping[tuple[str, int], Sequence[Rows]]) -> int:
    """Return how many motors have commands; motors beyond four count only with commands other than 0."""
    parts = topics.get((_MOTORS, 0), ())
    fields = [field for field in (parts[0].dtype.names or () if parts else ()) if field.startswith("control[")]
    moved = [any(np.any(np.nan_to_num(rows[field])) for rows in parts) for field in fields[len(MOTORS) :]]
    four = [any(np.isfinite(rows[field]).any() for rows in parts) for field in fields[: len(MOTORS)]]
    return sum(four) + sum(moved)


def _numbered(rows: Sequence[Rows], motors: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Return places of a topic's entries and the Crazyflie's numbers of their motors: in order, or as entries state.

    PX4's reports of motor controllers are in the order of the controllers, and number the motors from 101.
    """
    names = [name for name in rows[0].dtype.names or () if name.endswith("].actuator_function")]
    stated = {int(np.median(rows[0][name])) - _FIRST_MOTOR: place for place, name in enumerate(names)}
    if set(range(len(motors))) <= set(stated):
        return tuple((stated[one], motor) for one, motor in enumerate(motors))
    return tuple(enumerate(motors))


def _forwards(column: _Column, rows: Sequence[Rows]) -> _Column:
    """Return a rotor's speed, its sign changed where it is never above zero but is below: it turns the other way."""
    values = rows[0][column.field]
    return column._replace(divisor=-1.0) if values.max() <= 0 > values.min() else column


def _blocks(rows: Sequence[Rows], columns: Sequence[_Column]) -> Iterator[Array]:
    for part in rows:
        for begin in range(0, len(part), BLOCK_ROWS):
            some = part[begin : begin + BLOCK_ROWS]
            with np.errstate(invalid="ignore"):  # damaged floats that are signalling NaN become quiet ones
                values = [some[each.field].astype(np.float64) / each.divisor for each in columns]
            yield np.column_stack([some["timestamp"] / 1e6, *values])


def _is_number(value: Any) -> bool:
    """Return whether a value is a number, or an array of numbers: a damaged file may state another type."""
    return np.asarray(value).dtype.kind in "biuf"


def _as_a_crazyflie_s(topic: str, motors: tuple[tuple[int, int], ...]) -> Iterator[_Column]:
    """Yield the channels that a Crazyflie also has, under its names and in its units."""
    for_motors = {_MOTORS: ("control.m{}", "control[{}]"), _CONTROLLERS: ("rpm.m{}", "esc[{}].esc_rpm")}
    if topic in for_motors:
        name, own = for_motors[topic]
        for place, motor in motors:
            yield _Column(crazyflie_channel(name.format(motor)), own.format(place))
    if topic == _BATTERY:
        yield _Column(crazyflie_channel("pm.vbat"), "voltage_v")
    if topic == "vehicle_acceleration":
        yield _Column(crazyflie_channel("acc.z"), "xyz[2]", -USUAL_GRAVITY_MPS2)


def _unit(topic: str, field: str) -> str:
    name = f"{topic}.{field}"
    return next((unit for pattern, unit in _PATTERNS if pattern.fullmatch(name)), "")
