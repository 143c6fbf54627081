"""Write simulated runs to disk in the form of recorded runs."""

from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from cfid.records.campaign import Campaign
from cfid.records.run import Label
from tests.lab import made_run
from tests.offline.runs import SimulatedRun


def write_runs(campaign: Campaign, runs: Iterable[SimulatedRun]) -> list[Path]:
    """Write runs with consecutive times, the last of which ends now; return their folders."""
    runs = list(runs)
    begin = datetime.now(UTC) - timedelta(seconds=sum(run.next_after_s for run in runs))
    scales = {"encoder": {"counts_per_turn": campaign.rig.encoder.counts_per_turn}}
    folders = []
    for run in runs:
        begin_s = begin.timestamp()
        columns = {
            name: dict(zip(device.columns, (np.round(begin_s + device.values[0], 6), *device.values[1:]), strict=True))
            for name, device in run.devices.items()
        }
        made = made_run(
            campaign.folder,
            run.kind,
            columns,
            facts_of={name: {**scales.get(name, {}), **device.facts} for name, device in run.devices.items()},
            label=Label(axis=run.axis, weight_g=run.weight_g, body=run.body),
            started=begin,
            simulated=True,
            facts=campaign.rig.facts,
            requested=run.requested,
        )
        folders.append(made.folder)
        begin += timedelta(seconds=run.next_after_s)
    return folders
