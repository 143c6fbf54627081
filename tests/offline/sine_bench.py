"""Simulates series of sines as a rig would record them: reports with delay, and a load cell with vibration.

The plant is a first-order lag behind a zero-order hold, integrated exactly, or the simulated rotors, whose thrust
is quadratic in their speed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cfid.sim.link import Direction, RadioTruth
from cfid.sim.loadcell import LoadCellTruth, SimulatedLoadCell
from cfid.sim.propulsion import RotorTruth, SimulatedRotors
from cfid.sim.stepping import Array
from cfid.wire.app import LARGEST_COMMAND, MIDDLE, SAMPLES_PER_S

LATE_RADIO = RadioTruth(
    latency_s=0.028, jitter_s=0.016
)  # table 3.2 of the thesis: half of 57 ms, and its standard deviation
ARM_M = 0.046  # C.2.5
SAMPLE_S = 1 / SAMPLES_PER_S
USUAL_CELL = LoadCellTruth()

_REST_S = 1.2  # before and after each run
_BEGIN_S = 1.75e9  # on the host's clock
_WRAPS_US = 1 << 32
_IDLE_RAD_PER_S, _RAD_PER_S_PER_COMMAND = 381.0, 0.0408  # eq. 3.4
_PLACES_DEG = {1: -45.0, 2: -135.0, 3: 135.0, 4: 45.0}  # of the motors, to the left of the vehicle's x axis


@dataclass(frozen=True, kw_only=True)
class LinearTruth:
    """Thrust of a command: K / (1 + s tau) behind a zero-order hold, `early_s` early.

    `vibration_n` is the amplitude of the line at the rotor's frequency; the line at twice that has half of it.
    """

    static_gain_n: float
    time_constant_s: float
    early_s: float = 0.0
    vibration_n: float = 0.0

    @classmethod
    def of_coefficients(cls, b0: float, a1: float, *, vibration_n: float = 0.0) -> "LinearTruth":
        """Return b0/(1 - a1 z^-1) as in eq. 3.15, where the force at a sample already shows that sample's command."""
        lag_s = -SAMPLE_S / math.log(a1)
        return cls(static_gain_n=b0 / (1 - a1), time_constant_s=lag_s, early_s=SAMPLE_S, vibration_n=vibration_n)


@dataclass(frozen=True, kw_only=True)
class Bench:
    """The set-up around the plant. `loop_error` is the relative excess of the loop's 500 Hz, on the host's clock."""

    rate_hz: float = 1000.0
    radio: RadioTruth = LATE_RADIO
    loadcell_latency_s: float = 0.0006
    loadcell: LoadCellTruth = USUAL_CELL
    vehicle_clock: float = 84 / 85
    loop_error: float = 0.0
    motor: int = 1

    @property
    def delay_s(self) -> float:
        """The mean delay of the force's stamps after those of the commands."""
        return self.loadcell_latency_s - self.radio.mean_s


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedSine:
    """One run. Reports (m,) with the host's time, command, sample and vehicle's microseconds; counts (n, 6).

    The last report has the command 0 and the number of samples played. `time_s` is the load cell's, by the
    host's clock.
    """

    periods: int
    samples: int
    amplitude: int
    motor: int
    report_host_s: Array
    report_command: Array
    report_sample: Array
    report_vehicle_us: Array
    time_s: Array
    counts: Array


class _Played(NamedTuple):
    """Commands (N,), times (n,) of the load cell since the first command, and how long each is held."""

    commands: Array
    since_s: Array
    sample_s: float
    motor: int
    yaw_deg: float  # of the load cell's x axis, to the left of the vehicle's


def simulate_sines(
    truth: LinearTruth | RotorTruth,
    *,
    periods: Sequence[int],
    samples: int,
    rng: np.random.Generator,
    amplitude: int = 20000,
    bench: Bench = Bench(),
) -> list[SimulatedSine]:
    """Return a run of eq. 3.6 for each l in `periods`, one after the other on one clock and one load cell."""
    radio, cell = Direction(bench.radio, rng), SimulatedLoadCell(bench.loadcell, rng)
    sample_s = SAMPLE_S / (1 + bench.loop_error)
    each_s = samples * sample_s + 2 * _REST_S
    runs = []
    for place, l in enumerate(periods):  # noqa: E741 - the letter of the equation
        start_s = _BEGIN_S + _REST_S + place * each_s + rng.uniform(0, 1 / bench.rate_hz)
        commands = _commands(l, samples, amplitude)
        sample, command = _reports(commands)
        sent_s = start_s + sample * sample_s
        arrived = [radio.arrival_s(time_s) for time_s in sent_s]
        came = np.array([time_s is not None for time_s in arrived])
        tick = math.ceil((start_s - _REST_S) * bench.rate_hz)
        time_s = (tick + np.arange(int((each_s - 0.1) * bench.rate_hz))) / bench.rate_hz
        played = _Played(commands, time_s - start_s, sample_s, bench.motor, bench.loadcell.yaw_deg)
        wrench = _wrench(truth, played, rng)
        runs.append(
            SimulatedSine(
                periods=l,
                samples=samples,
                amplitude=amplitude,
                motor=bench.motor,
                report_host_s=np.array([time_s for time_s in arrived if time_s is not None]),
                report_command=command[came],
                report_sample=sample[came],
                report_vehicle_us=np.floor((sent_s - _BEGIN_S) * bench.vehicle_clock * 1e6)[came] % _WRAPS_US,
                time_s=time_s + bench.loadcell_latency_s,
                counts=cell.read(time_s, wrench)[0].astype(np.float64),
            )
        )
    return runs


