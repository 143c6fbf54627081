"""Which runs an argument selects, what fits leave out, what a campaign knows, and what is set by hand."""

import json
import os
import shutil
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal

import pytest

from cfid.console.selection import chosen
from cfid.records.campaign import Campaign
from cfid.records.choose import labelled
from cfid.records.run import DeviceRecord, Label, Run, read_run
from cfid.records.run_writer import create_run
from tests.lab import STARTED, Cfid, made_run, new_campaign, sections_at

DROPS = labelled("drop")


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    """A campaign with three drops, one of them interrupted, and two swings of different bodies."""
    for minute, (kind, body, state) in enumerate(plan()):
        label = Label(axis="x" if kind == "swing" else None, body=body)
        columns = {"encoder": {"t": [1.0, 2.0], "phi": [3, 4]}}
        made_run(tmp_path, kind, columns, label=label, state=state, started=STARTED + timedelta(minutes=minute))
    return new_campaign(tmp_path)


def plan() -> Iterator[tuple[str, Literal["crazyflie", "testbody"] | None, Literal["complete", "interrupted"]]]:
    yield "drop", None, "complete"
    yield "drop", None, "interrupted"
    yield "drop", None, "complete"
    yield "swing", None, "complete"
    yield "swing", "testbody", "complete"


def names(campaign: Campaign) -> list[str]:
    return sorted(path.name for path in campaign.runs_folder.iterdir())


def words(campaign: Campaign, *given: str) -> list[str]:
    return chosen(list(given), campaign, suits=DROPS, wanted="drops")


# Arguments


