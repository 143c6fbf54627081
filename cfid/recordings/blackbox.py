"""Read the blackbox logs of Betaflight and its relatives with orangebox: the longest flight of a file, or a chosen one.

Motors, their speeds, the acceleration along z and the battery's voltage get the names, numbers and units of a Crazyflie
in addition to their own.
"""

import logging
import re
import struct
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding
from cfid.large import empty, joined, parts
from cfid.recordings.crazyflie import printable
from cfid.recordings.recording import Column, Facts, How, Recording, Series
from cfid.records.extras import optional_library
from cfid.records.files import sha256_of
from cfid.records.parameters import Source
from cfid.units import MOTORS

Array = npt.NDArray[np.float64]
_Raw = tuple[str, str, Array, Callable[[Array], Array] | None]  # a column's name, unit and counts, and its conversion
_Flight = tuple[Mapping[str, Any], list[str], Array, list[Finding]]

BEGIN = b"H Product:Blackbox"

_TIME, _LOOP = "time", "loopIteration"
_WHOLE = "I"  # frames with full numbers; other frames have differences from earlier ones
_LONGEST_US, _LONGEST_LOOPS = 10_000_000, 5000  # between two frames, as in Betaflight's viewer
_PART_ROWS = 1 << 16
_QUAD_X = (2, 1, 3, 4)  # the Crazyflie's numbers of Betaflight's motors: rear right, front right, rear left, front left
_GYRO = re.compile(r"gyro(?:ADC|Unfilt)\[\d\]")
_FINE, _FINE_STEP = "blackbox_high_resolution", 0.1  # a header of Betaflight 4.3 and later, and the step that it sets
_ALSO_FINE = {"1": re.compile(r"rcCommand\[\d\]"), "deg/s": re.compile(r"setpoint\[[0-2]\]")}
_MOST = 1.01  # relative to full throttle
_VOLTS = "vbatLatest"
_BETAFLIGHT = re.compile(r"Betaflight (\d+)\.(\d+)")
# By the firmware's voltage.h: 0.1 V from 3.1 on, 0.01 V from 4.0 on. Older ones log the converter's counts.
_VOLT_STEPS = (((4, 0), 0.01), ((3, 1), 0.1))
_PLAIN = re.compile(r"(?:motor|eRPM|debug|rcCommand)\[\d\]|loopIteration")


def read_blackbox(path: Path, how: How | None = None) -> Recording:
    """Read one flight of a blackbox file: that of `how.log`, counted from 1, else the longest.

    Raises ConfigError without orangebox and for a flight that is not there, DataError for a file that it cannot read,
    or that has no frame or time.
    """
    how = how or How()
    how.refuse_unused(path, "log", "props_out")
    orangebox = optional_library("orangebox", extra="blackbox", what="a blackbox log")
    logging.getLogger("orangebox").addHandler(logging.NullHandler())  # it reports headers that it does not need
    count = orangebox.reader.Reader(str(path)).log_count
    if how.log is not None and not 1 <= how.log <= count:
        raise ConfigError(f"{path}: `log` {how.log}: it has {count}.")
    numbers = range(1, 1 + count) if how.log is None else (how.log,)
    rows = {number: _rows(path, orangebox, number, count) for number in numbers}
    number = max(rows, key=lambda one: len(rows[one][2]))
    headers, names, frames, findings = rows[number]
    if not len(frames):
        raise DataError(f"{path}: a blackbox file without a whole frame.")
    if len(rows) > 1:
        others = ", ".join(f"{one} ({len(frames)} rows)" for one, (_, _, frames, _) in rows.items() if one != number)
        findings.append(finding("log-of-several", count=count, log=number, rows=len(frames), others=others))
    place = names.index(_TIME)
    fields = {name: frames[:, at] for at, name in enumerate(names) if at != place}
    begin_us = float(frames[0, place])
    time_s, *values = _converted(
        [
            (_TIME, "s", frames[:, place], lambda time_us: (time_us - begin_us) / 1e6),
            *(raw := [*(_scaled(*field, headers) for field in fields.items()), *_as_a_crazyflie_s(fields, headers)]),
        ]
    )
    series = Series(
        name=f"log{number}",
        path=path,
        columns=tuple(
            Column(name=name, unit=unit, values=own) for (name, unit, _, _), own in zip(raw, values, strict=True)
        ),
        rows=len(frames),
        time_s=time_s,
        begin_s=begin_us / 1e6,
    )
    if "control.m1" in [column.name for column in series.columns]:
        own = ", ".join(f"motor[{_QUAD_X.index(motor)}]" for motor in MOTORS)
        findings.append(finding("log-motors", own=own, why="Betaflight's quad X"))
    if wrong := _beyond_full(fields, headers):
        findings.append(finding("log-outputs-left-out", count=wrong))
    motors = sum(name.startswith("motor[") for name in names) or None
    return Recording(
        path=path,
        source=Source(str(path), sha256_of(path)),
        facts=Facts(
            clock="true",
            props_out=how.props_out,
            motors=motors,
            square=None if motors in (None, len(MOTORS)) else False,
            program=f"blackbox log of {printable(str(headers.get('Firmware revision', 'unknown firmware')))}",
        ),
        series={series.name: series},
        findings=tuple(one.at(path.name) for one in findings),
    )


