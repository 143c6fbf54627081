"""Simulates chapter 3 of the thesis: a staircase, a tachometer, sines and pings, with fewer steps and runs."""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from cfid.sim.link import Direction
from cfid.sim.propulsion import WindTruth
from cfid.sim.stepping import Array
from cfid.sim.truth import SimTruth
from tests.offline.runs import PAUSE_S, SimulatedDevice, SimulatedRun, wrench_device
from tests.offline.sine_bench import Bench, SimulatedSine, simulate_sines
from tests.offline.stand import STILL_AIR, StandRecord, simulate_stand, staircase_steps

RATE_HZ, FULL_RATE_HZ = 1000.0, 7000.0  # the latter for speeds estimated from vibration: blade pass exceeds 500 Hz
STEPS = tuple(range(0, 64001, 4000))  # the thesis has steps of 2000
QUICK_STEPS = (20000, 40000, 60000)
MOTORS = (1, 3)
PERIODS = (2, 7, 20, 50, 100, 70, 33, 12, 4)  # of N = 4000 samples, up and down; the thesis has 43 runs
SAMPLES, AMPLITUDE = 4000, 20000
PINGS = 300

_HOLD_S, _REST_S = 2.5, 1.0
_PING_EVERY_S = 0.1
_TIMES_A_LOG = 10  # ticks of the stand in 100 ms: the battery is logged ten times a second


def record_staircase(
    truth: SimTruth,
    rng: np.random.Generator,
    *,
    steps: Sequence[int],
    motors: Sequence[int],
    hold_s: float,
    rest_s: float,
    rate_hz: float = RATE_HZ,
    wind: WindTruth = STILL_AIR,
    kind: str = "thrust",
    requested: Mapping[str, object] = MappingProxyType({}),
) -> SimulatedRun:
    """Run a staircase of some motors on the load cell, with or without wind; `requested` adds entries to run.toml."""
    when, duration_s = staircase_steps(steps, motors=motors, hold_s=hold_s, rest_s=rest_s)
    stand = simulate_stand(
        rotors=truth.rotors,
        loadcell=truth.loadcell,
        battery=truth.battery,
        steps=when,
        duration_s=duration_s,
        rate_hz=rate_hz,
        rng=rng,
        wind=wind,
    )
    staircase = {"steps": list(steps), "motors": list(motors), "hold_s": hold_s, "rest_s": rest_s}
    return SimulatedRun(
        kind=kind,
        next_after_s=duration_s + PAUSE_S,
        devices=_of_stand(stand, truth, rate_hz),
        requested={**staircase, **requested},
    )


def _of_stand(stand: StandRecord, truth: SimTruth, rate_hz: float) -> dict[str, SimulatedDevice]:
    """Return what `cfid log thrust` records on a stand: commands, load cell, battery."""
    cell = truth.loadcell
    logged = slice(None, None, _TIMES_A_LOG)
    ms = np.rint(1e3 * stand.tick_s[logged]).astype(np.int64)
    return {
        "commands": SimulatedDevice(
            columns=("t", "m1", "m2", "m3", "m4"), values=(stand.command_time_s, *stand.commands.astype(np.int64).T)
        ),
        "loadcell": wrench_device(
            stand.time_s,
            np.rint(stand.wrench * cell.counts_per_unit),
            rate_hz=rate_hz,
            counts_per_n=cell.counts_per_n,
            counts_per_nm=cell.counts_per_nm,
        ),
        "crazyflie": SimulatedDevice(
            columns=("t", "vehicle_ms", "pm.vbat"), values=(stand.tick_s[logged], ms, np.round(stand.volts[logged], 3))
        ),
    }


def shown_rpm(
    commands: Array, truth: SimTruth, rng: np.random.Generator, *, volts: Array | float | None = None
) -> Array:
    """Return a tachometer's readings in rpm of rotors at commands (n,) and their voltage; it counts every marker."""
    speed = truth.rotors.steady_rad_per_s(commands, volts=truth.rotors.nominal_v if volts is None else volts)
    shown = truth.rotors.markers * speed * 60 / math.tau * (1 + truth.rotors.tachometer_gain)
    return np.round(shown * (1 + truth.rotors.tachometer_std * rng.standard_normal(len(speed))))


