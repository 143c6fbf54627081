"""Steady points of one motor as a frame: one row for each steady window of any instrument.

Columns: `command`; `thrust_n`, `torque_nm` and `speed_rad_s` of one motor, each with its standard uncertainty;
`motors`, how many ran together; `vbat_v`; and the parts of the uncertainties that points share, one column for each
tare. A column that is absent was not measured, and a missing value is nan.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import pandas as pd

from cfid.errors import FitError
from cfid.estimate.polynomials import fit_polynomial
from cfid.estimate.staircase import FZ, Point
from cfid.units import ROTOR_TURNS, RPM

Array = npt.NDArray[np.float64]
Points: TypeAlias = pd.DataFrame

STD_OF = {"thrust_n": "thrust_std_n", "torque_nm": "torque_std_nm", "speed_rad_s": "speed_std_rad_s"}
TZ = 5

_LEAST_STD = 0.1  # of the median
_OF_STEPS = ("mean", "std_of_mean", "tare_shares")


def frame(
    command: npt.ArrayLike,
    *,
    thrust_shared_n: Array | None = None,
    torque_shared_nm: Array | None = None,
    source: str = "",
    **columns: npt.ArrayLike | None,
) -> Points:
    """Return points at commands (n,), with the `columns` (n,) that were measured.

    `thrust_shared_n` and `torque_shared_nm` (n, m) are the parts of the uncertainties that points of a `source` share,
    with one column for each cause.
    """
    measured = {name: value for name, value in columns.items() if value is not None}
    points = [pd.DataFrame({"command": np.asarray(command, dtype=np.float64), **measured})]
    for name, shared in (("thrust_n", thrust_shared_n), ("torque_nm", torque_shared_nm)):
        if shared is not None:
            tares = [f"{_tare(name)}{at} of {source}" for at in range(shared.shape[1])]
            points.append(pd.DataFrame(shared, columns=tares))
    return pd.concat(points, axis=1)


def joined(*parts: Points) -> Points:
    """Concatenate the points of several sources, with nan where one did not measure what another did."""
    return pd.concat([part for part in parts if len(part)] or parts[:1], ignore_index=True)


def column(points: Points, name: str) -> Array | None:
    """Return a column (n,), None where it was not measured."""
    return points[name].to_numpy(dtype=np.float64) if name in points else None


def shared(points: Points, name: str) -> Array:
    """Return the parts (n, m) of a column's uncertainties that points have in common."""
    tares = [tare for tare in points.columns if tare.startswith(_tare(name))]
    return np.asarray(np.nan_to_num(points[tares].to_numpy(dtype=np.float64)))


def _tare(name: str) -> str:
    return f"{name} by tare "


def points_of(
    steps: Sequence[Point], *, motors: int | None = None, thrust: int = FZ, torque: int = TZ, source: str = ""
) -> Points:
    """Return one motor's points from settled steps; `motors` is how many ran where the steps do not state which.

    Thrust is divided by the number of motors that ran, torque by how many more of these turn one way than the other;
    torque is nan where equally many turn each way. A channel that is absent or nan was not measured.
    """
    ran = np.array([float(len(step.motors) or motors or 1) for step in steps])
    turning = np.array(
        [abs(sum(ROTOR_TURNS[motor] for motor in step.motors)) if step.motors else motors or 1 for step in steps]
    )
    mean, std, tares = (np.array([getattr(step, name) for step in steps]) for name in _OF_STEPS)
    measured: dict[str, Any] = {}
    if np.isfinite(mean[:, thrust]).any():
        measured |= {"thrust_n": mean[:, thrust] / ran, "thrust_std_n": std[:, thrust] / ran}
        measured["thrust_shared_n"] = tares[:, :, thrust] / ran[:, np.newaxis]
    if torque < mean.shape[1] and np.isfinite(mean[:, torque]).any():
        alike = np.where(turning == 0, np.nan, turning)
        measured |= {"torque_nm": mean[:, torque] / alike, "torque_std_nm": std[:, torque] / alike}
        measured["torque_shared_nm"] = tares[:, :, torque] / alike[:, np.newaxis]
    return frame([float(step.command or 0) for step in steps], motors=ran, source=source, **measured)


def rotor_speed_rad_s(shown_rpm: npt.ArrayLike, *, markers: npt.ArrayLike) -> Array:
    """Return a rotor's speed in rad/s from the rpm of a tachometer that counts each marker (eq. 3.2: two markers)."""
    return np.asarray(np.asarray(shown_rpm, dtype=np.float64) * (RPM / np.asarray(markers)))