def _rows(path: Path, orangebox: Any, number: int, count: int) -> _Flight:
    """Return the headers of one flight, the names of its fields, its frames (n, fields), and findings on damage."""
    try:
        parser = orangebox.Parser.load(str(path), number)
    except Exception as fault:  # a damaged file may make it raise anything
        raise DataError(
            f"{path}: not readable as a blackbox log: orangebox cannot read the header of log {number} of {count} "
            f"({type(fault).__name__}). Copy it from the flight controller again."
        ) from None
    if _TIME not in parser.field_names:
        raise DataError(f"{path}: log {number} of {count} is a blackbox log without a field '{_TIME}'.")
    lost = array("b")
    rows = _frames(parser, lost)
    blocks = iter(lambda: list(islice(rows, _PART_ROWS)), [])
    frames = joined(chain([np.zeros((0, len(parser.field_names)))], (np.array(block) for block in blocks)))
    findings = []
    if any(lost[:-1]):
        findings.append(finding("log-frames-left-out", log=number, count=sum(lost[:-1])))
    if lost[-1]:
        findings.append(finding("log-cut"))
    return parser.headers, [str(name) for name in parser.field_names], frames, findings


def _frames(parser: Any, lost: "array[int]") -> Iterator[list[float]]:
    """Yield frames, NaN where a field has no value yet; `lost` gets a word for each frame, and one for the end.

    Where the time or the loop count goes back or jumps, bytes are damaged. The search for a frame then resumes one byte
    later, which orangebox does not do by itself, and frames are lost up to the next whole one.
    """
    width = len(parser.field_names)
    counted = [parser.field_names.index(name) for name in (_TIME, _LOOP) if name in parser.field_names]
    most, last, broken = (_LONGEST_US, _LONGEST_LOOPS)[: len(counted)], None, False
    place = parser.reader.tell()
    try:
        for frame in parser.frames():
            if len(frame.data) != width:
                continue
            now = [frame.data[place] for place in counted]
            follows = last is None or all(0 <= b - a <= c for a, b, c in zip(last, now, most, strict=True))
            broken = not follows or (broken and frame.type.value != _WHOLE)
            if not follows:
                parser.reader.seek(place + 1)
            place = parser.reader.tell()
            lost.append(broken)
            if not broken:
                last = now
                yield [np.nan if value == "" else float(value) for value in frame.data]
    except Exception:  # as above; without its end event, a log ends in an error
        lost.append(True)
    else:
        lost.append(False)


