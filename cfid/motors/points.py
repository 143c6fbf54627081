"""Steady points of one motor from any instrument: per motor and marker, joined over runs, as a table, or in pairs."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from cfid.errors import FitError
from cfid.estimate.polynomials import fit_polynomial
from cfid.units import RPM

Array = npt.NDArray[np.float64]

_STD_OF = {"thrust_n": "thrust_std_n", "torque_nm": "torque_std_nm", "speed_rad_s": "speed_std_rad_s"}
_SHARED_OF = {"thrust_n": "thrust_shared_n", "torque_nm": "torque_shared_nm"}
_LEAST_STD = 0.1  # of the median


@dataclass(frozen=True, kw_only=True)
class MotorPoints:
    """One motor's values at commands (n,), one point per steady window; each column (n,) has its uncertainty.

    A column that was not measured is None; a missing value within a column is nan. `thrust_shared_n` and
    `torque_shared_nm` (n, m) are the parts of the uncertainties that points have in common, with one column per cause.
    """

    command: Array
    thrust_n: Array | None = None
    torque_nm: Array | None = None
    speed_rad_s: Array | None = None
    thrust_std_n: Array | None = None
    torque_std_nm: Array | None = None
    speed_std_rad_s: Array | None = None
    thrust_shared_n: Array | None = None
    torque_shared_nm: Array | None = None


class TableRow(NamedTuple):
    """One command's row of `motor.table`: means over `windows` steady windows, None for what was not measured there."""

    cmd: float
    thrust_n: float | None
    torque_nm: float | None
    speed_rad_s: float | None
    windows: int


class Errors(NamedTuple):
    """Standard uncertainty of each point (n,), and the parts that points have in common (n, m); None where unknown."""

    std: Array | None
    shared: Array | None


class PairedPoints(NamedTuple):
    """Points (n,) that have both values, y over x, with standard uncertainties and their shared parts, where known.

    `windows` (n, N) is how much each of all N windows contributes to each point, in units of the window's uncertainty.
    Over the windows that measured either quantity, each of its rows has length one.
    """

    command: Array
    x: Array
    y: Array
    windows: Array
    x_errors: Errors = Errors(None, None)
    y_errors: Errors = Errors(None, None)

    def kept(self, rows: npt.NDArray[np.bool_]) -> "PairedPoints":
        """Return the points that `rows` (n,) selects."""
        x_errors, y_errors = (Errors(*(None if part is None else part[rows] for part in errors)) for errors in self[4:])
        return PairedPoints(self.command[rows], self.x[rows], self.y[rows], self.windows[rows], x_errors, y_errors)

    def total_errors(self, *, order: int) -> Errors:
        """Return the errors of y, with those of x times the slope added; None where those of y are unknown."""
        y_std, x_std = weighable(self.y_errors.std), weighable(self.x_errors.std)
        if y_std is None or x_std is None:
            return Errors(y_std, None if y_std is None else self.y_errors.shared)
        slope = fit_polynomial(self.x, self.y, order=order, std=y_std).slope_at(self.x)
        parts = [self.y_errors.shared, _times(slope, self.x_errors.shared)]
        shared = [part for part in parts if part is not None]
        return Errors(np.hypot(y_std, slope * x_std), np.hstack(shared) if shared else None)


def rotor_speed_rad_s(shown_rpm: npt.ArrayLike, *, markers: npt.ArrayLike) -> Array:
    """Return a rotor's speed in rad/s from the rpm of a tachometer that counts each marker (eq. 3.2: two markers)."""
    return np.asarray(np.asarray(shown_rpm, dtype=np.float64) * (RPM / np.asarray(markers)))


def per_motor(points: MotorPoints, *, motors: int) -> MotorPoints:
    """Divide thrust and torque, with their uncertainties, by the number of motors that ran (section 3.3.1: two)."""
    divided = (*_SHARED_OF, "thrust_std_n", "torque_std_nm", *_SHARED_OF.values())
    there = {name: value for name in divided if (value := getattr(points, name)) is not None}
    return replace(points, **{name: value / motors for name, value in there.items()})


def joined(*sets: MotorPoints) -> MotorPoints:
    """Concatenate the points of several runs, with nan where a run did not measure what another did."""
    columns = {}
    for name in (*_STD_OF, *_STD_OF.values()):
        parts = [getattr(points, name) for points in sets]
        if any(part is not None for part in parts):
            blank = [np.full(len(points.command), np.nan) for points in sets]
            columns[name] = np.concatenate([b if p is None else p for p, b in zip(parts, blank, strict=True)])
    for name in _SHARED_OF.values():
        if any(getattr(points, name) is not None for points in sets):
            columns[name] = block_diag(*(_shared(points, name) for points in sets))  # runs have no tare in common
    return MotorPoints(command=np.concatenate([points.command for points in sets]), **columns)


