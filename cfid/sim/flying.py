"""Simulates quadrocopters that fly freely, many at once: body, rotors and air, and what their logs show of them.

The state is velocity, attitude, rotor speeds and the angular momentum of body and rotors along the world's axes: how
rotors react on the body, and gyroscopic moments, follow from its conservation. Axes are x forward, y left, z up, from
the middle of the rotors' plane.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from importlib.resources import files
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import butter
from scipy.spatial.transform import Rotation

from cfid.sim.pilot import HUBS, PLAN_S, SPINS, Controller, angles
from cfid.sim.stepping import Array
from cfid.units import FULL_COMMAND, MOTORS, RPM, USUAL_GRAVITY_MPS2

STEP_S = 1e-3
LOGGED = (
    *(f"motor.m{motor}" for motor in MOTORS),
    *(f"motor.m{motor}_rpm" for motor in MOTORS),
    *(f"gyro.{axis}" for axis in "xyz"),
    *(f"acc.{axis}" for axis in "xyz"),
    "pm.vbat",
    *(f"stateEstimate.v{axis}" for axis in "xyz"),
    *(f"stateEstimate.q{part}" for part in "xyzw"),
)

_GYRO_HZ, _ACC_HZ = 80.0, 30.0  # of the second-order filters in crazyflie-firmware, sensors_bmi088_bmp3xx.c
_TILT_RAD, _TILT_S = 0.005, 3.0  # the standard deviation and correlation time of the estimate's errors
_DRIFT_MPS, _DRIFT_S = 0.02, 0.3
_ESTIMATE_DELAY_S = 0.008
_VOLTS_NOISE_V = 0.005
# Of a step's random numbers; four processes are the gusts' force and moment, the attitude's error and the velocity's.
_GYRO, _ACC, _PROCESSES, _VOLTS, _NOISES = slice(0, 3), slice(3, 6), slice(6, 18), slice(18, 19), 19
_NOISE_STEPS = 500  # for which random numbers are drawn at once
_SKEWS = np.cross(np.eye(3)[:, np.newaxis], np.eye(3)).transpose(0, 2, 1).reshape(3, 9)
_SCATTERED = (
    "mass_kg", "thrust_ns2_per_rad2", "thrust_slope", "torque_m", "rotor_inertia_kg_m2", "drag_kg_per_rad",
    "flapping_kgm_per_rad", "rising", "falling", "command_delay_s", "telemetry_delay_s",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class FlyingVehicle:
    """A quadrocopter's true parameters, those of its instruments, and the gusts that it meets.

    The inertia is about the centre of mass, rotors included. A rotor's thrust is (`thrust_ns2_per_rad2` +
    `thrust_slope` w) w^2, its torque `torque_m` times that. Each hub feels -`drag_kg_per_rad` w times its velocity;
    `flapping_kgm_per_rad` w is a moment about x per vy and one about y per vx. dw/dt = k1 (c - w) + k2 (c^2 - w^2) with
    `rising` (k1, k2) where c > w, `falling` elsewhere; c is `idle_rad_s` plus `rad_s_per_v` times the voltage times the
    share of the full command, late by `command_delay_s`. The battery loses `fade_v_per_s`, and `ohm`, its own over the
    efficiency, times the rotors' power over the voltage.

    A flight's biases are drawn with standard deviations. A rotor's speed is what a period of 1/`pulses` turns shows, in
    microseconds cut to `period_bits` significant bits, as bidirectional DShot sends it, every `telemetry_s`, and then
    late by `telemetry_delay_s`. Gusts are Ornstein-Uhlenbeck forces and moments with standard deviations `gust_n` and
    `gust_nm` along each axis and the correlation time `gust_s`.
    """

    mass_kg: float
    inertia_kg_m2: Sequence[Sequence[float]]
    arm_m: float
    centre_of_mass_m: Sequence[float]
    thrust_ns2_per_rad2: float
    thrust_slope: float
    torque_m: float
    rotor_inertia_kg_m2: float
    drag_kg_per_rad: Sequence[float]
    flapping_kgm_per_rad: Sequence[float]
    rising: Sequence[float]
    falling: Sequence[float]
    idle_rad_s: float
    rad_s_per_v: float
    command_delay_s: float
    least_command: float
    open_v: float
    fade_v_per_s: float
    ohm: float
    imu_m: Sequence[float]
    gyro_noise_rad_s: float
    gyro_bias_rad_s: float
    acc_noise_mps2: float
    acc_bias_mps2: float
    pulses: float
    period_bits: float
    telemetry_s: float
    telemetry_delay_s: float
    gust_n: float = 0.0
    gust_nm: float = 0.0
    gust_s: float = 0.3

    @property
    def hover_rad_s(self) -> float:
        """The rotors' speed that carries the weight."""
        roots = np.roots([self.thrust_slope, self.thrust_ns2_per_rad2, 0.0, -self.mass_kg * USUAL_GRAVITY_MPS2 / 4])
        return float(max(roots[np.isreal(roots)].real))

    @property
    def moment_per_velocity_ns(self) -> tuple[float, float]:
        """The moments about x per vy and about y per vx at hover, with that of drag above the centre of mass."""
        (roll, pitch), (x, y, _) = self.flapping_kgm_per_rad, self.drag_kg_per_rad
        above_m, speeds = -self.centre_of_mass_m[2], 4 * self.hover_rad_s
        return speeds * (roll + above_m * y), speeds * (pitch - above_m * x)


