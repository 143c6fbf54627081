"""Predict a flight from its commands, for every parameter set alike: its next row, or a whole segment.

Over a longer time, rates accumulate effects that no set contains, mainly of air, to which the autopilot responds:
commands then counteract it, and moments that are too large have smaller errors than the true ones. One row ahead, given
the errors before, what remains happened after the commands, and only the true set minimises it: by this condition, `fit
flight` finds moments (decision 22).

One integrator predicts segments. Each starts with the rates that the gyro showed; from there on, only commands count.
Thrust of one rotor is a polynomial of its lagging drive; rates follow J dw/dt + w x J w = torques, by the midpoint rule
with steps of 2 ms. A constant angular acceleration about each axis, as an offset centre of mass causes, is estimated
from the whole flight for every set alike, because no set contains it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from cfid.flight.model import ThrustLag, turning_equation, whitening, without
from cfid.flight.rows import AXES, LEVER, ROW_S, ROW_STEPS, STEP_S, Flight, delayed, segments
from cfid.units import USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

HORIZONS = (1, 10, 50, 100)  # rows: one step, and 0.1, 0.5 and 1 s
QUANTITIES = ("rates", "attitude", "velocity")
UNITS = {"rates": "rad/s", "attitude": "deg", "velocity": "m/s"}


@dataclass(frozen=True, kw_only=True, eq=False)
class ParameterSet:
    """A vehicle's parameters along forward, left and up: everything that a prediction needs.

    `thrust_n` is one rotor's thrust, lowest power first, as a function of its command relative to full command, or of
    volts where `in_volts`. `lag` is None where rotors follow at once, and `delay_s` is that of the flight's sensors and
    link, the same for all sets. `drag_per_s` is drag over mass across the thrust, None where unknown.
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


def errors(flight: Flight, parameters: ParameterSet, at: Rows) -> dict[str, Array]:
    """Return the error (s, h) of each quantity in each segment after each horizon, as lengths and angles.

    The attitude's error is the angle between the predicted rotation and that of the recorded rates. The velocity's
    error is that of the change of velocity: along the vehicle's vertical by the accelerometer, or with motion capture
    along all three axes.
    """
    thrusts = thrusts_of(flight, parameters)
    turning = thrusts @ flight.turning.T * parameters.levers_m  # (n, 3) in N m
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
    mean_n = float(
        np.mean(np.polynomial.polynomial.polyval(flight.drive[flight.step_driven], np.array(parameters.thrust_n)))
    )
    upright = replace(flight, velocity=None, attitude=None)
    level = replace(parameters, thrust_n=(mean_n,), lag=None, delay_s=0.0)
    return errors(upright, level, at)["velocity"]


def unchanged(flight: Flight, at: Rows) -> Array:
    """Return the mean change (h,) of rates within each horizon: the error of predicting no change."""
    return np.array(
        [float(np.mean(np.linalg.norm(flight.rates[at + rows] - flight.rates[at], axis=1))) for rows in HORIZONS]
    )


def late_drives(flight: Flight, parameters: ParameterSet) -> Array:
    """Return the drives (n, 4) that a set's rotors have at each step, `ROW_STEPS` to a row."""
    return delayed(flight.drive if parameters.lag is None else parameters.lag.follow(flight.drive), parameters.delay_s)


def thrusts_of(flight: Flight, parameters: ParameterSet) -> Array:
    """Return the rotors' thrusts (n, 4) in N, `ROW_STEPS` to a row."""
    return np.asarray(np.polynomial.polynomial.polyval(late_drives(flight, parameters), np.array(parameters.thrust_n)))


def _rates(flight: Flight, parameters: ParameterSet, turning: Array, at: Rows) -> tuple[Array, Array]:
    """Return the predicted rates (s, h, 3) at each row of each segment, and rotations (s, h, 3, 3) since its start."""
    moments = np.array(parameters.moments_kg_m2)
    pushed = turning / moments
    known = flight.rates_known[1:] & flight.rates_known[:-1]
    by_row = pushed[: len(flight.rates) * ROW_STEPS].reshape(-1, ROW_STEPS, 3).mean(axis=1)[:-1]
    shown = np.diff(flight.rates, axis=0) / ROW_S + _gyroscopic(flight.rates[:-1], moments)
    pushed = pushed + (shown - by_row)[known].mean(axis=0)
    now = flight.rates[at].copy()
    course = [now.copy()]
    for step in range(max(HORIZONS) * ROW_STEPS):
        middle = (pushed[at * ROW_STEPS + step] + pushed[at * ROW_STEPS + step + 1]) / 2
        half = now + STEP_S / 2 * (middle - _gyroscopic(now, moments))
        now = now + STEP_S * (middle - _gyroscopic(half, moments))
        if (step + 1) % ROW_STEPS == 0:
            course.append(now.copy())
    rates = np.stack(course, axis=1)
    return rates, _turned(rates)


def _gyroscopic(rates: Array, moments: Array) -> Array:
    """Return the cross product of rates (n, 3) and momenta over moments (3,) in every step, as `np.cross` is slow."""
    x, y, z = rates.T
    of_x, of_y, of_z = (moments * rates).T
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
