"""Round trips and the vehicle's clock: quantities with findings, and the rows of table 3.2."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

from cfid.errors import ConfigError, DataError, FitError
from cfid.estimate.propagation import widened
from cfid.estimate.signals import block_means, correlation_inflation
from cfid.findings import rejection, warning
from cfid.latency.clocks import clock_line, unwrapped_s
from cfid.recordings.sines import PINGS, PingRecord, read_pings
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent, Result
from cfid.records.run import Run

Array = npt.NDArray[np.float64]

_HEAD = f"{'circumstances':<28} {'packets':>8} {'mean RTT [ms]':>14} {'std [ms]':>10} {'least [ms]':>11}"
_BINS, _BAR_WIDTH = 12, 40
_EARLIEST_S = 1e9  # since 1970: 2001, before the first vehicle
_FEW_EFFECTIVE = 200.0  # from there on, the correlation itself is known well enough
_PARTS = 10  # of a record, whose means show what wanders too slowly for neighbours to show it
_BY_CHANCE = 0.001  # below it, the means scatter by more than those of independent round trips
_LONGEST = 4  # correlation is followed over one nth of a record
_SHARES = (0.5, 0.95)  # of round trips that are shorter than the stated ones
_BLOCKS, _RESAMPLED = 20, 400  # blocks of a record, and how often records of them are drawn


class RoundTrips(NamedTuple):
    """Statistics of round trips in s; `std_s` is that of a single one (with n - 1), `mean_std_s` that of their mean.

    Neighbours share a burst or a busy channel: their mean is as uncertain as that of `effective` independent round
    trips.
    """

    answers: int
    effective: float
    mean_s: float
    std_s: float
    mean_std_s: float
    least_s: float
    median_s: float
    median_std_s: float
    p95_s: float
    p95_std_s: float
    wander: bool = False

    @property
    def are_correlated(self) -> bool:
        """Whether they are worth half as many or fewer, and too few to know well how uncertain their mean is.

        Round trips that `wander` are correlated, too: the means of parts of the record differ.
        """
        return self.wander or self.effective < min(self.answers / 2, _FEW_EFFECTIVE)

    @property
    def one_way_mean_s(self) -> float:
        """The mean one-way latency in s, if both ways take equally long."""
        return self.mean_s / 2

    @property
    def offset_bound_s(self) -> float:
        """The largest error in s of a clock offset that takes both ways of the quickest answer as equally long."""
        return self.least_s / 2


class Clock(NamedTuple):
    """The vehicle's clock against this computer's.

    `offset_s` is this computer's time less the vehicle's in the middle of the pings, if both ways take equally long at
    their quickest; otherwise it is off by up to `offset_bound_s`. `skew` is the relative excess of the vehicle's rate.
    Answers came `mean_lateness_s` later, on average, than the quickest. Where times are not `dated`, from 1970 on but
    from the start of a record, the offset means nothing.
    """

    offset_s: float
    offset_std_s: float
    offset_bound_s: float
    skew: float
    skew_std: float
    mean_lateness_s: float
    dated: bool

    @property
    def quantities(self) -> dict[str, Parameter]:
        """Skew and, where times are dated, offset."""
        offset = {"latency.clock_offset_s": Parameter(value=self.offset_s, std=self.offset_std_s)} if self.dated else {}
        return {**offset, "latency.clock_skew": Parameter(value=self.skew, std=self.skew_std)}


def fit(runs: Sequence[PingRecord | Run | Path | str]) -> Result:
    """Return the statistics of all round trips together, and the clock of the last run whose answers were stamped.

    A path is that of a run folder, or of a CSV file with a column rtt_s, and with t and vehicle_us where it has them.
    Raises ConfigError for no run, DataError for a run that cannot be read or is named twice, FitError for fewer than
    two round trips.
    """
    records = [_record(run) for run in runs]
    if not records:
        raise ConfigError("no run of pings to read: give at least one.")
    for place, record in enumerate(records):
        if any(record.source.sha256 == before.source.sha256 for before in records[:place]):
            raise DataError(f"{record.name}: the same pings as before: name each run once.")
    rtt_s = np.concatenate([record.rtt_s for record in records])
    trips = round_trips(rtt_s)
    findings = [finding for record in records for finding in record.findings]
    if trips.are_correlated:
        why = "and parts of the record differ" if trips.wander else f"fewer than {_FEW_EFFECTIVE:.0f}"
        text = (
            f"{trips.answers} round trips are worth only {trips.effective:.0f} independent ones, {why}, as late "
            "answers follow each other: the uncertainties of mean and clock are rough."
        )
        findings.append(warning("round-trips-correlated", text, "latency.rtt_mean_s", "latency.clock_*"))
    clock = None
    try:
        clock = _clock(records)
    except DataError as error:
        findings.append(rejection("clock-stamps-too-few", str(error), "latency.clock_*"))
    return Result(
        command="tf latency",
        section="latency",
        method="default",
        quantities={**_trip_quantities(trips), **({} if clock is None else clock.quantities)},
        wanted=("latency.rtt_*",),
        merits={
            "answers": trips.answers,
            "one_way_mean_s": Dependent(trips.one_way_mean_s, "latency.rtt_mean_s"),
            "offset_bound_s": Dependent((clock or trips).offset_bound_s, "latency.rtt_min_s"),
        },
        findings=tuple(findings),
        sources=tuple(record.source for record in records),
        lines=(
            *(Dependent(row, *_trip_quantities(trips)) for row in _table(records, rtt_s)),
            Dependent(
                f"one way, if both take equally long: {1e3 * trips.one_way_mean_s:.2f} ms on average",
                "latency.rtt_mean_s",
            ),
            *(() if clock is None else (Dependent(_clock_line(clock), *clock.quantities),)),
        ),
    )


def round_trips(rtt_s: Array) -> RoundTrips:
    """Return the statistics of round trips (n,) in s, in their order. Raises FitError for fewer than two."""
    count = len(rtt_s)
    if count < 2:
        raise FitError(f"{count} round trip(s) have no standard deviation: at least two are needed.")
    std_s, mean_s = float(np.std(rtt_s, ddof=1)), float(np.mean(rtt_s))
    effective = count / correlation_inflation(rtt_s - mean_s, longest=count // _LONGEST)
    freedom = max(round(effective) - 1, 1)
    of_parts = _effective_of_parts(rtt_s)
    if of_parts < effective:
        effective, freedom = of_parts, min(freedom, _PARTS - 1)
    mean_std_s = widened(std_s / math.sqrt(effective), freedom)
    (median_s, p95_s), (median_std_s, p95_std_s) = (part.tolist() for part in quantiles(rtt_s))
    return RoundTrips(
        answers=count,
        effective=effective,
        mean_s=mean_s,
        std_s=std_s,
        mean_std_s=mean_std_s,
        least_s=float(rtt_s.min()),
        median_s=median_s,
        median_std_s=median_std_s,
        p95_s=p95_s,
        p95_std_s=p95_std_s,
        wander=math.isfinite(of_parts),
    )


def _effective_of_parts(rtt_s: Array) -> float:
    """Return how many independent round trips the means of parts show, infinite where these means scatter by chance.

    A latency that wanders slowly is a small part of each round trip, and hardly correlates neighbours.
    """
    length, variance = len(rtt_s) // _PARTS, float(np.var(rtt_s, ddof=1))
    if length < _PARTS or not variance:
        return math.inf
    scatter = float(np.var(block_means(rtt_s, length=length), ddof=1)) / variance
    return _PARTS / scatter if chdtrc(_PARTS - 1, (_PARTS - 1) * length * scatter) < _BY_CHANCE else math.inf


def quantiles(rtt_s: Array) -> tuple[Array, Array]:
    """Return the median and the 95th percentile of round trips (n,) in their order, and standard uncertainties.

    These are the scatter over records of blocks drawn with replacement: a burst lies within a block.
    """
    blocks = np.array_split(rtt_s, min(_BLOCKS, len(rtt_s)))
    rng = np.random.default_rng(0)
    drawn = [
        np.quantile(np.concatenate([blocks[place] for place in rng.integers(len(blocks), size=len(blocks))]), _SHARES)
        for _ in range(_RESAMPLED)
    ]
    return np.quantile(rtt_s, _SHARES), np.std(drawn, axis=0, ddof=1)


def _record(run: PingRecord | Run | Path | str) -> PingRecord:
    if isinstance(run, PingRecord):
        return run
    return read_pings(run.folder if isinstance(run, Run) else Path(run))


def _clock(records: Sequence[PingRecord]) -> Clock | None:
    """Compare the clocks by the last run with stamps, None without any. Raises DataError for too few.

    Arrivals of answers lie above the line of the clocks, and sendings below it: the sharpest lines there are halfway.
    """
    for record in reversed(records):
        if record.vehicle_us is not None and record.sent_s is not None:
            arrived_s = record.sent_s + record.rtt_s
            device_s = unwrapped_s(record.vehicle_us / 1e6, arrived_s)
            back, there = clock_line(device_s, arrived_s), clock_line(-device_s, -record.sent_s)
            rate = (back.rate + there.rate) / 2
            return Clock(
                offset_s=(back.middle_host_s - there.middle_host_s) / 2 - back.middle_device_s,
                offset_std_s=math.hypot(back.offset_std_s, there.offset_std_s) / 2,
                offset_bound_s=(back.middle_host_s + there.middle_host_s) / 2,
                skew=1 / rate - 1,
                skew_std=math.hypot(back.rate_std, there.rate_std) / 2 / rate**2,
                mean_lateness_s=back.mean_offset_s,
                dated=back.offset_s > _EARLIEST_S,
            )
    return None


def _trip_quantities(trips: RoundTrips) -> dict[str, Parameter]:
    return {
        "latency.rtt_mean_s": Parameter(value=trips.mean_s, std=trips.mean_std_s),
        "latency.rtt_std_s": Parameter(value=trips.std_s),
        "latency.rtt_min_s": Parameter(value=trips.least_s),
        "latency.rtt_median_s": Parameter(value=trips.median_s, std=trips.median_std_s),
        "latency.rtt_p95_s": Parameter(value=trips.p95_s, std=trips.p95_std_s),
    }


def _table(records: Sequence[PingRecord], rtt_s: Array) -> list[str]:
    """Return table 3.2 with a row for each run, and a histogram of all round trips (n,) in s."""
    rows = [_row(record.circumstances or record.name, record.rtt_s) for record in records]
    total = [_row("all", rtt_s)] if len(records) > 1 else []
    counts, edges_s = np.histogram(rtt_s, bins=_BINS)
    bars = [
        f"{1e3 * edge_s:9.3f} ms {'█' * round(_BAR_WIDTH * count / counts.max()):{_BAR_WIDTH}} {count}"
        for edge_s, count in zip(edges_s[:-1], counts, strict=True)
    ]
    return [_HEAD, *rows, *total, *bars]


def _row(circumstances: str, rtt_s: Array) -> str:
    std_ms = f"{1e3 * np.std(rtt_s, ddof=1):.4f}" if len(rtt_s) > 1 else "-"
    return f"{circumstances[:28]:<28} {len(rtt_s):8d} {1e3 * rtt_s.mean():14.4f} {std_ms:>10} {1e3 * rtt_s.min():11.4f}"


def _clock_line(clock: Clock) -> str:
    rate = (
        f"the vehicle's clock: {1e6 * clock.skew:+.1f} ppm against this computer's; answers came "
        f"{1e3 * clock.mean_lateness_s:.2f} ms later, on average, than the quickest. "
    )
    if not clock.dated:
        return f"{rate}Times of sending since the begin of a record, not since 1970, show no offset of the clocks"
    return (
        f"{rate}The standard uncertainty of its offset in the middle, {1e3 * clock.offset_std_s:.2f} ms, covers how "
        "pings scatter; how the quickest round trip divides into its two ways is unknown, and moves the offset by "
        f"up to {1e3 * clock.offset_bound_s:.2f} ms more"
    )


def verdict(run: Run) -> str:
    """Judge pings as soon as they are recorded. Raises FitError for fewer than two answers."""
    mean_ms = 1e3 * fit([run]).quantities["latency.rtt_mean_s"].value
    answers = run.header.devices[PINGS].rows
    return f"{answers} of {run.header.requested['count']} answered, {mean_ms:.1f} ms on average."
