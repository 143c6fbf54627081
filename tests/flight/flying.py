"""A quadrocopter that flies manoeuvres by its own autopilot, many at once: a plant that shares no code with the fit.

Rigid body, four rotors with two time constants that get their commands late, a battery that sags, wind as red noise of
force and torque, air that brakes velocity, climbing and turning, the low-pass filters of a Crazyflie's gyro and
accelerometer, and an autopilot that answers all of it: what a rotor is commanded depends on what the sensors showed.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.signal import butter

from cfid.records.logs.log import Channel, FlightLog, in_memory
from cfid.records.parameters import Source

Array = npt.NDArray[np.float64]

G = 9.81
STEP = 0.002
LATE_STEPS = 2  # between a command and the rotor's motion towards it
GYRO_HZ, ACCELEROMETER_HZ = 80.0, 30.0  # of second-order low-pass filters
GYRO_DELAY_S, ACCELEROMETER_DELAY_S = (STEP / 2**0.5 / np.tan(np.pi * hz * STEP) for hz in (GYRO_HZ, ACCELEROMETER_HZ))
PUSH_MPS2, PUSHED_M = 20.0, 1e-3  # of the ground at a touch, and how far off the middle it pushes
SAG = 0.04  # of the thrust, from a flight's begin to its end
# Motor 1 to 4: front right, rear right, rear left, front left; x forward, y left; 1 turns counterclockwise from above.
GUST = np.sqrt(2 * STEP / 0.1)  # of red noise with a variance of one, in a step
CLIMBING_COUNTS = np.array([1.0, 1.0, 1.2])  # of the air's braking, along each axis
DAMPED = np.array([1.5, 1.5, 0.5])  # of a rate, in 1/s
PUSHED_ABOUT = np.array([1, -1])
GRAVITY = np.array([0, 0, G])
HALF_MORE = 1.5 * np.eye(3)
X, Y, TURNS = np.array([1, -1, -1, 1.0]), np.array([-1, -1, 1, 1.0]), np.array([1, -1, 1, -1.0])


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """Vehicles (n,): each flight has one of its own. Moments are (n, 3); thrust is k (w0 + w1 u)^2 of a lagging u."""

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
    """Draw vehicles about a Crazyflie."""

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
) -> list[FlightLog]:
    """Return a log of each vehicle at 500 Hz; one that hovers has no manoeuvres.

    `size` and `noise` are shares of the usual manoeuvres and noise. `load_sag` is the share of its voltage that the
    battery loses under the thrust of hovering, 4 V being left, which the log has `with_volts`. Commands act
    `late_steps` later, the voltage at once. `inflow` is the share of thrust that a climb of 1 m/s along the rotors'
    axis takes. The ground pushes for 0.1 s from `touches_s` on, off the middle. The accelerometer
    is at `accelerometer_m` from the centre of mass, its filter at `accelerometer_hz`. A vehicle that `climbs_with_roll`
    does so at the same times.
    """
    count, steps, level = len(vehicles.mass), int(seconds / STEP), _level(vehicles)
    late = np.tile(level[:, None], (1, 4))
    rates, velocity = np.zeros((count, 3)), np.zeros((count, 3))
    turn = np.tile(np.eye(3), (count, 1, 1))
    torque_wind, force_wind, spinning = (np.zeros((count, 3)) for _ in range(3))
    bias = rng.normal(0, 0.01, (count, 3)), rng.normal(0, 0.05, (count, 3)) * [1, 1, 0.2]
    plan = _manoeuvres(count, steps, rng, climbs_with_roll=climbs_with_roll) * (0.02 if hover else size)
    sizes = 0.04 * noise, 0.5 * noise, wind * 4.0 * GUST, wind * 0.3 * GUST
    chance = rng.normal(0, 1, (steps, 4, count, 3)) * np.reshape(sizes, (4, 1, 1))
    rows = np.zeros((steps, count, 10 + 7 + with_volts))
    turns = np.zeros((steps, count, 3, 3))
    pending = [late.copy() for _ in range(late_steps)]
    gyro, accelerometer = _LowPass(GYRO_HZ, (count, 3)), _LowPass(accelerometer_hz, (count, 3))
    idle, gain, braking = vehicles.idle[:, None], vehicles.gain[:, None], vehicles.braking[:, None]
    rising, falling = (1 - np.exp(-STEP / tau[:, None]) for tau in (vehicles.rising, vehicles.falling))
    for step in range(steps):
        k = vehicles.k * (1 + SAG * (0.5 - step / steps))
        thrust = k * (idle + gain * late) ** 2
        up = turn[:, 2, :]  # the world's vertical along the vehicle's axes
        at = (np.einsum("nij,nj->ni", turn.transpose(0, 2, 1), velocity)) * CLIMBING_COUNTS
        taken = 1 - inflow * at[:, 2:] / 1.2  # of thrust, by air along the rotors' axis
        thrust *= taken
        force = force_wind - braking * at
        force[:, 2] += thrust.sum(axis=1) / vehicles.mass
        force[:, 2] += (push := _push(STEP * step, touches_s))
        shown = rows[step, :, 4:7] = gyro(rates + bias[0] + chance[step, 0])
        off_centre = _cross(spinning, accelerometer_m) + _cross(rates, _cross(rates, accelerometer_m))
        rows[step, :, 7:10] = accelerometer(force + off_centre + bias[1] + chance[step, 1])
        rows[step, :, 10:13] = velocity
        turns[step] = turn
        command = rows[step, :, :4] = _autopilot(vehicles, plan[step], shown, up, velocity[:, 2], level)
        pending.append(command)
        volts = 1 + load_sag * (1 - thrust.sum(axis=1) / (vehicles.mass * G))  # of those that hovering leaves
        if with_volts:
            rows[step, :, 17] = 4 * volts
        ahead = pending.pop(0) * volts[:, None] - late
        moved = ahead * np.where(ahead > 0, rising, falling)
        middle = taken * k * (idle + gain * (late + moved / 2)) ** 2
        turning = _torques(vehicles, middle, gain * moved / STEP)
        turning[:, :2] += (vehicles.mass * push * PUSHED_M)[:, None] * PUSHED_ABOUT
        turning += vehicles.moments * (torque_wind - DAMPED * rates)
        turning -= _cross(rates, vehicles.moments * rates)
        before, spinning = rates, turning / vehicles.moments
        rates = rates + spinning * STEP
        late = late + moved
        velocity = velocity + STEP * (np.einsum("nij,nj->ni", turn, force) - GRAVITY)
        turn = _turned(turn, (before + rates) / 2 * STEP)
        torque_wind += -torque_wind * STEP / 0.1 + chance[step, 2]
        force_wind += -force_wind * STEP / 0.1 + chance[step, 3]
    rows[:, :, 13:17] = _quaternion(turns)
    return [_log(rows[:, place], number=place) for place in range(count)]


def _torques(vehicles: Fleet, thrusts: Array, spun_up: Array) -> Array:
    """Return what rotors' thrusts and accelerations in rad/s^2, (n, 4) each, turn the vehicles by (n, 3)."""
    about = np.empty((len(thrusts), 3))
    about[:, 0] = vehicles.lever * (thrusts @ Y)
    about[:, 1] = -vehicles.lever * (thrusts @ X)
    about[:, 2] = -vehicles.torque * (thrusts @ TURNS) - 2e-8 * (spun_up @ TURNS)
    return about


