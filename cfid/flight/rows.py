"""Represent a quadrocopter's flight as rows: its rotors' drives every 2 ms, and its sensors' values every 10 ms."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from cfid.recordings.crazyflie import Timed
from cfid.units import MOTOR_AZIMUTH_DEG, MOTORS, ROTOR_TURNS

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

ROW_S = 0.01  # between rows of the sensors: motion is far below 50 Hz
ROW_STEPS = 5
STEP_S = ROW_S / ROW_STEPS  # of drives: a Crazyflie's commands change every 2 ms at most
AXES = ("roll", "pitch", "yaw")
_INSTANT_S = 1e-4
LEVER = 0.5**0.5  # the lever about x or y relative to the arm

# The signs with which thrusts turn the vehicle about x and y, and their reaction torques about z; (3, 4).
TURNING = np.array(
    [
        [np.sign(np.sin(np.radians(MOTOR_AZIMUTH_DEG[motor]))) for motor in MOTORS],
        [-np.sign(np.cos(np.radians(MOTOR_AZIMUTH_DEG[motor]))) for motor in MOTORS],
        [-ROTOR_TURNS[motor] for motor in MOTORS],
    ]
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """Commands (n, 4) relative to full command, `ROW_STEPS` to a row, and what sensors showed every 10 ms from then on.

    `rates` (m, 3) in rad/s and `force` (m, 3), the specific force in m/s^2, are along the vehicle's axes, as is
    `velocity` (m, 3) in m/s, None where unknown. `attitude` (m, 4) is the quaternion w, x, y, z that turns these axes
    to the world's. `volts` (n,) is the battery's voltage, None where it is unknown or not used. `speeds` (k, 4) are
    the rotors' in rad/s, at times since the first command, None where unknown; with them, commands may have no
    rows. `averaged` is true where rows are means over their 10 ms. `airborne` (m,) marks rows in the air; `driven`
    (m,) marks those among them at which every rotor has been under a command within its range for a while. `beyond`
    (m,) marks rows at which the gyro was at an end of its range. With `props_out`, rotors turn the other way than a
    Crazyflie's: front right clockwise, seen from above. `low_pass_hz` are the cut-offs of the Butterworth filters
    of accelerometer and gyro, None where unknown, `ages_s` are the times by which their readings may be older than
    the rows that show them, and `held_s` is the time for which commands are repeated.
    """

    name: str
    command: Array
    rates: Array
    force: Array
    airborne: Mask
    driven: Mask
    beyond: Mask
    averaged: bool
    low_pass_hz: tuple[float | None, float | None] = (None, None)
    ages_s: tuple[float, float] = (0.0, 0.0)
    held_s: float = 0.0
    velocity: Array | None = None
    attitude: Array | None = None
    volts: Array | None = None
    speeds: Timed | None = None
    props_out: bool = False

    @cached_property
    def drive(self) -> Array:
        """The drives (n, 4): commands, times the battery's volts where these are known."""
        return self.drives_of_late(0.0)

    @property
    def in_volts(self) -> bool:
        """Whether drives are in volts."""
        return self.volts is not None

    @property
    def turning(self) -> Array:
        """The signs (3, 4) with which thrusts turn the vehicle about x and y, and their reaction torques about z."""
        return TURNING * [[1.0], [1.0], [-1.0 if self.props_out else 1.0]]

    @property
    def time_s(self) -> Array:
        """The times (m,) of the sensors' rows since the first drive."""
        return np.asarray(ROW_S * np.arange(len(self.rates)), dtype=np.float64)

    @property
    def rescaled(self) -> bool:
        """Whether a Crazyflie's firmware, whose filters are known, divided accelerations by their size at rest."""
        return self.low_pass_hz[0] is not None

    @property
    def row_drives(self) -> Array:
        """The drives (m, 4) at the sensors' rows."""
        return self.drive[::ROW_STEPS][: len(self.rates)]

    @cached_property
    def _turned(self) -> CubicSpline:
        """The integral of the speeds over time."""
        assert self.speeds is not None
        return CubicSpline(*self.speeds).antiderivative()

    def row_speeds(self, delay_s: float) -> Array:
        """Return the speeds (m, 4) at the sensors' rows, of rotors that are logged later than the sensors by a time."""
        half_s = ROW_S / 2 if self.averaged else _INSTANT_S
        low, high = self.time_s + delay_s - half_s, self.time_s + delay_s + half_s
        return np.asarray((self._turned(high) - self._turned(low)) / (2 * half_s))

    @property
    def rates_known(self) -> Mask:
        """The driven rows (m,) at which the gyro was within its range."""
        return self.driven & ~self.beyond

    def drives_of_late(self, command_s: float) -> Array:
        """Return the drives (n, 4) of commands that act later by this time, at the voltage of the moment they act."""
        late = delayed(self.command, command_s) if command_s else self.command
        return late if self.volts is None else np.asarray(late * self.volts[:, np.newaxis])

    @property
    def step_driven(self) -> Mask:
        """Whether each drive (n,) belongs to a driven row."""
        return np.repeat(self.driven, ROW_STEPS)[: len(self.drive) or None]


def delayed(late: Array, delay_s: float) -> Array:
    """Return the drives (n, 4) delayed by this time, interpolated between steps."""
    whole = math.floor(delay_s / STEP_S)
    share = delay_s / STEP_S - whole
    padded = with_ends(late, max(whole, 0) + 1, max(-whole, 0))
    begin = max(-whole, 0)
    newer, older = padded[begin + 1 : begin + 1 + len(late)], padded[begin : begin + len(late)]
    return np.asarray((1 - share) * newer + share * older)


def with_ends(values: Array, before: int, after: int) -> Array:
    """Return values (n, k) with the first repeated `before` times and the last `after` times; NumPy's `pad` is slow."""
    return np.concatenate([*before * [values[:1]], values, *after * [values[-1:]]])


def turned_back(attitude: Array, vector: Array) -> Array:
    """Return vectors (m, 3), given in the world's axes, along the axes of a vehicle with attitude w, x, y, z (m, 4)."""
    return np.asarray(Rotation.from_quat(attitude, scalar_first=True).apply(vector, inverse=True))


def segments(mask: Mask, fewest: int = 100) -> list[slice]:
    """Return the runs of marked rows that have at least `fewest` rows."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= fewest]
