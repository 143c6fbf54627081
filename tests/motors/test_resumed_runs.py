"""An interrupted and resumed run counts as one run wherever runs are chosen."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from cfid.console.selection import chosen
from cfid.records.campaign import Campaign
from cfid.records.choose import labelled
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import load_rig, new_rig_text
from cfid.records.run import DeviceRecord, Label, amend_run, read_run
from cfid.records.run_writer import create_run


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    return Campaign(folder=tmp_path, rig=load_rig(tmp_path / RIG_FILE))


def run(campaign: Campaign, minute: int, state: Any, **requested: Any) -> str:
    writer = create_run(
        campaign.runs_folder,
        kind="thrust",
        label=Label(),
        devices={"loadcell": DeviceRecord(file="loadcell.csv", columns=("t", "Fz"))},
        started=datetime(2026, 11, 21, 8, minute, tzinfo=UTC),
        cfid_version="0.2.0",
        requested={"steps": [1, 2], "motors": [1], **requested},
    )
    writer.close(state)
    return writer.folder.name


def names(campaign: Campaign, *words: str) -> list[str]:
    return chosen(words, campaign, suits=labelled("thrust"), wanted="runs")


def test_an_interrupted_run_is_taken_with_the_one_that_completes_it(
    campaign: Campaign, capsys: pytest.CaptureFixture[str]
) -> None:
    first = run(campaign, 1, "interrupted")
    second = run(campaign, 2, "interrupted", resumes=first)
    third = run(campaign, 3, "complete", resumes=second)
    alone = run(campaign, 4, "interrupted")

    assert names(campaign) == [first, second, third]
    assert names(campaign, third) == [first, second, third]
    assert names(campaign, "last") == [first, second, third]
    assert f"left out: {alone}" in capsys.readouterr().err

    amend_run(read_run(campaign.runs_folder / first), excluded="the cable touched")
    assert names(campaign) == [second, third]
