"""The state of a campaign: what it found, what it lacks, and the one command that comes next."""

import contextlib
import hashlib
import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.console.campaign import make_campaign
from cfid.errors import RejectedError
from cfid.findings import rejection
from cfid.guide.plan import Words, tasks
from cfid.guide.status import Status, TaskStatus, status_of
from cfid.records.campaign import open_campaign
from cfid.records.covariances import Covariance
from cfid.records.parameters import Parameter, Section, Source
from cfid.records.result import Result
from cfid.records.rig_file import CampaignGoal, CampaignKind, load_rig
from cfid.records.run import Label, Run, State, Verdict, amend_run, list_runs, read_run
from tests.lab import Cfid, keep, made_run

BEGAN = datetime(2026, 1, 1, 8, tzinfo=UTC)
LATER = BEGAN + timedelta(hours=9)
MATRIX = np.diag([16e-6, 17e-6, 29e-6])
USELESS = Verdict(usable=False, text="no release found.")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a new campaign's folder."""
    return make_campaign(tmp_path / "lab", seed=1, kind="simulated").parent


def swing(folder: Path, axis: str, *, minute: int, by: str = "encoder", body: str | None = None) -> Run:
    columns = {"t": 1.7e9 + np.arange(10) * 1e-3, "phi": np.arange(10)}
    started = BEGAN + timedelta(minutes=minute)
    facts = {by: {"counts_per_turn": 8192.0}}
    return made_run(folder, "swing", {by: columns}, facts_of=facts, label=Label(axis=axis, body=body), started=started)


def sine(folder: Path, periods: int, *, minute: int, planned: Sequence[int] = (), state: State = "complete") -> Run:
    """Write a run of a sine, which is part of the series `planned`, if any."""
    requested: dict[str, Any] = {"l": periods, "n": 4000, "amplitude": 20000, "motor": 1}
    series = {"planned": list(planned)} if planned else {}
    devices = {"crossings": {"t": [1.7e9], "sample": [0]}}
    started = BEGAN + timedelta(minutes=minute)
    return made_run(folder, f"sine_l{periods}", devices, state=state, requested=requested | series, started=started)


def staircase(folder: Path, *, minute: int, **requested: str) -> Run:
    """Write a staircase that was interrupted in its first step."""
    steps = {"steps": [10000, 20000], "motors": [1], "hold_s": 1.0, "rest_s": 1.0}
    columns = {"t": [1.7e9], "m1": [10000], "m2": [0], "m3": [0], "m4": [0]}
    started = BEGAN + timedelta(minutes=minute)
    return made_run(
        folder, "thrust", {"commands": columns}, state="interrupted", requested=steps | requested, started=started
    )


def fitted(
    folder: Path,
    *,
    std: float = 1e-7,
    found: datetime = LATER,
    product: float = 0.0,
    by_mass: float = 0.0,
    rejected: str = "",
    key: str = "inertia.matrix_kg_m2",
    suspects: tuple[str, ...] = (),
) -> None:
    """Keep a matrix of all swings, like `cfid fit inertia`; `by_mass` is the part of the mass in each moment's std."""
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
        suspects=suspects,
    )
    keep(folder, "inertia", section)


def refused(folder: Path, runs: Sequence[Path]) -> None:
    """Let a fit of runs be rejected as a whole."""
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


def task(folder: Path, section: str = "inertia", *, kind: CampaignKind = "inertia") -> TaskStatus:
    statuses = status_of(open_campaign(folder), kind=kind).tasks
    return next(status for status in statuses if status.task.section == section)


def asked(folder: Path) -> Words:
    return status_of(open_campaign(folder), kind="inertia").next.words


def asked_for(status: TaskStatus) -> Words:
    """Return what comes next in a campaign with one task."""
    return Status(tasks=(status,)).next.words


def swung(folder: Path) -> list[str]:
    """Record every swing that the next step asks for, in that order; return the axes."""
    axes: list[str] = []
    while (words := asked(folder))[:2] == ("log", "encoder") and "--axis" in words:
        axes.append(words[3])
        swing(folder, axes[-1], minute=len(axes))
    return axes


