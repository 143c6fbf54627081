"""Read ULog files of PX4 with pyulog: a series for every topic."""

import io
import re
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from cfid.errors import DataError
from cfid.records.extras import optional_library
from cfid.records.logs.log import Channel, FlightLog, Series, in_memory, printable
from cfid.records.parameters import Source

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
    series = [_series(topic) for topic in log.data_list if len(topic.data["timestamp"])]
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
        notes=tuple(notes),
    )


def _series(topic: Any) -> Series:
    name = topic.name if not topic.multi_id else f"{topic.name}_{topic.multi_id}"
    fields = [field for field in topic.data if field != "timestamp"]
    channels = [Channel(printable(field), _unit(topic.name, field)) for field in fields]
    values = [np.asarray(topic.data[field], dtype=np.float64) for field in fields]
    return in_memory(printable(name), topic.data["timestamp"] * 1e-6, channels, values)


def _unit(topic: str, field: str) -> str:
    name = f"{topic}.{field}"
    return next((unit for pattern, unit in _PATTERNS if pattern.fullmatch(name)), "")
