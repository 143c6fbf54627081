"""Read the blackbox logs of Betaflight and its relatives with orangebox: a series for every log of the file.

Motors, their speeds, the acceleration along z and the battery's voltage get the names, numbers and units of a Crazyflie
in addition to their own.
"""

import logging
import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from cfid.errors import DataError
from cfid.large import empty, joined, parts
from cfid.records.extras import optional_library
from cfid.records.logs.blackbox_bytes import LogBytes, logs_in
from cfid.records.logs.crazyflie_names import crazyflie_channel
from cfid.records.logs.log import BLOCK_ROWS, Array, Channel, FlightLog, Series, in_memory, printable
from cfid.records.logs.motor_numbers import BETAFLIGHT_QUAD_X, not_four, numbering
from cfid.records.logs.spin import by_mixer
from cfid.records.parameters import Source

BEGIN = b"H Product:Blackbox"

_TIME, _LOOP = "time", "loopIteration"
_WHOLE = "I"  # frames with full numbers; other frames have differences from earlier ones
_LONGEST_US, _LONGEST_LOOPS = 10_000_000, 5000  # between two frames, as in Betaflight's viewer
_GYRO = re.compile(r"gyro(?:ADC|Unfilt)\[\d\]")
_FINE, _FINE_STEP = "blackbox_high_resolution", 0.1  # a header of Betaflight 4.3 and later, and the step that it sets
_ALSO_FINE = {"1": re.compile(r"rcCommand\[\d\]"), "deg/s": re.compile(r"setpoint\[[0-2]\]")}
_ABOUT_YAW = re.compile(r"axis[PIDF]\[2\]")
_MOTOR, _MOST = re.compile(r"motor\[[0-3]\]"), 1.01  # relative to full throttle
_VOLTS = "vbatLatest"
_BETAFLIGHT = re.compile(r"Betaflight (\d+)\.(\d+)")
# By the firmware's voltage.h: 0.1 V from 3.1 on, 0.01 V from 4.0 on. Older ones log the converter's counts.
_VOLT_STEPS = (((4, 0), 0.01), ((3, 1), 0.1))
_PLAIN = re.compile(r"(?:motor|eRPM|debug|rcCommand)\[\d\]|loopIteration")


def read_blackbox(path: Path, source: Source) -> FlightLog:
    """Read a blackbox file.

    Raises ConfigError without orangebox, DataError for a file that it cannot read, or that has no frame or time.
    """
    orangebox = optional_library("orangebox", extra="blackbox", what="a blackbox log")
    logging.getLogger("orangebox").addHandler(logging.NullHandler())  # it reports headers that it does not need
    series: list[Series] = []
    notes: list[str] = []
    program, logs = "", list(logs_in(path))
    for number, place in enumerate(logs, start=1):
        try:
            parser = orangebox.Parser(LogBytes(orangebox, *place))
        except Exception as fault:  # a damaged file may make it raise anything
            raise DataError(
                f"{path}: not readable as a blackbox log: orangebox cannot read the header of log {number} of "
                f"{len(logs)} ({type(fault).__name__}). Copy it from the flight controller again."
            ) from None
        if _TIME not in parser.field_names:
            raise DataError(f"{path}: log {number} of {len(logs)} is a blackbox log without a field '{_TIME}'.")
        program = program or printable(str(parser.headers.get("Firmware revision", "unknown firmware")))
        frames, fault_name, lost = _frames(parser)
        if lost:
            many = "frame does" if lost == 1 else "frames do"
            notes.append(f"log {number} of {len(logs)}: {lost} {many} not follow from those before: left out.")
        if fault_name:
            notes.append(
                f"log {number} of {len(logs)} has a frame that cannot be read; {len(frames)} before it are used."
            )
        if wrong := _impossible(parser, frames):
            notes.append(
                f"log {number} of {len(logs)}: {wrong} outputs of motors are beyond full throttle, which damaged bytes "
                "alone show: left out of control.m1 to control.m4."
            )
        if len(frames):
            series.append(_series(f"log{number}", parser, frames))
    if not series:
        raise DataError(f"{path}: a blackbox file without a whole frame.")
    return FlightLog(
        path=path,
        source=source,
        program=f"blackbox log of {program}",
        clock="times are the flight controller's, since it started",
        series=tuple(series),
        assumed=_assumed(series),
        notes=(*notes, *not_four(max(sum(map(_is_motor, one.names)) for one in series), "motor")),
    )