def runs_of(folder: Path) -> list[Path]:
    return sorted((folder / "runs").iterdir())


def swing_again(axis: str) -> Words:
    return ("log", "encoder", "--axis", axis, "--for", "20")


def drawn(folder: Path) -> list[str]:
    return [recording.label.axis or "" for recording in tasks(open_campaign(folder).rig)[0].recordings]


# The order of recordings


def test_every_mount_is_asked_for_in_a_drawn_order_and_the_first_once_more(folder: Path) -> None:
    rig = open_campaign(folder).rig
    axes = swung(folder)
    seeded = (rig.model_copy(update={"campaign": CampaignGoal(seed=seed)}) for seed in range(6))
    orders = {tuple(recording.label.axis or "" for recording in tasks(one)[0].recordings) for one in seeded}

    assert sorted(axes[:6]) == sorted(rig.mounts)
    assert axes[6:] == axes[:1]
    assert len(orders) > 3


def test_the_mount_that_was_swung_about_first_is_the_one_to_repeat(folder: Path) -> None:
    mounts = drawn(folder)
    swing(folder, mounts[1], minute=-1, body="testbody")
    swing(folder, mounts[3], minute=0)

    assert swung(folder) == [*(mount for mount in mounts[:6] if mount != mounts[3]), mounts[3]]


def test_a_clock_that_was_set_back_changes_neither_the_order_nor_what_is_newer_than_a_fit(folder: Path) -> None:
    mounts = drawn(folder)
    for minute, axis in zip(range(100, 94, -1), reversed(mounts[:6]), strict=True):  # each swing an earlier name
        swing(folder, axis, minute=minute)
    assert task(folder).lacking[0].label.axis == mounts[5]

    fitted(folder)
    swing(folder, mounts[5], minute=-1000)
    assert (task(folder).state, asked(folder)) == ("stale", ("fit", "inertia"))


def test_swings_by_gyro_continue_by_gyro(folder: Path) -> None:
    assert asked(folder)[:2] == ("log", "encoder")
    swing(folder, asked(folder)[3], minute=1, by="gyro")
    assert asked(folder)[:2] == ("log", "gyro")


def test_a_body_on_threads_is_swung_by_its_gyro(folder: Path) -> None:
    threads = "threads = { above_mm = 65.0, below_mm = 65.0, length_mm = 400.0 }"
    vehicle = "[vehicle]\nmass_kg = 0.028\ncentre_of_mass_mm = [0, 0, 0]\n"
    (folder / "rig.toml").write_text(f"{vehicle}[mounts.z]\ndirection = [0, 0, 1]\n{threads}\n", "utf-8")

    assert asked(folder) == ("log", "gyro", "--axis", "z", "--for", "30")


# The state of a fit


def test_recorded_swings_are_fitted_and_a_fit_that_is_no_longer_current_again(folder: Path) -> None:
    axes = swung(folder)
    assert (task(folder).state, asked(folder)) == ("not fitted", ("fit", "inertia"))

    fitted(folder, found=BEGAN + timedelta(hours=1))
    swing(folder, axes[0], minute=59)  # before the fit, which did not use it
    assert task(folder).state == "accepted"

    amend_run(read_run(runs_of(folder)[0]), excluded="the cable touched")  # one of the two swings of its mount
    status = task(folder)
    assert (status.state, status.recorded, asked(folder)) == ("stale", 6, ("fit", "inertia"))
    assert "the cable touched" in status.reason


def test_a_swing_that_was_excluded_after_the_fit_is_recorded_again_before_the_next_fit(folder: Path) -> None:
    axes = swung(folder)
    fitted(folder, found=BEGAN + timedelta(hours=1))
    amend_run(read_run(runs_of(folder)[2]), excluded="the cable touched")
    assert (task(folder).state, task(folder).recorded, asked(folder)) == ("missing", 6, swing_again(axes[2]))

    swing(folder, axes[2], minute=30)
    assert asked(folder) == ("fit", "inertia")