VEHICLES = {
    name: FlyingVehicle(**values)
    for name, values in tomllib.loads(files("cfid.sim").joinpath("flying_vehicles.toml").read_text("utf-8")).items()
}


def scattered(vehicle: FlyingVehicle, rng: np.random.Generator, *, gust: float = 0.0) -> FlyingVehicle:
    """Return a vehicle within 10 % of another, in gusts whose force is a share `gust` of its weight."""
    changed = {
        name: (getattr(vehicle, name) * rng.uniform(0.9, 1.1, np.shape(getattr(vehicle, name)))).tolist()
        for name in _SCATTERED
    }
    # Mostly a common factor: no principal moment of a body exceeds the sum of the others.
    sizes = np.sqrt(rng.uniform(0.9, 1.1) * rng.uniform(0.98, 1.02, 3))
    gust_n = gust * changed["mass_kg"] * USUAL_GRAVITY_MPS2
    return replace(
        vehicle,
        **changed,
        inertia_kg_m2=(np.outer(sizes, sizes) * vehicle.inertia_kg_m2).tolist(),
        centre_of_mass_m=rng.normal(vehicle.centre_of_mass_m, 0.01 * vehicle.arm_m).tolist(),
        arm_m=vehicle.arm_m * rng.uniform(0.97, 1.03),
        gust_n=gust_n,
        gust_nm=0.05 * gust_n * vehicle.arm_m,
    )


class State(NamedTuple):
    """Velocity (n, 3), attitude (n, 3, 3), angular momentum (n, 3) and the rotors' speeds (n, 4), in SI units.

    The velocity of the centre of mass and the momentum of body and rotors are along the world's axes, to which the
    attitude's matrices turn the vehicle's.
    """

    velocity: Array
    attitude: Array
    momentum: Array
    speeds: Array

    def moved(self, slopes: "Slopes", by_s: float) -> "State":
        """Return the state after a time of constant slopes, short enough that it turns by less than 0.1 rad."""
        angle = by_s * slopes.rates
        turn, square = _skew(angle), np.sum(angle**2, axis=1)[:, np.newaxis, np.newaxis]
        return State(
            self.velocity + by_s * slopes.velocity,
            self.attitude + self.attitude @ ((1 - square / 6) * turn + (1 / 2 - square / 24) * (turn @ turn)),
            self.momentum + by_s * slopes.momentum,
            self.speeds + by_s * slopes.speeds,
        )


class Slopes(NamedTuple):
    """The derivatives of a state; rates and specific forces (n, 3) are along the vehicle's axes."""

    velocity: Array
    rates: Array
    momentum: Array
    speeds: Array
    specific: Array


