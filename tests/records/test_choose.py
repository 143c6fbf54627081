"""`last` is the newest usable run of the kind that a command takes, in every command and in Python."""

import json
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import ConfigError
from cfid.records.campaign import open_campaign
from cfid.records.choose import lasts
from cfid.records.run import Label, Run, State, Verdict, amend_run, list_runs, read_run
from tests.lab import STARTED, Cfid, made_run, new_campaign


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return new_campaign(tmp_path / "lab").folder


def recorded(folder: Path, kind: str, *, day: int, state: State = "complete", **label: object) -> Run:
    columns = {"encoder": {"t": 1.7e9 + np.arange(10) * 1e-3, "phi": np.arange(10)}}
    facts, named = {"encoder": {"counts_per_turn": 8192.0}}, Label.model_validate(label)
    started = STARTED + timedelta(days=day)
    return made_run(folder, kind, columns, facts_of=facts, state=state, label=named, started=started)


def runs_of(folder: Path) -> list[Run]:
    return [run for run in list_runs(folder / "runs") if isinstance(run, Run)]


@pytest.fixture
def swing(folder: Path) -> Run:
    """Return the newest usable swing: the clock was set back before it, and nothing after it is usable."""
    recorded(folder, "swing", day=9, axis="x")
    swing = recorded(folder, "swing", day=1, axis="y")
    recorded(folder, "swing", day=2, axis="z", state="interrupted")
    amend_run(recorded(folder, "swing", day=3, axis="z"), excluded="the cable touched")
    amend_run(recorded(folder, "swing", day=4, axis="z"), verdict=Verdict(usable=False, text="no release found."))
    return swing


def test_last_kind_is_the_newest_usable_run_of_a_kind(folder: Path, swing: Run) -> None:
    drop = recorded(folder, "drop", day=5, weight_g=20)
    campaign = open_campaign(folder)

    assert campaign.run("last").folder == drop.folder
    assert campaign.run("last swing").folder == swing.folder
    assert lasts(runs_of(folder)) == {drop.folder.name: ["last", "last drop"], swing.folder.name: ["last swing"]}
    with pytest.raises(ConfigError):
        campaign.run("last thrust")


def _noted(folder: Path, cfid: Cfid) -> str:
    return cfid("runs", "note", "last swing", "a gust", "--campaign", folder).stdout


def _shown(folder: Path, cfid: Cfid) -> str:
    return cfid("show", "last swing", "--json", "--no-figures", "--campaign", folder).stderr


def _fitted(folder: Path, cfid: Cfid) -> str:
    return cfid("fit", "swing", "last", "--no-figures", "--campaign", folder).stderr


def _fitted_by_axis(folder: Path, cfid: Cfid) -> str:
    return cfid("fit", "inertia", "y=last", "--no-figures", "--campaign", folder).stderr


@pytest.mark.parametrize("command", [_noted, _shown, _fitted, _fitted_by_axis])
def test_every_command_means_the_same_run(
    folder: Path, swing: Run, cfid: Cfid, command: Callable[[Path, Cfid], str]
) -> None:
    recorded(folder, "drop", day=5, weight_g=20)  # newer, of another kind

    assert swing.folder.name in command(folder, cfid)


@pytest.mark.parametrize("word", ["20=last", "20:last"])
def test_a_label_goes_before_last(folder: Path, swing: Run, cfid: Cfid, word: str) -> None:
    drop = recorded(folder, "drop", day=5)
    recorded(folder, "swing", day=6, axis="x")

    ended = cfid("fit", "friction", word, "--no-figures", "--campaign", folder)

    assert ended.returncode == 4  # ten rows are no drop
    assert drop.folder.name in ended.stderr
    assert swing.folder.name not in ended.stderr


def test_the_list_of_runs_marks_what_last_is_and_keeps_its_keys(folder: Path, swing: Run, cfid: Cfid) -> None:
    listed = cfid("runs", "--campaign", folder).stdout
    marked = [line for line in listed.splitlines() if "last" in line]

    assert len(marked) == 1
    assert swing.folder.name in marked[0]
    rows = json.loads(cfid("runs", "--json", "--campaign", folder).stdout)["runs"]
    assert rows[1]["run"] == swing.folder.name
    assert rows[1]["note"] == ""


def test_a_run_that_was_not_excluded_is_not_included_again(folder: Path, swing: Run, cfid: Cfid) -> None:
    ended = cfid("runs", "include", "last", "--campaign", folder)

    assert (ended.returncode, ended.stdout) == (0, "")
    assert swing.folder.name in ended.stderr
    assert read_run(swing.folder) == swing
