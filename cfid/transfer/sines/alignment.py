"""Put sine runs on one time base: when each sample was played, and the thrust that the load cell measured then.

Forces are in newtons of thrust on the host's clock, as stamped. Times within a run count from its sample 0 as if every
report had arrived as fast as the fastest; the mean delay of the others is stated with them.
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
from cfid.latency.clocks import COUNTER_S, ClockLine, Start, clock_line, sessions, start_by_phase, unwrapped_s
from cfid.recordings.wrench import turn_about_z
from cfid.transfer.sines.plan import SAMPLE_S, Sine
from cfid.transfer.sines.reports import Matched, Reports, match_reports
from cfid.units import MOTOR_AZIMUTH_DEG

Array = npt.NDArray[np.float64]
Channel = Literal["Fz", "Tx", "Ty", "arm"]
Sign = Literal["auto", "+", "-"]

# Parts of the force that are kept: from this long before the run, with the baseline until this long before it, to this
# long after its end.
_BEFORE_S, _BASELINE_S, _MARGIN_S = 0.9, 0.1, 0.5
_SMALLEST_BASELINE = 10
_LARGEST_GAP_S = 0.25
# Reports at least this far apart do not, or seldom, wait for each other in the radio.
_APART_S, _NEAR_S = 0.06, 0.035
_FEWEST_USUAL = 12  # reports of a run, the least from which the shortest delay is known
_LOOP_STD = 1.5e-3  # the firmware warns when its loop period is more than 0.3 % off


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedSine:
    """A requested sine, its reports as they arrived, and thrust (n,) in N, with bias, at the host's times (n,) in s."""

    name: str
    sine: Sine
    reports: Reports
    time_s: Array
    force_n: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SineRun:
    """A run on its own time: sample n is played at n `sample_s`, and time 0 is `start_s` on the host's clock.

    `time_s`, `force_n` (n,) reach from the baseline before the run to after its end, with bias and sign corrected.
    `start_std_s` is the standard uncertainty of this run's start alone; `shared_s` are those that runs share, by name,
    each with its sign.
    """

    name: str
    sine: Sine
    start_s: float
    start_std_s: float
    shared_s: Mapping[str, float]
    sample_s: float
    time_s: Array
    force_n: Array
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


class _Synchronised(NamedTuple):
    start: Start
    shared_s: Mapping[str, float]
    sample_s: float
    lateness_s: Array


def thrust_of(
    channel: Channel, force_n: Array, torque_nm: Array, *, arm_m: float, motor: int = 1, yaw_deg: float = -45.0
) -> Array:
    """Return a motor's thrust (n,) in N by a channel, from forces and torques (n, 3) in N and N m.

    `yaw_deg` turns the cell's vectors into the vehicle's frame (see `turn_about_z`). The thesis turned the vehicle left
    by 45 degrees on the load cell, a yaw of -45, so that motor 1 lies on the cell's x axis, 4 on y, 3 on -x and 2 on
    -y. A thrust f up at (x, y) causes Tx = y f and Ty = -x f: motors 1 and 3 load Ty with -1 and +1 times f `arm_m`, 2
    and 4 load Tx with -1 and +1. C.2.5 has that minus for motor 1. "Tx" and "Ty", the cell's own, are divided by the
    arm and keep their sign; "arm" projects on the motor's own arm for any `yaw_deg`, with thrust positive.
    """
    if channel == "Fz":
        return force_n[:, 2]
    if motor not in MOTOR_AZIMUTH_DEG:
        raise DataError("all motors together make no torque about an arm: use the channel Fz.")
    if channel == "arm":
        angle, torque_nm = math.radians(MOTOR_AZIMUTH_DEG[motor]), turn_about_z(torque_nm, yaw_deg=yaw_deg)
        return np.asarray((math.sin(angle) * torque_nm[:, 0] - math.cos(angle) * torque_nm[:, 1]) / arm_m)
    return np.asarray(torque_nm[:, 0 if channel == "Tx" else 1] / arm_m)