def command_means(points: Points) -> Points:
    """Return one point per command, in ascending order: the mean over its windows, and its standard uncertainty."""
    command = points["command"]
    means = {}
    for name, std_name in STD_OF.items():
        if name not in points:
            continue
        measured = points[name].notna()
        windows = measured.groupby(command).sum()
        means[name] = points[name].groupby(command).mean()
        if std_name in points:
            squares = points[std_name].where(measured) ** 2
            means[std_name] = np.sqrt(squares.groupby(command).sum()) / windows
        for tare in [tare for tare in points.columns if tare.startswith(_tare(name))]:
            means[tare] = points[tare].where(measured, 0.0).groupby(command).sum() / windows
    return pd.DataFrame(means, index=pd.Index(np.unique(command.dropna()), name="command")).reset_index()


def motor_table(points: Points) -> list[dict[str, Any]]:
    """Return the table of everything measured, one row per command; None for what was not measured there."""
    means = command_means(points)
    windows = points.groupby("command").size().tolist()
    columns = {
        name: [None if np.isnan(value) else float(value) for value in means[name]]
        if name in means
        else [None] * len(means)
        for name in STD_OF
    }
    rows = zip(means["command"].tolist(), *columns.values(), windows, strict=True)
    return [dict(zip(("cmd", *columns, "windows"), row, strict=True)) for row in rows]


class Pairs(NamedTuple):
    """Points (n,) that have both values: `y_name` over `x_name`.

    `windows` (n, N) is how much each of all N windows contributes to each point, in units of the window's uncertainty.
    Over the windows that measured either quantity, each of its rows has length one.
    """

    points: Points
    x_name: str
    y_name: str
    windows: Array

    @property
    def command(self) -> Array:
        """The commands (n,)."""
        return np.asarray(self.points["command"], dtype=np.float64)

    @property
    def x(self) -> Array:
        """The values (n,) on the first axis."""
        return np.asarray(self.points[self.x_name], dtype=np.float64)

    @property
    def y(self) -> Array:
        """The values (n,) on the second axis."""
        return np.asarray(self.points[self.y_name], dtype=np.float64)

    def kept(self, rows: npt.NDArray[np.bool_]) -> "Pairs":
        """Return the points that `rows` (n,) selects."""
        return self._replace(points=self.points[rows], windows=self.windows[rows])

    def errors(self, *, order: int) -> tuple[Array | None, Array | None]:
        """Return standard uncertainties (n,) of y, with those of x times the slope, and the shared parts (n, m).

        Both are None where those of y are unknown.
        """
        y_std, x_std = (
            weighable(column(self.points, STD_OF[name])) if name in STD_OF else None
            for name in (self.y_name, self.x_name)
        )
        if y_std is None:
            return None, None
        parts = shared(self.points, self.y_name)
        if x_std is None:
            return y_std, parts
        slope = fit_polynomial(self.x, self.y, order=order, std=y_std).slope_at(self.x)
        return np.hypot(y_std, slope * x_std), np.hstack([parts, slope[:, None] * shared(self.points, self.x_name)])


def measured(points: Points, name: str, *, over: str = "command") -> Pairs:
    """Return the points that have both quantities or, where no single point has both, the means at each command.

    Raises FitError when either quantity was not measured, or when they were never measured at the same command.
    """
    if missing := [wanted for wanted in (over, name) if wanted not in points]:
        raise FitError(
            f"no known column of {' or '.join(missing)}: it was not measured, or its column has another name."
        )
    single = Pairs(points, over, name, np.eye(len(points)))
    both = np.isfinite(single.x) & np.isfinite(single.y)
    if both.any():
        return single.kept(both)
    means = Pairs(command_means(points), over, name, _windows_of_commands(points, name, over))
    both = np.isfinite(means.x) & np.isfinite(means.y)
    if both.any():
        return means.kept(both)
    if points["command"].isna().all():
        raise FitError(
            f"no row has a command: {name} over {over} cannot be given. Name the column of commands by `columns`, as "
            "in cmd=1 (0 to 65535), pwm_percent=1 or command_fraction=1 (0 to 1); thrust over speed needs none "
            "(`cfid fit speed`)."
        )
    raise FitError(f"no command has both {over} and {name}: they were measured at different ones.")


def _windows_of_commands(points: Points, *names: str) -> Array:
    """Return how much each window contributes to each command's means (commands, N), summed over the quantities."""
    command = points["command"].to_numpy()
    at_command = np.unique(command[np.isfinite(command)])[:, np.newaxis] == command
    total = np.zeros(at_command.shape)
    for name in names:
        of_name = at_command & points[name].notna().to_numpy()
        total += of_name / np.sqrt(np.maximum(of_name.sum(axis=1, keepdims=True), 1))
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
