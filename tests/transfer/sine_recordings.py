"""Sine runs to test their analysis: simulated runs of the bench, and exact runs of a difference equation."""

import functools
from collections.abc import Sequence

import numpy as np

from cfid.sim.link import RadioTruth
from cfid.sim.loadcell import LoadCellTruth
from cfid.transfer.alignment import RecordedSine, Reports
from cfid.transfer.data import Channel, thrust_of
from cfid.transfer.model import EQ_3_15
from cfid.transfer.plan import SAMPLE_S, Sine
from tests.offline.sine_bench import ARM_M, Bench, LinearTruth, SimulatedSine, simulate_sines

SILENT_CELL = LoadCellTruth(bias=(0.0,) * 6, drift_per_s=(0.0,) * 6, noise_std=(0.0,) * 6)
PUNCTUAL = RadioTruth(latency_s=0.0, jitter_s=0.0)
FIRST_PERIODS = (*range(1, 16), *range(20, 101, 5))  # table 3.1 as far as C.2.5 states it, from 1 to the cut-off
GAIN_N, LAG_S = EQ_3_15.static_gain_n, EQ_3_15.time_constant_s or 0.0
# Five times the sine's amplitude at l = 100 of N = 4000.
VIBRATION_N = 5 * 20000 * abs(complex(EQ_3_15.response(np.array([2 * np.pi * 12.5]))[0]))
SHAKEN = LinearTruth(static_gain_n=GAIN_N, time_constant_s=LAG_S, vibration_n=VIBRATION_N)
USUAL = Bench()
STILL = LinearTruth(static_gain_n=GAIN_N, time_constant_s=LAG_S)


def log_spaced(count: int, most: int) -> tuple[int, ...]:
    return tuple(sorted(set(np.round(np.geomspace(1, most, count)).astype(int).tolist())))


@functools.cache
def simulated(
    periods: tuple[int, ...],
    *,
    samples: int = 4000,
    seed: int = 0,
    truth: LinearTruth = SHAKEN,
    bench: Bench = USUAL,
) -> tuple[SimulatedSine, ...]:
    rng = np.random.default_rng(seed)
    return tuple(simulate_sines(truth, periods=periods, samples=samples, rng=rng, bench=bench))


def noiseless_bench(rate_hz: float) -> Bench:
    return Bench(rate_hz=rate_hz, radio=PUNCTUAL, loadcell_latency_s=0.0, loadcell=SILENT_CELL, vehicle_clock=1.0)


def recorded(runs: Sequence[SimulatedSine], *, stamped: bool = True, channel: Channel = "Ty") -> list[RecordedSine]:
    return [_recorded(run, stamped, channel) for run in runs]


def _recorded(run: SimulatedSine, stamped: bool, channel: Channel) -> RecordedSine:
    sine = Sine(
        periods=run.periods,
        samples=run.samples,
        amplitude=run.amplitude,
        motor=run.motor,
    )
    on_board = (run.report_sample, run.report_vehicle_us) if stamped else (None, None)
    wrench = run.counts / 1e6
    return RecordedSine(
        name=f"l = {run.periods}",
        sine=sine,
        reports=Reports(run.report_host_s, run.report_command, *on_board),
        time_s=run.time_s,
        force_n=thrust_of(channel, wrench[:, :3], wrench[:, 3:], arm_m=ARM_M, motor=run.motor, yaw_deg=-45.0),
    )


def exact(b0: float, a1: float, *, periods: Sequence[int], samples: int, cut: bool = True) -> list[RecordedSine]:
    """Make runs of y[n] = a1 y[n-1] + b0 u[n] at 500 Hz without noise or latency; `cut` truncates u to integers."""
    runs = []
    for l in periods:  # noqa: E741
        sine = Sine(periods=l, samples=samples, amplitude=20000)
        whole = sine.commands()
        commands = whole if cut else 20000 * np.cos(sine.omega_rad * np.arange(samples)) + 30000
        force, state = [], 0.0
        for command in commands.tolist():
            state = a1 * state + b0 * command
            force.append(state)
        rest = np.zeros(2000)
        before = np.append(0.0, whole[:-1])
        crossing = np.flatnonzero(((before > 30000) & (whole <= 30000)) | ((before < 30000) & (whole >= 30000)))
        reports = Reports(np.append(crossing, samples) * SAMPLE_S, np.append(whole[crossing], 0.0))
        time_s = np.asarray(np.arange(-len(rest), samples + len(rest)) * SAMPLE_S)
        runs.append(
            RecordedSine(
                name=f"l = {l}",
                sine=sine,
                reports=reports,
                time_s=time_s,
                force_n=np.concatenate([rest, force, rest]),
            )
        )
    return runs
