"""A crest-optimised odd multisine in one run, against single sines: standard deviations, biases and bench time.

Both drive the same simulated rotor, load cell and radio, and are fitted by the same maximum likelihood. Deviations are
found by repetition. A run is integrated once for each of a few rotors, which vibrate differently; the load cell's noise
and the radio's lateness are drawn again for each repetition. Biases are those of one series without noise and lateness,
also for rotors that are less simple than the identified lag.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import Pool
from multiprocessing.pool import Pool as PoolType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from cfid.estimate.signals import block_means
from cfid.sim.link import Direction, RadioTruth
from cfid.sim.loadcell import LoadCellTruth, SimulatedLoadCell
from cfid.sim.propulsion import NOMINAL_V, RotorTruth, SimulatedRotors
from cfid.transfer.alignment import RecordedSine, Reports, SineRun, SineSeries, align
from cfid.transfer.data import thrust_of
from cfid.transfer.estimation import MeasuredSeries, fit_transfer, measure
from cfid.transfer.frequency_response import END_S, SETTLE_S, Response
from cfid.transfer.plan import SAMPLE_S, Sine
from cfid.wire.app import MIDDLE
from tests.offline.sine_bench import ARM_M, LATE_RADIO, USUAL_CELL
from tests.transfer.sine_recordings import SILENT_CELL

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

ROTORS = int(os.environ.get("BENCH_ROTORS", "3"))
DRAWS = int(os.environ.get("BENCH_DRAWS", "30"))  # for each rotor
PROCESSES = 2

LINES = 31
AMPLITUDE = 20000
PERIOD = 4000  # samples: N of the sines, and the period of the multisine
MOST = 100  # periods within PERIOD: 12.5 Hz, the highest frequency of the fits
OVERHEAD_S = 3.5  # of a run: a second at rest before it, and 2.5 s more in the estimate of `cfid log sine`
REST = 500  # samples before and after each run with the load cell recorded
READINGS = 2  # per sample: 1 kHz
THINNED = 10  # readings per mean, before the least squares of the multisine
BESIDE = 20  # bins on either side of a line from which its noise is estimated
BEGIN_S, VEHICLE_CLOCK, CELL_LATENCY_S = 1.75e9, 84 / 85, 0.0006
PUNCTUAL = RadioTruth(latency_s=0.0, jitter_s=0.0)
RISING = RotorTruth()
FALLING = RotorTruth(time_constant_s=1.5 * RISING.time_constant_s)
GAIN_N = (  # of thrust over command around the middle
    2
    * RISING.thrust_ns2_per_rad2
    * RISING.rad_per_s_per_command
    * (RISING.idle_rad_per_s + RISING.rad_per_s_per_command * MIDDLE)
)
STAMPS = ("on-board stamps", "host stamps alone")
WHAT = ("gain %", "lag %", "delay ms", "least ms")  # delays after the mean report and after the quickest report
HEADER = " " * 56 + "".join(f"{what:>10}" for what in WHAT)


@dataclass(frozen=True, kw_only=True)
class Multisine(Sine):
    """Periods of one wave (4000,) between -1 and 1 with given lines, after the time that a sine needs to settle."""

    wave: Array
    lines: tuple[int, ...]

    def commands(self) -> Array:
        exact = np.round(self.amplitude * self.wave + self.middle, 6)
        return np.asarray(np.trunc(exact)[np.arange(self.samples) % PERIOD])


class Contestant(NamedTuple):
    """Runs that together yield one transfer function."""

    name: str
    plans: Sequence[Sine]

    @property
    def label(self) -> str:
        return f"{self.name}, {self.bench_s:.1f} s"

    @property
    def bench_s(self) -> float:
        return sum(plan.samples * SAMPLE_S + OVERHEAD_S for plan in self.plans)


class Plant(NamedTuple):
    """A rotor: its class, its truth, and how much voltage it loses per second."""

    rotors: type[SimulatedRotors] = SimulatedRotors
    truth: RotorTruth = RISING
    sag_v_per_s: float = 0.0


class Bent(RotorTruth):
    """A steady speed minus a cubic term of the command, which is 5 % of the speed's amplitude at both ends."""

    def steady_rad_per_s(self, command: Array, *, volts: Array | float) -> Array:
        bend = 0.05 * self.rad_per_s_per_command * AMPLITUDE * ((command - MIDDLE) / AMPLITUDE) ** 3
        return np.asarray(super().steady_rad_per_s(command, volts=volts) - np.where(command > 0, bend, 0.0))


