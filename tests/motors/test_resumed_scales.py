"""An interrupted run of scales and the runs that complete it count as one run, in verdict and fit."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.console.verdicts import judged, verdict_line
from cfid.motors.maps.verdict import of_readings
from cfid.motors.plan import missing
from cfid.recordings.resumed import steps_left
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.records.run import DeviceRecord, Label, Run, Verdict, amend_run, read_run, write_header
from cfid.records.run_writer import create_run
from tests.lab import Cfid
from tests.motors.stand_in_a_folder import BEGIN_S
from tests.motors.test_motor_fits import found, true_thrust_n

COMMANDS = tuple(range(0, 40001, 10000))


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    rows = [f"{command},{float(true_thrust_n(command)):.6f}" for command in range(16000, 64001, 4000)]
    (tmp_path / "forces.csv").write_text("\n".join(["cmd,thrust_n", "0,0", *rows]) + "\n")
    return tmp_path


def grams(command: float, *, rest_g: float = 60.0) -> float:
    """Return the grams on scales while motors 1 and 3 run at a command."""
    return rest_g - 2e3 * float(true_thrust_n(command) if command else 0.0) / 9.81


def weighed(campaign: Path, minute: int, state: Any, readings: Mapping[int, float], **requested: Any) -> Run:
    """Write a run with the readings of scales that an operator typed while two motors ran."""
    with create_run(
        campaign / "runs",
        kind="scales",
        label=Label(),
        devices={"readings": DeviceRecord(file="readings.csv", columns=("t", "command", "grams", "withdrawn"))},
        started=datetime(2026, 11, 21, 8, minute, tzinfo=UTC),
        cfid_version="0",
        requested={"steps": COMMANDS, "motors": (1, 3), "hold_s": 2.0, "rest_s": 1.0, **requested},
    ) as writer:
        count = len(readings)
        if count:
            columns = (np.array(list(readings)), np.array(list(readings.values())), np.zeros(count))
            writer.append("readings", (BEGIN_S + 60 * minute + np.arange(count), *columns))
        return writer.close(state)


def two_parts(campaign: Path) -> tuple[Run, Run]:
    first = weighed(campaign, 1, "interrupted", {at: grams(at) for at in COMMANDS[:2]})
    left = {"steps": COMMANDS[2:], "resumes": first.folder.name}
    return first, weighed(campaign, 2, "complete", {at: grams(at) for at in COMMANDS[2:]}, **left)


def test_the_verdict_of_a_part_takes_the_weight_at_rest_of_the_run_that_it_completes(campaign: Path) -> None:
    first, second = two_parts(campaign)

    assert of_readings(second).endswith(f"It verifies a map together with {first.folder.name}, which it completes.")
    amend_run(first, excluded="the vehicle slid")
    assert "Alone it verifies no map" in of_readings(read_run(second.folder))


def test_a_display_that_stands_still_is_named_with_the_run_before_and_what_to_do_about_either(campaign: Path) -> None:
    first = weighed(campaign, 1, "interrupted", dict.fromkeys(COMMANDS[:3], 60.0))
    left = {"steps": COMMANDS[3:], "resumes": first.folder.name}
    second = weighed(campaign, 2, "complete", dict.fromkeys(COMMANDS[3:], 60.0), **left)
    line = verdict_line(judged(second, of_readings))
    name = first.folder.name

    assert f"NOT USABLE: together with {name} (commands 0 to 20000), which it completes: the scales show 60" in line
    assert f"If {name} is right, `cfid log scales --resume {name}` records the rest again; else record it all" in line
    assert missing(first.folder, kind="scales").steps == COMMANDS[3:]  # the steps that this command records


@pytest.mark.parametrize("named", ["second", "both", "reversed"])
def test_a_map_is_verified_by_all_parts_of_a_run_of_scales(cfid: Cfid, campaign: Path, named: str) -> None:
    first, second = (run.folder.name for run in two_parts(campaign))
    names = {"second": [second], "both": [first, second], "reversed": [second, first]}[named]
    verify = [word for name in names for word in ("--verify", name)]
    content = found(cfid, "fit", "thrust", campaign / "forces.csv", *verify, "--no-figures")
    said = cfid("fit", "thrust", campaign / "forces.csv", *verify, "--no-figures")

    assert "verification: 5 readings" in said.stdout
    assert content["quality"]["verification_rms_n"] < 1e-3


def test_a_part_with_a_weight_at_rest_of_its_own_is_compared_with_that(cfid: Cfid, campaign: Path) -> None:
    """Between the parts, the vehicle was taken off the scales and put back with its cable over the edge."""
    first = weighed(campaign, 1, "interrupted", {at: grams(at) for at in COMMANDS[:4]})
    again = {at: grams(at, rest_g=57.0) for at in (40000, 0)}
    left = {"steps": (40000, 0), "resumes": first.folder.name}
    second = weighed(campaign, 2, "complete", again, **left)
    words = ("fit", "thrust", campaign / "forces.csv", "--verify", second.folder.name, "--no-figures")

    assert found(cfid, *words)["quality"]["verification_rms_n"] < 1e-3


def test_two_runs_of_scales_verify_a_map_together_each_by_its_own_weight_at_rest(cfid: Cfid, campaign: Path) -> None:
    heavy, light = (
        weighed(campaign, minute, "complete", {at: grams(at, rest_g=rest_g) for at in COMMANDS})
        for minute, rest_g in ((1, 412.0), (2, 60.0))
    )
    verify = ("--verify", heavy.folder.name, "--verify", light.folder.name, "--no-figures")
    said = cfid("fit", "thrust", campaign / "forces.csv", *verify)

    assert said.returncode == 0, said.stderr
    assert "verification: 10 readings" in said.stdout
    assert found(cfid, "fit", "thrust", campaign / "forces.csv", *verify)["quality"]["verification_rms_n"] < 1e-3


def test_a_part_whose_predecessor_has_no_reading_verifies_no_map(cfid: Cfid, campaign: Path) -> None:
    first = weighed(campaign, 1, "interrupted", {})
    left = {"steps": COMMANDS[2:], "resumes": first.folder.name}
    second = weighed(campaign, 2, "complete", {at: grams(at) for at in COMMANDS[2:]}, **left)
    said = cfid("fit", "thrust", campaign / "forces.csv", "--verify", second.folder.name, "--no-figures")

    assert "Alone it verifies no map" in of_readings(second)
    assert said.returncode == 0, said.stderr
    assert "the map is not verified: scales show a change of weight" in " ".join((said.stdout + said.stderr).split())


def test_what_a_later_part_recorded_is_not_recorded_again(cfid: Cfid, campaign: Path) -> None:
    first, second = two_parts(campaign)
    for word in (first.folder, first.folder.name):
        said = cfid("log", "scales", "--resume", word, "--dry-run")

        assert said.returncode == 2
        assert f"{first.folder.name}: {second.folder.name} completes it; nothing is left to record." in said.stderr


def test_what_all_parts_lack_is_recorded_and_completes_the_last_of_them(campaign: Path) -> None:
    first = weighed(campaign, 1, "interrupted", {at: grams(at) for at in COMMANDS[:2]})
    left = {"steps": COMMANDS[2:], "resumes": first.folder.name}
    second = weighed(campaign, 2, "interrupted", {COMMANDS[2]: grams(COMMANDS[2])}, **left)
    third = weighed(campaign, 3, "failed", {}, steps=COMMANDS[3:], resumes=second.folder.name)
    plan = missing(first.folder, kind="scales")

    assert plan.steps == COMMANDS[3:]
    assert plan.resumes == third.folder.name
    assert missing(third.folder, kind="scales") == plan


@pytest.mark.parametrize("spoilt", ["excluded", "not usable"])
def test_a_later_part_of_no_use_is_recorded_again(campaign: Path, spoilt: str) -> None:
    first, second = two_parts(campaign)
    if spoilt == "excluded":
        amend_run(second, excluded="the vehicle slid")
    else:
        amend_run(second, verdict=Verdict(usable=False, text="the display stands still."))
    plan = missing(first.folder, kind="scales")

    assert plan.steps == COMMANDS[2:]
    assert plan.resumes == first.folder.name


def killed(campaign: Path, readings: Mapping[int, float]) -> Run:
    """Write a run as a killed recorder leaves it: run.toml was never closed."""
    run = weighed(campaign, 1, "interrupted", readings)
    header = run.header.model_copy(
        update={
            "state": "recording",
            "devices": {name: one.model_copy(update={"rows": None}) for name, one in run.header.devices.items()},
        }
    )
    write_header(run.folder, header)
    return read_run(run.folder)


def test_what_was_typed_until_the_recorder_was_killed_is_not_asked_for_again(campaign: Path) -> None:
    run = killed(campaign, {at: grams(at) for at in COMMANDS[:2]})
    assert missing(run.folder, kind="scales").steps == COMMANDS[2:]

    with (run.folder / "readings.csv").open("a") as file:
        file.write("1763712345.5,20000,5")  # the recorder was killed while it wrote a row
    assert missing(run.folder, kind="scales").steps == COMMANDS[2:]


def test_a_recorder_that_was_killed_before_a_reading_has_every_step_to_record(campaign: Path) -> None:
    run = killed(campaign, {})
    left = {"steps": COMMANDS, "resumes": run.folder.name}
    second = weighed(campaign, 2, "complete", {at: grams(at) for at in COMMANDS}, **left)

    assert steps_left(run) == COMMANDS
    assert of_readings(second).startswith("5 readings at 5 steps")
