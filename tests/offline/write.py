"""Write the demo's runs to disk in the form of recorded runs."""

from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from cfid.records.campaign import Campaign
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from cfid.version import __version__
from tests.offline.runs import SimulatedRun


def write_runs(campaign: Campaign, runs: Iterable[SimulatedRun]) -> list[Path]:
    """Write runs with consecutive times, the last of which ends now; return their folders."""
    runs = list(runs)
    begin = datetime.now(UTC) - timedelta(seconds=sum(run.next_after_s for run in runs))
    folders = []
    for run in runs:
        folders.append(_write(campaign, run, begin))
        begin += timedelta(seconds=run.next_after_s)
    return folders


def _write(campaign: Campaign, run: SimulatedRun, started: datetime) -> Path:

    scale = campaign.rig.encoder.counts_per_turn
    records = {
        name: DeviceRecord.model_validate(
            {
                "file": f"{name}.csv",
                "columns": device.columns,
                **({"counts_per_turn": scale} if name == "encoder" else {}),
                **device.facts,
            }
        )
        for name, device in run.devices.items()
    }
    with create_run(
        campaign.runs_folder,
        kind=run.kind,
        label=Label(axis=run.axis, weight_g=run.weight_g, body=run.body),
        devices=records,
        started=started,
        cfid_version=__version__,
        simulated=True,
        facts=campaign.rig.facts,
        requested=run.requested,
    ) as writer:
        for name, device in run.devices.items():
            time_s, *values = device.values
            writer.append(name, (np.round(started.timestamp() + time_s, 6), *values))
    return writer.folder