def test_a_fit_that_was_rejected_as_a_whole_is_not_offered_again_until_something_was_recorded(folder: Path) -> None:
    axes = swung(folder)
    runs = runs_of(folder)
    refused(folder, runs[:2])
    assert task(folder).state == "not fitted"  # a fit of two runs does not reject all seven

    refused(folder, runs)
    status = task(folder)
    assert (status.state, status.reason) == ("rejected", "hung anew?")
    assert asked_for(status) == swing_again(axes[1])  # the one made longest ago, since axes[0] has two swings
    assert not any("1.6e-05" in path.read_text() for path in (folder / "fits").iterdir())

    refused(folder, [*runs, swing(folder, axes[1], minute=99).folder])
    assert asked_for(task(folder)) == swing_again(axes[2])  # not the same mount every time

    swing(folder, axes[0], minute=100)
    amend_run(read_run(runs[0]), excluded="the mount stayed")
    assert asked(folder) == ("fit", "inertia")


@pytest.mark.parametrize("runs", [(), ("*_x",)])
def test_a_fit_of_all_runs_that_gave_nothing_is_not_offered_again_until_something_changes(
    cfid: Cfid, folder: Path, runs: tuple[str, ...]
) -> None:
    swung(folder)  # ten samples per run, in which nothing swings
    ended = cfid("fit", "inertia", *runs, folder=folder)
    status = task(folder)
    assert (ended.returncode, status.state) == (4, "not fitted" if runs else "rejected")

    if not runs:
        assert status.reason in ended.stderr
        assert asked_for(status)[:2] == ("log", "encoder")
        last = read_run(runs_of(folder)[-1])
        amend_run(last, excluded="nothing swung")
        swing(folder, str(last.header.label.axis), minute=90)
        assert task(folder).state == "not fitted"


def test_a_rejected_matrix_is_recorded_again_and_another_rejected_quantity_is_not(folder: Path) -> None:
    swung(folder)
    fitted(folder, rejected="the swings contradict each other")
    assert (task(folder).state, task(folder).reason) == ("rejected", "the swings contradict each other")

    fitted(folder, rejected="the cable was stiff", key="inertia.axis_kg_m2.x")
    assert task(folder).state == "accepted"


# How certain a number is


def test_the_run_without_which_the_others_agree_is_named_and_left_out_first(folder: Path) -> None:
    axes = swung(folder)
    wrong = next(run for run in runs_of(folder) if run.name.endswith(f"_{axes[3]}"))
    fitted(folder, rejected="they contradict each other.", suspects=(wrong.name,))
    status = status_of(open_campaign(folder), kind="inertia")

    assert status.tasks[0].suspects == (wrong.name,)
    assert status.next.words == ("runs", "exclude", wrong.name)

    amend_run(read_run(wrong), excluded="a wrong mount")
    assert asked_for(task(folder)) == swing_again(axes[3])


def test_a_number_that_is_too_uncertain_is_measured_again(folder: Path) -> None:
    swung(folder)
    fitted(folder, std=2e-6, product=5e-7)  # small products are judged by the moments
    status = task(folder)
    (certainty,) = status.found

    assert certainty.std == pytest.approx(2e-6 / 16e-6)
    assert certainty.short_by == pytest.approx(2e-6 / 16e-6 / 0.03)
    assert certainty.mostly == "noise and the inputs of its own fit"
    assert asked_for(status)[:2] == ("log", "encoder")


def test_a_number_that_rig_toml_bounds_is_not_recorded_again(folder: Path) -> None:
    swung(folder)
    fitted(folder, std=2e-6, by_mass=1.5e-6)  # 12 %; 8 % without the part of the mass
    assert task(folder).found[0].bounded_by == ""

    fitted(folder, std=2e-6, by_mass=1.99e-6)  # 1 % without the part of the mass
    status = task(folder)
    assert (status.found[0].bounded_by, status.found[0].mostly) == ("mass", "mass")
    assert asked_for(status) == ("report",)
    assert "because of the mass" in Status(tasks=(status,)).remarks[0]


