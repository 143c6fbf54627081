"""The recording of one wind setting: commands of all motors in turn, and the tachometer read at each."""

from typing import Any

from cfid.console.live import LiveLine
from cfid.drag.wind.plan import KIND, WindSetting
from cfid.errors import DataError
from cfid.records.campaign import Campaign
from cfid.records.run import Label, Run, list_runs
from cfid.rig.log import Plan
from cfid.rig.loop import Loop
from cfid.rig.procedures import StaircasePlan, read_at_steps, run_staircase
from cfid.rig.questions import Questions
from cfid.rig.recorder import sleep


def wind_run(
    setting: WindSetting,
    stairs: StaircasePlan,
    campaign: Campaign,
    live: LiveLine,
    *,
    note: str | None,
    simulated: bool,
    asks: bool,
) -> Plan:
    """Return what is to be recorded; if `asks`, the operator types the tachometer's reading at each command."""

    async def read(there: Any, loop: Loop) -> None:
        await _read_tachometer(stairs, there, loop, live)

    return Plan(
        runs_folder=campaign.runs_folder,
        kind=KIND,
        label=Label(note=note),
        procedure=read
        if asks
        else lambda there, loop: run_staircase(stairs, there["commands"], loop=loop, tell=live.task),
        facts=campaign.rig.facts,
        asked={**stairs.asked, **setting.asked},
        simulated=simulated,
    )


def wind_runs(campaign: Campaign, *, simulated: bool) -> list[Run]:
    """Return the campaign's wind runs of this rig: simulated ones count for a simulated one only."""
    runs = [run for run in list_runs(campaign.runs_folder) if not isinstance(run, DataError)]
    same = [run for run in runs if run.header.kind == KIND and run.header.simulated == simulated]
    return [run for run in same if not run.header.excluded]


async def _read_tachometer(stairs: StaircasePlan, there: Any, loop: Loop, live: LiveLine) -> None:
    """Wait for the tare, then ask at each command that turns the rotors."""
    questions = Questions(loop=loop, tell=live.task, say=live.tell)

    async def ask(command: int) -> float | None:
        if command == 0:
            return None
        return await questions.number(f"RPM shown at command {command}, Enter alone for none")

    questions.open()
    try:
        await sleep(loop, stairs.rest_s)
        await read_at_steps(stairs, there["commands"], there["readings"].add, ask, loop=loop, tell=live.task)
    finally:
        questions.close()