def _cross(first: Array, second: npt.ArrayLike) -> Array:
    """Return cross products (n, 3) of vectors with others (n, 3), or with one (3,): of few, quicker than NumPy's."""
    a, b = first.T, np.asarray(second).T
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]).T


def _push(now_s: float, touches_s: tuple[float, ...]) -> float:
    """Return how much the ground pushes a vehicle up in m/s^2."""
    phases = (min(max(now_s - at_s, 0.0) / 0.1, 1.0) for at_s in touches_s)
    return sum(PUSH_MPS2 * max(float(np.sin(np.pi * phase)), 0.0) for phase in phases)


class _LowPass:
    """A second-order Butterworth filter of many channels, a step at a time; it starts settled."""

    def __init__(self, cut_off_hz: float, shape: tuple[int, ...]) -> None:
        self.b, self.a = butter(2, cut_off_hz, fs=1 / STEP)
        self.state: list[Array] = []
        self.shape = shape

    def __call__(self, now: Array) -> Array:
        b, a = self.b, self.a
        if not self.state:
            self.state = [now * (1 - b[0]), now * (b[2] - a[2])]
        out = b[0] * now + self.state[0]
        self.state = [b[1] * now - a[1] * out + self.state[1], b[2] * now - a[2] * out]
        return np.asarray(out)