def test_torque_is_judged_in_hover_and_by_the_covariance_of_its_numbers(folder: Path) -> None:
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
    at_hover = np.array([2 * hover_n, 1.0, 0.0])
    relative = np.sqrt(at_hover @ correlated @ at_hover) / (2 * square * hover_n + slope)

    (certainty,) = task(folder, "torque", kind="full").found
    assert certainty.std == pytest.approx(relative, rel=1e-3)
    assert certainty.short_by == pytest.approx(relative / 0.05, rel=1e-3)


def test_the_report_comes_when_all_is_found_and_certain(folder: Path) -> None:
    swung(folder)
    fitted(folder)
    status = task(folder)

    assert asked_for(status) == ("report",)
    assert Status(tasks=(status,), kind="inertia").next.words == ("report", "--kind", "inertia")


# Runs that are of no use, or a part of what was planned


def test_a_run_of_no_use_is_named_until_a_later_one_is_good(folder: Path) -> None:
    mount = drawn(folder)[0]
    useless = swing(folder, mount, minute=0)
    amend_run(useless, verdict=USELESS)
    assert asked(folder) == swing_again(mount)
    assert task(folder).reason == f"{useless.folder.name} is not usable: no release found."

    swing(folder, mount, minute=5)
    assert (task(folder).reason, task(folder).recorded) == ("", 1)


def test_a_run_that_is_being_recorded_or_cannot_be_read_is_named_and_does_not_count(cfid: Cfid, folder: Path) -> None:
    growing, broken = swing(folder, "x", minute=0), swing(folder, "y", minute=1)
    text = (growing.folder / "run.toml").read_text()
    (growing.folder / "run.toml").write_text(text.replace('state = "complete"', 'state = "recording"'))
    (broken.folder / "run.toml").write_text("format = [[\n", encoding="utf-8")
    ended = cfid("status", "--kind", "inertia", "--json", folder=folder)
    status = json.loads(ended.stdout)["tasks"][0]

    assert (ended.returncode, status["runs"], status["runs_planned"]) == (0, 0, 7)
    assert status["reason"].startswith(growing.folder.name)
    assert f"{broken.folder.name}/run.toml" in ended.stderr


def tf(folder: Path) -> TaskStatus:
    return task(folder, "tf", kind="motors")


def test_a_series_of_sines_that_ended_early_is_completed(folder: Path) -> None:
    sine(folder, 2, minute=0, planned=[2, 5, 8])
    sine(folder, 5, minute=1, planned=[2, 5, 8])
    failed = sine(folder, 8, minute=2, planned=[2, 5, 8], state="failed")
    assert (tf(folder).state, tf(folder).recorded) == ("missing", 0)
    assert asked_for(tf(folder)) == ("log", "sine", "--resume", failed.folder.name)

    sine(folder, 8, minute=3, planned=[2, 5, 8])
    assert (tf(folder).state, tf(folder).recorded) == ("not fitted", 1)


def test_a_sine_of_no_use_is_played_again_and_one_that_was_excluded_only_on_request(cfid: Cfid, folder: Path) -> None:
    def resumed(*words: str) -> subprocess.CompletedProcess[str]:
        return cfid(*(words or ("log", "sine", "--resume", last.folder.name)), "--dry-run", folder=folder)

    first, second, last = (sine(folder, periods, minute=periods, planned=[2, 5, 8]) for periods in (2, 5, 8))
    assert (tf(folder).state, resumed().returncode) == ("not fitted", 2)

    amend_run(second, verdict=USELESS)
    assert asked_for(tf(folder)) == ("log", "sine", "--resume", last.folder.name)
    assert resumed().stdout.startswith("1 sine of ")

    amend_run(first, excluded="for verification")
    words = asked_for(tf(folder))
    assert words == ("log", "sine", "--resume", last.folder.name, "--hz", "0.625")
    assert resumed(*words).stdout.startswith("1 sine of ")
    assert resumed().stdout.startswith("2 sines of ")

    amend_run(second, excluded="too fast for this cell")
    assert tf(folder).state == "not fitted"


