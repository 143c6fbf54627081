"""A gyro's readings of simulated swings, processed as those of a run."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.recordings.gyro import SCALE_STD, about_one_axis, integrated
from cfid.sim.imu import Hanging, Imu, ImuTruth
from cfid.sim.plants import Motion
from cfid.swing.pendulum import NO_THREADS, Threads
from cfid.swing.window import FreeSwing, find_swing

Array = npt.NDArray[np.float64]
Axis = Sequence[float] | Array

X = (1.0, 0.0, 0.0)


def gyro_of(
    motion: Motion, i: int, *, rate_hz: float, truth: ImuTruth, rng: np.random.Generator, axis: Axis = X
) -> tuple[Array, Array]:
    """Return a gyro's times (n,) and rates (n, 3) in rad/s for one body of a motion with steps of 1 ms or less."""
    every = round(1 / rate_hz / (motion.time_s[1] - motion.time_s[0]))
    time_s, speed = motion.time_s[::every], motion.speed_rad_per_s[::every, i]
    hanging = Hanging(axis=np.array(axis), down=np.array([0.0, 0.0, -1.0]), sensor_m=np.zeros(3), gravity_mps2=9.81)
    moving = iter(speed.tolist())
    imu = Imu(truth, hanging, lambda _: (0.0, next(moving), 0.0), rng)
    return time_s, np.radians([imu.at(float(at)).gyro_dps for at in time_s])


def gyro_swing(time_s: Array, rates_rad_per_s: Array, threads: Threads = NO_THREADS) -> FreeSwing:
    """Return the swing that a gyro's rates (n, 3) show."""
    found = about_one_axis(rates_rad_per_s)
    angle, bias = integrated(time_s, found.rate_rad_per_s)
    swing = find_swing(time_s, angle)
    rate = found.rate_rad_per_s - bias
    return replace(swing, rate_rad_per_s=rate, rate_scale_std=SCALE_STD, threads=threads)


def usual_gyro(rng: np.random.Generator) -> ImuTruth:
    """Return a gyro with a random bias, and with scale errors that its data sheet allows."""
    x, y, z = rng.normal(0, SCALE_STD, 3).tolist()
    bias = rng.uniform(-1, 1, 3).tolist()
    return ImuTruth(gyro_scale=(x, y, z), gyro_bias_dps=(bias[0], bias[1], bias[2]))
