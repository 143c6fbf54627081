"""Recording a sine: the plan of its run, and which sines of a sweep a campaign does not have yet."""

from collections.abc import Callable

from cfid.records.campaign import Campaign
from cfid.records.run import Label, Run, list_runs
from cfid.rig.log import Plan
from cfid.rig.procedures import play_sine
from cfid.transfer.sines.plan import Sine, SineSweep


def plan_sine(
    sine: Sine,
    campaign: Campaign,
    *,
    before_s: float,
    note: str | None,
    simulated: bool,
    tell: Callable[[str], None],
) -> Plan:
    """Return the plan of a run that records `before_s` seconds with the motors off, then plays the sine."""
    return Plan(
        runs_folder=campaign.runs_folder,
        kind=f"sine_l{sine.periods}",
        label=Label(note=note),
        procedure=lambda there, loop: play_sine(
            sine.request(), there["crossings"], before_s=before_s, loop=loop, tell=tell
        ),
        facts=campaign.rig.facts,
        asked=sine.to_run(),
        simulated=simulated,
    )


def missing_sines(sweep: SineSweep, campaign: Campaign, *, simulated: bool) -> list[Sine]:
    """Return the sines without a complete run; simulated runs count for a simulated rig only."""
    runs = [run.header for run in list_runs(campaign.runs_folder) if isinstance(run, Run)]
    there = [header.asked for header in runs if header.simulated == simulated and header.state == "complete"]
    return [sine for sine in sweep.sines if sine.to_run() not in there]
