"""`cfid log ping`: round trips to the vehicle."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.console.live import LiveLine
from cfid.console.options import flat, positive
from cfid.console.recording import DryRun, KeepOptions, record, rehearse, rig_of
from cfid.console.vehicle import VehicleOptions, reach

if TYPE_CHECKING:
    from cfid.records.run import Run


@flat
def ping(
    *,
    count: Annotated[int, typer.Option(min=1, help="How many round trips.")] = 1000,
    interval: Annotated[float, typer.Option(metavar="S", help="Seconds from one to the next.")] = 0.1,
    vehicle: VehicleOptions,
    keep: KeepOptions,
    dry_run: DryRun = False,
    note: Annotated[str | None, typer.Option(help="Circumstances, kept with the run.")] = None,
) -> None:
    """Measure round trips to the vehicle: mean, standard deviation, least, histogram (table 3.2). No motor turns.

    Example: [bold]cfid log ping --count 500 --note "just started up"[/bold]
    """
    from cfid.records.run import Label
    from cfid.rig.log import Plan
    from cfid.rig.procedures import ping_often

    every_s = positive(interval, "--interval")
    campaign, devices, simulated = rig_of(keep.campaign)
    if dry_run:
        rehearse(f"{count} pings", campaign.runs_folder, count * every_s)
        return
    live = LiveLine()
    with ExitStack() as held:
        crazyflie = reach(vehicle, devices, held, simulated=simulated)
        plan = Plan(
            runs_folder=campaign.runs_folder,
            kind="ping",
            label=Label(note=note),
            procedure=lambda there, loop: ping_often(
                there["pings"], count=count, every_s=every_s, loop=loop, tell=live.task
            ),
            asked={"count": count, "interval_s": every_s},
            simulated=simulated,
        )
        record("log ping", plan, [crazyflie.pings()], live, keep, found=found)


def found(run: "Run") -> tuple[Mapping[str, Any], Sequence[str]]:
    """Return what a run's round trips give as --json has it, and as lines; why not, where they are too few."""
    from cfid.errors import FitError
    from cfid.latency import fit

    try:
        result = fit([run])
    except FitError as error:
        return {}, [str(error)]
    return {key: quantity.as_json() for key, quantity in result.quantities.items()}, result.lines