def command_means(points: MotorPoints) -> MotorPoints:
    """Return one point per command, in ascending order: the mean over its windows, and its standard uncertainty."""
    commands = np.unique(points.command)
    at_command = commands[:, np.newaxis] == points.command
    columns = {}
    for name, std_name in _STD_OF.items():
        value: Array | None = getattr(points, name)
        std: Array | None = getattr(points, std_name)
        if value is not None:
            there = at_command & np.isfinite(value)
            with np.errstate(invalid="ignore"):
                share = there / there.sum(axis=1, keepdims=True)  # nan where a command has no value
            columns[name] = share @ np.nan_to_num(value)
            if std is not None:
                columns[std_name] = np.sqrt(share**2 @ np.nan_to_num(std) ** 2)
            if name in _SHARED_OF and getattr(points, _SHARED_OF[name]) is not None:
                columns[_SHARED_OF[name]] = share @ getattr(points, _SHARED_OF[name])
    return MotorPoints(command=commands, **columns)


def motor_table(points: MotorPoints) -> tuple[TableRow, ...]:
    """Return the table of everything measured, one row per command."""
    means = command_means(points)
    windows = np.unique(points.command, return_counts=True)[1]
    columns = [_or_none(getattr(means, name), len(windows)) for name in _STD_OF]
    rows = zip(means.command.tolist(), *columns, windows.tolist(), strict=True)
    return tuple(TableRow(*row) for row in rows)


def measured(points: MotorPoints, name: str, *, over: str = "command") -> PairedPoints:
    """Return the points that have both quantities or, where no single point has both, the means at each command.

    Raises FitError when either quantity was not measured, or when they were never measured at the same command.
    """
    single, of_command = np.eye(len(points.command)), _windows_of_commands(points, name, over)
    for source, windows in ((points, single), (command_means(points), of_command)):
        x, y = getattr(source, over), getattr(source, name)
        missing = [column for column, value in ((over, x), (name, y)) if value is None]
        if missing:
            raise FitError(
                f"no known column of {' or '.join(missing)}: it was not measured, or its column has another name."
            )
        both = np.isfinite(x) & np.isfinite(y)
        if both.any():
            found = PairedPoints(source.command, x, y, windows, _errors(source, over), _errors(source, name))
            return found.kept(both)
    if not np.isfinite(points.command).any():
        raise FitError(
            f"no row has a command: {name} over {over} cannot be given. Name the column of commands by `columns`, as "
            "in cmd=1 (0 to 65535), pwm_percent=1 or command_fraction=1 (0 to 1); thrust over speed needs none "
            "(`cfid fit speed`)."
        )
    raise FitError(f"no command has both {over} and {name}: they were measured at different ones.")


def _windows_of_commands(points: MotorPoints, *names: str) -> Array:
    """Return how much each window contributes to each command's means (commands, N), summed over the quantities."""
    total = np.zeros((len(np.unique(points.command)), len(points.command)))
    for name in names:
        value: Array | None = getattr(points, name)
        if value is not None:
            there = (np.unique(points.command)[:, np.newaxis] == points.command) & np.isfinite(value)
            total += there / np.sqrt(np.maximum(there.sum(axis=1, keepdims=True), 1))
    return total


def weighable(std: Array | None) -> Array | None:
    """Return standard uncertainties (n,) for use as weights: None where none is known, the usual one in place of nan.

    A window without scatter (a motor at rest, a steady display) must not get an infinite weight, so no standard
    uncertainty is smaller than a tenth of the usual one.
    """
    if std is None or not np.any(std > 0):
        return None
    usual = float(np.median(std[std > 0]))
    return np.maximum(np.where(np.isfinite(std), std, usual), _LEAST_STD * usual)


def _errors(points: MotorPoints, name: str) -> Errors:
    return Errors(*(getattr(points, of[name]) if name in of else None for of in (_STD_OF, _SHARED_OF)))


def _shared(points: MotorPoints, name: str) -> Array:
    """Return the parts (n, m) that points have in common; m is 0 where none are known."""
    found: Array | None = getattr(points, name)
    return np.empty((len(points.command), 0)) if found is None else found


def _times(slope: Array, shared: Array | None) -> Array | None:
    return None if shared is None else slope[:, np.newaxis] * shared


def _or_none(values: Array | None, count: int) -> list[float | None]:
    if values is None:
        return [None] * count
    return [value if math.isfinite(value) else None for value in values.tolist()]
