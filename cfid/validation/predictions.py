"""Predict a flight from its commands, for every parameter set alike: its next row, or a whole segment.

Over a longer time, rates accumulate effects that no set contains, mainly of air, to which the autopilot responds:
commands then counteract it, and moments that are too large have smaller errors than the true ones. One row ahead, given
the errors before, what remains happened after the commands, and only the true set minimises it: by this condition, `fit
flight` finds moments (decision 22).

One integrator predicts segments. Each starts with the rates that the gyro showed; from there on, only commands count.
Thrust of one rotor is a polynomial of its lagging drive, or of its speed where log and set have that; rates follow J
dw/dt + w x (J w + h) + dh/dt = torques, where h is the rotors' angular momentum and a torque may be over the velocity
that the log shows, by the midpoint rule with steps of 2 ms. What a log or a set lacks of these is zero. A constant
angular acceleration about each axis, as an offset centre of mass causes, is estimated from the whole flight for every
set alike, because no set contains it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from cfid.flight.model import ThrustLag, turning_equation, whitening, without
from cfid.flight.rows import AXES, LEVER, ROW_S, ROW_STEPS, STEP_S, Flight, delayed, segments
from cfid.units import USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

_DELAYS_S = (-0.03, 0.05)  # below zero where telemetry of speeds is later than the gyro
_DELAY_TOLERANCE_S = 1e-4
HORIZONS = (1, 10, 30, 50, 100)  # rows: one step, and 0.1, 0.3, 0.5 and 1 s
QUANTITIES = ("rates", "attitude", "velocity")
UNITS = {"rates": "rad/s", "attitude": "deg", "velocity": "m/s"}


@dataclass(frozen=True, kw_only=True, eq=False)
class ParameterSet:
    """A vehicle's parameters along forward, left and up: everything that a prediction needs.

    `thrust_n` is one rotor's thrust, lowest power first, as a function of its command relative to full command, or of
    volts where `in_volts`; `thrust_speed_n` is the same of its speed in rad/s, None where unknown. `lag` is None where
    rotors follow at once, and `delay_s` is that of the flight's sensors and link. `drag_per_s` is drag over mass across
    the thrust, and `moment_per_velocity_ns` the moment about x over velocity along y, and about y over that along x;
    both are None where unknown. A `rotor_inertia_kg_m2` of zero is unknown.
    """

    name: str
    origin: str
    mass_kg: float
    moments_kg_m2: tuple[float, float, float]
    arm_m: float
    torque_m: float
    thrust_n: tuple[float, ...]
    in_volts: bool
    lag: ThrustLag | None = None
    delay_s: float = 0.0
    drag_per_s: tuple[float, float] | None = None
    thrust_speed_n: tuple[float, ...] | None = None
    rotor_inertia_kg_m2: float = 0.0
    moment_per_velocity_ns: tuple[float, float] | None = None

    @property
    def levers_m(self) -> tuple[float, float, float]:
        """A rotor's moment about each axis divided by its thrust."""
        return LEVER * self.arm_m, LEVER * self.arm_m, self.torque_m


def starts(flight: Flight) -> Rows:
    """Return the rows (s,) at which segments of a second start, one after the other where all rotors were driven.

    The gyro is within its range in each: rates beyond it are unknown.
    """
    last = max(HORIZONS)
    runs = [np.arange(one.start, one.stop - last, last) for one in segments(flight.rates_known, last + 1)]
    return np.concatenate([*runs, np.zeros(0, np.intp)]).astype(np.intp)


def next_rate_errors(flight: Flight, parameters: ParameterSet, axes: Sequence[str], *, parts: int) -> Array:
    """Return the root mean square errors (parts,) of the rates' next row about some axes, in rad/s.

    The part that the errors of the 16 rows before predict is removed, and so are the effects of damping, gyroscopic
    torque and the like, which are fitted for every set. Parts are consecutive and of equal length.
    """
    levers = dict(zip(AXES, parameters.levers_m, strict=True))
    late, thrusts = late_drives(flight, parameters), thrusts_of(flight, parameters)
    squares = []
    for axis in axes:
        place = AXES.index(axis)
        block = turning_equation(flight, np.stack([thrusts, late, late**2]), place)
        error = block.shown - levers[axis] / parameters.moments_kg_m2[place] * block.terms[:, 0]
        white = whitening(block, without(error, block.others), fed_back=True)
        squares.append((ROW_S * white.size * white.of(error[:, np.newaxis])[:, 0]) ** 2)
    return np.array([np.sqrt(np.mean(part)) for part in np.array_split(np.sum(squares, axis=0), parts)])