def held(commands: Array, time_s: Array, *, sample_s: float = SAMPLE_S) -> Array:
    """Return the command (n,) in effect at times (n,) since sample 0: each is held for one sample, and 0 outside."""
    place = np.clip(np.floor(time_s / sample_s + 1e-9), -1, len(commands)).astype(np.intp)
    return np.asarray(np.concatenate([[0.0], commands, [0.0]])[place + 1])


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
    matched = [_matched(run) for run in recorded]
    if not matched:
        raise DataError("no sine run is left to align.")
    if all(reports.vehicle_us is not None for reports in matched):
        found, lines = _by_vehicle(matched)
    else:
        found, lines = _by_phase(matched), ()
    runs = [_cut(run, by, sign) for run, by in zip(recorded, found, strict=True)]
    free = np.concatenate(
        [by.lateness_s[_waits_for_none(own, by.sample_s)] for own, by in zip(matched, found, strict=True)]
    )
    return SineSeries(
        runs=tuple(runs),
        mean_lateness_s=float(free.mean()),
        mean_lateness_std_s=float(mean_of(free).std[0]) if len(free) > 1 else math.inf,
        lines=lines,
        findings=_findings(runs, stamped=bool(lines)),
    )


def _matched(run: RecordedSine) -> Matched:
    try:
        return match_reports(run.sine, run.reports)
    except DataError as error:
        raise DataError(f"{run.name}: {error}") from None


def _by_vehicle(matched: Sequence[Matched]) -> tuple[list[_Synchronised], tuple[ClockLine, ...]]:
    """Map the vehicle's time of each sample to the host's clock by one line for all runs since the vehicle started."""
    order = sorted(range(len(matched)), key=lambda place: matched[place].host_s[0])
    device_s = [np.asarray(matched[place].vehicle_us, dtype=np.float64) / 1e6 for place in order]
    host_s = [matched[place].host_s for place in order]
    numbers = np.array(sessions([own[0] for own in device_s], [own[0] for own in host_s]))
    found: dict[int, _Synchronised] = {}
    lines = []
    for number in range(numbers[-1] + 1):
        places = np.flatnonzero(numbers == number)
        used = [_line_rows(matched[order[place]], alone=len(places) == 1) for place in places]
        host = np.concatenate([host_s[place][rows] for place, rows in zip(places, used, strict=True)])
        device = np.concatenate([device_s[place][rows] for place, rows in zip(places, used, strict=True)])
        lines.append(clock_line(unwrapped_s(device, host), host))
        for place in places:
            by = _on_line(lines[-1], matched[order[place]].sample, device_s[place], host_s[place])
            found[order[place]] = by._replace(shared_s={f"{what} {number}": v for what, v in by.shared_s.items()})
    return [found[place] for place in range(len(matched))], tuple(lines)


def _line_rows(reports: Matched, *, alone: bool) -> npt.NDArray[np.intp]:
    """Return the reports for a line fit: those that seldom wait for others, or a selection of a single dense run."""
    rows = np.flatnonzero(_waits_for_none(reports, SAMPLE_S, apart_s=_NEAR_S))
    if len(rows) > 2 or not alone:
        return rows
    return np.flatnonzero(np.diff(np.floor(reports.sample * SAMPLE_S / _NEAR_S), prepend=-1) > 0)


def _on_line(line: ClockLine, sample: Array, device_s: Array, host_s: Array) -> _Synchronised:
    turns = np.round((float(line.device_s(host_s[0])) - device_s[0]) / COUNTER_S)
    device_s = unwrapped_s(device_s, host_s) + turns * COUNTER_S
    first_s, sample_s = np.polynomial.polynomial.polyfit(sample, device_s, 1)
    # Stamps on board are exact to microseconds, so the run has no error of its own; the line's remains.
    shared_s = {"offset": line.offset_std_s, "rate": line.rate_std * float(first_s - line.middle_device_s)}
    start = Start(float(line.host_s(first_s)), 0.0)
    return _Synchronised(start, shared_s, line.rate * float(sample_s), host_s - line.host_s(device_s))


def _by_phase(matched: Sequence[Matched]) -> list[_Synchronised]:
    """Find the start of each run from its own reports; sampling time and the radio's jitter come from all runs."""
    sample_s = _common_sample_s(matched)
    lags = [reports.host_s - reports.sample * sample_s for reports in matched]
    free = [lag[_waits_for_none(reports, sample_s)] for reports, lag in zip(matched, lags, strict=True)]
    usual = _usual_lateness(free if sum(map(len, free)) > _FEWEST_USUAL else lags)
    starts = [
        start_by_phase(lag, lateness_s=usual, spacing_s=_spacing_s(reports, sample_s))
        for reports, lag in zip(matched, lags, strict=True)
    ]
    shared_s = {"quickest": float(usual.mean()) * math.sqrt(len(free)) / len(usual)}
    return [
        _Synchronised(start, shared_s, sample_s, lag - start.start_s) for start, lag in zip(starts, lags, strict=True)
    ]