def _scaled(name: str, values: Array, headers: Mapping[str, Any]) -> _Raw:
    """Return a field with the unit that the headers give its counts."""
    step = _FINE_STEP if headers.get(_FINE) == 1 else 1.0
    one_g = headers.get("acc_1G")
    if _GYRO.fullmatch(name) and (scale := _float_of(headers.get("gyro_scale"))):
        return name, "deg/s", values, lambda counts: counts * (step * scale)
    if _FINE in headers and (unit := next((each for each, one in _ALSO_FINE.items() if one.fullmatch(name)), "")):
        return name, unit, values, lambda counts: counts * step
    if name.startswith("accSmooth") and isinstance(one_g, int) and one_g > 0:
        return name, "g", values, lambda counts: counts / one_g
    if name == _VOLTS and (step_v := _volt_step(headers)):
        return name, "V", values, lambda counts: counts * step_v
    return printable(name), "1" if _PLAIN.fullmatch(name) else "", values, None


def _as_a_crazyflie_s(fields: Mapping[str, Array], headers: Mapping[str, Any]) -> Iterator[_Raw]:
    """Yield the columns that a Crazyflie also has, under its names and in its units."""
    low, high = _range(headers.get("motorOutput"))
    poles = headers.get("motor_poles")
    for place, motor in enumerate(_QUAD_X):
        output, speed = fields.get(f"motor[{place}]"), fields.get(f"eRPM[{place}]")
        if output is not None and low < high:
            yield f"control.m{motor}", "1", output, partial(_share, low=low, high=high)
        if speed is not None and isinstance(poles, int) and poles >= 2:
            yield f"rpm.m{motor}", "rpm", speed, lambda counts: counts * (100 / (poles / 2))
    for own, name in (("accSmooth[2]", "acc.z"), (_VOLTS, "pm.vbat")):
        if own in fields and (raw := _scaled(own, fields[own], headers))[1]:
            yield name, *raw[1:]


def _share(output: Array, *, low: float, high: float) -> Array:
    """Return outputs (n,) as shares of full throttle, NaN where they are impossible."""
    share = np.clip((output - low) / (high - low), 0, None)
    return np.where(share > _MOST, np.nan, share)


def _converted(columns: Sequence[_Raw]) -> list[Array]:
    """Return the converted values (n,) of columns: together and part by part, since they may exceed the memory."""
    changed = sum(convert is not None for _, _, _, convert in columns)
    rows = iter(empty(changed, len(columns[0][2])))
    converted = []
    for _, _, values, convert in columns:
        row = values if convert is None else next(rows)
        if convert is not None:
            for part in parts(len(values)):
                row[part] = convert(values[part])
        converted.append(row)
    return converted


def _beyond_full(fields: Mapping[str, Array], headers: Mapping[str, Any]) -> int:
    """Return how many outputs of motors are beyond full throttle, which only damaged bytes show."""
    low, high = _range(headers.get("motorOutput"))
    outputs = [fields[name] for place in range(len(MOTORS)) if (name := f"motor[{place}]") in fields]
    most = low + _MOST * (high - low)
    return sum(int(np.count_nonzero(output > most)) for output in outputs) if low < high else 0


def _volt_step(headers: Mapping[str, Any]) -> float:
    """Return the step of the battery's voltage in V by the firmware's version, 0.0 where that does not show it."""
    stated = _BETAFLIGHT.match(str(headers.get("Firmware revision")))
    version = (int(stated[1]), int(stated[2])) if stated else (0, 0)
    return next((step_v for since, step_v in _VOLT_STEPS if version >= since), 0.0)


def _range(header: object) -> tuple[float, float]:
    """Return the motor output at standstill and at full throttle, zeros where the header does not state both."""
    numbers = header if isinstance(header, list | tuple) else str(header).split(",")
    try:
        low, high = (float(number) for number in numbers)
    except ValueError:
        return 0.0, 0.0
    return low, high


def _float_of(word: object) -> float:
    """Return the float whose bits a header states in hexadecimal, 0.0 for anything else."""
    bits = int(word, 16) if isinstance(word, str) and re.fullmatch("0x[0-9a-fA-F]{1,8}", word) else word
    if not isinstance(bits, int) or not 0 <= bits < 1 << 32:
        return 0.0
    value = float(struct.unpack("<f", struct.pack("<I", bits))[0])
    return value if np.isfinite(value) else 0.0