def _level(vehicles: Fleet) -> Array:
    """Return the drives (n,) that carry the vehicles."""
    each = vehicles.mass * G / 4
    return np.asarray((np.sqrt(each / vehicles.k) - vehicles.idle) / vehicles.gain)


def _manoeuvres(count: int, steps: int, rng: np.random.Generator, *, climbs_with_roll: bool) -> Array:
    """Return targets (steps, n, 4): roll, pitch in rad, yaw rate in rad/s, vertical velocity in m/s, held a while."""
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
    plan[:, :, 3] -= plan[:, :, 3].mean(axis=0)  # what climbs comes down again
    return plan


def _autopilot(vehicles: Fleet, target: Array, rates: Array, up: Array, climb: Array, level: Array) -> Array:
    """Return the commands (n, 4), 0.1 to 0.98."""
    wanted = np.column_stack([8 * (target[:, 0] - up[:, 1]), 8 * (target[:, 1] + up[:, 0]), target[:, 2]])
    mix = (wanted - rates) * [0.02, 0.02, 0.06]
    total = level + 0.12 * (target[:, 3] - climb)
    each = total[:, None] + mix[:, :1] * Y - mix[:, 1:2] * X - mix[:, 2:] * TURNS
    return np.asarray(np.clip(each, 0.1, 0.98))


def _turned(turn: Array, angle: Array) -> Array:
    """Return attitudes (n, 3, 3) turned by small angles (n, 3) about the vehicle's axes, orthogonal to second order."""
    x, y, z = angle.T
    small = np.zeros((3, 3, len(angle)))
    small[2, 1], small[1, 2], small[0, 2], small[2, 0], small[1, 0], small[0, 1] = x, -x, y, -y, z, -z
    by = small.transpose(2, 0, 1)
    once = turn @ by
    turn = turn + once + once @ by / 2
    return np.asarray(turn @ (HALF_MORE - 0.5 * turn.transpose(0, 2, 1) @ turn))


def _quaternion(turn: Array) -> Array:
    """Return w, x, y, z (..., 4) of attitudes (..., 3, 3) that are never upside down."""
    w = np.sqrt(np.maximum(1 + np.trace(turn, axis1=-2, axis2=-1), 1e-9)) / 2
    x, y, z = (turn[..., a, b] - turn[..., b, a] for a, b in ((2, 1), (0, 2), (1, 0)))
    return np.stack([w, x / (4 * w), y / (4 * w), z / (4 * w)], axis=-1)


def _log(rows: Array, *, number: int) -> FlightLog:
    """Return rows (steps, 17), or with the voltage (steps, 18), as a log; before and after them the motors stand."""
    channels = [Channel(f"motor.m{motor}", "1") for motor in (1, 2, 3, 4)]
    channels += [Channel(f"gyro.{axis}", "rad/s") for axis in "xyz"] + [
        Channel(f"acc.{axis}", "m/s^2") for axis in "xyz"
    ]
    channels += [Channel(name, "m/s") for name in ("vx", "vy", "vz")] + [Channel(f"q{part}", "1") for part in "wxyz"]
    channels += [Channel("pm.vbat", "V")] * (rows.shape[1] - len(channels))
    values = rows.copy()
    values[:, :4] *= 65535
    time_s = np.asarray(STEP * np.arange(len(rows)), dtype=np.float64)
    path = Path(f"flight{number}.csv")
    return FlightLog(
        path=path,
        source=Source(str(path), f"{number:064x}"),
        program="simulated flight",
        clock="times are in s",
        series=(in_memory("log", time_s, channels, list(values.T)),),
    )