def test_resume_without_a_name_completes_the_series_of_the_newest_run(cfid: Cfid, folder: Path) -> None:
    sine(folder, 2, minute=1, planned=[2, 5, 8])
    assert cfid("log", "sine", "--resume", "--dry-run", folder=folder).stdout.startswith("2 sines of ")


def test_scales_are_as_good_as_a_load_cell_for_the_thrust_map(folder: Path) -> None:
    columns = {"t": [1.7e9, 1.7e9 + 5], "command": [0, 20000], "grams": [60.0, 55.0]}
    made_run(folder, "scales", {"readings": columns}, started=BEGAN)

    thrust = task(folder, "thrust", kind="afternoon")
    assert (thrust.state, thrust.recorded) == ("not fitted", 1)
    assert task(folder, "torque", kind="afternoon").state == "missing"


def test_speeds_recorded_after_the_thrust_was_fitted_are_fitted_with_it(folder: Path) -> None:
    commands = {"t": [1.7e9], "m1": [10000], "m2": [0], "m3": [0], "m4": [0]}
    recorded = made_run(folder, "thrust", {"commands": commands}, started=BEGAN)
    file = recorded.device_file("commands")
    section = Section(
        method="default",
        found=LATER,
        cfid_version="0.2.0",
        accepted=True,
        sources=(Source(str(file.relative_to(folder)), hashlib.sha256(file.read_bytes()).hexdigest()),),
        parameters={"motor.max_thrust_n": Parameter(value=0.16, std=1e-3, unit="N")},
    )
    keep(folder, "thrust", section)
    assert task(folder, "thrust", kind="motors").state == "accepted"
    columns = {"t": [1.7e9, 1.7e9 + 5], "command": [0, 20000], "rpm": [0.0, 11000.0]}
    made_run(folder, "speed", {"readings": columns}, started=LATER + timedelta(hours=1))

    assert asked_for(task(folder, "thrust", kind="motors")) == ("fit", "thrust")


def test_a_staircase_that_was_interrupted_is_completed_unless_it_was_excluded(folder: Path) -> None:
    def thrust() -> Words:
        return asked_for(task(folder, "thrust", kind="motors"))

    first = staircase(folder, minute=0)
    second = staircase(folder, minute=5, resumes=first.folder.name)
    assert thrust() == ("log", "thrust", "--resume", second.folder.name)
    amend_run(second, excluded="gust")
    assert thrust() == ("log", "thrust", "--resume", first.folder.name)
    amend_run(first, excluded="gust")
    assert thrust() == ("log", "thrust")


# The commands


def test_the_kind_of_a_campaign_is_that_of_rig_toml(cfid: Cfid, folder: Path) -> None:
    rig = folder / "rig.toml"
    rig.write_text(rig.read_text().replace('kind = "full"', 'kind = "motors"'))
    content = json.loads(cfid("status", "--json", folder=folder).stdout)
    assert [task["fit"] for task in content["tasks"]] == ["thrust", "torque", "speed", "latency", "tf"]

    rig.write_text(rig.read_text().replace('"motors"', '"morning"'))
    assert cfid("status", folder=folder).returncode == 2


def test_next_becomes_the_command_and_without_an_answer_starts_nothing(cfid: Cfid, folder: Path) -> None:
    ended = cfid("next", folder=folder)
    assert ended.returncode == 2
    assert "--yes" in ended.stderr
    assert list_runs(folder / "runs") == []

    swung(folder)
    ended = cfid("next", "--kind", "inertia", "--yes", folder=folder)
    assert "next: cfid fit inertia" in ended.stdout
    assert ended.returncode == 4  # of the fit: ten rows are no swing


def test_ctrl_c_at_the_question_of_next_ends_it_with_the_code_of_an_interruption(folder: Path) -> None:
    words = [sys.executable, "-m", "cfid.cli.main", "next"]
    with subprocess.Popen(
        words, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        assert process.stderr is not None
        printed = b""
        while b"Start it?" not in printed:
            letter = process.stderr.read(1)
            assert letter, printed
            printed += letter
        for _ in range(3):  # the first signal may come between the question and the reading of its answer
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
                break

        assert process.returncode == 130
