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
    count, steps = len(vehicles.mass), int(seconds / STEP)
    level = _level(vehicles)
    late = np.tile(level[:, None], (1, 4))
    rates, velocity = np.zeros((count, 3)), np.zeros((count, 3))
    turn = np.tile(np.eye(3), (count, 1, 1))
    torque_wind, force_wind = np.zeros((count, 3)), np.zeros((count, 3))
    bias = rng.normal(0, 0.01, (count, 3)), rng.normal(0, 0.05, (count, 3)) * [1, 1, 0.2]
    plan = _manoeuvres(count, steps, rng, climbs_with_roll=climbs_with_roll) * (0.02 if hover else size)
    spinning = np.zeros((count, 3))
    rows = np.zeros((steps, count, 10 + 7 + with_volts))
    pending = [late.copy() for _ in range(late_steps)]
    gyro, accelerometer = _LowPass(GYRO_HZ, (count, 3)), _LowPass(accelerometer_hz, (count, 3))
    for step in range(steps):
        k = vehicles.k * (1 + SAG * (0.5 - step / steps))
        thrust = k * (vehicles.idle[:, None] + vehicles.gain[:, None] * late) ** 2
        up = turn[:, 2, :]  # the world's vertical along the vehicle's axes
        at = (np.einsum("nij,nj->ni", turn.transpose(0, 2, 1), velocity)) * [1.0, 1.0, 1.2]
        taken = 1 - inflow * at[:, 2:] / 1.2  # of thrust, by air along the rotors' axis
        thrust *= taken
        force = force_wind - vehicles.braking[:, None] * at
        force[:, 2] += thrust.sum(axis=1) / vehicles.mass
        force[:, 2] += (push := _push(STEP * step, touches_s))
        shown = gyro(rates + bias[0] + rng.normal(0, 0.04 * noise, (count, 3)))
        rows[step, :, 4:7] = shown
        off_centre = np.cross(spinning, accelerometer_m) + np.cross(rates, np.cross(rates, accelerometer_m))
        rows[step, :, 7:10] = accelerometer(force + off_centre + bias[1] + rng.normal(0, 0.5 * noise, (count, 3)))
        rows[step, :, 10:13] = velocity
        rows[step, :, 13:17] = _quaternion(turn)
        command = _autopilot(vehicles, plan[step], shown, up, velocity[:, 2], level)
        rows[step, :, :4] = command
        pending.append(command)
        volts = 1 + load_sag * (1 - thrust.sum(axis=1) / (vehicles.mass * G))  # of those that hovering leaves
        if with_volts:
            rows[step, :, 17] = 4 * volts
        ahead = pending.pop(0) * volts[:, None] - late
        tau = np.where(ahead > 0, vehicles.rising[:, None], vehicles.falling[:, None])
        moved = ahead * (1 - np.exp(-STEP / tau))
        middle = taken * k * (vehicles.idle[:, None] + vehicles.gain[:, None] * (late + moved / 2)) ** 2
        spun_up = vehicles.gain[:, None] * moved / STEP  # rad/s^2
        turning = np.column_stack(
            [
                vehicles.lever * (middle @ Y),
                -vehicles.lever * (middle @ X),
                -vehicles.torque * (middle @ TURNS) - 2e-8 * (spun_up @ TURNS),
            ]
        )
        turning[:, :2] += (vehicles.mass * push * PUSHED_M)[:, None] * [1, -1]
        turning += vehicles.moments * (torque_wind - [1.5, 1.5, 0.5] * rates)
        turning -= np.cross(rates, vehicles.moments * rates)
        before, spinning = rates, turning / vehicles.moments
        rates = rates + spinning * STEP
        late = late + moved
        velocity = velocity + STEP * (np.einsum("nij,nj->ni", turn, force) - [0, 0, G])
        turn = _turned(turn, (before + rates) / 2 * STEP)
        torque_wind += -torque_wind * STEP / 0.1 + wind * 4.0 * np.sqrt(2 * STEP / 0.1) * rng.normal(0, 1, (count, 3))
        force_wind += -force_wind * STEP / 0.1 + wind * 0.3 * np.sqrt(2 * STEP / 0.1) * rng.normal(0, 1, (count, 3))
    return [_log(rows[:, place], number=place) for place in range(count)]


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
    zero = np.zeros_like(x)
    small = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    turn = turn + turn @ small + turn @ small @ small / 2
    return np.asarray(turn @ (1.5 * np.eye(3) - 0.5 * turn.transpose(0, 2, 1) @ turn))


def _quaternion(turn: Array) -> Array:
    """Return w, x, y, z (n, 4) of attitudes that are never upside down."""
    w = np.sqrt(np.maximum(1 + np.trace(turn, axis1=1, axis2=2), 1e-9)) / 2
    x, y, z = turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]
    return np.column_stack([w, x / (4 * w), y / (4 * w), z / (4 * w)])


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
