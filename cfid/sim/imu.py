"""Simulates the vehicle's gyro and accelerometer while its body turns about an axis, sample by sample."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from cfid.records.rig_file import Positive, RigTable, Spread, Vector
from cfid.sim.stepping import Array

_WORD = 1 << 15  # steps to either side of zero

Turning = Callable[[float], tuple[float, float, float]]  # angle, speed and acceleration at a time


class ImuTruth(RigTable):
    """A BMI088 as in a Crazyflie 2.1: 16 bits over its range, noise as a standard deviation of one sample.

    `gyro_scale` and `acc_scale` are relative errors of x, y, z; `misalignment_deg` turns the sensor in the body.
    """

    gyro_noise_dps: Spread = 0.07
    gyro_bias_dps: Vector = (0.3, -0.2, 0.3)
    gyro_scale: Vector = (0.0, 0.0, 0.0)
    gyro_range_dps: Positive = 2000.0
    acc_noise_g: Spread = 0.003
    acc_bias_g: Vector = (0.01, -0.01, 0.015)
    acc_scale: Vector = (0.0, 0.0, 0.0)
    acc_range_g: Positive = 16.0
    misalignment_deg: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Hanging:
    """How a body hangs: the axis' unit vector (3,), the unit vector pointing down at rest, and the sensor's position.

    All are in the body frame; `down` is along the axis where that is vertical, `sensor_m` is from the axis.
    """

    axis: Array
    down: Array
    sensor_m: Array
    gravity_mps2: float


class ImuSample(NamedTuple):
    """What both sensors show, as the firmware logs it: deg/s and g."""

    gyro_dps: tuple[float, float, float]
    acc_g: tuple[float, float, float]


class Imu:
    """The sensors of a hanging body. Reading the same time twice returns the same sample."""

    def __init__(self, truth: ImuTruth, hanging: Hanging, turning: Turning, rng: np.random.Generator) -> None:
        """Take how the body hangs and turns."""
        self._turning, self._rng = turning, rng
        axis, sensor_m, g = hanging.axis, hanging.sensor_m, hanging.gravity_mps2
        to_sensor = Rotation.from_rotvec(truth.misalignment_deg, degrees=True).apply(np.eye(3))  # rows: its axes
        along = (hanging.down @ axis) * axis
        lever = np.cross(axis, sensor_m)
        # per angular acceleration, square of speed, cosine and sine of the angle
        felt = np.stack([lever / g, np.cross(axis, lever) / g, along - hanging.down, np.cross(axis, hanging.down)])
        acc_gain, gyro_gain = 1 + np.array(truth.acc_scale), 1 + np.array(truth.gyro_scale)
        self._of_motion = np.zeros((6, 5))  # gyro and accelerometer, per speed and per those four
        self._of_motion[:3, 0] = gyro_gain * (to_sensor @ axis)
        self._of_motion[3:, 1:] = acc_gain[:, np.newaxis] * (to_sensor @ felt.T)
        self._at_rest = np.array([*truth.gyro_bias_dps, *(np.array(truth.acc_bias_g) - acc_gain * (to_sensor @ along))])
        self._noise = np.repeat([truth.gyro_noise_dps, truth.acc_noise_g], 3)
        self._steps = np.repeat([truth.gyro_range_dps / _WORD, truth.acc_range_g / _WORD], 3).tolist()
        self._last: tuple[float, ImuSample] | None = None

    def at(self, time_s: float) -> ImuSample:
        """Return the sample of a time."""
        if self._last is None or self._last[0] != time_s:
            self._last = time_s, self._sampled(*self._turning(time_s))
        return self._last[1]

    def _sampled(self, angle_rad: float, speed_rad_per_s: float, acceleration: float) -> ImuSample:
        motion = np.array([
            math.degrees(speed_rad_per_s), acceleration, speed_rad_per_s**2, math.cos(angle_rad), math.sin(angle_rad)
        ])  # fmt: skip
        shown = self._of_motion @ motion + self._at_rest + self._noise * self._rng.standard_normal(6)
        x, y, z, a, b, c = map(_word, shown.tolist(), self._steps)
        return ImuSample((x, y, z), (a, b, c))


def _word(value: float, step: float) -> float:
    """Return a value rounded to the steps of 16 bits, and clipped at their ends."""
    return min(max(round(value / step), -_WORD), _WORD - 1) * step
