"""`cfid tf latency`: round trips to the vehicle (table 3.2), and its clock against this computer's."""

from typing import Annotated

import typer

from cfid.console.inputs import find_recording, open_workplace
from cfid.console.options import Delivery, RigOptions, flat
from cfid.console.outcome import deliver
from cfid.console.selection import chosen, labelled


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
    """Report round trips of pings, and the vehicle's clock offset and skew where it stamped its answers.

    The round trips of several runs are taken together; the clock is that of the last run with stamps.

    Example: [bold]cfid tf latency 2026-11-21_083012_ping[/bold]
    """
    from cfid.latency import fit

    workplace = open_workplace(rig)
    words = chosen(runs, workplace.campaign, suits=labelled("ping"), wanted="runs of pings")
    deliver(fit([find_recording(word, workplace) for word in words]), delivery, workplace.campaign)
