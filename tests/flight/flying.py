"""Quadrocopters that fly manoeuvres under their own autopilots: a plant that shares no code with the fit.

It has a rigid body, four rotors with two time constants and delayed commands, a battery that sags, wind as red noise of
force and torque, air that brakes velocity, climb and rotation, the low-pass filters of a Crazyflie's gyro and
accelerometer, and an autopilot in closed loop: the commands of the rotors depend on what the sensors showed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.signal import butter

from cfid.recordings.recording import Recording
from cfid.sim.app_core import compiled
from tests.recordings.made import made_log, made_series

Array = npt.NDArray[np.float64]

G = 9.81
STEP = 0.002
LATE_STEPS = 2  # between a command and the rotor's first response
GYRO_HZ, ACCELEROMETER_HZ = 80.0, 30.0  # of second-order low-pass filters
GYRO_DELAY_S, ACCELEROMETER_DELAY_S = (STEP / 2**0.5 / np.tan(np.pi * hz * STEP) for hz in (GYRO_HZ, ACCELEROMETER_HZ))
PUSH_MPS2, PUSHED_M = 20.0, 1e-3  # of the ground at a touch, and how far off the centre it acts
SAG = 0.04  # share of the thrust, from the start of a flight to its end
GUST_S = 0.1  # time constant of the red noise
GUST = np.sqrt(2 * STEP / GUST_S)  # change in a step, of red noise with a variance of one


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """Vehicles (n,), one per flight. Moments are (n, 3); thrust is k (w0 + w1 u)^2 of a lagging u."""

    mass: Array
    lever: Array
    torque: Array
    moments: Array
    idle: Array
    gain: Array
    rising: Array
    falling: Array
    braking: Array
    k: float = 1.8e-8


def fleet(count: int, rng: np.random.Generator) -> Fleet:
    """Draw vehicles that scatter about a Crazyflie."""

    def about(value: float | list[float], spread: float = 0.1) -> Array:
        shape = (count, len(value)) if isinstance(value, list) else count
        return np.asarray(np.array(value) * rng.uniform(1 - spread, 1 + spread, shape))

    return Fleet(
        mass=about(0.030),
        lever=about(0.0325, 0.03),
        torque=about(0.006),
        moments=about([1.4e-5, 1.5e-5, 2.2e-5]),
        idle=about(400.0),
        gain=about(2600.0, 0.05),
        rising=about(0.06),
        falling=about(0.08),
        braking=about(0.4),
    )


def fly(
    vehicles: Fleet,
    rng: np.random.Generator,
    *,
    seconds: float = 14.0,
    hover: bool = False,
    size: float = 1.0,
    wind: float = 1.0,
    noise: float = 1.0,
    load_sag: float = 0.0,
    inflow: float = 0.0,
    late_steps: int = LATE_STEPS,
    with_volts: bool = False,
    touches_s: tuple[float, ...] = (),
    accelerometer_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    accelerometer_hz: float = ACCELEROMETER_HZ,
    climbs_with_roll: bool = False,
) -> list[Recording]:
    """Return a log of each vehicle at 500 Hz; with `hover`, the vehicles fly hardly any manoeuvres.

    `size` and `noise` are shares of the usual manoeuvres and noise. `load_sag` is the share of its voltage that the
    battery loses under the thrust of hovering, where 4 V remain; the log contains the voltage if `with_volts`. Commands
    act `late_steps` later, the voltage at once. `inflow` is the share of thrust that is lost to a climb of 1 m/s along
    the rotors' axis. The ground pushes off the centre for 0.1 s from each of `touches_s` on. The accelerometer is at
    `accelerometer_m` from the centre of mass, and its filter at `accelerometer_hz`. With `climbs_with_roll`, a vehicle
    climbs at the times at which it rolls.
    """
    count, steps, level = len(vehicles.mass), int(seconds / STEP), _level(vehicles)
    bias = rng.normal(0, 0.01, (count, 3)), rng.normal(0, 0.05, (count, 3)) * [1, 1, 0.2]
    plan = _manoeuvres(count, steps, rng, climbs_with_roll=climbs_with_roll) * (0.02 if hover else size)
    sizes = 0.04 * noise, 0.5 * noise, wind * 4.0 * GUST, wind * 0.3 * GUST
    chance = rng.normal(0, 1, (steps, 4, count, 3)) * np.reshape(sizes, (4, 1, 1))
    pushes = np.array([_push(STEP * step, touches_s) for step in range(steps)], dtype=np.float64)
    filters = _low_pass(GYRO_HZ), _low_pass(accelerometer_hz)
    rising, falling = (1 - np.exp(-STEP / tau) for tau in (vehicles.rising, vehicles.falling))
    logs = []
    for i in range(count):
        rows, turns = np.zeros((steps, 18)), np.zeros((steps, 3, 3))
        vehicle = (vehicles.mass, vehicles.lever, vehicles.torque, vehicles.moments, vehicles.idle, vehicles.gain)
        lagging = (rising, falling, vehicles.braking)
        _compiled()(
            _numbers(*(one[i] for one in (*vehicle, *lagging)), vehicles.k, level[i]),
            _numbers(
                *(STEP, SAG, load_sag, inflow, GUST_S, PUSHED_M, bias[0][i], bias[1][i], accelerometer_m, *filters),
                *(steps, late_steps),
            ),
            *(np.ascontiguousarray(one) for one in (plan[:, i], chance[:, :, i], pushes)),
            rows,
            turns,
        )
        rows[:, 13:17] = _quaternion(turns)
        logs.append(_log(rows if with_volts else rows[:, :17], number=i))
    return logs


@cache
def _compiled() -> Callable[..., None]:
    """Return the function that flies one vehicle; its steps in C take a hundredth of the time of steps in NumPy."""
    step_by_step = compiled(Path(__file__).with_suffix(".c")).fly
    step_by_step.argtypes = [np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")] * 7
    step_by_step.restype = None
    return step_by_step


def _numbers(*values: npt.ArrayLike) -> Array:
    """Return numbers (n,) in the order of a structure of the C code."""
    return np.concatenate([np.ravel(value) for value in values]).astype(np.float64)


def _push(now_s: float, touches_s: tuple[float, ...]) -> float:
    """Return the upward push of the ground on a vehicle in m/s^2."""
    phases = (min(max(now_s - at_s, 0.0) / 0.1, 1.0) for at_s in touches_s)
    return sum(PUSH_MPS2 * max(float(np.sin(np.pi * phase)), 0.0) for phase in phases)


def _low_pass(cut_off_hz: float) -> Array:
    """Return the coefficients (2, 3) of a second-order Butterworth filter."""
    return np.array(butter(2, cut_off_hz, fs=1 / STEP))


def _level(vehicles: Fleet) -> Array:
    """Return the drives (n,) at which the vehicles hover."""
    each = vehicles.mass * G / 4
    return np.asarray((np.sqrt(each / vehicles.k) - vehicles.idle) / vehicles.gain)


def _manoeuvres(count: int, steps: int, rng: np.random.Generator, *, climbs_with_roll: bool) -> Array:
    """Return held targets (steps, n, 4): roll and pitch in rad, yaw rate in rad/s, vertical velocity in m/s."""
    plan = np.zeros((steps, count, 4))
    for place in range(count):
        for kind, (size, least, most) in enumerate(
            ((0.5, 0.2, 0.6), (0.5, 0.2, 0.6), (6.0, 0.3, 0.8), (2.0, 0.3, 0.9))
        ):
            step = 0
            while step < steps:
                until = step + int(rng.uniform(least, most) / STEP)
                plan[step:until, place, kind] = size * rng.uniform(-1, 1)
                step = until
    if climbs_with_roll:
        plan[:, :, 3] = 4 * plan[:, :, 0]
    plan[:, :, 3] -= plan[:, :, 3].mean(axis=0)  # climbs and descents balance
    return plan


def _quaternion(turn: Array) -> Array:
    """Return w, x, y, z (..., 4) of attitudes (..., 3, 3) that are never upside down."""
    w = np.sqrt(np.maximum(1 + np.trace(turn, axis1=-2, axis2=-1), 1e-9)) / 2
    x, y, z = (turn[..., a, b] - turn[..., b, a] for a, b in ((2, 1), (0, 2), (1, 0)))
    return np.stack([w, x / (4 * w), y / (4 * w), z / (4 * w)], axis=-1)


def _log(rows: Array, *, number: int) -> Recording:
    """Return rows (steps, 17), or (steps, 18) with the voltage, as a log."""
    columns = [(f"motor.m{motor}", "1") for motor in (1, 2, 3, 4)]
    columns += [*((f"gyro.{axis}", "rad/s") for axis in "xyz"), *((f"acc.{axis}", "m/s^2") for axis in "xyz")]
    columns += [*((name, "m/s") for name in ("vx", "vy", "vz")), *((f"q{part}", "1") for part in "wxyz")]
    columns += [("pm.vbat", "V")] * (rows.shape[1] - len(columns))
    values = rows.copy()
    values[:, :4] *= 65535
    series = made_series("log", np.asarray(STEP * np.arange(len(rows)), dtype=np.float64), columns, list(values.T))
    return made_log(series, path=Path(f"flight{number}.csv"), number=number)
