"""`cfid rig check` and `cfid rig sim`: which devices answer, a simulated rig, and what remains of it afterwards."""

import json
import signal
import tomllib
from pathlib import Path

import pytest

from cfid.rig.sim_file import SIM_FILE
from cfid.wire.netft import rate_query, read_settings
from tests.lab import new_campaign, run_cfid
from tests.rig_in_a_folder import lab_in as served_lab_in
from tests.rig_in_a_folder import rig_sim
from tests.virtual_lab import LOADCELL_HZ, lab_in

SIMULATED = "note: the rig is simulated: "


def test_a_check_changes_no_setting(tmp_path: Path) -> None:
    with lab_in(tmp_path) as lab:
        lab.e201.word_bits = 18
        lab.box.get(rate_query(rate_hz=LOADCELL_HZ, buffer_size=3))
        ended = lab.cfid("rig", "check", "--json")
        answers = json.loads(ended.out)["devices"]

        assert ended.code == 0
        assert [(answer["asked"], answer["state"]) for answer in answers["loadcell"]][:3] == [
            ("settings, HTTP", "ok"),
            ("reading, TCP", "ok"),
            ("RDT, UDP", "ok"),
        ]
        assert [answer["state"] for answer in answers["encoder"]] == ["ok", "warning"]
        assert lab.e201.word_bits == 18
        assert read_settings(lab.box.box.page()).buffer_size == 3


def test_what_is_wrong_is_told_with_what_to_do(tmp_path: Path) -> None:
    with lab_in(tmp_path) as lab:
        lab.encoder_suffers(not_an_e201=True)
        lab.loadcell_suffers(drop_every=3)
        lab.box.box.status = 0x80010000
        ended = lab.cfid("rig", "check", "--json")
        answers = json.loads(ended.out)["devices"]
        faults = [answer for answer in answers["encoder"] + answers["loadcell"] if answer["state"] == "fault"]

        assert ended.code == 3
        assert "not ready: encoder, loadcell." in ended.err
        assert all(fault["advice"] for fault in faults)
        assert {answer["asked"]: answer["state"] for answer in answers["loadcell"]}["reading, TCP"] == "warning"


@pytest.mark.usefixtures("in_time")
def test_commands_use_a_served_rig_which_leaves_nothing_behind(tmp_path: Path) -> None:
    faults = ("--fault", "loadcell.duplicate_every=10", "--fault", "encoder.drop_every=40")
    with served_lab_in(tmp_path) as lab, rig_sim(lab, "--axis", "x", *faults) as sim:
        file = lab.folder / SIM_FILE
        second = lab.cfid("rig", "sim")
        recorded = [lab.cfid("log", device, "--for", 0.5) for device in ("loadcell", "encoder")]
        losses = {
            name: device
            for run in json.loads(lab.cfid("runs", "--json").out)["runs"]
            for name, device in tomllib.loads((lab.folder / "runs" / run["run"] / "run.toml").read_text())[
                "devices"
            ].items()
        }
        ended = sim.ask_to_end(signal.SIGTERM)

        assert second.code == 2
        assert all(said.code == 0 and said.err.startswith(SIMULATED) for said in recorded)
        assert losses["loadcell"]["arrivals"]["duplicates"] > 0
        assert losses["encoder"]["losses"]["polls_without_position"] > 0
        assert ended.code == 0
        assert not file.exists()
        assert list(lab.folder.glob("cfid-sim-*")) == []


@pytest.mark.usefixtures("in_time")
def test_a_log_ends_with_a_killed_rig_which_is_then_not_taken_for_the_real_one(tmp_path: Path) -> None:
    with served_lab_in(tmp_path) as lab:
        with rig_sim(lab) as sim:
            log = lab.start("log", "encoder")
            log.wait_for_rows(30)
            sim.process.kill()
            sim.process.wait()
            log.wait_until_said("unplugged")
            assert log.ask_to_end().code == 3
        assert lab.run().header.state == "failed"
        assert (lab.folder / SIM_FILE).exists()

        refused = lab.cfid("log", "encoder", "--for", 0.3)
        assert refused.code == 2  # the real devices do not replace the simulated ones
        assert lab.cfid("rig", "check").code != 2
        assert len(list(lab.folder.glob("runs/*"))) == 1


def test_a_simulated_rig_ends_after_its_time(tmp_path: Path) -> None:
    new_campaign(tmp_path)

    assert run_cfid(["rig", "sim", "--for", "0.1"], tmp_path).returncode == 0
    assert not (tmp_path / SIM_FILE).exists()


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ("--fault loadcell.drop=1", "loadcell.drop"),
        ("--for 0", "--for 0"),
        ("--axis q", "'q'"),
        ("--truth nowhere.toml", "nowhere.toml"),
    ],
)
def test_a_simulation_with_a_wrong_option_is_refused(tmp_path: Path, words: str, option: str) -> None:
    new_campaign(tmp_path)
    ended = run_cfid(["rig", "sim", *words.split()], tmp_path)

    assert ended.returncode == 2
    assert option in ended.stderr
    assert not (tmp_path / SIM_FILE).exists()