def _commands(l: int, samples: int, amplitude: int) -> Array:  # noqa: E741
    angle = 2 * np.pi * (l * np.arange(samples) % samples) / samples
    return np.clip(np.trunc(np.round(amplitude * np.cos(angle) + MIDDLE, 6)), 0, LARGEST_COMMAND)


def _reports(commands: Array) -> tuple[Array, Array]:
    """Return sample and command of each report, as the vehicle's app sends them."""
    before = np.append(0.0, commands[:-1])
    crossing = np.flatnonzero(((before > MIDDLE) & (commands <= MIDDLE)) | ((before < MIDDLE) & (commands >= MIDDLE)))
    return np.append(crossing, len(commands)).astype(np.float64), np.append(commands[crossing], 0.0)


def _wrench(truth: LinearTruth | RotorTruth, played: _Played, rng: np.random.Generator) -> Array:
    """Return the wrench (n, 6) in N and Nm at the load cell's times."""
    if isinstance(truth, RotorTruth):
        return _of_rotors(truth, played, rng)
    place = math.radians(_PLACES_DEG[played.motor] - played.yaw_deg)
    x, y = math.cos(place), math.sin(place)
    thrust_n = truth.static_gain_n * _lagging(played, truth.time_constant_s, early_s=truth.early_s)
    thrust_n += _vibration(truth, played, rng)
    none = np.zeros_like(thrust_n)
    return np.stack([none, none, thrust_n, y * ARM_M * thrust_n, -x * ARM_M * thrust_n, none], axis=1)


def _lagging(played: _Played, time_constant_s: float, *, early_s: float = 0.0) -> Array:
    """Return the lag's output in commands; the command is 0 before and after the run."""
    decay = math.exp(-played.sample_s / time_constant_s)
    state, states = 0.0, []
    for command in played.commands.tolist():
        states.append(state)
        state = command + (state - command) * decay
    level = np.concatenate([[0.0], played.commands, [0.0]])
    begun = np.array([0.0, *states, state])
    since_s = played.since_s + early_s
    hold = np.clip(np.floor(since_s / played.sample_s + 1e-9), -1, len(states)).astype(np.intp)
    elapsed_s = np.maximum(since_s - hold * played.sample_s, 0.0)
    rest = np.where(hold < 0, 0.0, np.exp(-elapsed_s / time_constant_s))
    return np.asarray(level[hold + 1] + (begun[hold + 1] - level[hold + 1]) * rest)


def _vibration(truth: LinearTruth, played: _Played, rng: np.random.Generator) -> Array:
    """Return lines at the frequency of a rotor that lags like the thrust, and at twice that, while it runs."""
    time_s = played.since_s
    running = (time_s > 0) & (time_s < len(played.commands) * played.sample_s)
    speed = _IDLE_RAD_PER_S + _RAD_PER_S_PER_COMMAND * _lagging(played, truth.time_constant_s)
    angle = np.cumsum(speed * running) * (time_s[1] - time_s[0]) + rng.uniform(0, 2 * math.pi)
    return np.asarray(truth.vibration_n * running * (np.sin(angle) + 0.5 * np.sin(2 * angle)))


def _of_rotors(truth: RotorTruth, played: _Played, rng: np.random.Generator) -> Array:
    """Return the wrench of four rotors, one of which follows the commands."""
    rotors = SimulatedRotors(truth, rng, yaw_deg=played.yaw_deg)
    begin_s = np.append(min(played.since_s[0], 0.0), np.arange(len(played.commands) + 1) * played.sample_s)
    commands = np.concatenate([[0.0], played.commands, [0.0]])[:, np.newaxis] * np.eye(4)[played.motor - 1]
    return rotors.play(played.since_s, begin_s, commands)
