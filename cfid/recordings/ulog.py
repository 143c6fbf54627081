"""Read ULog files of PX4 with pyulog: a series for every topic.

Motors, their speeds, the battery's voltage and the acceleration along z get the names, numbers and units of a Crazyflie
in addition to their own.
"""

import io
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.findings import Finding, finding
from cfid.large import empty
from cfid.recordings.crazyflie import printable
from cfid.recordings.recording import Column, Facts, How, Recording, Series
from cfid.records.extras import optional_library
from cfid.records.files import sha256_of
from cfid.records.parameters import Source
from cfid.units import MOTORS, ROTOR_TURNS, USUAL_GRAVITY_MPS2

BEGIN = b"ULog\x01\x12\x35"

# From PX4's message definitions, by topic: a field that is missing here has no certain unit.
_UNITS = tuple(
    (re.compile(pattern), unit)
    for pattern, unit in (
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
)
_MOTORS, _CONTROLLERS, _BATTERY = "actuator_motors", "esc_status", "battery_status"
_FILLING = re.compile(r"(?:^|\.)_padding\d*")  # bytes by which definitions make records longer
_FIRST_MOTOR = 101  # PX4's `actuator_function` of Motor1
_SEARCH_BYTES = 512  # that pyulog reads at once where it looks for the next whole message
_QUAD_X = (1, 3, 4, 2)  # the Crazyflie's numbers of PX4's motors in order: front right, rear left, front left, ...
_PLACES = {(True, True): 1, (False, True): 2, (False, False): 3, (True, False): 4}  # forward, right
_OFF_SQUARE = 0.01  # relative to the lever: airframe files round places by as much


_Raw = tuple[str, str, npt.NDArray[Any], float]  # a column's name, unit and values, and what divides these


class _Topic(NamedTuple):
    """A topic's fields (n,) by name, without the rows of damaged times."""

    name: str
    number: int
    time_us: npt.NDArray[Any]
    fields: dict[str, npt.NDArray[Any]]


class _File(io.BufferedReader):
    """A file whose cut last message ends pyulog's reading; pyulog would go back and read it again without end."""

    cut = False

    def read(self, size: int | None = -1) -> bytes:
        """Return the next bytes. Raises struct.error, at which pyulog ends, for fewer than asked."""
        content = super().read(size)
        if size is not None and 0 < len(content) < size != _SEARCH_BYTES:
            self.cut = True
            raise struct.error
        return content


def read_ulog(path: Path, how: How | None = None) -> Recording:
    """Read a ULog file.

    Raises ConfigError without pyulog, DataError for a file that it cannot read, or that has no data.
    """
    how = how or How()
    how.refuse_unused(path, "props_out")
    pyulog = optional_library("pyulog", extra="ulog", what="a ULog file")
    try:
        with redirect_stdout(io.StringIO()), _File(io.FileIO(path)) as file:  # pyulog prints what it finds damaged
            log = pyulog.ULog(file)
    except Exception as fault:  # a damaged file may make it raise anything
        raise DataError(
            f"{path}: not readable as a ULog file: pyulog cannot read it ({type(fault).__name__}). Copy it from the "
            "autopilot again."
        ) from None
    topics, wrong_times = _topics(log.data_list)
    log.data_list.clear()
    if not topics:
        raise DataError(f"{path}: a ULog file without data.")
    parameters = {name: float(value) for name, value in log.initial_parameters.items() if _is_number(value)}
    stated = _by_geometry(parameters)
    battery = _connected(topics)
    driven = _driven(topics)
    series = [_series(path, topic, stated or _QUAD_X, is_battery=topic is battery) for topic in topics]
    names = {column.name for one in series for column in one.columns}
    motors = max(int(parameters.get("CA_ROTOR_COUNT", 0)), driven) or None
    props_out = how.props_out if how.props_out is not None else _turn_other_way(parameters, stated or _QUAD_X)
    findings: list[Finding] = []
    if log.dropouts:
        lost_s = sum(dropout.duration for dropout in log.dropouts) / 1e3
        findings.append(finding("log-dropouts", count=len(log.dropouts), lost_s=lost_s))
    if wrong_times:
        findings.append(finding("log-times-left-out", count=wrong_times))
    if log.file_corruption or file.cut:
        findings.append(finding("log-cut" if file.cut and not log.file_corruption else "log-parts-damaged"))
    if "control.m1" in names:
        own = [f"control[{(stated or _QUAD_X).index(motor)}]" for motor in MOTORS]
        findings.append(finding("log-motors", own=", ".join(own), why="its parameters" if stated else "PX4's quad X"))
    return Recording(
        path=path,
        source=Source(str(path), sha256_of(path)),
        facts=Facts(
            clock="true",
            props_out=props_out,
            motors=motors,
            square=_is_square(parameters) if motors in (None, len(MOTORS)) else False,
            program=f"ULog of PX4 ({printable(str(log.msg_info_dict.get('ver_hw', 'unknown hardware')))})",
        ),
        series={one.name: one for one in series},
        findings=tuple(one.at(path.name) for one in findings),
    )


def _topics(parts: Sequence[Any]) -> tuple[list[_Topic], int]:
    """Return the topics with times, and how many rows are left out since their times are damaged.

    Such a time is later than the next one, or earlier than one before.
    """
    topics, wrong = [], 0
    for part in parts:
        fields = {name: np.asarray(values) for name, values in part.data.items() if _is_number(values)}
        if "timestamp" not in fields:
            continue
        time_us = fields.pop("timestamp").astype(np.int64)
        above = np.zeros(len(time_us), bool)
        above[:-1] = time_us[:-1] > time_us[1:]
        above[1:-1] &= time_us[:-2] <= time_us[2:]
        latest = np.where(above, np.iinfo(np.int64).min, time_us)
        kept = ~above & (latest >= np.maximum.accumulate(latest))
        wrong += int(np.count_nonzero(~kept))
        if not kept.all():
            time_us, fields = time_us[kept], {name: values[kept] for name, values in fields.items()}
        topics.append(_Topic(part.name, part.multi_id, time_us, fields))
    return sorted(topics, key=lambda topic: topic[:2]), wrong


def _series(path: Path, topic: _Topic, motors: tuple[int, ...], *, is_battery: bool) -> Series:
    fields = {name: values for name, values in topic.fields.items() if not _FILLING.search(name)}
    raw = [(printable(name), _unit(topic.name, name), values, 1.0) for name, values in fields.items()]
    if topic.name != _BATTERY or is_battery:
        raw += _as_a_crazyflie_s(topic, motors)
    numbers = empty(1 + len(raw), len(topic.time_us))  # together, since they may be larger than the memory
    with np.errstate(invalid="ignore"):  # damaged floats that are signalling NaN become quiet ones
        for row, (_, _, values, divisor) in zip(numbers[1:], raw, strict=True):
            np.divide(values, divisor, out=row, dtype=np.float64)
    numbers[0] = (topic.time_us - topic.time_us[0]) / 1e6
    topic.fields.clear()  # the file's bytes are still in memory
    return Series(
        name=printable(f"{topic.name}_{topic.number}" if topic.number else topic.name),
        path=path,
        columns=tuple(
            Column(name=name, unit=unit, values=row) for row, (name, unit, _, _) in zip(numbers[1:], raw, strict=True)
        ),
        rows=len(topic.time_us),
        time_s=numbers[0],
        begin_s=float(topic.time_us[0]) / 1e6,
    )


def _unit(topic: str, field: str) -> str:
    name = f"{topic}.{field}"
    return next((unit for pattern, unit in _UNITS if pattern.fullmatch(name)), "")


def _as_a_crazyflie_s(topic: _Topic, motors: tuple[int, ...]) -> Iterator[_Raw]:
    """Yield the columns that a Crazyflie also has, under its names and in its units, and what divides their values."""
    fields = topic.fields
    if topic.name == _MOTORS:
        for place, motor in enumerate(motors):
            if f"control[{place}]" in fields:
                yield f"control.m{motor}", "1", fields[f"control[{place}]"], 1.0
    if topic.name == _CONTROLLERS:
        for place, motor in _of_controllers(fields, motors):
            speed = fields.get(f"esc[{place}].esc_rpm")
            if speed is not None:
                sign = -1.0 if speed.max() <= 0 > speed.min() else 1.0  # of a rotor that turns the other way
                yield f"rpm.m{motor}", "rpm", speed, sign
    if topic.name == _BATTERY and "voltage_v" in fields:
        yield "pm.vbat", "V", fields["voltage_v"], 1.0
    if topic.name == "vehicle_acceleration" and "xyz[2]" in fields:
        yield "acc.z", "g", fields["xyz[2]"], -USUAL_GRAVITY_MPS2


def _of_controllers(fields: Mapping[str, Any], motors: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Return places of motor controllers and the numbers of their motors: as stated from 101 on, or in order."""
    names = [name for name in fields if name.endswith("].actuator_function")]
    stated = {int(np.median(fields[name])) - _FIRST_MOTOR: place for place, name in enumerate(names)}
    if set(range(len(motors))) <= set(stated):
        return tuple((stated[place], motor) for place, motor in enumerate(motors))
    return tuple(enumerate(motors))


def _connected(topics: Sequence[_Topic]) -> _Topic | None:
    """Return the topic of the battery that feeds the vehicle: the first of those that are connected, else the first."""
    batteries = [topic for topic in topics if topic.name == _BATTERY]
    shown = (topic for topic in batteries if np.any(topic.fields.get("voltage_v", np.zeros(1)) > 0))
    return next(shown, batteries[0] if batteries else None)


def _driven(topics: Sequence[_Topic]) -> int:
    """Return how many motors have commands; motors beyond four count only with commands other than 0."""
    topic = next((topic for topic in topics if (topic.name, topic.number) == (_MOTORS, 0)), None)
    commands = [values for name, values in topic.fields.items() if name.startswith("control[")] if topic else []
    four = [bool(np.isfinite(values).any()) for values in commands[: len(MOTORS)]]
    return sum(four) + sum(bool(np.any(np.nan_to_num(values))) for values in commands[len(MOTORS) :])


def _by_geometry(parameters: Mapping[str, float]) -> tuple[int, ...] | None:
    """Return the Crazyflie's numbers of PX4's motors in order, from its rotor positions; None where these show none."""
    places = _places_m(parameters)
    if any(0.0 in place for place in places) or parameters.get("CA_ROTOR_COUNT", len(MOTORS)) != len(MOTORS):
        return None
    numbers = tuple(_PLACES[forward > 0, right > 0] for forward, right in places)
    return numbers if set(numbers) == set(MOTORS) else None


def _is_square(parameters: Mapping[str, float]) -> bool | None:
    """Return whether PX4's parameters place the rotors at the corners of a square, None where they do not say."""
    if _by_geometry(parameters) is None:
        return None
    levers = np.abs(_places_m(parameters))
    return bool(np.max(np.abs(levers - levers.mean())) <= _OFF_SQUARE * levers.mean())


def _places_m(parameters: Mapping[str, float]) -> list[tuple[float, float]]:
    """Return PX4's rotor positions forward and right, 0 for an unknown one."""
    return [
        (parameters.get(f"CA_ROTOR{at}_PX", 0.0), parameters.get(f"CA_ROTOR{at}_PY", 0.0)) for at in range(len(MOTORS))
    ]


def _turn_other_way(parameters: Mapping[str, float], numbers: Sequence[int]) -> bool | None:
    """Return whether rotors turn the other way than a Crazyflie's, None where PX4's parameters do not say.

    PX4 counts the moment over the thrust of a rotor that turns counterclockwise, seen from above, as positive.
    """
    stated = [parameters.get(f"CA_ROTOR{place}_KM", 0.0) * ROTOR_TURNS[motor] for place, motor in enumerate(numbers)]
    return True if max(stated) < 0 else False if min(stated) > 0 else None


def _is_number(value: Any) -> bool:
    """Return whether a value is a number, or an array of numbers: a damaged file may state another type."""
    return np.asarray(value).dtype.kind in "biuf"
