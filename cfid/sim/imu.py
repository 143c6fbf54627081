"""Simulates the vehicle's gyro and accelerometer while its body turns about an axis, sample by sample."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict

from cfid.records.facts import Positive, Spread
from cfid.records.mounts import Vector
from cfid.sim.stepping import Array

_WORD = 1 << 15  # steps to either side of zero

Turning = Callable[[float], tuple[float, float, float]]  # angle, speed and acceleration at a time


class ImuTruth(BaseModel):
    """A BMI088 as in a Crazyflie 2.1: 16 bits over its range, noise as a standard deviation of one sample.

    `gyro_scale` and `acc_scale` are relative errors about x, y, z; `misalignment_deg` turns the sensor in the body.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

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
    """How a body hangs: the axis' unit vector (3,), the unit vector that points down at rest, and sensor from axis.

    All are in the body frame; `down` is along the axis where that is vertical.
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
    """The sensors of a hanging body. A time that is read twice shows the same sample."""

    def __init__(self, truth: ImuTruth, hanging: Hanging, turning: Turning, rng: np.random.Generator) -> None:
        """Take how the body hangs and turns."""
        self._truth, self._turning, self._rng = truth, turning, rng
        axis, sensor_m = hanging.axis, hanging.sensor_m
        self._gravity_mps2 = hanging.gravity_mps2
        to_sensor = turned(np.eye(3), np.radians(truth.misalignment_deg))  # rows: the sensor's axes
        along = (hanging.down @ axis) * axis
        lever = np.cross(axis, sensor_m)
        rows = (axis, lever, np.cross(axis, lever), along, hanging.down - along, np.cross(axis, hanging.down))
        self._axis, self._lever, self._inward, self._along, self._across, self._aside = (to_sensor @ r for r in rows)
        self._gains = 1 + np.array(truth.gyro_scale), 1 + np.array(truth.acc_scale)
        self._last: tuple[float, ImuSample] | None = None

    def at(self, time_s: float) -> ImuSample:
        """Return the sample of a time."""
        if self._last is None or self._last[0] != time_s:
            self._last = time_s, self._sampled(*self._turning(time_s))
        return self._last[1]

    def _sampled(self, angle_rad: float, speed_rad_per_s: float, acceleration: float) -> ImuSample:
        truth, (gyro_gain, acc_gain) = self._truth, self._gains
        down = self._along + math.cos(angle_rad) * self._across - math.sin(angle_rad) * self._aside
        felt = (acceleration * self._lever + speed_rad_per_s**2 * self._inward) / self._gravity_mps2 - down
        noise = self._rng.standard_normal(6)
        gyro = math.degrees(speed_rad_per_s) * self._axis * gyro_gain + truth.gyro_bias_dps
        acc = felt * acc_gain + truth.acc_bias_g
        return ImuSample(
            _words(gyro + truth.gyro_noise_dps * noise[:3], truth.gyro_range_dps),
            _words(acc + truth.acc_noise_g * noise[3:], truth.acc_range_g),
        )


def _words(values: Array, largest: float) -> tuple[float, float, float]:
    """Return values (3,) in steps of 16 bits over the range, at whose ends they stay."""
    step = largest / _WORD
    x, y, z = (np.clip(np.round(values / step), -_WORD, _WORD - 1) * step).tolist()
    return x, y, z


def turned(vectors: Array, by_rad: Array) -> Array:
    """Turn vectors (3,) or the rows of (n, 3) by a rotation vector (3,), by the formula of Rodrigues."""
    angle = float(np.linalg.norm(by_rad))
    if angle == 0:
        return vectors
    unit = by_rad / angle
    along = (vectors @ unit)[..., None] * unit
    across = vectors - along
    return np.asarray(along + math.cos(angle) * across + math.sin(angle) * np.cross(unit, vectors))