class FreeFlight:
    """The bodies and rotors of n vehicles, which start level, at rest, at the speeds that carry them."""

    def __init__(self, vehicles: Sequence[FlyingVehicle]) -> None:
        """Take the vehicles, one a flight."""
        self._own = own = _stacked(vehicles)
        count, self._inverse = len(vehicles), np.linalg.inv(own.inertia_kg_m2)
        hubs_m = own.arm_m[:, np.newaxis] * HUBS - own.centre_of_mass_m[:, np.newaxis]
        # From the hubs' forces (n, 12) to their moment.
        self._levers = _skew(hubs_m.reshape(-1, 3)).reshape(count, 4, 3, 3).transpose(0, 2, 1, 3).reshape(count, 3, 12)
        self.hover_rad_s = np.array([[vehicle.hover_rad_s] for vehicle in vehicles])
        speeds, none = np.repeat(self.hover_rad_s, 4, axis=1), np.zeros((count, 3))
        self.state = State(none, np.repeat([np.eye(3)], count, axis=0), self._spun(speeds), speeds)

    def controller(self) -> Controller:
        """Return a controller that knows how commands accelerate these vehicles at hover."""
        own, hover = self._own, self.hover_rad_s
        volts = own.open_v - own.ohm * own.torque_m * own.mass_kg * USUAL_GRAVITY_MPS2 * hover / own.open_v
        per_command = own.rad_s_per_v * volts * (2 * own.thrust_ns2_per_rad2 + 3 * own.thrust_slope * hover) * hover
        levers = np.hstack([own.arm_m * [0.5**0.5, 0.5**0.5], own.torque_m])
        principal = np.diagonal(own.inertia_kg_m2, axis1=1, axis2=2)
        shares = np.hstack([own.mass_kg, principal / levers]) / (4 * per_command)
        return Controller(
            shares, (hover - own.idle_rad_s) / (own.rad_s_per_v * volts), own.least_command / FULL_COMMAND
        )

    def thrust_n(self, speeds: Array) -> Array:
        """Return the thrusts (n, 4) of rotors at speeds (n, 4) in still air."""
        return np.asarray((self._own.thrust_ns2_per_rad2 + self._own.thrust_slope * speeds) * speeds**2)

    def rates(self, state: State) -> Array:
        """Return the rates (n, 3) along the vehicle's axes."""
        momentum = _times(state.attitude.transpose(0, 2, 1), state.momentum)
        return _times(self._inverse, momentum - self._spun(state.speeds))

    def slopes(self, state: State, steady: Array, force_n: Array | float, moment_nm: Array | float) -> Slopes:
        """Return the slopes where rotors head for speeds (n, 4), and gusts (n, 3) act along the vehicle's axes."""
        own, speeds, rates = self._own, state.speeds, self.rates(state)
        thrust = self.thrust_n(speeds)
        air = _times(state.attitude.transpose(0, 2, 1), state.velocity)
        at_hubs = air[:, np.newaxis] + _times(self._levers.transpose(0, 2, 1), rates).reshape(-1, 4, 3)
        forces = -own.drag_kg_per_rad[:, np.newaxis] * speeds[:, :, np.newaxis] * at_hubs
        forces[:, :, 2] += thrust
        moment = _times(self._levers, forces.reshape(-1, 12)) + moment_nm
        moment[:, :2] += own.flapping_kgm_per_rad * air[:, 1::-1] * np.sum(speeds, axis=1, keepdims=True)
        moment[:, 2] -= (own.torque_m * thrust) @ SPINS
        specific = (np.sum(forces, axis=1) + force_n) / own.mass_kg
        coefficients = [np.where(steady > speeds, own.rising[:, [k]], own.falling[:, [k]]) for k in (0, 1)]
        return Slopes(
            velocity=_times(state.attitude, specific) - [0, 0, USUAL_GRAVITY_MPS2],
            rates=rates,
            momentum=_times(state.attitude, moment),
            speeds=(steady - speeds) * (coefficients[0] + coefficients[1] * (steady + speeds)),
            specific=specific,
        )

    def step(self, steady: Array, force_n: Array | float = 0.0, moment_nm: Array | float = 0.0) -> Slopes:
        """Advance by a millisecond by the midpoint rule; return the slopes in its middle."""
        first = self.slopes(self.state, steady, force_n, moment_nm)
        middle = self.slopes(self.state.moved(first, STEP_S / 2), steady, force_n, moment_nm)
        self.state = self.state.moved(middle, STEP_S)
        return middle

    def _spun(self, speeds: Array) -> Array:
        """Return the angular momenta (n, 3) of rotors relative to the body, along its axes."""
        return np.asarray(self._own.rotor_inertia_kg_m2 * (speeds @ SPINS)[:, np.newaxis] * [0.0, 0.0, 1.0])


class _Late:
    """Values (n, k) of each step, which a flight sees late by a time of its own (n, 1), between steps interpolated."""

    def __init__(self, first: Array, delay_s: Array) -> None:
        whole, self._share = np.divmod(delay_s / STEP_S, 1)
        self._whole, self._flights = whole[:, 0].astype(int), np.arange(len(first))
        self._kept = np.repeat(first[np.newaxis], int(np.max(self._whole)) + 2, axis=0)
        self._now = 0

    def seen(self, values: Array) -> Array:
        self._now = (self._now + 1) % len(self._kept)
        self._kept[self._now] = values
        newer, older = (self._kept[self._now - self._whole - steps, self._flights] for steps in (0, 1))
        return np.asarray(newer + self._share * (older - newer))