class Coasting(SimulatedRotors):
    """Rotors whose motors do not brake: they take one and a half times as long to slow down as to speed up."""

    def advance(self, time_s: Array, command: Array, *, volts: float | None = None) -> Array:
        steady = RISING.steady_rad_per_s(command, volts=NOMINAL_V if volts is None else volts)
        self._truth = FALLING if self.speed_rad_per_s[0] > steady[0] else RISING
        return super().advance(time_s, command, volts=volts)


PLANTS = {
    "as simulated": Plant(),
    "bent": Plant(truth=Bent()),
    "coasting": Plant(rotors=Coasting),
    "sagging": Plant(sag_v_per_s=5e-4),  # what one motor draws from a cell of 240 mAh
}


# The signals.


def spaced(count: int, *, step: int = 1, first: int = 1) -> tuple[int, ...]:
    """Return `count` values of l, from `first` on at multiples of `step`, as even over the logarithm as possible."""
    tried, found = count, ()
    while len(found) < count:
        exact = np.geomspace(first, MOST + 1 - step, tried)
        found = tuple(sorted(set((first + step * np.round((exact - first) / step)).astype(int).tolist())))
        tried += 1
    return found


def sines(count: int, *, first: int = 1, samples: int = PERIOD) -> Contestant:
    plans = [
        Sine(periods=l * samples // PERIOD, samples=samples, amplitude=AMPLITUDE)
        for l in spaced(count, first=first)  # noqa: E741
    ]
    return Contestant(f"{count} sines from l = {plans[0].periods} of {samples}", plans)


def up_and_down(contestant: Contestant) -> Contestant:
    """Return every second frequency rising, then the others falling, so that no time has frequencies of its own."""
    plans = list(contestant.plans)
    return Contestant(f"{contestant.name}, up and down", [*plans[::2], *plans[1::2][::-1]])


def multisine(count: int, *, bench_s: float, step: int = 2) -> Contestant:
    """Return a multisine of as many whole periods as a bench time allows."""
    lines = spaced(count, step=step)
    around = round((SETTLE_S + END_S) / SAMPLE_S)
    periods = int(((bench_s - OVERHEAD_S) / SAMPLE_S - around) / PERIOD)
    plan = Multisine(
        periods=periods * max(lines),  # those of its fastest line
        samples=around + periods * PERIOD,
        amplitude=AMPLITUDE,
        wave=low_crest(lines),
        lines=lines,
    )
    return Contestant(f"{count} {'odd lines' if step == 2 else 'lines, even ones too,'} at once", [plan])


@cache
def low_crest(lines: tuple[int, ...], *, starts: int = 8) -> Array:
    """Return a period of lines of equal amplitude with the lowest peak found, scaled to a peak of 1 at its start.

    Norms of increasing order are minimised one after the other (P. Guillaume, J. Schoukens, R. Pintelon, I. Kollar,
    Crest-factor minimization using nonlinear Chebyshev approximation methods, 1991).
    """
    rng = np.random.default_rng(0)
    coarse = turns(lines, 8 * MOST)
    best, least = np.zeros(len(lines)), np.inf
    for _ in range(starts):
        phases = rng.uniform(0, 2 * np.pi, len(lines))
        for order in 2 ** np.arange(2, 9):
            phases = minimize(log_norm, phases, args=(coarse, order), jac=True, method="L-BFGS-B").x
        peak = float(np.abs((coarse @ np.exp(1j * phases)).real).max())
        if peak < least:
            best, least = phases, peak
    wave = (turns(lines, PERIOD) @ np.exp(1j * best)).real
    return np.asarray(np.roll(wave, -int(wave.argmax())) / np.abs(wave).max())


def turns(lines: Sequence[int], samples: int) -> Complex:
    """Return exp(j l angle) for the angles of one turn (samples, lines)."""
    return np.asarray(np.exp(2j * np.pi / samples * np.outer(np.arange(samples), lines)))


def log_norm(phases: Array, turned: Complex, order: int) -> tuple[float, Array]:
    """Return the logarithm of a wave's norm, and its gradient."""
    lines = turned * np.exp(1j * phases)
    wave = lines.real.sum(axis=1)
    peak = np.abs(wave).max()
    power = np.mean((wave / peak) ** order)
    gradient = (wave / peak) ** (order - 1) @ -lines.imag / (len(wave) * peak * power)
    return float(np.log(peak) + np.log(power) / order), gradient


# The recordings.


def wrenches(contestant: Contestant, plant: Plant, rng: np.random.Generator) -> list[Array]:
    """Return, for each run, the wrench of motor 1 on the load cell (n, 6), at 1/4 and 3/4 of each sample."""
    since_s, found = 0.0, []
    at_rest = np.zeros(REST)
    readings_s = np.array([0.25, 0.75, 1.0]) * SAMPLE_S
    for plan in contestant.plans:
        rotors = plant.rotors(plant.truth, rng)
        rows = []
        for place, command in enumerate([*at_rest, *plan.commands(), *at_rest]):
            volts = NOMINAL_V - plant.sag_v_per_s * (since_s + place * SAMPLE_S - contestant.bench_s / 2)
            rows.append(rotors.advance(place * SAMPLE_S + readings_s, np.array([command, 0, 0, 0]), volts=volts)[:-1])
        found.append(np.vstack(rows))
        since_s += plan.samples * SAMPLE_S + OVERHEAD_S
    return found


def record(
    contestant: Contestant, felt: Sequence[Array], radio: RadioTruth, cell: LoadCellTruth, rng: np.random.Generator
) -> list[RecordedSine]:
    """Return the runs as if recorded one after the other."""
    link, loadcell = Direction(radio, rng), SimulatedLoadCell(cell, rng)
    at_s, runs = BEGIN_S, []
    for plan, wrench in zip(contestant.plans, felt, strict=True):
        time_s = at_s + (np.arange(len(wrench)) + 0.5) * SAMPLE_S / READINGS
        read = loadcell.read(time_s, wrench)[0] / cell.counts_per_unit
        force = thrust_of("arm", read[:, :3], read[:, 3:], arm_m=ARM_M, yaw_deg=0.0)
        reports = reports_of(plan, at_s + REST * SAMPLE_S, link)
        runs.append(
            RecordedSine(
                name=f"l = {plan.periods}", sine=plan, reports=reports, time_s=time_s + CELL_LATENCY_S, force_n=force
            )
        )
        at_s += plan.samples * SAMPLE_S + OVERHEAD_S
    return runs


def reports_of(plan: Sine, start_s: float, link: Direction) -> Reports:
    """Return the reports of crossings, as the app sends them."""
    commands = plan.commands()
    before = np.append(0.0, commands[:-1])
    crosses = ((before > MIDDLE) & (commands <= MIDDLE)) | ((before < MIDDLE) & (commands >= MIDDLE))
    sample = np.append(np.flatnonzero(crosses), len(commands)).astype(np.float64)
    sent_s = start_s + sample * SAMPLE_S
    host_s = np.array([link.arrival_s(time_s) for time_s in sent_s], dtype=np.float64)
    return Reports(
        host_s, np.append(commands[crosses], 0.0), sample, np.floor((sent_s - BEGIN_S) * VEHICLE_CLOCK * 1e6)
    )


def without_stamps(run: RecordedSine) -> RecordedSine:
    return replace(run, reports=Reports(run.reports.host_s, run.reports.command))


# The fits.


def identified(runs: Sequence[RecordedSine], radio: RadioTruth) -> Array:
    """Return the errors (4,) of gain, lag and delays, in the order and units of `WHAT`."""
    series = align(runs)
    measured = respond_at_once(series) if isinstance(runs[0].sine, Multisine) else measure("", series)
    fit = fit_transfer([measured])
    delay = fit.delays[measured.name]
    truth_s = CELL_LATENCY_S - radio.latency_s
    return np.array(
        [
            100 * (fit.gain_n / GAIN_N - 1),
            100 * (fit.time_constant_s / RISING.time_constant_s - 1),
            1e3 * (delay.delay_s - truth_s),
            1e3 * (delay.after_quickest_s - truth_s - radio.jitter_s),
        ]
    )


def respond_at_once(series: SineSeries) -> MeasuredSeries:
    """Return the responses at all lines of a multisine by one least-squares fit, with the noise between the lines."""
    (run,) = series.runs
    plan = run.sine
    assert isinstance(plan, Multisine)
    base = 2 * np.pi / (PERIOD * run.sample_s)
    time_s, force = whole_periods(run)
    columns = columns_of(time_s, base * np.array(plan.lines))
    found = np.linalg.solve(columns @ columns.T, columns @ force)
    levels = noise_levels(force - found @ columns, plan)
    drives = 2 / PERIOD * (plan.commands()[:PERIOD] @ turns(plan.lines, PERIOD).conj())
    drives = drives * kept_by_means(base * np.array(plan.lines), run.sample_s / READINGS)
    phasors = found[3::2] - 1j * found[4::2]
    responses = [
        Response(
            name=f"l = {l}",
            periods=l,
            frequency_rad_s=base * l,
            sample_s=run.sample_s,
            value=complex(phasor / drive),
            covariance=2 * level / len(force) / abs(drive) ** 2 * np.eye(2),
            start_std_s=0.0,
            shared_s={**run.shared_s, "start": run.start_std_s},  # one start time shifts all lines
        )
        for l, phasor, drive, level in zip(plan.lines, phasors, drives, levels, strict=True)  # noqa: E741
    ]
    return MeasuredSeries(
        name="",
        responses=tuple(responses),
        mean_lateness_s=series.mean_lateness_s,
        mean_lateness_std_s=series.mean_lateness_std_s,
    )


def whole_periods(run: SineRun) -> tuple[Array, Array]:
    """Return times and force of all whole periods after settling, as means of a few readings."""
    periods = int((run.duration_s - SETTLE_S - END_S) / (PERIOD * run.sample_s) + 1e-3)
    begin = int(np.searchsorted(run.time_s, SETTLE_S))
    taken = slice(begin, begin + periods * PERIOD * READINGS)
    time_s, force = (block_means(values[taken], length=THINNED) for values in (run.time_s, run.force_n))
    return time_s, force


def columns_of(time_s: Array, omega: Array) -> Array:
    """Return a constant, a linear and a quadratic drift, then cosine and sine of each frequency."""
    place = 2 * (time_s - time_s.mean()) / np.ptp(time_s)
    waves = np.exp(1j * omega[:, None] * time_s)
    pairs = np.stack([waves.real, waves.imag], axis=1).reshape(-1, len(time_s))
    return np.vstack([np.ones_like(place), place, place**2, pairs])


def kept_by_means(omega: Array, step_s: float) -> Array:
    """Return the factors by which means of readings `step_s` apart attenuate waves."""
    return np.asarray(np.sin(THINNED * omega * step_s / 2) / (THINNED * np.sin(omega * step_s / 2)))


def noise_levels(residual: Array, plan: Multisine) -> Array:
    """Return the variance per sample of white noise as strong as that around each line, in bins without harmonics."""
    powers = np.abs(np.fft.rfft(residual)) ** 2 / len(residual)
    periods = plan.samples // PERIOD
    between = np.arange(len(powers)) % periods > 0
    near = [slice(max(l * periods - BESIDE, 0), l * periods + BESIDE + 1) for l in plan.lines]  # noqa: E741
    return np.array([powers[bins][between[bins]].mean() for bins in near])


# The comparison.


def repeat(contestant: Contestant, seed: int) -> Array:
    """Return errors (draws, stamps, 4) with one rotor."""
    rng = np.random.default_rng(seed)
    felt = wrenches(contestant, Plant(), rng)
    errors = []
    for _ in range(DRAWS):
        runs = record(contestant, felt, LATE_RADIO, USUAL_CELL, rng)
        errors.append([identified(own, LATE_RADIO) for own in (runs, [without_stamps(run) for run in runs])])
    return np.array(errors)


def bias(contestant: Contestant, plant: Plant) -> Array:
    """Return errors (4,) without noise and lateness."""
    rng = np.random.default_rng(0)
    felt = wrenches(contestant, plant, rng)
    return identified(record(contestant, felt, PUNCTUAL, SILENT_CELL, rng), PUNCTUAL)


def needed_s(contestant: Contestant, deviations: Array, wanted: Array) -> Array:
    """Return the bench time of one run that reaches the wanted deviations: variances fall with the used time."""
    (plan,) = contestant.plans
    beside_s = OVERHEAD_S + SETTLE_S + END_S
    return np.asarray(beside_s + (plan.samples * SAMPLE_S - SETTLE_S - END_S) * (deviations / wanted) ** 2)


def compare(one_by_one: Contestant, errors: Array, at_once: Contestant, at_once_errors: Array) -> None:
    """Print deviations of errors (repetitions, stamps, 4), and the time in which the multisine matches the sines."""
    for place, stamps in enumerate(STAMPS):
        deviations = [found[:, place].std(axis=0, ddof=1) for found in (errors, at_once_errors)]
        print(f"{stamps}:")
        print_row(one_by_one.label, deviations[0])
        print_row(at_once.label, deviations[1])
        print_row("its time for the same, over theirs", needed_s(at_once, *deviations[::-1]) / one_by_one.bench_s)
    print()


def print_row(name: str, figures: Array) -> None:
    print(f"  {name:<54}" + "".join(f"{figure:10.3f}" for figure in figures))


def repetitions(pool: PoolType, contestants: Sequence[Contestant]) -> list[Array]:
    """Return the errors of each contestant with all rotors (repetitions, stamps, 4)."""
    jobs = [(each, seed) for each in contestants for seed in range(ROTORS)]
    errors = pool.starmap(repeat, jobs, chunksize=1)
    return [np.concatenate(errors[place : place + ROTORS]) for place in range(0, len(errors), ROTORS)]


def print_deviations(pool: PoolType) -> None:
    mixed = [up_and_down(sines(10, first=2)), up_and_down(sines(10, samples=2 * PERIOD))]
    singles = [sines(10), *mixed, sines(43), up_and_down(sines(43, first=2))]
    rivals = {bench_s: multisine(LINES, bench_s=bench_s) for bench_s in (single.bench_s for single in singles)}
    errors = dict(zip(rivals, repetitions(pool, list(rivals.values())), strict=True))
    print(f"deviations of {ROTORS * DRAWS} series; {OVERHEAD_S:g} s a run are counted beside what is played\n{HEADER}")
    for single, own in zip(singles, repetitions(pool, singles), strict=True):
        compare(single, own, rivals[single.bench_s], errors[single.bench_s])


def print_biases(pool: PoolType) -> None:
    ten = sines(10)
    rivals = [multisine(LINES, bench_s=ten.bench_s, step=step) for step in (2, 1)]
    cases = [(each, plant) for plant in PLANTS for each in (ten, *rivals)]
    cases += [(each, "sagging") for each in (sines(20), up_and_down(sines(20)))]
    found = pool.starmap(bias, [(each, PLANTS[plant]) for each, plant in cases], chunksize=1)
    print(f"biases, without noise or lateness\n{HEADER}")
    for (contestant, plant), figures in zip(cases, found, strict=True):
        print_row(f"{plant}: {contestant.name}", figures)


def main() -> None:
    crest = 1 / np.sqrt(np.mean(low_crest(spaced(LINES, step=2)) ** 2))
    print(f"{LINES} odd lines up to {MOST / PERIOD / SAMPLE_S:g} Hz; their peak is {crest:.2f} times their rms value")
    with Pool(PROCESSES) as pool:
        print_deviations(pool)
        print_biases(pool)


if __name__ == "__main__":
    main()
