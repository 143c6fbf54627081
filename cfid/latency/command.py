"""`cfid log ping` and `cfid tf latency`: round trips to the vehicle (table 3.2), and its clock."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.console.inputs import find_recording, open_workplace
from cfid.console.labels import Note
from cfid.console.options import Figures, Force, Out
from cfid.console.outcome import Delivery, deliver
from cfid.console.recording import DryRun, rehearse_devices, rig_of
from cfid.console.selection import chosen
from cfid.console.vehicle import Uri
from cfid.counted import counted
from cfid.errors import FitError
from cfid.lazy import later
from cfid.records.choose import labelled

if TYPE_CHECKING:
    from cfid.records.run import Run

_EVERY_S = 0.1  # from one ping to the next


def latency(
    runs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="RUN ...", help="Runs of cfid log ping, or files with a column rtt_s; default: all complete runs."
        ),
    ] = None,
    *,
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Report round trips of pings, and the vehicle's clock offset and skew if it stamped its answers.

    The round trips of several runs are pooled; clock offset and skew are those of the last run with stamps.

    Example: cfid tf latency 2026-11-21_083012_ping
    """
    from cfid.latency import fit

    workplace = open_workplace()
    words = chosen(runs, workplace.campaign, suits=labelled("ping"), wanted="runs of pings")
    result = fit([find_recording(word, workplace) for word in words])
    deliver(result, Delivery(force, figures, out), workplace)


def ping(
    *,
    count: Annotated[int, typer.Option(min=1, help="Number of round trips.")] = 1000,
    uri: Uri = None,
    dry_run: DryRun = False,
    note: Note = None,
) -> None:
    """Measure round trips to the vehicle: mean, standard deviation, minimum, histogram (table 3.2). No motor turns.

    Example: cfid log ping --count 500 --note "just started up"
    """
    from cfid.latency.record import record_pings

    rig = rig_of()
    if dry_run:
        rehearse_devices("log ping", counted(count, "ping"), rig.campaign.runs_folder, count * _EVERY_S)
        return
    record_pings(
        count=count,
        every_s=_EVERY_S,
        rig=rig,
        uri=uri,
        note=note,
        judge=later("cfid.latency.result", "verdict"),
        found=_found,
    )


def _found(run: "Run") -> tuple[Mapping[str, Any], Sequence[str]]:
    """Return what a run's round trips give, for --json and as lines; where they are too few, a line states that."""
    from cfid.latency import fit

    try:
        result = fit([run]).without_rejected()
    except FitError as error:
        return {}, [str(error)]
    return {key: quantity.as_json() for key, quantity in result.quantities.items()}, result.summary()
