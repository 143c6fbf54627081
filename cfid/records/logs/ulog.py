"""Read ULog files of PX4 with pyulog: a series for every topic.

Motors, their speeds, the battery's voltage and the acceleration along z get the names, numbers and units of a Crazyflie
beside their own.
"""

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.large import stored
from cfid.records.extras import optional_library
from cfid.records.logs.crazyflie_names import crazyflie_channel
from cfid.records.logs.log import Channel, FlightLog, Series, in_memory, printable
from cfid.records.logs.motor_numbers import PX4_QUAD_X, by_geometry, numbering
from cfid.records.parameters import Source
from cfid.units import USUAL_GRAVITY_MPS2

Numbers = npt.NDArray[Any]

BEGIN = b"ULog\x01\x12\x35"

# Of PX4's message definitions, by topic: what has no row here has no unit that is certain.
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
_PATTERNS = tuple((re.compile(pattern), unit) for pattern, unit in _UNITS)


def read_ulog(path: Path, source: Source) -> FlightLog:
    """Read a ULog file.

    Raises ConfigError without pyulog, DataError for a file that it cannot read, or that has no data.
    """
    pyulog = optional_library("pyulog", extra="ulog", what="a ULog file")
    try:
        with redirect_stdout(io.StringIO()):  # pyulog prints what it finds damaged
            log = pyulog.ULog(str(path))
    except Exception as fault:  # a damaged file may make it raise anything
        raise DataError(f"{path}: not readable as a ULog file: {type(fault).__name__}.") from None
    stated = by_geometry({name: value for name, value in log.initial_parameters.items() if _is_number(value)})
    timed = [
        topic for topic in log.data_list if _is_number(topic.data.get("timestamp")) and len(topic.data["timestamp"])
    ]
    series = [_series(topic, stated or PX4_QUAD_X) for topic in timed]
    if not series:
        raise DataError(f"{path}: a ULog file without data.")
    notes = [f"{len(log.dropouts)} dropouts, of {sum(each.duration for each in log.dropouts) / 1e3:.3f} s together."]
    notes = notes if log.dropouts else []
    if log.file_corruption:
        notes.append("parts of the file are damaged and left out.")
    return FlightLog(
        path=path,
        source=source,
        program=f"ULog of PX4 ({printable(str(log.msg_info_dict.get('ver_hw', 'unknown hardware')))})",
        clock="times are the autopilot's, since it started; axes are PX4's: x forward, y right, z down",
        series=tuple(series),
        assumed=_assumed(series, stated),
        notes=tuple(notes),
    )


def _assumed(series: Sequence[Series], stated: tuple[int, ...] | None) -> tuple[str, ...]:
    names = {name for one in series for name in one.names}
    why = "by the rotors' places in its parameters" if stated else "as in PX4's quad X"
    numbers = (numbering(stated or PX4_QUAD_X, "control[{}]", why=why),) if "control.m1" in names else ()
    return (*numbers, *((f"acc.z is -xyz[2] over {USUAL_GRAVITY_MPS2:g} m/s^2",) if "acc.z" in names else ()))


def _series(topic: Any, numbers: tuple[int, ...]) -> Series:
    name = topic.name if not topic.multi_id else f"{topic.name}_{topic.multi_id}"
    fields = [field for field, value in topic.data.items() if field != "timestamp" and _is_number(value)]
    channels = [Channel(printable(field), _unit(topic.name, field)) for field in fields]
    values = [np.asarray(topic.data[field]) for field in fields]
    for channel, value in _as_a_crazyflie_s(topic.name, dict(zip(fields, values, strict=True)), numbers):
        channels.append(crazyflie_channel(channel))
        values.append(value)
    return in_memory(printable(name), stored(topic.data["timestamp"] * 1e-6), channels, values)


def _is_number(value: Any) -> bool:
    """Return whether a value is a number, or an array of numbers: a damaged file may state another type."""
    return np.asarray(value).dtype.kind in "biuf"


def _as_a_crazyflie_s(
    topic: str, fields: Mapping[str, Numbers], numbers: tuple[int, ...]
) -> Iterator[tuple[str, Numbers]]:
    """Yield the channels that a Crazyflie has too, by its names and in its units."""
    motors = {"actuator_motors": ("control.m{}", "control[{}]"), "esc_status": ("rpm.m{}", "esc[{}].esc_rpm")}
    if topic in motors:
        name, own = motors[topic]
        for place, motor in enumerate(numbers):
            if own.format(place) in fields:
                yield name.format(motor), fields[own.format(place)]
    if topic == "battery_status" and "voltage_v" in fields:
        yield "pm.vbat", fields["voltage_v"]
    if topic == "vehicle_acceleration" and "xyz[2]" in fields:
        yield "acc.z", stored(-fields["xyz[2]"].astype(np.float64) / USUAL_GRAVITY_MPS2)


def _unit(topic: str, field: str) -> str:
    name = f"{topic}.{field}"
    return next((unit for pattern, unit in _PATTERNS if pattern.fullmatch(name)), "")
