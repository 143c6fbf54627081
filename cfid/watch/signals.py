"""Defines the signals of a run's devices: which columns are drawn together, and in which unit, from raw rows."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import groupby
from typing import Literal

import numpy as np
import numpy.typing as npt

from cfid.recordings.crazyflie import crazyflie_unit
from cfid.recordings.recording import ENCODER
from cfid.recordings.sines import CROSSINGS
from cfid.recordings.vehicle import COMMANDS, READINGS, SUPERVISOR, VEHICLE_LOG
from cfid.recordings.wrench import AXES, LOADCELL, USUAL_COUNTS
from cfid.records.run import DeviceRecord
from cfid.watch.extremes import Extremes
from cfid.wire.rls import STEPS_PER_TURN, turns_of

Array = npt.NDArray[np.float64]
Convert = Callable[[Array], Array]

_START_S = 0.3  # motors are off for at least this long at the start of every recording with motors

_NO_VALUES = {"t", "vehicle_ms", "vehicle_us", "device_us", "sample", "report", "status", "stable", "withdrawn"}
_UNITS = {"rpm": "rpm", "rtt_s": "s", "grams": "g"}
_TITLES = {
    "pm": "battery",
    "motor": "motors, as the vehicle logs them",
    "rtt_s": "round trip",
    "rpm": "speed",
    "grams": "weight on the scales",
    "thrust_rec": "command, as the vehicle reports it",
}


@dataclass(kw_only=True)
class Trace:
    """Curves drawn together: `convert` makes their values (n, c) from a device's rows (n, columns).

    Curves in `steps` hold their value until the next row; `marks` show single rows, between which no line may be.
    """

    title: str
    unit: str
    names: tuple[str, ...]
    convert: Convert
    style: Literal["line", "steps", "marks"] = "line"
    extremes: Extremes = field(init=False)

    def __post_init__(self) -> None:
        """Start without a sample."""
        self.extremes = Extremes(len(self.names))


def signals_of(device: str, record: DeviceRecord, *, rests: bool) -> list[Trace]:
    """Return the signals of a device of any kind: an unknown column is drawn in its own unit.

    A load cell that `rests` at first, unloaded, is drawn without its bias.
    """
    if device == ENCODER and "phi" in record.columns:
        return [Trace(title="angle", unit="degrees", names=("angle",), convert=_angle(record))]
    if device == LOADCELL and set(AXES) <= set(record.columns):
        return [_of_cell(record, AXES[:3], rests=rests), _of_cell(record, AXES[3:], rests=rests)]
    if device == SUPERVISOR:  # its states are words, not values to draw
        return []
    return list(_groups(device, record))


def _of_cell(record: DeviceRecord, axes: tuple[str, ...], *, rests: bool) -> Trace:
    facts = record.model_extra or {}
    title, unit, scale = ("forces", "mN", "counts_per_n") if axes[0] == "Fx" else ("torques", "mN m", "counts_per_nm")
    per_unit = 1.0 if facts.get("units") == "n,nm" else float(facts.get(scale) or USUAL_COUNTS)
    convert = _picked(record, axes, 1e3 / per_unit)
    if rests:
        title, convert = f"{title}, less those of the first {_START_S:g} s", _since_start(convert)
    return Trace(title=title, unit=unit, names=axes, convert=convert)


def _groups(device: str, record: DeviceRecord) -> Iterator[Trace]:
    """Yield a signal for each group of a vehicle's variables (`gyro.x`, `gyro.y`), else one for all columns."""
    labels = {"command"} if device == READINGS else set()  # which a reading belongs to
    names = [name for name in record.columns if name not in _NO_VALUES | labels]
    if device == VEHICLE_LOG:
        groups = [(group, tuple(members)) for group, members in groupby(names, lambda name: name.partition(".")[0])]
    else:
        groups = [(names[0] if len(names) == 1 else device, tuple(names))] if names else []
    for group, members in groups:
        unit = _UNITS.get(group) or crazyflie_unit(members[0])
        yield Trace(
            title=_TITLES.get(group, group),
            unit="" if unit == "1" else unit,
            names=members,
            convert=_picked(record, members, 1.0),
            style="steps" if device in (COMMANDS, CROSSINGS) else "marks" if device == READINGS else "line",
        )


def _picked(record: DeviceRecord, names: tuple[str, ...], factor: float) -> Convert:
    places = [record.columns.index(name) for name in names]
    return lambda rows: factor * rows[:, places]


def _since_start(convert: Convert) -> Convert:
    """Return values less their mean over the first moment: a load cell's bias would hide what changes."""
    until_s, total, count = math.nan, np.zeros(1), np.zeros(1)

    def converted(rows: Array) -> Array:
        nonlocal until_s, total, count
        values = convert(rows)
        if math.isnan(until_s):
            until_s = float(rows[0, 0]) + _START_S
        early = values[rows[:, 0] < until_s]
        total = total + np.nansum(early, axis=0)
        count = count + np.isfinite(early).sum(axis=0)
        return np.asarray(values - total / np.maximum(count, 1.0))

    return converted


def _angle(record: DeviceRecord) -> Convert:
    """Return counts as a continuous angle in degrees; words that fail their check are left out."""
    in_radians = (record.model_extra or {}).get("angle_unit") == "rad"
    per_turn = math.tau if in_radians else record.counts_per_turn or STEPS_PER_TURN
    place, before = record.columns.index("phi"), np.empty(0)

    def converted(rows: Array) -> Array:
        nonlocal before
        turns, valid = turns_of(rows[:, place], per_turn)
        good = np.unwrap(np.concatenate([before, turns[valid]]), period=1.0)[len(before) :]
        before = good[-1:] if len(good) else before
        degrees = np.full((len(turns), 1), np.nan)
        degrees[valid, 0] = 360 * good
        return degrees

    return converted