class _LowPass:
    """A second-order Butterworth filter of values (n, 3), which begins settled."""

    def __init__(self, first: Array, cut_off_hz: float) -> None:
        self._b, self._a = butter(2, cut_off_hz, fs=1 / STEP_S)
        self._newer, self._older = first * (1 - self._b[0]), first * (self._b[2] - self._a[2])

    def seen(self, values: Array) -> Array:
        shown = self._b[0] * values + self._newer
        self._newer = self._b[1] * values - self._a[1] * shown + self._older
        self._older = self._b[2] * values - self._a[2] * shown
        return np.asarray(shown)


class _Instruments:
    """What n flights' sensors, telemetry and estimates make of the truth."""

    def __init__(self, flight: FreeFlight, own: SimpleNamespace, rngs: Sequence[np.random.Generator]) -> None:
        bias, one = np.stack([rng.standard_normal(6) for rng in rngs]), np.ones((len(rngs), 1))
        self._flight, self._own = flight, own
        self._gyro_bias, self._acc_bias = own.gyro_bias_rad_s * bias[:, _GYRO], own.acc_bias_mps2 * bias[:, _ACC]
        at_rest = self._acc_bias + np.array([0.0, 0.0, USUAL_GRAVITY_MPS2])
        self._rest_mps2 = np.linalg.norm(at_rest, axis=1, keepdims=True)  # which the firmware takes for 1 g
        self._gyro, self._acc = _LowPass(self._gyro_bias, _GYRO_HZ), _LowPass(at_rest, _ACC_HZ)
        self._imu, self._origin = _skew(own.centre_of_mass_m - own.imu_m), _skew(own.centre_of_mass_m)
        self._telemetry = _Late(flight.state.speeds, own.telemetry_delay_s)
        self._every = np.round(own.telemetry_s / STEP_S).astype(int)
        self._phase = np.stack([rng.integers(0, 1000, 4) for rng in rngs])
        self.rpm = self._sent(flight.state.speeds)
        self._velocity = _Late(flight.state.velocity, _ESTIMATE_DELAY_S * one)
        self._attitude = _Late(flight.state.attitude.reshape(-1, 9), _ESTIMATE_DELAY_S * one)

    def before(self, tilt: Array, drift: Array, noise: Array, *, step: int) -> tuple[Array, Array, Array]:
        """Return velocity and attitude as estimated, with errors (n, 3), and the gyro's rates (n, 3) in rad/s."""
        state, rates = self._flight.state, self._flight.rates(self._flight.state)
        self.rpm = np.where(
            (step + self._phase) % self._every, self.rpm, self._sent(self._telemetry.seen(state.speeds))
        )
        shown = self._gyro.seen(rates + self._gyro_bias + self._own.gyro_noise_rad_s * noise[:, _GYRO])
        of_origin = state.velocity + _times(state.attitude, _times(self._origin, rates))
        tilted = state.attitude + state.attitude @ _skew(tilt)
        attitude = self._attitude.seen(tilted.reshape(-1, 9)).reshape(-1, 3, 3)
        return self._velocity.seen(of_origin + drift), attitude, shown

    def during(self, middle: Slopes, quicker: Array, noise: Array) -> Array:
        """Return what the accelerometer shows in g (n, 3), by angular accelerations (n, 3)."""
        moved = _times(self._imu, quicker) + _times(_skew(middle.rates), _times(self._imu, middle.rates))
        raw = middle.specific + moved + self._acc_bias + self._own.acc_noise_mps2 * noise[:, _ACC]
        return np.asarray(self._acc.seen(raw) / self._rest_mps2)

    def _sent(self, speeds: Array) -> Array:
        """Return the speeds (n, 4) in rpm that telemetry sends of true ones in rad/s."""
        period_us = 60e6 * RPM / (self._own.pulses * speeds)
        unit_us = 2.0 ** np.maximum(np.floor(np.log2(period_us)) + 1 - self._own.period_bits, 0)
        return np.asarray(np.floor(60e6 / (self._own.pulses * np.floor(period_us / unit_us) * unit_us)))


@dataclass(frozen=True, kw_only=True, eq=False)
class FlightLogs:
    """What n vehicles logged, in the firmware's units: `time_s` (m,) and `rows` (n, m, 22) of `LOGGED`, as float32."""

    time_s: Array
    rows: npt.NDArray[np.float32]

    def columns(self, flight: int) -> dict[str, Array]:
        """Return a flight's columns (m,) by their names in a log of the firmware."""
        return dict(zip(LOGGED, self.rows[flight].T.astype(np.float64), strict=True))


