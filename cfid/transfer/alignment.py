"""Put sine runs on one time base: when each sample was played, and the thrust that the load cell measured then.

The vehicle reports its first sample, each crossing of the middle, and, with the value 0, that the motors are off
(C.2.4). cfid's app adds sample and time on board; the module of 2015 does not. Forces are in newtons of thrust on the
host's clock, as stamped. Times within a run count from its sample 0 as if every report had arrived as fast as the
fastest; the mean delay of the others is stated with them.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.estimate.linear import mean_of
from cfid.findings import Finding, note, warning
from cfid.latency.clocks import COUNTER_S, ClockLine, clock_line, sessions, unwrapped_s
from cfid.transfer.plan import SAMPLE_S, Sine

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]
Sign = Literal["auto", "+", "-"]

_LONGEST = 10_000_000  # samples, five and a half hours
_SLACK_S = 0.3  # the time that the radio may add to a run
_DENSE_S = 0.1  # between crossings whose phases the radio's latencies hide
_COHERENT = 0.5  # of crossings at equal phases, as far as radio latencies allow
_LOST = 0.5  # share of reports with stamps that may be missing; fast sines lose more of them in the radio
_LOST_DENSE, _UNRESOLVED_S = 0.9, 0.03
# Parts of the force that are kept: from this long before the run, with the baseline until this long before it, to this
# long after its end.
_BEFORE_S, _BASELINE_S, _MARGIN_S = 0.9, 0.1, 0.5
_SMALLEST_BASELINE = 10
_LARGEST_GAP_S = 0.25
# Reports at least this far apart do not, or seldom, wait for each other in the radio.
_APART_S, _NEAR_S = 0.06, 0.035
_LOOP_STD = 1.5e-3  # the firmware warns when its loop period is more than 0.3 % off
_HELD_UP = 50  # reports back, the earliest that may still hold one up


class Reports(NamedTuple):
    """Reports (m,) of one sine as they arrived: host's time in s, command; sample and microseconds from cfid's app."""

    host_s: Array
    command: Array
    sample: Array | None = None
    vehicle_us: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedSine:
    """A requested sine, its reports as they arrived, and thrust (n,) in N, with bias, at the host's times (n,) in s.

    Where the load cell has its `own_clock`, this agrees with the host's at the first sample, and may run at another
    rate.
    """

    name: str
    sine: Sine
    reports: Reports
    time_s: Array
    force_n: Array
    own_clock: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class SineRun:
    """A run on its own time: sample n is played at n `sample_s`, and time 0 is `start_s` on the host's clock.

    `time_s`, `force_n` (n,) reach from the baseline before the run to after its end, with bias and sign corrected.
    `first_s` is the first stamp of a load cell with its own clock, None for one on the host's. `start_std_s` is the
    standard uncertainty of this run's start alone; `shared_s` are those that runs share, by name, each with its sign.
    """

    name: str
    sine: Sine
    start_s: float
    start_std_s: float
    shared_s: Mapping[str, float]
    sample_s: float
    time_s: Array
    force_n: Array
    first_s: float | None
    bias_n: float | None
    sign: int

    @property
    def duration_s(self) -> float:
        """The duration of the run."""
        return self.sine.samples * self.sample_s

    @property
    def frequency_rad_s(self) -> float:
        """The sine's frequency on the host's clock."""
        return self.sine.omega_rad / self.sample_s


@dataclass(frozen=True, kw_only=True, eq=False)
class SineSeries:
    """Runs on one time base; on average, reports arrive `mean_lateness_s` later than the fastest.

    `lines` compare the vehicle's clock with the host's, with one line for each start of the vehicle; none without the
    vehicle's stamps.
    """

    runs: tuple[SineRun, ...]
    mean_lateness_s: float
    mean_lateness_std_s: float
    lines: tuple[ClockLine, ...]
    findings: tuple[Finding, ...]


class Matched(NamedTuple):
    """Reports (k,) with known samples; from the module of 2015 without the last, which comes a sample early."""

    sample: Array
    host_s: Array
    vehicle_us: Array | None

    def waits_for_none(self, sample_s: float = SAMPLE_S, *, apart_s: float = _APART_S) -> npt.NDArray[np.bool_]:
        """Return which reports (k,) had no other report pending before them."""
        return np.diff(self.sample, prepend=-math.inf) * sample_s >= apart_s


class _Synchronised(NamedTuple):
    start_s: float
    start_std_s: float
    shared_s: Mapping[str, float]
    sample_s: float
    lateness_s: Array


def with_end(recorded: Sequence[RecordedSine]) -> tuple[list[RecordedSine], tuple[Finding, ...]]:
    """Return the runs whose last report arrived, and a warning about the others; all runs if none has it."""
    lost = [run for run in recorded if len(run.reports.command) and run.reports.command[-1] != 0]
    if not lost or len(lost) == len(recorded):
        return list(recorded), ()
    text = (
        f"{', '.join(run.name for run in lost)}: the report of the end is missing, by the radio or as the run was cut "
        f"short. {len(lost)} of {counted(len(recorded), 'run')} left out."
    )
    return [run for run in recorded if run not in lost], (warning("sine-without-end", text, "tf.*"),)


def align(recorded: Sequence[RecordedSine], *, sign: Sign = "auto") -> SineSeries:
    """Find when each sample was played, by on-board stamps if all runs have them, else by each sine's phase.

    Sign "auto" takes thrust to be positive: motors push one way. Raises DataError with the run's name for reports or
    load-cell files that are not those of the run.
    """
    if not recorded:
        raise DataError("no sine run is left to align.")
    matched = []
    for run in recorded:
        try:
            matched.append(match_reports(run.sine, run.reports))
        except DataError as error:
            raise DataError(f"{run.name}: {error}") from None
    stamped = all(reports.vehicle_us is not None for reports in matched)
    starts, lines = _by_vehicle(matched) if stamped else (_by_phase(matched), ())
    runs = [_cut(run, start, sign) for run, start in zip(recorded, starts, strict=True)]
    free = np.concatenate(
        [
            start.lateness_s[reports.waits_for_none(start.sample_s)]
            for reports, start in zip(matched, starts, strict=True)
        ]
    )
    unbiased = ", ".join(run.name for run in runs if run.bias_n is None)
    no_baseline = f"no baseline was recorded before {unbiased}: bias and sign are not corrected."
    no_stamps = "crossings carry no time of the vehicle: each run's start comes from the phase of its sine."
    return SineSeries(
        runs=tuple(runs),
        mean_lateness_s=float(free.mean()),
        mean_lateness_std_s=float(mean_of(free).std[0]) if len(free) > 1 else math.inf,
        lines=lines,
        findings=(
            *((warning("sine-without-baseline", no_baseline, "tf.*"),) if unbiased else ()),
            *(() if stamped else (note("sine-without-stamps", no_stamps, "tf.*"),)),
        ),
    )


def match_reports(sine: Sine, reports: Reports) -> Matched:
    """Return the samples of a sine's reports.

    Raises DataError when there are too few reports, when the run was cut short, or when they are those of another N or
    l. Without samples of the vehicle, all reports have to be there.
    """
    if sine.samples > _LONGEST:
        hours = sine.samples * SAMPLE_S / 3600
        raise DataError(f"N = {sine.samples} would last {hours:.0f} hours: state the N it was played with.")
    commands = sine.commands()
    before = np.append(0.0, commands[:-1])
    falling = (before > sine.middle) & (commands <= sine.middle)
    expected = np.flatnonzero(falling | ((before < sine.middle) & (commands >= sine.middle)))
    _check_ends(sine, reports, len(expected) + 1, commands[0])
    if reports.sample is not None:
        is_own = reports.sample[-1] == sine.samples and np.isin(reports.sample[:-1], expected).all()
        _check_course(sine, len(expected) + 1, len(reports.sample), float(reports.sample[-1]), fits=bool(is_own))
        return Matched(reports.sample, reports.host_s, reports.vehicle_us)
    place = (reports.host_s - reports.host_s[0]) / SAMPLE_S
    count, played = len(expected) + 1, float(place[-1])
    coherence = abs(np.exp(4j * np.pi * sine.periods / sine.samples * place[1:-1]).mean()) if count > 2 else 1.0
    fits = abs(played - sine.samples) <= _SLACK_S / SAMPLE_S and (
        coherence > _COHERENT or sine.half_period_s < _DENSE_S
    )
    if fits and len(place) < count:
        raise DataError(
            f"{count - len(place)} of {count} reports are missing, and without the vehicle's own stamps it is unknown "
            "which: record it with cfid's app, or use `method` thesis."
        )
    _check_course(sine, count, len(place), played, fits=fits and len(place) == count)
    # An exact middle may be one unit too low on board: the sine then crosses one sample later.
    step = sine.amplitude * sine.omega_rad
    late = (commands[expected] == sine.middle) & (reports.command[:-1] - sine.middle > 0.5 * step)
    return Matched((expected + late).astype(np.float64), reports.host_s[:-1], None)


def _check_ends(sine: Sine, reports: Reports, expected: int, first: float) -> None:
    count = len(reports.host_s)
    lost = _LOST if sine.half_period_s > _UNRESOLVED_S else _LOST_DENSE
    if count < max(min(3, expected), (1 - lost) * expected):
        raise DataError(
            f"too few crossings: {counted(count, 'report')}, where a sine of {sine.hz:g} Hz makes {expected}. "
            "Record it again, or look whether its file is that of another run."
        )
    if reports.command[-1] != 0:
        raise DataError(
            f"cut short: its last report is {reports.command[-1]:.0f} and not the 0 that "
            "reports the motors off. Record it again."
        )
    is_first = reports.sample is None or reports.sample[0] == 0
    if is_first and abs(reports.command[0] - first) > 1:
        raise DataError(
            f"it began with {reports.command[0]:.0f}, a sine of amplitude {sine.amplitude:.0f} begins "
            f"with {first:.0f}: state its amplitude, or record it again if its first report was lost."
        )


def _check_course(sine: Sine, expected: int, count: int, played: float, *, fits: bool) -> None:
    if not fits:
        raise DataError(
            f"it played {SAMPLE_S * played:.1f} s with {counted(count, 'report')}, where {sine.hz:g} Hz for "
            f"{SAMPLE_S * sine.samples:g} s make {expected}: was it cut short, or were two runs swapped?"
        )


def _by_vehicle(matched: Sequence[Matched]) -> tuple[list[_Synchronised], tuple[ClockLine, ...]]:
    """Map the vehicle's time of each sample to the host's clock by one line for all runs since the vehicle started."""
    order = sorted(range(len(matched)), key=lambda place: matched[place].host_s[0])
    device_s = [np.asarray(matched[place].vehicle_us, dtype=np.float64) / 1e6 for place in order]
    host_s = [matched[place].host_s for place in order]
    numbers = np.array(sessions([own[0] for own in device_s], [own[0] for own in host_s]))
    starts: dict[int, _Synchronised] = {}
    lines = []
    for number in range(numbers[-1] + 1):
        places = np.flatnonzero(numbers == number)
        used = [_line_rows(matched[order[place]], alone=len(places) == 1) for place in places]
        host = np.concatenate([host_s[place][rows] for place, rows in zip(places, used, strict=True)])
        device = np.concatenate([device_s[place][rows] for place, rows in zip(places, used, strict=True)])
        line = clock_line(unwrapped_s(device, host), host)
        lines.append(line)
        for place in places:
            turns = np.round((float(line.device_s(host_s[place][0])) - device_s[place][0]) / COUNTER_S)
            stamps_s = unwrapped_s(device_s[place], host_s[place]) + turns * COUNTER_S
            first_s, sample_s = np.polynomial.polynomial.polyfit(matched[order[place]].sample, stamps_s, 1)
            # Stamps on board are exact to microseconds, so the run has no error of its own; the line's remains.
            starts[order[place]] = _Synchronised(
                start_s=float(line.host_s(first_s)),
                start_std_s=0.0,
                shared_s={
                    f"offset {number}": line.offset_std_s,
                    f"rate {number}": line.rate_std * float(first_s - line.middle_device_s),
                },
                sample_s=line.rate * float(sample_s),
                lateness_s=host_s[place] - line.host_s(stamps_s),
            )
    return [starts[place] for place in range(len(matched))], tuple(lines)


def _line_rows(reports: Matched, *, alone: bool) -> Rows:
    """Return the reports for a line fit: those that seldom wait for others, or a selection of a single dense run."""
    rows = np.flatnonzero(reports.waits_for_none(apart_s=_NEAR_S))
    if len(rows) > 2 or not alone:
        return rows
    return np.flatnonzero(np.diff(np.floor(reports.sample * SAMPLE_S / _NEAR_S), prepend=-1) > 0)


def _by_phase(matched: Sequence[Matched]) -> list[_Synchronised]:
    """Find the start of each run from its earliest report; sampling time and mean lateness come from all runs.

    The least of n latencies that are exponential beyond the quickest lies 1/n of their mean above it, and scatters by
    as much.
    """
    rates, weights = [1.0], [_LOOP_STD**-2]
    for reports in matched:
        rows = _line_rows(reports, alone=False)
        if len(rows) > 3:
            line = clock_line(reports.sample[rows] * SAMPLE_S, reports.host_s[rows])
            rates.append(line.rate)
            weights.append((line.rate_std + 1e-9) ** -2)
    sample_s = SAMPLE_S * float(np.average(rates, weights=weights))
    lags = [reports.host_s - reports.sample * sample_s for reports in matched]
    free = [lag[reports.waits_for_none(sample_s)] for reports, lag in zip(matched, lags, strict=True)]
    usual = free if any(len(lag) > 1 for lag in free) else lags
    count = sum(map(len, usual))
    late_s = float(sum((lag - lag.min()).sum() for lag in usual)) / max(count - len(usual), 1)
    shared_s = {"quickest": late_s * math.sqrt(len(usual)) / count}
    starts = []
    for reports, lag in zip(matched, lags, strict=True):
        # Packets do not overtake each other: of dense reports, those count that none before them would have held up.
        spacing_s = float(np.ptp(reports.sample)) * sample_s / max(len(lag) - 1, 1)
        held_up = np.exp(-np.arange(1, 1 + _HELD_UP) * spacing_s / max(late_s, 1e-9))
        least_s = late_s / max(len(lag) * float(np.prod(1 - held_up)), 1.0)
        start_s = float(lag.min()) - least_s
        starts.append(_Synchronised(start_s, least_s, shared_s, sample_s, lag - start_s))
    return starts


def _cut(recorded: RecordedSine, by: _Synchronised, sign: Sign) -> SineRun:
    """Return the run's part of the load cell's record, without its bias."""
    end_s = recorded.sine.samples * by.sample_s
    begin, end = np.searchsorted(recorded.time_s, [by.start_s - _BEFORE_S, by.start_s + end_s + _MARGIN_S])
    time_s, force = recorded.time_s[begin:end] - by.start_s, recorded.force_n[begin:end]
    gaps = np.diff(np.concatenate([[0.0], time_s[(time_s >= 0) & (time_s <= end_s)], [end_s]]))
    if gaps.max() > _LARGEST_GAP_S:
        raise DataError(
            f"{recorded.name}: the load cell's record does not cover the run: of its {end_s:.1f} s {gaps.max():.1f} s "
            f"are missing; the record reaches from {recorded.time_s[0] - by.start_s:.1f} to "
            f"{recorded.time_s[-1] - by.start_s:.1f} s. Is it the file of another run, or was logging stopped?"
        )
    baseline = force[time_s < -_BASELINE_S]
    bias = float(baseline.mean()) if len(baseline) >= _SMALLEST_BASELINE else None
    run = SineRun(
        name=recorded.name,
        sine=recorded.sine,
        start_s=by.start_s,
        start_std_s=by.start_std_s,
        shared_s=by.shared_s,
        sample_s=by.sample_s,
        time_s=time_s,
        force_n=force if bias is None else force - bias,
        first_s=float(recorded.time_s[0]) - by.start_s if recorded.own_clock else None,
        bias_n=bias,
        sign=1,
    )
    down = sign == "-"
    if sign == "auto" and bias is not None:
        down = bool(run.force_n[(time_s > 0) & (time_s < end_s)].mean() < 0)
    return replace(run, force_n=-run.force_n, sign=-1) if down else run