def _usual_lateness(lags: Sequence[Array]) -> Array:
    """Return the delays of reports after the fastest, from runs with enough reports to know the fastest."""
    enough = min(_FEWEST_USUAL, max(len(lag) for lag in lags))
    above = [lag - lag.min() for lag in lags if len(lag) >= enough]
    return np.concatenate([late_s + late_s.sum() / (len(late_s) * max(len(late_s) - 1, 1)) for late_s in above])


def _common_sample_s(matched: Sequence[Matched]) -> float:
    """Return the weighted mean of the sampling times of all runs and of the firmware's."""
    rates, weights = [1.0], [_LOOP_STD**-2]
    for reports in matched:
        rows = _line_rows(reports, alone=False)
        if len(rows) > 3:
            line = clock_line(reports.sample[rows] * SAMPLE_S, reports.host_s[rows])
            rates.append(line.rate)
            weights.append((line.rate_std + 1e-9) ** -2)
    return SAMPLE_S * float(np.average(rates, weights=weights))


def _spacing_s(reports: Matched, sample_s: float) -> float:
    return float(np.ptp(reports.sample)) * sample_s / max(len(reports.sample) - 1, 1)


def _waits_for_none(reports: Matched, sample_s: float, *, apart_s: float = _APART_S) -> npt.NDArray[np.bool_]:
    """Return which reports (n,) had no other report pending before them."""
    return np.diff(reports.sample, prepend=-math.inf) * sample_s >= apart_s


def _cut(recorded: RecordedSine, by: _Synchronised, sign: Sign) -> SineRun:
    """Return the run's part of the load cell's record, without its bias."""
    start_s, end_s = by.start.start_s, recorded.sine.samples * by.sample_s
    begin, end = np.searchsorted(recorded.time_s, [start_s - _BEFORE_S, start_s + end_s + _MARGIN_S])
    time_s, force = recorded.time_s[begin:end] - start_s, recorded.force_n[begin:end]
    _check_cover(recorded, time_s, end_s, start_s=start_s)
    baseline = force[time_s < -_BASELINE_S]
    bias = float(baseline.mean()) if len(baseline) >= _SMALLEST_BASELINE else None
    run = SineRun(
        name=recorded.name,
        sine=recorded.sine,
        start_s=start_s,
        start_std_s=by.start.std_s,
        shared_s=by.shared_s,
        sample_s=by.sample_s,
        time_s=time_s,
        force_n=force if bias is None else force - bias,
        bias_n=bias,
        sign=1,
    )
    return run if _points_up(run, sign) else replace(run, force_n=-run.force_n, sign=-1)


def _points_up(run: SineRun, sign: Sign) -> bool:
    if sign == "auto" and run.bias_n is not None:
        return bool(run.force_n[(run.time_s > 0) & (run.time_s < run.duration_s)].mean() >= 0)
    return sign != "-"


def _check_cover(recorded: RecordedSine, time_s: Array, end_s: float, *, start_s: float) -> None:
    inside = time_s[(time_s >= 0) & (time_s <= end_s)]
    edges = np.concatenate([[0.0], inside, [end_s]])
    gaps = np.diff(edges)
    if gaps.max() <= _LARGEST_GAP_S:
        return
    raise DataError(
        f"{recorded.name}: the load cell's record does not cover the run: of its {end_s:.1f} s the "
        f"{gaps.max():.1f} s from {edges[gaps.argmax()]:.1f} s on are missing; the record reaches from "
        f"{recorded.time_s[0] - start_s:.1f} to {recorded.time_s[-1] - start_s:.1f} s. Is it the file of another run, "
        "or was logging stopped?"
    )


def _findings(runs: Sequence[SineRun], *, stamped: bool) -> tuple[Finding, ...]:
    unbiased = ", ".join(run.name for run in runs if run.bias_n is None)
    no_baseline = f"no baseline was recorded before {unbiased}: bias and sign are not corrected."
    no_stamps = "crossings carry no time of the vehicle: each run's start comes from the phase of its sine."
    return (
        *((warning("sine-without-baseline", no_baseline, "tf.*"),) if unbiased else ()),
        *(() if stamped else (note("sine-without-stamps", no_stamps, "tf.*"),)),
    )