def fly(
    vehicles: Sequence[FlyingVehicle], plans: Array, *, rngs: Sequence[np.random.Generator], rate_hz: int = 500
) -> FlightLogs:
    """Fly n vehicles by plans (n, m, 6) of `manoeuvres`, far from any ground, and log at `rate_hz`, a divisor of 1000.

    A flight depends on its own vehicle, plan and generator alone. A row's commands are those that rotors receive from
    its time on, late by the vehicle's delay; the accelerometer is read half a millisecond later.
    """
    count, plan_steps, every = len(vehicles), round(PLAN_S / STEP_S), round(1 / STEP_S / rate_hz)
    own, flight = _stacked(vehicles), FreeFlight(vehicles)
    instruments, controller = _Instruments(flight, own, rngs), flight.controller()
    one, volts = np.ones((count, 1)), own.open_v
    acting = _Late(np.repeat(np.floor(FULL_COMMAND * controller.hover), 4, axis=1), own.command_delay_s)
    kept = np.exp(-STEP_S / np.repeat(np.hstack([own.gust_s, own.gust_s, _TILT_S * one, _DRIFT_S * one]), 3, axis=1))
    spread = np.repeat(np.hstack([own.gust_n, own.gust_nm, _TILT_RAD * one, _DRIFT_MPS * one]), 3, axis=1)
    added, processes = spread * np.sqrt(1 - kept**2), np.zeros((count, 12))
    rows = np.empty((plans.shape[1] * plan_steps // every, count, len(LOGGED) - 1), np.float32)
    for step in range(len(rows) * every):
        if step % _NOISE_STEPS == 0:
            chance = np.stack([rng.standard_normal((_NOISE_STEPS, _NOISES)) for rng in rngs], axis=1)
        noise, state = chance[step % _NOISE_STEPS], flight.state
        processes = kept * processes + added * noise[:, _PROCESSES]
        force, moment, tilt, drift = np.split(processes, 4, axis=1)
        velocity, attitude, rates = instruments.before(tilt, drift, noise, step=step)
        command = controller.command(plans[:, step // plan_steps], velocity, attitude, rates, step=step)
        power_w = own.torque_m * np.sum(flight.thrust_n(state.speeds) * state.speeds, axis=1, keepdims=True)
        volts = own.open_v - own.fade_v_per_s * STEP_S * step - own.ohm * power_w / volts
        steady = own.idle_rad_s + own.rad_s_per_v * volts * acting.seen(command) / FULL_COMMAND
        middle = flight.step(steady, force, moment)
        quicker = (flight.rates(flight.state) - flight.rates(state)) / STEP_S
        felt_g = instruments.during(middle, quicker, noise)
        if step % every == 0:
            shown_v = volts + _VOLTS_NOISE_V * noise[:, _VOLTS]
            shown = (command, instruments.rpm, np.degrees(rates), felt_g, shown_v, velocity, angles(attitude))
            rows[step // every] = np.hstack(shown)
    others, turns = np.split(rows, [len(LOGGED) - 4], axis=2)
    quaternions = Rotation.from_euler("xyz", turns.reshape(-1, 3)).as_quat().reshape(len(rows), count, 4)
    shown_rows = np.concatenate([others, quaternions], axis=2, dtype=np.float32).transpose(1, 0, 2)
    return FlightLogs(
        time_s=np.asarray(STEP_S * every * np.arange(len(rows)), np.float64), rows=np.ascontiguousarray(shown_rows)
    )


def _stacked(vehicles: Sequence[FlyingVehicle]) -> SimpleNamespace:
    """Return the vehicles' fields by their names: numbers as arrays (n, 1), vectors (n, k), matrices (n, 3, 3)."""
    names = [each.name for each in fields(FlyingVehicle)]
    values = {name: np.array([getattr(vehicle, name) for vehicle in vehicles], np.float64) for name in names}
    return SimpleNamespace(**{name: each if each.ndim > 1 else each[:, np.newaxis] for name, each in values.items()})


def _skew(vectors: Array) -> Array:
    """Return the matrices (n, 3, 3) whose products with others are cross products of vectors (n, 3)."""
    return np.asarray((vectors @ _SKEWS).reshape(-1, 3, 3))


def _times(matrices: Array, vectors: Array) -> Array:
    """Return the products (n, k) of matrices (n, k, m) with vectors (n, m)."""
    return np.asarray((matrices @ vectors[:, :, np.newaxis])[:, :, 0])