def _assumed(series: Sequence[Series]) -> tuple[str, ...]:
    if not any("control.m1" in one.names for one in series):
        return ()
    longest = max(series, key=lambda one: one.rows)
    return (numbering(BETAFLIGHT_QUAD_X, "motor[{}]", why="as in Betaflight's quad X"), *_turning(longest))


def _turning(series: Series) -> tuple[str, ...]:
    """Return a sentence on which way rotors turn, judged by the wanted torque about yaw and the motors' outputs.

    Betaflight's headers do not state its `yaw_motors_reversed`, which changes the sign between the two.
    """
    wanted = [series.column(1 + series.place_of(name)) for name in series.names if _ABOUT_YAW.fullmatch(name)]
    outputs = {motor: f"control.m{motor}" for motor in BETAFLIGHT_QUAD_X}
    if not wanted or not set(outputs.values()) <= set(series.names):
        return ()
    return by_mixer(np.sum(wanted, axis=0), {motor: series.values(name) for motor, name in outputs.items()})


def _frames(parser: Any) -> tuple[Array, str, int]:
    """Return the frames (n, fields), NaN where a field has no value yet, what cut them short, and how many were lost.

    Where the time or the loop count goes back or jumps, bytes are damaged. The search for a frame then resumes one byte
    later, which orangebox does not do by itself, and frames are lost up to the next whole one.
    """
    fault_name, width, lost, broken = "", len(parser.field_names), 0, False
    counted = [parser.field_names.index(name) for name in (_TIME, _LOOP) if name in parser.field_names]
    most, last = (_LONGEST_US, _LONGEST_LOOPS)[: len(counted)], None

    def rows() -> Iterator[list[float]]:
        nonlocal fault_name, lost, broken, last
        looked_at = parser.reader.tell()
        try:
            for frame in parser.frames():
                if len(frame.data) != width:
                    continue
                now = [frame.data[place] for place in counted]
                follows = last is None or all(0 <= b - a <= c for a, b, c in zip(last, now, most, strict=True))
                broken = not follows or (broken and frame.type.value != _WHOLE)
                if not follows:
                    parser.reader.seek(looked_at + 1)
                looked_at = parser.reader.tell()
                if broken:
                    lost += 1
                else:
                    last = now
                    yield [np.nan if value == "" else float(value) for value in frame.data]
        except Exception as fault:  # as above
            fault_name = type(fault).__name__

    rest = rows()
    blocks = iter(lambda: list(islice(rest, BLOCK_ROWS)), [])
    found = joined(chain([np.zeros((0, width))], (np.array(block) for block in blocks)))
    return found, fault_name, lost


def _series(name: str, parser: Any, frames: Array) -> Series:
    names, headers = [str(name) for name in parser.field_names], parser.headers
    place = names.index(_TIME)
    channels = [_channel(each, headers) for each in names if each != _TIME]
    values = [frames[:, at] for at in range(len(names)) if at != place]
    for channel, value in _as_a_crazyflie_s(dict(zip(names, frames.T, strict=True)), headers):
        channels.append(crazyflie_channel(channel))
        values.append(value)
    return in_memory(name, _by_parts(frames[:, place], lambda one: one / 1e6), channels, values)


def _is_motor(name: str) -> bool:
    return name.startswith("motor[")