def test_without_a_word_all_complete_runs_of_the_kind_are_taken_and_the_others_named(
    campaign: Campaign, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second, third, *_ = names(campaign)

    assert words(campaign) == [first, third]
    assert capsys.readouterr().err == f"note: takes 2 complete drops; left out: {second} (interrupted).\n"


def test_a_folder_that_is_no_run_is_refused_by_name_and_left_out_by_a_glob_of_commands_that_take_one_run(
    campaign: Campaign, cfid: Cfid
) -> None:
    folder = campaign.runs_folder / "2026-11-22_photos"
    folder.mkdir()
    here = ("--campaign", str(campaign.folder))
    for command in (("show",), ("convert", "--to", "csv"), ("fit", "swing"), ("fit", "inertia"), ("fit", "thrust")):
        refused = cfid(*command, folder.name, *here)
        assert refused.returncode == 4, (command, refused.stderr)
        assert str(folder) in refused.stderr

    found = cfid("show", "last", "--no-figures", *here)
    assert f"{folder} is left out" in found.stderr
    assert f"{folder} is left out" in cfid("runs", *here).stderr


@pytest.mark.parametrize("given", ["2026*", "*drop* last 2026*", "runs/*_drop*", "./runs/*_drop*"])
def test_a_glob_finds_each_complete_run_of_the_kind_once_and_a_name_any_run(
    campaign: Campaign, given: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second, third, *_ = names(campaign)
    monkeypatch.chdir(campaign.folder)

    assert words(campaign, *given.split(), "20=file.csv") == [first, third, "20=file.csv"]
    assert f"{second} (interrupted)" in capsys.readouterr().err
    assert words(campaign, second) == [second]


# cfid runs


def test_a_run_is_left_out_and_counts_again(cfid: Cfid, campaign: Campaign) -> None:
    first = names(campaign)[0]
    rows = (campaign.runs_folder / first / "encoder.csv").read_bytes()

    assert cfid("runs", "exclude", first, "--note", "the cable touched").returncode == 0
    assert len(words(campaign)) == 1
    listed = json.loads(cfid("runs", "--json").stdout)["runs"][0]
    assert listed["excluded"] == "the cable touched"
    assert listed["note"] == "excluded: the cable touched"
    assert cfid("runs", "include", first).returncode == 0
    assert len(words(campaign)) == 2
    assert (campaign.runs_folder / first / "encoder.csv").read_bytes() == rows
    assert cfid("runs", "exclude", "runs/*_swing_x").stdout.startswith(names(campaign)[3])


def test_notes_are_added_to_runs_and_taken_away(cfid: Cfid, campaign: Campaign) -> None:
    assert "note added: new battery" in cfid("runs", "note", "*drop*", "new battery").stdout
    notes = [run.header.label.note for run in runs_of(campaign)]
    assert notes == ["new battery"] * 3 + [None] * 2

    cfid("runs", "note", names(campaign)[0], "21 degrees")
    assert runs_of(campaign)[0].header.label.note == "new battery; 21 degrees"

    cfid("runs", "note", names(campaign)[0], "")
    assert runs_of(campaign)[0].header.label.note is None


def test_a_run_that_is_being_recorded_is_not_touched(cfid: Cfid, campaign: Campaign) -> None:
    writer = create_run(
        campaign.runs_folder,
        kind="drop",
        label=Label(),
        devices={"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))},
        started=datetime.now(UTC),
        cfid_version="0",
    )

    def states(run: str) -> tuple[str, str]:
        (row,) = (row for row in json.loads(cfid("runs", "--json").stdout)["runs"] if row["run"] == run)
        (line,) = (line for line in cfid("runs").stdout.splitlines() if run in line)
        return row["state"], line.split()[1]

    ended = cfid("runs", "exclude", writer.folder.name)

    assert ended.returncode == 2
    assert "is still being recorded" in ended.stderr
    writer.append("encoder", ([1.7e9], [0]))
    os.utime(writer.folder / "encoder.csv", (0, 0))  # old, as if it waited for an encoder or a typed reading
    assert states(writer.folder.name) == ("recording", "recording")
    assert cfid("runs", "exclude", writer.folder.name).returncode == 2
    shutil.copytree(writer.folder, campaign.runs_folder / "9999-01-01_000000_drop")
    assert states("9999-01-01_000000_drop") == ("cut", "cut")
    assert cfid("runs", "exclude", "9999-01-01_000000_drop").returncode == 0
    writer.close("failed")


@pytest.mark.parametrize("by_name", [True, False])
def test_a_run_that_cannot_be_read_is_not_taken_for_another(cfid: Cfid, campaign: Campaign, by_name: bool) -> None:
    last = names(campaign)[-1]
    (campaign.runs_folder / last / "run.toml").write_text("kind = ")
    ended = cfid("runs", "exclude", last if by_name else "last")

    assert (ended.returncode, ended.stdout) == (4, "")
    assert "invalid TOML" in ended.stderr


# cfid parameters, cfid set


def test_the_mass_is_changed_in_rig_toml_with_every_comment_kept(cfid: Cfid, campaign: Campaign) -> None:
    path = campaign.folder / "rig.toml"
    before = path.read_text()
    ended = cfid("set", "mass_kg", "0.0301:0.0002")
    after = path.read_text()

    assert ended.returncode == 0
    assert "vehicle.mass_kg. Earlier fits used the old number" in ended.stdout
    changed = [line for line, old in zip(after.splitlines(), before.splitlines(), strict=True) if line != old]
    assert [line.split("#")[0].strip() for line in changed] == ["mass_kg = 0.0301", "mass_std_kg = 0.0002"]
    assert all("#" in line for line in changed)


def test_a_rig_file_that_is_a_link_stays_one_and_keeps_its_permissions(cfid: Cfid, campaign: Campaign) -> None:
    link, file = campaign.folder / "rig.toml", campaign.folder / "shared.toml"
    link.rename(file)
    file.chmod(0o600)
    link.symlink_to(file)
    assert cfid("set", "mass_kg", "0.0301").returncode == 0

    assert link.is_symlink()
    assert "0.0301" in file.read_text()
    assert file.stat().st_mode & 0o777 == 0o600


def test_any_quantity_that_is_registered_can_be_set_with_all_its_numbers(cfid: Cfid, campaign: Campaign) -> None:
    matrix = "16.6e-6:1e-7,16.7e-6:1e-7,29.3e-6:1e-7,0.8e-6:2e-7,0.7e-6:2e-7,1.8e-6:2e-7"
    words = {
        "motor.torque_poly": ["0.006:0.0001,0:1e-6"],
        "drag.simple_kg_per_rad": ["--", "-9e-7:1e-8,-9e-7:1e-8,-1e-6:2e-8"],
        "inertia.matrix_kg_m2": [matrix],
    }
    for name, value in words.items():
        assert cfid("set", name, *value).returncode == 0
    found = {key: one.as_json() for key, one in sections_at(campaign.folder)["set"].parameters.items()}

    assert found["motor.torque_poly"] == {"value": [0.006, 0], "std": [1e-4, 1e-6], "unit": "Nm(N)"}
    assert found["drag.simple_kg_per_rad"]["value"] == [-9e-7, -9e-7, -1e-6]
    assert found["inertia.matrix_kg_m2"]["value"][0] == [16.6e-6, 0.8e-6, 0.7e-6]
    assert found["inertia.matrix_kg_m2"]["std"][2] == [2e-7, 2e-7, 1e-7]
    for name, wrong in (
        ("motor.torque_poly", "0.006:0.0001,0"),
        ("inertia.matrix_kg_m2", "1e-6,2e-6"),
        ("foo.bar", "3"),
    ):
        assert cfid("set", name, wrong).returncode == 2


def test_what_no_fit_finds_stands_in_a_section_of_its_own(cfid: Cfid, campaign: Campaign) -> None:
    cfid("set", "arm_m", "0.046:0.0005")
    cfid("set", "thing_m", "3")
    section = sections_at(campaign.folder)["set"]

    assert section.method == "by hand"
    assert section.parameters["arm_m"].as_json() == {"value": 0.046, "std": 0.0005, "unit": "m"}
    assert section.parameters["thing_m"].unit == "m"
    listed = json.loads(cfid("parameters", "--json").stdout)
    assert listed["sections"]["set"]["parameters"]["arm_m"]["value"] == 0.046
    assert "arm_m" in cfid("parameters").stdout


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("mass_kg 0", "vehicle.mass_kg: should be greater than 0"),
        ("wind_m_per_s 3", "its unit is unknown"),
        ("Arm_m 3", "no parameter that can be set"),
        ("arm_m nan", "finite numbers"),
        ("arm_m 1:inf", "finite numbers"),
        ("arm_m 0.046:0", "not above zero"),
        ("centre_of_mass_m 0.1", "rig.toml states it"),
    ],
)
def test_what_cannot_be_meant_changes_nothing(cfid: Cfid, campaign: Campaign, given: str, expected: str) -> None:
    before = (campaign.folder / "rig.toml").read_bytes()
    ended = cfid("set", *given.split())

    assert ended.returncode == 2
    assert expected in ended.stderr
    assert (campaign.folder / "rig.toml").read_bytes() == before
    assert not campaign.parameters_file.exists()


def runs_of(campaign: Campaign) -> list[Run]:
    return [read_run(campaign.runs_folder / name) for name in names(campaign)]