def speed_run(truth: SimTruth, rng: np.random.Generator) -> SimulatedRun:
    """Simulate an operator who types a tachometer's readings."""
    commands = np.array([step for step in STEPS if step > truth.rotors.dead_below_command], dtype=np.float64)
    shown = shown_rpm(commands, truth, rng)
    each_s = _HOLD_S + _REST_S
    typed_s = _REST_S + each_s * np.arange(len(commands)) + _HOLD_S - 0.2
    turned_s = np.append(0.0, np.ravel(np.column_stack([typed_s + 0.2 - _HOLD_S, typed_s + 0.2])))
    turned = np.append(0, np.ravel(np.column_stack([commands, np.zeros(len(commands))]))).astype(np.int64)
    still = np.zeros(len(turned), np.int64)
    return SimulatedRun(
        kind="speed",
        next_after_s=float(typed_s[-1] + each_s) + PAUSE_S,
        devices={
            "commands": SimulatedDevice(
                columns=("t", "m1", "m2", "m3", "m4"), values=(turned_s, turned, still, turned, still)
            ),
            "readings": SimulatedDevice(
                columns=("t", "command", "rpm"), values=(typed_s, commands.astype(np.int64), shown)
            ),
        },
        requested={
            "steps": commands.astype(int).tolist(),
            "motors": list(MOTORS),
            "hold_s": _HOLD_S,
            "rest_s": _REST_S,
        },
    )


def sine_runs(truth: SimTruth, rng: np.random.Generator) -> list[SimulatedRun]:
    """Play a series of sines, up and down."""
    bench = Bench(rate_hz=RATE_HZ, radio=truth.radio, loadcell=truth.loadcell, vehicle_clock=truth_clock(truth))
    found = simulate_sines(truth.rotors, periods=PERIODS, samples=SAMPLES, amplitude=AMPLITUDE, rng=rng, bench=bench)
    begin_s = [float(sine.time_s[0]) for sine in found]
    after_s = [*np.diff(begin_s).tolist(), PAUSE_S]  # on one clock, since the vehicle's continues through all runs
    return [_sine(sine, truth, float(next_s)) for sine, next_s in zip(found, after_s, strict=True)]


def _sine(sine: SimulatedSine, truth: SimTruth, next_after_s: float) -> SimulatedRun:
    begin_s = float(sine.time_s[0])
    number = np.arange(len(sine.report_host_s))
    whole = [values.astype(np.int64) for values in (sine.report_command, sine.report_sample, sine.report_vehicle_us)]
    cell = truth.loadcell
    return SimulatedRun(
        kind=f"sine_l{sine.periods}",
        next_after_s=next_after_s,
        devices={
            "crossings": SimulatedDevice(
                columns=("t", "thrust_rec", "sample", "vehicle_us", "report"),
                values=(sine.report_host_s - begin_s, *whole, number),
            ),
            "loadcell": wrench_device(
                sine.time_s - begin_s,
                sine.counts,
                rate_hz=RATE_HZ,
                counts_per_n=cell.counts_per_n,
                counts_per_nm=cell.counts_per_nm,
            ),
        },
        requested={"l": sine.periods, "n": sine.samples, "amplitude": sine.amplitude, "motor": sine.motor},
    )


def ping_run(truth: SimTruth, rng: np.random.Generator, *, count: int = PINGS) -> SimulatedRun:
    """Send pings to the vehicle, and keep those that are answered."""
    up, down = Direction(truth.radio, rng), Direction(truth.radio, rng)
    sent_s = _PING_EVERY_S * np.arange(count)
    there_s: Array = np.array([_came(up, at_s) for at_s in sent_s])
    back_s: Array = np.array([_came(down, at_s) for at_s in there_s])
    vehicle_us = np.rint(1e6 * truth_clock(truth) * np.nan_to_num(there_s)).astype(np.int64)
    answered = np.isfinite(back_s)
    return SimulatedRun(
        kind="ping",
        next_after_s=float(sent_s[-1]) + PAUSE_S,
        devices={
            "pings": SimulatedDevice(
                columns=("t", "rtt_s", "vehicle_us"),
                values=(sent_s[answered], np.round(back_s - sent_s, 7)[answered], vehicle_us[answered]),
            )
        },
        requested={"count": count, "interval_s": _PING_EVERY_S},
    )


def truth_clock(truth: SimTruth) -> float:
    """Return how many seconds the vehicle's clock counts in a true one."""
    return 1 + truth.crazyflie.clock_skew


def _came(way: Direction, sent_s: float) -> float:
    arrived = way.arrival_s(sent_s) if math.isfinite(sent_s) else None
    return math.nan if arrived is None else arrived