def _as_a_crazyflie_s(fields: Mapping[str, Array], headers: Any) -> Iterator[tuple[str, Array]]:
    """Yield the channels that a Crazyflie also has, under its names and in its units."""
    low, high = _range(headers.get("motorOutput"))
    poles = headers.get("motor_poles")
    for place, motor in enumerate(BETAFLIGHT_QUAD_X):
        own, speed = f"motor[{place}]", f"eRPM[{place}]"
        if own in fields and low < high:
            yield f"control.m{motor}", _by_parts(fields[own], partial(_share, low=low, high=high))
        if speed in fields and isinstance(poles, int) and poles >= 2:
            yield f"rpm.m{motor}", _by_parts(fields[speed], lambda one: one * 100 / (poles / 2))
    one_g = headers.get("acc_1G")
    if "accSmooth[2]" in fields and isinstance(one_g, int) and one_g > 0:
        yield "acc.z", _by_parts(fields["accSmooth[2]"], lambda one: one / one_g)
    if _VOLTS in fields and (step_v := _volt_step(headers)):
        yield "pm.vbat", _by_parts(fields[_VOLTS], lambda one: one * step_v)


def _volt_step(headers: Any) -> float:
    """Return the step of the battery's voltage in V by the firmware's version, 0.0 where that does not show it."""
    stated = _BETAFLIGHT.match(str(headers.get("Firmware revision")))
    version = (int(stated[1]), int(stated[2])) if stated else (0, 0)
    return next((step_v for since, step_v in _VOLT_STEPS if version >= since), 0.0)


def _share(output: Array, *, low: float, high: float) -> Array:
    """Return outputs (n,) as shares of full throttle, NaN where they are impossible."""
    share = np.clip((output - low) / (high - low), 0, None)
    return np.where(share > _MOST, np.nan, share)


def _by_parts(values: Array, convert: Callable[[Array], Array]) -> Array:
    """Return values (n,) converted part by part, since they may be larger than the memory."""
    found = empty(len(values))
    for part in parts(len(values)):
        found[part] = convert(values[part])
    return found


def _impossible(parser: Any, frames: Array) -> int:
    """Return how many outputs of motors are beyond full throttle, which only damaged bytes show."""
    low, high = _range(parser.headers.get("motorOutput"))
    own = [at for at, name in enumerate(parser.field_names) if _MOTOR.fullmatch(str(name))]
    if low >= high:
        return 0
    most = low + _MOST * (high - low)
    return sum(int(np.count_nonzero(frames[part, at] > most)) for part in parts(len(frames)) for at in own)


def _range(header: object) -> tuple[float, float]:
    """Return the motor output at standstill and at full throttle, zeros where the header does not state both."""
    numbers = header if isinstance(header, list | tuple) else str(header).split(",")
    try:
        low, high = (float(number) for number in numbers)
    except ValueError:
        return 0.0, 0.0
    return low, high


def _channel(name: str, headers: Any) -> Channel:
    step = _FINE_STEP if headers.get(_FINE) == 1 else 1.0
    if _GYRO.fullmatch(name) and (scale := _float_of(headers.get("gyro_scale"))):
        return Channel(name, "deg/s", step * scale)
    if _FINE in headers and (unit := next((each for each, one in _ALSO_FINE.items() if one.fullmatch(name)), "")):
        return Channel(name, unit, step)
    if name.startswith("accSmooth") and isinstance(one_g := headers.get("acc_1G"), int) and one_g > 0:
        return Channel(name, "g", 1 / one_g)
    if name == _VOLTS and (step_v := _volt_step(headers)):
        return Channel(name, "V", step_v)
    return Channel(printable(name), "1" if _PLAIN.fullmatch(name) else "")


def _float_of(word: object) -> float:
    """Return the float whose bits a header states in hexadecimal, 0.0 for anything else."""
    bits = int(word, 16) if isinstance(word, str) and re.fullmatch("0x[0-9a-fA-F]{1,8}", word) else word
    if not isinstance(bits, int) or not 0 <= bits < 1 << 32:
        return 0.0
    value = float(struct.unpack("<f", struct.pack("<I", bits))[0])
    return value if np.isfinite(value) else 0.0