def best_delay(flight: Flight, parameters: ParameterSet, axes: Sequence[str]) -> tuple[float, float]:
    """Return the least error of a set's next rates about some axes in rad/s, and the delay in s that it has it with."""

    def error(delay_s: float) -> float:
        late = replace(parameters, delay_s=float(delay_s))
        return float(next_rate_errors(flight, late, axes, parts=1)[0])

    best = minimize_scalar(error, bounds=_DELAYS_S, method="bounded", options={"xatol": _DELAY_TOLERANCE_S})
    return float(best.fun), float(best.x)


def errors(flight: Flight, parameters: ParameterSet, at: Rows) -> dict[str, Array]:
    """Return the error (s, h) of each quantity in each segment after each horizon, as lengths and angles.

    The attitude's error is the angle between the predicted rotation and that of the recorded rates. The velocity's
    error is that of the change of velocity: along the vehicle's vertical by the accelerometer, or with motion capture
    along all three axes.
    """
    thrusts = thrusts_of(flight, parameters)
    turning = thrusts @ flight.turning.T * parameters.levers_m  # (n, 3) in N m
    if parameters.moment_per_velocity_ns is not None and flight.velocity is not None:
        turning[:, :2] += np.repeat(parameters.moment_per_velocity_ns * flight.velocity[:, 1::-1], ROW_STEPS, axis=0)
    rates, turns = _rates(flight, parameters, turning, at)
    recorded = np.stack([flight.rates[at + count] for count in range(max(HORIZONS) + 1)], axis=1)
    real = _turned(recorded)
    ends = np.array(HORIZONS)
    apart = np.einsum("shji,shjk->shik", real[:, ends], turns[:, ends])
    cosine = (np.trace(apart, axis1=2, axis2=3) - 1) / 2
    return {
        "rates": np.linalg.norm(rates[:, ends] - recorded[:, ends], axis=2),
        "attitude": np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))),
        "velocity": _velocity_errors(flight, parameters, thrusts.sum(axis=1) / parameters.mass_kg, turns, at)[:, ends],
    }


def thrust_errors(flight: Flight, parameters: ParameterSet, at: Rows) -> Array:
    """Return the errors (s, h) of the change of velocity along the vehicle's vertical at a flight's mean thrust."""
    upright = replace(flight, velocity=None, attitude=None)
    at_once = replace(parameters, lag=None, delay_s=0.0)
    mean_n = float(np.mean(thrusts_of(flight, at_once)[flight.step_driven]))
    level = replace(at_once, thrust_n=(mean_n,), thrust_speed_n=at_once.thrust_speed_n and (mean_n,))
    return errors(upright, level, at)["velocity"]


def unchanged(flight: Flight, at: Rows) -> Array:
    """Return the mean change (h,) of rates within each horizon: the error of predicting no change."""
    return np.array(
        [float(np.mean(np.linalg.norm(flight.rates[at + rows] - flight.rates[at], axis=1))) for rows in HORIZONS]
    )


def speeds_of(flight: Flight, parameters: ParameterSet) -> Array | None:
    """Return the rotors' logged speeds (n, 4) in rad/s at each step, None where the log or the set has no use of them.

    The set has one if it knows the thrust over speed.
    """
    logged = flight.speeds
    if logged is None or parameters.thrust_speed_n is None:
        return None
    time_s = STEP_S * np.arange(ROW_STEPS * len(flight.rates))
    return np.stack([np.interp(time_s, logged.time_s, speed) for speed in logged.value.T], axis=1)


def late_drives(flight: Flight, parameters: ParameterSet) -> Array:
    """Return the speeds or drives (n, 4) that a set's rotors have at each step, `ROW_STEPS` to a row."""
    speeds = speeds_of(flight, parameters)
    if speeds is not None:
        return delayed(speeds, parameters.delay_s)
    return delayed(flight.drive if parameters.lag is None else parameters.lag.follow(flight.drive), parameters.delay_s)


def thrusts_of(flight: Flight, parameters: ParameterSet) -> Array:
    """Return the rotors' thrusts (n, 4) in N, `ROW_STEPS` to a row."""
    thrust_n = parameters.thrust_n if speeds_of(flight, parameters) is None else parameters.thrust_speed_n
    return np.asarray(np.polynomial.polynomial.polyval(late_drives(flight, parameters), np.array(thrust_n)))


