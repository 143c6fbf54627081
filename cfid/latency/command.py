"""`cfid tf latency`: round trips to the vehicle (table 3.2), and its clock against this computer's."""

from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.options import Delivery, RigOptions, flat
from cfid.console.outcome import deliver
from cfid.console.selection import chosen, labelled
from cfid.errors import DataError
from cfid.findings import warning
from cfid.records.result import Result

if TYPE_CHECKING:
    from cfid.latency.clocks import ClockLine
    from cfid.records.parameters import Parameter
    from cfid.records.tables.pings import PingRecord


@flat
def latency(
    *,
    runs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="RUN ...", help="Runs of cfid log ping, or files with rtt_s; default: all complete runs."
        ),
    ] = None,
    rig: RigOptions,
    delivery: Delivery,
) -> None:
    """Tell round trips of pings, and offset and skew of the vehicle's clock where it stamped its answers.

    Of several runs round trips are taken together, and the clock is that of the last one that has stamps.

    Example: [bold]cfid tf latency 2026-11-21_083012_ping[/bold]
    """
    from cfid.records.tables.pings import read_pings

    workplace = open_workplace(rig)
    words = chosen(runs, workplace.campaign, suits=labelled("ping"), wanted="runs of pings")
    records = [read_pings(find_recording(word, workplace)) for word in words]
    for place, record in enumerate(records):
        if any(record.source.sha256 == before.source.sha256 for before in records[:place]):
            raise DataError(f"{record.name}: the same pings as before: name each run once.")
    deliver(_outcome(records, workplace), delivery, workplace.campaign)


def _outcome(records: "list[PingRecord]", workplace: Workplace) -> Result:
    import numpy as np

    from cfid.latency.clocks import ping_latency
    from cfid.latency.estimation import round_trips
    from cfid.latency.result import HEAD, as_parameters, bars, trip_parameters, trip_row

    rtt_s = np.concatenate([record.rtt_s for record in records])
    all_of_them = ping_latency(rtt_s)
    rows = [trip_row(record.circumstances or record.name, round_trips(record.rtt_s)) for record in records]
    total = [trip_row("all", all_of_them.round_trips)] if len(records) > 1 else []
    stamped = [record for record in records if record.vehicle_us is not None and record.sent_s is not None]
    line = _clock(stamped[-1]) if stamped else None
    bound_s = all_of_them.offset_bound_s
    clocks = () if line is None else (_told(line, bound_s),)
    return Result(
        command="tf latency",
        section="latency",
        method="default",
        quantities={**as_parameters(trip_parameters(all_of_them.round_trips)), **_clock_parameters(line, bound_s)},
        quality={"answers": len(rtt_s), "one_way_mean_s": all_of_them.one_way_mean_s, "offset_bound_s": bound_s},
        findings=tuple(warning("recording", text) for record in records for text in record.notes),
        sources=tuple(record.source for record in records),
        lines=(
            HEAD,
            *rows,
            *total,
            *bars(rtt_s),
            f"one way, if both take as long: {1e3 * all_of_them.one_way_mean_s:.2f} ms on average",
            *clocks,
        ),
        folder=workplace.figures_beside([record.path for record in records]),
    )


def _clock(record: "PingRecord") -> "ClockLine":
    """Lay a line under the arrivals of answers over the vehicle's stamps. Raises DataError for too few."""
    from cfid.latency.clocks import clock_line, unwrapped_s

    assert record.vehicle_us is not None
    assert record.sent_s is not None
    arrived_s = record.sent_s + record.rtt_s
    return clock_line(unwrapped_s(record.vehicle_us / 1e6, arrived_s), arrived_s)


def _clock_parameters(line: "ClockLine | None", bound_s: float) -> "dict[str, Parameter]":
    """Return the host's time when the vehicle's clock was zero, as if the quickest answer took half its round trip."""
    from math import hypot

    from cfid.records.parameters import Parameter

    if line is None:
        return {}
    std_s = hypot(line.offset_std_s, line.rate_std * line.middle_device_s)
    return {
        "latency.clock_offset_s": Parameter(value=line.offset_s - bound_s, std=std_s, unit="s"),
        "latency.clock_skew": Parameter(value=line.skew, std=line.rate_std / line.rate**2, unit="1"),
    }


def _told(line: "ClockLine", bound_s: float) -> str:
    return (
        f"the vehicle's clock: {1e6 * line.skew:+.1f} ppm against this computer's, its offset known but for the least "
        f"one-way latency, within {1e3 * bound_s:.2f} ms; answers came {1e3 * line.mean_offset_s:.2f} ms later, on "
        "average, than the quickest"
    )
