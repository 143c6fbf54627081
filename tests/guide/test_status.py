"""What a campaign found, what it lacks, and the one command that comes next."""

import contextlib
import hashlib
import json
import re
import shutil
import signal
import subprocess
import sys
from collections import Counter
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from cfid.console.campaign import make_campaign
from cfid.errors import CfidError, ConfigError, RejectedError
from cfid.findings import rejection
from cfid.guide.plan import Words, tasks
from cfid.guide.status import Next, Status, TaskStatus, next_of, status_of
from cfid.records import run as records_run
from cfid.records.campaign import open_campaign
from cfid.records.covariances import Covariance
from cfid.records.files import read_toml
from cfid.records.parameters import Parameter, Section, Source
from cfid.records.result import Result
from cfid.records.rig_file import CampaignGoal, load_rig
from cfid.records.run import DeviceRecord, Label, Verdict, amend_run, list_runs, read_run
from cfid.records.run_writer import create_run
from cfid.records.stale import stale_in
from tests.lab import Cfid, keep

ENCODER = DeviceRecord(file="encoder.csv", columns=("t", "phi"), counts_per_turn=8192.0)
BEGAN = datetime(2026, 1, 1, 8, tzinfo=UTC)
LATER = BEGAN + timedelta(hours=9)
MATRIX = np.diag([16e-6, 17e-6, 29e-6])
Kind = Literal["thrust", "speed"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a new campaign's folder."""
    return make_campaign(tmp_path / "lab", seed=1).parent


def swing(folder: Path, axis: str, *, minute: int, by: str = "encoder", body: str | None = None) -> Path:
    devices = {by: ENCODER}
    started = BEGAN + timedelta(minutes=minute)
    how = {
        "kind": "swing",
        "label": Label(axis=axis, body=body),
        "devices": devices,
        "started": started,
        "cfid_version": "0.2.0",
    }
    with create_run(folder / "runs", **how) as writer:  # type: ignore[arg-type]
        writer.append(by, (1.7e9 + np.arange(10) * 1e-3, np.arange(10)))
    return writer.folder


def fitted(
    folder: Path,
    *,
    std: float = 1e-7,
    rejected: str = "",
    key: str = "inertia.matrix_kg_m2",
    found: datetime = LATER,
    product: float = 0.0,
    by_mass: float = 0.0,
) -> None:
    """Store a matrix of all swings, like `cfid fit inertia`; `by_mass` is the part of the mass in each moment's std."""
    files = sorted(folder.glob("runs/*/encoder.csv"))
    sources = tuple(Source(str(p.relative_to(folder)), hashlib.sha256(p.read_bytes()).hexdigest()) for p in files)
    matrix = MATRIX + product * (1 - np.eye(3))
    section = Section(
        method="default",
        found=found,
        cfid_version="0.2.0",
        accepted=not rejected,
        sources=sources,
        parameters={"inertia.matrix_kg_m2": Parameter(value=matrix, std=np.full((3, 3), std), unit="kg m^2")},
        common={"mass": {"inertia.matrix_kg_m2": [by_mass] * 3 + [0.0] * 3}} if by_mass else {},
        rejected={key: rejected} if rejected else {},
    )
    keep(folder, "inertia", section)


def standing(folder: Path, *, task: str = "inertia") -> tuple[TaskStatus, Next]:
    found = status_of(open_campaign(folder), kind="inertia")
    return next(one for one in found.tasks if one.task.section == task), found.next


def test_swings_by_gyro_go_on_by_gyro(folder: Path) -> None:
    first = standing(folder)[1].words
    assert first[:2] == ("log", "encoder")
    swing(folder, first[3], minute=1, by="gyro")
    asked = standing(folder)[1]
    assert asked.words[:2] == ("log", "gyro")
    assert asked.recording is not None
    assert asked.recording.reminder.startswith("Turn it on.")


def test_a_body_on_threads_is_swung_by_its_gyro(folder: Path) -> None:
    threads = "threads = { above_mm = 65.0, below_mm = 65.0, length_mm = 400.0 }"
    vehicle = "[vehicle]\nmass_kg = 0.028\ncentre_of_mass_mm = [0, 0, 0]\n"
    (folder / "rig.toml").write_text(f"{vehicle}[mounts.z]\ndirection = [0, 0, 1]\n{threads}\n", "utf-8")
    asked = standing(folder)[1]
    assert asked.words == ("log", "gyro", "--axis", "z", "--for", "30")
    assert asked.recording is not None
    assert "on the threads of mount z" in asked.recording.reminder


def swung(folder: Path) -> list[str]:
    """Record every swing that the next step asks for, in that order; return the axes."""
    axes = []
    while (step := standing(folder)[1]).words[:2] == ("log", "encoder") and "--axis" in step.words:
        axes.append(step.words[3])
        swing(folder, axes[-1], minute=len(axes))
    return axes


def test_a_campaign_asks_for_every_mount_in_a_drawn_order_and_for_the_first_once_more(folder: Path) -> None:
    rig = open_campaign(folder).rig
    axes = swung(folder)
    seeded = (rig.model_copy(update={"campaign": CampaignGoal(seed=seed)}) for seed in range(6))
    orders = {tuple(recording.label.axis or "" for recording in tasks(one)[0].recordings) for one in seeded}

    assert sorted(axes[:6]) == sorted(rig.mounts)
    assert axes[6:] == axes[:1]
    assert len(orders) > 3


def test_the_order_of_mounts_is_drawn_by_new_and_stays_that_of_a_copy_and_of_a_renamed_campaign(
    cfid: Cfid, folder: Path
) -> None:
    asked = standing(folder)[1].words
    for name in ("b1", "b2"):
        shutil.copytree(folder, folder.with_name(name))
        assert standing(folder.with_name(name))[1].words == asked
    others = []
    for number in range(4):
        assert cfid("new", f"other{number}").returncode == 0
        others.append(load_rig(folder.with_name(f"other{number}") / "rig.toml").campaign.seed)
    assert len({load_rig(folder / "rig.toml").campaign.seed, *others}) > 3


def test_a_campaign_that_states_no_seed_has_a_fixed_order(folder: Path) -> None:
    for name in ("b1", "b2"):
        shutil.copytree(folder, folder.with_name(name))
        text = (folder / "rig.toml").read_text()
        (folder.with_name(name) / "rig.toml").write_text(re.sub(r"seed = .*\n", "", text))

    assert standing(folder.with_name("b1"))[1].words == standing(folder.with_name("b2"))[1].words


def test_the_mount_that_was_swung_about_first_is_the_one_to_repeat(folder: Path) -> None:
    drawn = [recording.label.axis or "" for recording in tasks(open_campaign(folder).rig)[0].recordings]
    swing(folder, drawn[1], minute=-1, body="testbody")
    swing(folder, drawn[3], minute=0)
    axes = swung(folder)
    assert axes == [*(mount for mount in drawn[:6] if mount != drawn[3]), drawn[3]]


def test_a_clock_that_was_set_back_changes_neither_the_order_of_mounts_nor_what_is_newer_than_a_fit(
    folder: Path,
) -> None:
    drawn = [recording.label.axis or "" for recording in tasks(open_campaign(folder).rig)[0].recordings]
    for minute, axis in zip(range(100, 94, -1), reversed(drawn[:6]), strict=True):  # each swing an earlier name
        swing(folder, axis, minute=minute)
    assert standing(folder)[0].lacking[0].label.axis == drawn[5]

    fitted(folder)
    swing(folder, drawn[5], minute=-1000)
    left, step = standing(folder)
    assert (left.state, step.words) == ("stale", ("fit", "inertia"))


def test_a_fit_that_left_out_a_run_is_not_stale(folder: Path) -> None:
    axes = swung(folder)
    fitted(folder, found=BEGAN + timedelta(hours=1))
    swing(folder, axes[0], minute=59)  # before the fit, which did not use it
    assert standing(folder)[0].state == "accepted"


def test_status_reads_each_run_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    swung(folder)
    for minute in range(200, 210):
        staircase(folder, minute=minute)
        sine(folder, minute, minute=minute, planned=[2, 5, 8])
    read: Counter[Path] = Counter()

    def counting(path: Path, error: type[CfidError]) -> dict[str, Any]:
        read[path] += 1
        return read_toml(path, error)

    monkeypatch.setattr(records_run, "read_toml", counting)
    found = status_of(open_campaign(folder))

    assert [task.recorded for task in found.tasks][:1] == [7]
    assert len(read) == 27
    assert set(read.values()) == {1}


def test_recorded_swings_are_fitted_next_and_a_fit_that_is_no_longer_current_again(folder: Path) -> None:
    swung(folder)
    recorded, step = standing(folder)
    assert (recorded.state, step.words) == ("not fitted", ("fit", "inertia"))

    fitted(folder)
    assert standing(folder)[0].state == "accepted"

    run = read_run(sorted((folder / "runs").iterdir())[0])  # one of the two swings of its mount
    amend_run(run, excluded="the cable touched")
    left_out, step = standing(folder)
    assert (left_out.state, step.words) == ("stale", ("fit", "inertia"))
    assert "the cable touched" in left_out.reason
    assert left_out.recorded == 6


def test_a_run_whose_folder_was_renamed_is_the_same_run_and_makes_its_fit_outdated_when_it_is_excluded(
    folder: Path,
) -> None:
    swung(folder)
    refused(folder, sorted((folder / "runs").iterdir()))
    section = open_campaign(folder).fits()[-1].section
    first = sorted((folder / "runs").iterdir())[0]
    renamed = first.rename(first.with_name("the_first"))
    assert stale_in(folder, open_campaign(folder).runs(complete=False), open_campaign(folder).rig)(section) == ()

    amend_run(read_run(renamed), excluded="the cable touched")
    (reason,) = stale_in(folder, open_campaign(folder).runs(complete=False), open_campaign(folder).rig)(section)
    assert "the_first (the cable touched)" in reason


def test_a_swing_that_was_excluded_after_the_fit_is_recorded_again_before_the_next_fit(folder: Path) -> None:
    axes = swung(folder)
    fitted(folder, found=BEGAN + timedelta(hours=1))
    run = read_run(sorted((folder / "runs").iterdir())[2])
    amend_run(run, excluded="the cable touched")

    lacks, step = standing(folder)
    assert (lacks.state, lacks.recorded) == ("missing", 6)
    assert step.words == ("log", "encoder", "--axis", axes[2], "--for", "20")
    assert "the cable touched" in step.why

    swing(folder, axes[2], minute=30)
    assert standing(folder)[1].words == ("fit", "inertia")


def refused(folder: Path, runs: list[Path]) -> None:
    files = [run / "encoder.csv" for run in runs]
    result = Result(
        command="fit inertia",
        method="default",
        quantities={"inertia.matrix_kg_m2": Parameter(value=MATRIX, std=MATRIX)},
        findings=(rejection("inertia-swings-contradict", "hung anew?", "inertia.matrix_kg_m2"),),
        sources=tuple(Source(str(one), hashlib.sha256(one.read_bytes()).hexdigest()) for one in files),
    )
    with pytest.raises(RejectedError):
        open_campaign(folder).keep(result)


def test_a_fit_that_was_rejected_whole_is_not_offered_again_until_something_was_recorded(folder: Path) -> None:
    axes = swung(folder)
    runs = sorted((folder / "runs").iterdir())
    refused(folder, runs[:2])
    assert standing(folder)[0].state == "not fitted"  # a fit of two runs does not reject all seven

    refused(folder, runs)
    rejected, _ = standing(folder)
    assert (rejected.state, rejected.reason) == ("rejected", "hung anew?")
    step = next_of([rejected])
    assert step.words[:2] == ("log", "encoder")
    assert not (folder / "parameters.toml").exists()
    assert not any("1.6e-05" in path.read_text() for path in (folder / "fits").iterdir())

    assert "cfid runs exclude RUN" in step.why
    again = step.words[step.words.index("--axis") + 1]
    assert again == axes[1]  # the one made longest ago, since axes[0] has two swings
    refused(folder, [*runs, swing(folder, again, minute=99)])
    other = next_of([standing(folder)[0]]).words
    assert other[other.index("--axis") + 1] not in (axes[0], again)  # not the same mount every time

    swing(folder, axes[0], minute=100)
    amend_run(read_run(runs[0]), excluded="the mount stayed")
    assert standing(folder)[1].words == ("fit", "inertia")


def test_a_rejected_fit_of_the_same_runs_changes_nothing_where_an_accepted_one_counts(folder: Path) -> None:
    swung(folder)
    runs = sorted((folder / "runs").iterdir())
    fitted(folder)
    assert standing(folder)[0].state == "accepted"
    refused(folder, runs)
    assert standing(folder)[0].state == "accepted"
    assert open_campaign(folder).values().accepted("inertia.matrix_kg_m2") is not None


def test_a_label_that_was_corrected_makes_a_fit_stale_and_takes_a_rejection_back(folder: Path) -> None:
    swung(folder)
    runs = sorted((folder / "runs").iterdir())
    refused(folder, runs)
    assert standing(folder)[0].state == "rejected"
    amend_run(read_run(runs[1]), note="a gust", verdict=Verdict(usable=True, text="good"))
    assert standing(folder)[0].state == "rejected"  # neither changes the input of a fit

    file = runs[1] / "run.toml"
    axes = {axis: file.read_text().replace(f'axis = "{axis}"', 'axis = "x"') for axis in ("y", "z", "xy", "xz", "yz")}
    file.write_text(next(text for axis, text in axes.items() if text != file.read_text()))
    run = read_run(runs[1])
    assert run.header.label.axis == "x"
    assert stale_in(folder, [run], open_campaign(folder).rig)(open_campaign(folder).fits()[-1].section) == (
        f"Changed since it was fitted: runs/{run.folder.name}/run.toml: fit again.",
    )
    assert standing(folder)[0].state != "rejected"


def test_a_fit_that_gave_nothing_is_not_offered_again_until_something_changes(cfid: Cfid, folder: Path) -> None:
    swung(folder)  # ten samples per run, in which nothing swings
    assert standing(folder)[1].words == ("fit", "inertia")
    refused_by = cfid("fit", "inertia", "--campaign", folder, "--no-figures")
    assert refused_by.returncode == 4

    rejected, _ = standing(folder)
    assert rejected.state == "rejected"
    assert rejected.reason in refused_by.stderr
    assert next_of([rejected]).words[:2] == ("log", "encoder")

    last = read_run(sorted((folder / "runs").iterdir())[-1])
    amend_run(last, excluded="nothing swung")
    assert standing(folder)[0].state == "missing"
    swing(folder, str(last.header.label.axis), minute=90)
    assert standing(folder)[0].state == "not fitted"


@pytest.mark.parametrize("spelling", [("--campaign", "{}"), ("--campaign={}",), ()])
def test_a_refused_fit_is_remembered_however_the_campaign_is_named(
    cfid: Cfid, folder: Path, spelling: tuple[str, ...]
) -> None:
    swung(folder)
    words = [word.format(folder) for word in spelling]
    assert cfid("fit", "inertia", *words, "--no-figures", folder=folder).returncode == 4
    assert standing(folder)[0].state == "rejected"


def test_a_fit_of_some_runs_that_gave_nothing_says_nothing_about_all(cfid: Cfid, folder: Path) -> None:
    swung(folder)
    assert cfid("fit", "inertia", "*_x", "--campaign", folder, "--no-figures").returncode == 4
    assert standing(folder)[0].state == "not fitted"


def test_a_later_fit_that_was_accepted_stands_over_one_that_was_rejected(folder: Path) -> None:
    swung(folder)
    refused(folder, sorted((folder / "runs").iterdir()))
    fitted(folder, found=datetime.now(UTC) + timedelta(hours=1))
    assert standing(folder)[0].state == "accepted"


def test_a_number_that_is_not_sure_enough_is_repeated_unless_the_operator_writes_the_report(folder: Path) -> None:
    swung(folder)
    fitted(folder, std=4e-6)
    step = next_of([standing(folder)[0]])

    assert step.words[:2] == ("log", "encoder")
    assert step.why.endswith("a rate controller's gains: 3 %. If it is enough: cfid report.")


def test_a_fit_that_no_plan_asks_for_is_named(cfid: Cfid, folder: Path) -> None:
    swung(folder)
    fitted(folder)
    keep(folder, "flight", open_campaign(folder).values().sections()["inertia"])
    words = ("status", "--kind", "inertia", "--campaign", folder)
    assert "beside the plan: flight" in cfid(*words).stdout
    assert json.loads(cfid(*words, "--json").stdout)["beside"] == ["flight"]


def test_a_matrix_of_six_swings_is_accepted_and_a_seventh_is_offered_for_what_it_would_show(
    cfid: Cfid, folder: Path
) -> None:
    axes = swung(folder)
    last = sorted((folder / "runs").iterdir())[-1]
    shutil.rmtree(last)
    unfitted, _ = standing(folder)
    assert (unfitted.state, unfitted.recorded) == ("missing", 6)

    fitted(folder)
    accepted, step = standing(folder)
    assert accepted.state == "accepted"
    assert step.words[:2] != ("log", "encoder") or "--axis" not in step.words
    said = cfid("status", "--campaign", folder, "--kind", "inertia").stdout
    again = f"inertia: `cfid log encoder --axis {axes[0]} --for 20` once more would show what drifted since the first."
    assert again in said
    assert again in remarks_of_the_report(cfid, folder)


def remarks_of_the_report(cfid: Cfid, folder: Path) -> list[str]:
    assert cfid("report", "--campaign", folder, "--format", "json", "--force").returncode == 0
    remarks: list[str] = json.loads((folder / "report.json").read_text())["summary"]["remarks"]
    return remarks


def test_a_run_of_no_use_is_named_with_what_to_record_again_until_that_is_done(cfid: Cfid, folder: Path) -> None:
    bad = read_run(swing(folder, "x", minute=0))
    amend_run(bad, verdict=Verdict(usable=False, text="no release found."))
    said = cfid("status", "--campaign", folder, "--kind", "inertia").stdout
    content = json.loads(cfid("status", "--campaign", folder, "--kind", "inertia", "--json").stdout)
    sentence = f"{bad.folder.name}: NOT USABLE: no release found. Record it again: cfid log encoder --axis x --for 20"

    assert sentence in said
    assert remarks_of_the_report(cfid, folder) == [sentence]
    assert content["not_usable"] == [
        {
            "run": bad.folder.name,
            "reason": "no release found.",
            "command": ["log", "encoder", "--axis", "x", "--for", "20"],
        }
    ]
    swung(folder)
    assert "NOT USABLE" not in cfid("status", "--campaign", folder, "--kind", "inertia").stdout


def test_of_a_staircase_that_was_resumed_only_the_last_part_is_named(folder: Path) -> None:
    parts = [staircase(folder, minute=0), ""]
    parts[1] = staircase(folder, minute=5, resumes=parts[0])
    for part in parts:
        amend_run(read_run(folder / "runs" / part), verdict=Verdict(usable=False, text="the app was silent."))

    def named() -> list[tuple[str, Words]]:
        campaign = open_campaign(folder)
        return [(one.run, one.again.words) for one in status_of(campaign, kind="motors").unusable]

    assert named() == [(parts[1], ("log", "thrust", "--resume", parts[1]))]
    amend_run(read_run(folder / "runs" / parts[1]), excluded="gust")
    assert named() == [(parts[0], ("log", "thrust", "--resume", parts[0]))]

    later = staircase(folder, minute=9)
    amend_run(read_run(folder / "runs" / later), verdict=Verdict(usable=False, text="a gust."))
    assert named() == [(later, ("log", "thrust", "--resume", later))]  # the later run replaces the earlier ones


def test_a_run_of_no_use_is_named_no_more_once_a_later_one_of_the_same_is_good(cfid: Cfid, folder: Path) -> None:
    first = tasks(open_campaign(folder).rig, kind="inertia")[0].recordings[0].label.axis
    assert first is not None
    amend_run(read_run(swing(folder, first, minute=0)), verdict=Verdict(usable=False, text="no release found."))
    swing(folder, first, minute=5)  # the repeat at the end is still missing

    assert "NOT USABLE" not in cfid("status", "--campaign", folder, "--kind", "inertia").stdout


def sine(folder: Path, periods: int, *, minute: int, planned: list[int] | None = None, complete: bool = True) -> str:
    """Write a run of a sine, which is part of the series `planned`, if any; return its name."""
    devices = {"crossings": DeviceRecord(file="crossings.csv", columns=("t", "sample"))}
    requested = {"l": periods, "n": 4000, "amplitude": 20000, "motor": 1}
    with create_run(
        folder / "runs",
        kind=f"sine_l{periods}",
        label=Label(),
        devices=devices,
        requested=requested | ({} if planned is None else {"planned": planned}),
        started=BEGAN + timedelta(minutes=minute),
        cfid_version="0.2.0",
    ) as writer:
        writer.append("crossings", ([1.7e9], [0]))
        writer.close("complete" if complete else "failed")
    return writer.folder.name


def test_a_series_of_sines_that_ended_early_is_short_and_its_rest_is_played_next(folder: Path) -> None:
    def transfer() -> TaskStatus:
        statuses = status_of(open_campaign(folder), kind="motors").tasks
        return next(one for one in statuses if one.task.section == "tf")

    sine(folder, 2, minute=0, planned=[2, 5, 8])
    sine(folder, 5, minute=1, planned=[2, 5, 8])
    failed = sine(folder, 8, minute=2, planned=[2, 5, 8], complete=False)
    short = transfer()
    step = next_of([short])

    assert (short.state, short.recorded) == ("missing", 0)
    assert step.words == ("log", "sine", "--resume", failed)

    sine(folder, 8, minute=3, planned=[2, 5, 8])
    assert (transfer().state, transfer().recorded) == ("not fitted", 1)


def test_a_sine_of_no_use_is_played_again_and_one_that_was_excluded_when_that_is_asked_for(
    cfid: Cfid, folder: Path
) -> None:
    def transfer() -> TaskStatus:
        statuses = status_of(open_campaign(folder), kind="motors").tasks
        return next(one for one in statuses if one.task.section == "tf")

    def resumed() -> subprocess.CompletedProcess[str]:
        return cfid("log", "sine", "--resume", last, "--dry-run", "--campaign", folder)

    names = [sine(folder, periods, minute=periods, planned=[2, 5, 8]) for periods in (2, 5, 8)]
    first, second, last = (folder / "runs" / name for name in names)
    assert (transfer().state, resumed().returncode) == ("not fitted", 2)

    amend_run(read_run(second), verdict=Verdict(usable=False, text="the load cell does not feel it."))
    assert transfer().state == "missing"
    assert next_of([transfer()]).words == ("log", "sine", "--resume", names[2])
    assert resumed().stdout.startswith("1 sine of ")

    amend_run(read_run(second), excluded="too fast for this cell")
    assert (transfer().state, transfer().reason) == ("not fitted", "recorded, not fitted yet.")

    amend_run(read_run(first), excluded="for verification")
    assert transfer().state == "not fitted"
    assert resumed().stdout.startswith("2 sines of ")
    sine(folder, 5, minute=9, planned=[2, 5, 8])
    assert resumed().stdout.startswith("1 sine of ")


def test_a_sine_that_was_excluded_is_not_played_with_one_of_no_use(cfid: Cfid, folder: Path) -> None:
    names = [sine(folder, periods, minute=periods, planned=[2, 5, 8]) for periods in (2, 5, 8)]
    first, second, _ = (read_run(folder / "runs" / name) for name in names)
    amend_run(first, excluded="for verification")
    amend_run(second, verdict=Verdict(usable=False, text="the load cell does not feel it."))

    statuses = status_of(open_campaign(folder), kind="motors").tasks
    words = next_of([one for one in statuses if one.task.section == "tf"]).words

    assert words == ("log", "sine", "--resume", names[2], "--periods", "5")
    assert cfid(*words, "--dry-run", "--campaign", folder).stdout.startswith("1 sine of ")


def test_a_staircase_that_is_being_recorded_is_named_and_not_resumed(folder: Path) -> None:
    writer = create_run(
        folder / "runs",
        kind="speed",
        label=Label(),
        devices={"readings": DeviceRecord(file="readings.csv", columns=("t", "command", "rpm"))},
        requested={"steps": [20000, 30000], "motors": [1], "hold_s": 3.0, "rest_s": 1.0},
        started=BEGAN,
        cfid_version="0.2.0",
    )
    statuses = status_of(open_campaign(folder), kind="motors").tasks
    speed = next(one for one in statuses if one.task.section == "speed")
    writer.close("interrupted")

    assert next_of([speed]).words == ("log", "speed")
    step = next_of([speed])
    assert step.why.endswith(f"{writer.folder.name} is being recorded: wait until it has ended.")
    assert Status(tasks=(speed,)).remarks == ()  # it is stated once


def test_a_sine_above_the_cutoff_that_no_cell_feels_is_not_played_for_ever(folder: Path) -> None:
    names = [sine(folder, periods, minute=at, planned=[5, 120]) for at, periods in enumerate((5, 120))]
    amend_run(read_run(folder / "runs" / names[1]), verdict=Verdict(usable=False, text="the cell does not feel it."))
    statuses = status_of(open_campaign(folder), kind="motors").tasks

    assert next(one for one in statuses if one.task.section == "tf").state == "not fitted"


def test_sines_of_no_known_series_count_as_one(folder: Path) -> None:
    sine(folder, 2, minute=0)
    statuses = status_of(open_campaign(folder), kind="motors").tasks
    assert next(one for one in statuses if one.task.section == "tf").state == "not fitted"


def staircase(folder: Path, *, minute: int, **requested: str) -> str:
    """Write a staircase that was interrupted in its first step; return its name."""
    devices = {"commands": DeviceRecord(file="commands.csv", columns=("t", "m1", "m2", "m3", "m4"))}
    with create_run(
        folder / "runs",
        kind="thrust",
        label=Label(),
        devices=devices,
        requested={"steps": [10000, 20000], "motors": [1], "hold_s": 1.0, "rest_s": 1.0, **requested},
        started=BEGAN + timedelta(minutes=minute),
        cfid_version="0.2.0",
    ) as writer:
        writer.append("commands", ([1.7e9], [10000], [0], [0], [0]))
        writer.close("interrupted")
    return writer.folder.name


def test_a_staircase_that_was_interrupted_is_completed_next(cfid: Cfid, folder: Path) -> None:
    name = staircase(folder, minute=0)

    def step() -> str:
        said = cfid("status", "--campaign", folder, "--kind", "motors").stdout
        return next(line for line in said.splitlines() if line.startswith("next: "))

    assert step() == f"next: cfid log thrust --resume {name}"
    assert cfid("runs", "exclude", name, "--because", "gust", "--campaign", folder).returncode == 0
    assert step() == "next: cfid log thrust"


def test_a_rejected_matrix_is_to_be_recorded_again_and_one_that_is_not_sure_enough_too(folder: Path) -> None:
    swung(folder)
    fitted(folder, rejected="the swings contradict each other")
    rejected, _ = standing(folder)
    assert (rejected.state, rejected.reason) == ("rejected", "the swings contradict each other")

    fitted(folder, std=2e-6)
    unsure, _ = standing(folder)
    assert unsure.found[0].std == pytest.approx(2e-6 / 16e-6)
    assert unsure.found[0].short_by == pytest.approx(2e-6 / 16e-6 / 0.03)
    assert unsure.found[0].mostly == "noise and the inputs of its own fit"


def test_what_rig_toml_states_too_vaguely_is_not_recorded_again(cfid: Cfid, folder: Path) -> None:
    swung(folder)
    fitted(folder, std=2e-6, by_mass=1.5e-6)  # 12 %; 8 % without the part of the mass
    assert standing(folder)[0].found[0].bounded_by == ""

    fitted(folder, std=2e-6, by_mass=1.99e-6)  # 1 % without the part of the mass
    bounded, _ = standing(folder)
    assert (bounded.found[0].bounded_by, bounded.found[0].mostly) == ("mass", "mass")
    step = next_of([bounded])
    assert (step.words, step.why) == (("report",), "everything is found, and as sure as rig.toml allows.")
    said = " ".join(cfid("status", "--campaign", folder, "--kind", "inertia").stdout.split())
    assert "inertia.matrix_kg_m2 is known to 12 % because of the mass, as rig.toml states it: recording again" in said


def test_small_products_of_inertia_are_judged_by_the_moments(folder: Path) -> None:
    swung(folder)
    fitted(folder, std=2e-7, product=5e-7)

    assert standing(folder)[0].found[0].std == pytest.approx(2e-7 / 16e-6)


def test_torque_and_speed_are_judged_where_they_are_used_and_by_the_covariance_of_their_numbers(folder: Path) -> None:
    hover_n = load_rig(folder / "rig.toml").vehicle.mass_kg * 9.81 / 4
    square, slope, least = 0.01, 0.005, 1e-5
    std = np.array([0.005, 4e-4, 1e-6])
    correlated = np.outer(std, std) * [[1, -0.9, 0], [-0.9, 1, 0], [0, 0, 1]]
    torque = Section(
        method="default", found=LATER, cfid_version="0.2.0", accepted=True, sources=(),
        parameters={"motor.torque_poly": Parameter(value=[square, slope, least], std=list(std), unit="Nm(N)")},
        covariance=(Covariance(of=("motor.torque_poly",), matrix=tuple(map(tuple, correlated))),),
    )  # fmt: skip
    keep(folder, "torque", torque)
    (found,) = next(one for one in status_of(open_campaign(folder)).tasks if one.task.section == "torque").found
    at_hover = np.array([2 * hover_n, 1.0, 0.0])

    relative = np.sqrt(at_hover @ correlated @ at_hover) / (2 * square * hover_n + slope)
    assert found.std == pytest.approx(relative, rel=1e-3)
    assert found.short_by == pytest.approx(relative / 0.05, rel=1e-3)


def test_what_is_rejected_beside_the_aim_of_a_fit_is_not_recorded_again(folder: Path) -> None:
    swung(folder)
    fitted(folder, rejected="the cable was stiff", key="inertia.axis_kg_m2.x")

    assert standing(folder)[0].state == "accepted"


def test_when_all_is_found_and_sure_the_report_comes_next(folder: Path) -> None:
    swung(folder)
    fitted(folder)
    statuses = [one for one in status_of(open_campaign(folder), kind="inertia").tasks if one.task.section == "inertia"]

    assert next_of(statuses).words == ("report",)
    assert next_of(statuses, kind="inertia").words == ("report", "--kind", "inertia")


def test_the_kind_of_a_campaign_stands_in_its_rig_file_and_another_is_refused(cfid: Cfid, folder: Path) -> None:
    rig = folder / "rig.toml"
    rig.write_text(rig.read_text().replace('kind = "full"', 'kind = "motors"'))
    said = cfid("status", "--campaign", folder, "--json")
    assert [task["fit"] for task in json.loads(said.stdout)["tasks"]] == ["thrust", "torque", "speed", "latency", "tf"]

    rig.write_text(rig.read_text().replace('"motors"', '"morning"'))
    with pytest.raises(ConfigError, match=r"campaign\.kind"):
        load_rig(rig)


def test_next_says_what_to_do_asks_and_becomes_the_command(cfid: Cfid, folder: Path) -> None:
    swung(folder)
    runs = len(list_runs(folder / "runs"))
    said = cfid("next", "--campaign", folder, "--kind", "inertia", "--yes")

    # Ten rows are no swing: the fit that came next reports this, with its own exit code.
    assert "next: cfid fit inertia" in said.stdout
    assert said.returncode == 4
    assert len(list_runs(folder / "runs")) == runs


def test_next_without_an_answer_starts_nothing_and_names_what_to_do(cfid: Cfid, folder: Path) -> None:
    said = cfid("next", "--campaign", folder)

    assert said.returncode == 2
    assert "standard input ended before an answer, nothing was started" in said.stderr
    assert "--yes" in said.stderr
    assert list_runs(folder / "runs") == []


def test_ctrl_c_at_the_question_of_next_ends_it_with_the_code_of_an_interruption(folder: Path) -> None:
    words = [sys.executable, "-m", "cfid.cli.main", "next", "--campaign", str(folder)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as asking:
        assert asking.stdout is not None
        said = b""
        while b"Start it?" not in said:
            one = asking.stdout.read(1)
            assert one, said
            said += one
        for _ in range(3):  # the first signal may come between the question and the reading of its answer
            asking.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                asking.wait(10)
                break

        assert asking.returncode == 130


def test_a_run_that_cannot_be_read_is_named_by_status_and_does_not_count(cfid: Cfid, folder: Path) -> None:
    run = swing(folder, "x", minute=0)
    (run / "run.toml").write_text("format = [[\n", encoding="utf-8")
    said = cfid("status", "--campaign", folder, "--kind", "inertia")

    assert said.returncode == 0
    assert f"{run.name}/run.toml: invalid TOML" in said.stderr
    assert "The run does not count." in said.stderr
    assert "0 of 7" in said.stdout