def _rates(flight: Flight, parameters: ParameterSet, turning: Array, at: Rows) -> tuple[Array, Array]:
    """Return the predicted rates (s, h, 3) at each row of each segment, and rotations (s, h, 3, 3) since its start."""
    moments = np.array(parameters.moments_kg_m2)
    spun = np.zeros(len(turning))
    if parameters.rotor_inertia_kg_m2 and speeds_of(flight, parameters) is not None:
        spun -= parameters.rotor_inertia_kg_m2 * (late_drives(flight, parameters) @ flight.turning[2])
    pushed = turning / moments
    pushed[:, 2] -= np.gradient(spun, STEP_S) / moments[2]
    known = flight.rates_known[1:] & flight.rates_known[:-1]
    by_row = pushed[: len(flight.rates) * ROW_STEPS].reshape(-1, ROW_STEPS, 3).mean(axis=1)[:-1]
    spun_at_rows = spun[::ROW_STEPS][: len(flight.rates) - 1]
    shown = np.diff(flight.rates, axis=0) / ROW_S + _gyroscopic(flight.rates[:-1], moments, spun_at_rows)
    pushed = pushed + (shown - by_row)[known].mean(axis=0)
    now = flight.rates[at].copy()
    course = [now.copy()]
    for step in range(max(HORIZONS) * ROW_STEPS):
        place = at * ROW_STEPS + step
        middle = (pushed[place] + pushed[place + 1]) / 2
        half = now + STEP_S / 2 * (middle - _gyroscopic(now, moments, spun[place]))
        now = now + STEP_S * (middle - _gyroscopic(half, moments, spun[place]))
        if (step + 1) % ROW_STEPS == 0:
            course.append(now.copy())
    rates = np.stack(course, axis=1)
    return rates, _turned(rates)


def _gyroscopic(rates: Array, moments: Array, spun: Array) -> Array:
    """Return the cross product of rates (n, 3) and momenta over moments (3,) in every step, as `np.cross` is slow.

    `spun` (n,) is the rotors' angular momentum about z relative to the vehicle, in N m s.
    """
    x, y, z = rates.T
    of_x, of_y, of_z = (moments * rates).T
    of_z = of_z + spun
    return np.stack([y * of_z - z * of_y, z * of_x - x * of_z, x * of_y - y * of_x], axis=1) / moments


def _turned(rates: Array) -> Array:
    """Return the rotations (s, h, 3, 3) from rates (s, h, 3) at rows since the first."""
    turn = np.tile(np.eye(3), (len(rates), 1, 1))
    turns = [turn]
    for place in range(1, rates.shape[1]):
        angle = (rates[:, place - 1] + rates[:, place]) / 2 * ROW_S
        turn = turn @ Rotation.from_rotvec(angle).as_matrix()
        turns.append(turn)
    return np.stack(turns, axis=1)


def _velocity_errors(flight: Flight, parameters: ParameterSet, lift: Array, turns: Array, at: Rows) -> Array:
    """Return the errors (s, h) of the change of velocity at each row of segments."""
    rows = lift[: len(flight.rates) * ROW_STEPS].reshape(-1, ROW_STEPS).mean(axis=1)
    count = max(HORIZONS)
    if flight.velocity is None or flight.attitude is None:
        wrong = np.stack([(rows - flight.force[:, 2])[at + place] for place in range(count)], axis=1)
        return np.asarray(np.abs(np.pad(np.cumsum(wrong, axis=1) * ROW_S, ((0, 0), (1, 0)))))
    attitude = Rotation.from_quat(flight.attitude, scalar_first=True).as_matrix()
    world = np.einsum("nij,nj->ni", attitude, flight.velocity)
    gravity = np.array([0.0, 0.0, USUAL_GRAVITY_MPS2])
    now = world[at].copy()
    result = [np.zeros(len(at))]
    for place in range(count):
        turn = attitude[at] @ turns[:, place]
        force = np.zeros((len(at), 3))
        force[:, 2] = rows[at + place]
        if parameters.drag_per_s is not None:
            along = np.einsum("sji,sj->si", turn, now)
            force[:, :2] = -np.array(parameters.drag_per_s) * along[:, :2]
        now = now + ROW_S * (np.einsum("sij,sj->si", turn, force) - gravity)
        result.append(np.linalg.norm(now - world[at + place + 1], axis=1))
    return np.stack(result, axis=1)
