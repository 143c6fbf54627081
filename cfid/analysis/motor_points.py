"""Steady points of one motor, whatever measured them: divided by motors and markers, joined, as a table, in pairs."""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.analysis.polynomials import fit_polynomial
from cfid.errors import FitError

Array = npt.NDArray[np.float64]

DEAD_COMMAND = 1000  # up to here a motor stands (thesis, section 3.3.2)
FULL_COMMAND = 65535

_STD_OF = {"thrust_n": "thrust_std_n", "torque_nm": "torque_std_nm", "speed_rad_s": "speed_std_rad_s"}
_LEAST_STD = 0.1  # of the median


@dataclass(frozen=True, kw_only=True)
class MotorPoints:
    """What one motor gave at commands (n,), a point a steady window, each column (n,) with one deviation.

    A column that nobody measured is None, a value that is missing within a column is nan.
    """

    command: Array
    thrust_n: Array | None = None
    torque_nm: Array | None = None
    speed_rad_s: Array | None = None
    thrust_std_n: Array | None = None
    torque_std_nm: Array | None = None
    speed_std_rad_s: Array | None = None


class TableRow(NamedTuple):
    """One command's row of `motor.table`: means over `windows` steady windows, None what was not measured there."""

    cmd: float
    thrust_n: float | None
    torque_nm: float | None
    speed_rad_s: float | None
    windows: int


class Measured(NamedTuple):
    """Points (n,) that have both values, y over x, with one deviation of each where it is known."""

    command: Array
    x: Array
    y: Array
    x_std: Array | None
    y_std: Array | None

    def kept(self, rows: npt.NDArray[np.bool_]) -> "Measured":
        """Return some of the points, `rows` (n,)."""
        x_std, y_std = (None if std is None else std[rows] for std in (self.x_std, self.y_std))
        return Measured(self.command[rows], self.x[rows], self.y[rows], x_std, y_std)

    def total_std(self, *, order: int) -> Array | None:
        """Return the deviations (n,) of y with what those of x amount to on the slope, None where y's are unknown."""
        y_std, x_std = weighable(self.y_std), weighable(self.x_std)
        if y_std is None or x_std is None:
            return y_std
        slope = fit_polynomial(self.x, self.y, order=order, std=y_std).slope_at(self.x)
        return np.hypot(y_std, slope * x_std)


def rotor_speed_rad_s(shown_rpm: npt.ArrayLike, *, markers: int) -> Array:
    """Return the rotor's speed of a tachometer's turns a minute, which counts each marker (eq. 3.2: two)."""
    return np.asarray(np.asarray(shown_rpm, dtype=np.float64) * (2 * math.pi / 60 / markers))


def per_motor(points: MotorPoints, *, motors: int) -> MotorPoints:
    """Divide thrust and torque, with their deviations, by how many motors ran together (section 3.3.1: two)."""
    shared = ("thrust_n", "thrust_std_n", "torque_nm", "torque_std_nm")
    there = {name: value for name in shared if (value := getattr(points, name)) is not None}
    return replace(points, **{name: value / motors for name, value in there.items()})


def joined(*sets: MotorPoints) -> MotorPoints:
    """Put the points of several runs one after another, nan where a run did not measure what another did."""
    columns = {}
    for name in (*_STD_OF, *_STD_OF.values()):
        parts = [getattr(points, name) for points in sets]
        if any(part is not None for part in parts):
            blank = [np.full(len(points.command), np.nan) for points in sets]
            columns[name] = np.concatenate([b if p is None else p for p, b in zip(parts, blank, strict=True)])
    return MotorPoints(command=np.concatenate([points.command for points in sets]), **columns)


def command_means(points: MotorPoints) -> MotorPoints:
    """Return one point a command, in rising order: the mean over its windows, and that mean's deviation."""
    commands, place = np.unique(points.command, return_inverse=True)
    columns = {}
    for name, std_name in _STD_OF.items():
        value: Array | None = getattr(points, name)
        std: Array | None = getattr(points, std_name)
        if value is not None:
            there = np.isfinite(value)
            count = np.bincount(place[there], minlength=len(commands))
            columns[name] = _over(np.bincount(place[there], value[there], len(commands)), count)
            if std is not None:
                squares = np.bincount(place[there], std[there] ** 2, len(commands))
                columns[std_name] = _over(np.sqrt(squares), count)
    return MotorPoints(command=commands, **columns)


def motor_table(points: MotorPoints) -> tuple[TableRow, ...]:
    """Return the cross table of everything measured, a row a command."""
    means = command_means(points)
    windows = np.unique(points.command, return_counts=True)[1]
    columns = [_or_none(getattr(means, name), len(windows)) for name in _STD_OF]
    rows = zip(means.command.tolist(), *columns, windows.tolist(), strict=True)
    return tuple(TableRow(*row) for row in rows)


def measured(points: MotorPoints, name: str, *, over: str = "command") -> Measured:
    """Take the points that have both quantities; where no single one has, command by command.

    Raises FitError when either was not measured, or never at the same command.
    """
    for source in (points, command_means(points)):
        x, y = getattr(source, over), getattr(source, name)
        missing = [column for column, value in ((over, x), (name, y)) if value is None]
        if missing:
            raise FitError(f"no column {' and no '.join(missing)}: it was not measured.")
        both = np.isfinite(x) & np.isfinite(y)
        if both.any():
            x_std = getattr(source, _STD_OF[over]) if over in _STD_OF else None
            return Measured(source.command, x, y, x_std, getattr(source, _STD_OF[name])).kept(both)
    raise FitError(f"no command has both {over} and {name}: they were measured at different ones.")


def weighable(std: Array | None) -> Array | None:
    """Return deviations (n,) that weights can be made of; None where none is known, the usual one where it is nan.

    A window without any scatter (the motor stands, a display does not flicker) is not certain without end: a tenth
    of the usual deviation is the least.
    """
    if std is None or not np.any(std > 0):
        return None
    usual = float(np.median(std[std > 0]))
    return np.maximum(np.where(np.isfinite(std), std, usual), _LEAST_STD * usual)


def _over(total: npt.NDArray[Any], count: npt.NDArray[np.intp]) -> Array:
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _or_none(values: Array | None, count: int) -> list[float | None]:
    if values is None:
        return [None] * count
    return [value if math.isfinite(value) else None for value in values.tolist()]
