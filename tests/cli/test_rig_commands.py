"""`cfid rig check` and `cfid rig sim`: which devices answer, a simulated rig, and what remains of it afterwards."""

import json
import signal
import socket
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from cfid.rig.sim_file import SIM_FILE
from tests.rig_in_a_folder import Lab, lab_in, rig_sim

pytestmark = pytest.mark.usefixtures("in_time")

SIMULATED = "note: the rig is simulated: "


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with lab_in(tmp_path) as lab:
        yield lab


# Check


def test_a_sound_rig_is_ready_and_no_setting_is_changed(lab: Lab) -> None:
    lab.e201.word_bits = 18
    lab.box.box.buffer_size = 3

    ended = lab.cfid("rig", "check", "--json")
    content = json.loads(ended.out)

    assert ended.code == 0
    assert ended.err == ""
    assert not content["simulated"]
    assert [answer["asked"] for answer in content["devices"]["loadcell"]] == [
        "settings, HTTP",
        "reading, TCP",
        "RDT, UDP",
        "receive buffer",
    ]
    assert {answer["state"] for answer in content["devices"]["loadcell"][:3]} == {"ok"}
    assert [answer["state"] for answer in content["devices"]["encoder"]] == ["ok", "warning"]
    assert lab.e201.word_bits == 18
    assert lab.box.box.buffer_size == 3


def test_what_is_wrong_is_told_with_what_to_do(lab: Lab) -> None:
    lab.encoder_suffers(not_an_e201=True)
    lab.loadcell_suffers(drop_every=3)
    lab.box.box.status = 0x80010000

    ended = lab.cfid("rig", "check")

    assert ended.code == 3
    assert ended.err == "cfid: not ready: encoder, loadcell.\n"
    assert "-> plug it in, or set devices.encoder.port in rig.toml" in ended.out
    assert "reading, TCP    warning  a threshold is latched" in ended.out
    assert "-> the stream broke off: another client uses the same box, or the network drops datagrams" in ended.out


# A simulated rig


def test_logs_of_a_simulated_rig_say_so_and_meet_its_faults(lab: Lab) -> None:
    with rig_sim(
        lab, "--axis", "x", "--fault", "loadcell.duplicate_every=10", "--fault", "encoder.drop_every=40"
    ) as sim:
        checked = lab.cfid("rig", "check")
        logs = [lab.start("log", "loadcell", "--for", 1), lab.start("log", "encoder", "--axis", "x", "--for", 1)]
        loadcell, encoder = (log.end() for log in logs)
        listed = lab.cfid("runs", "--json")
    runs = json.loads(listed.out)["runs"]

    assert checked.code == loadcell.code == encoder.code == 0
    for ended in (checked, loadcell, encoder):
        assert ended.err.startswith(SIMULATED)
    assert "7000 Hz" in checked.out
    assert "rig.toml states 700 Hz: `cfid log loadcell` sets them" in checked.out
    assert "duplicates" in loadcell.out
    assert "polls without position" in encoder.out
    assert [run["simulated"] for run in runs] == [True, True]
    assert sim.end().code == 0
    assert not (lab.folder / SIM_FILE).exists()


def test_a_simulated_rig_tells_where_its_vehicle_is_and_traces_its_motors(lab: Lab) -> None:
    with rig_sim(lab, "--trace", "motors.txt", "--fault", "crazyflie.reboot_after_s=5") as sim:
        uri = tomllib.loads((lab.folder / SIM_FILE).read_text())["devices"]["crazyflie"]["uri"]
        host, _, port = uri.removeprefix("udp://").partition(":")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            for number, value in ((1, b"\x30\x75"), (0, b"\x02")):  # motorPowerSet: 30000 for all motors
                client.sendto(b"\x2e" + bytes([number, 0]) + value, (host, int(port)))
        trace = lab.folder / "motors.txt"
        sim.wait_until(lambda: len(trace.read_text().splitlines()) == 3, "motors that started and stopped")
    lines = [line.split() for line in trace.read_text().splitlines()]
    assert [line[1:] for line in lines] == [["0"] * 4, ["30000"] * 4, ["0"] * 4]
    assert float(lines[0][0]) < float(lines[1][0]) < float(lines[2][0]) < time.monotonic()


def test_a_killed_simulated_rig_is_not_taken_for_the_real_one(lab: Lab) -> None:
    with rig_sim(lab) as sim:
        sim.process.kill()
        sim.process.wait()
    assert (lab.folder / SIM_FILE).exists()

    ended = lab.cfid("log", "encoder", "--for", 0.3)

    assert ended.code == 2  # the real devices do not replace the simulated ones
    assert "Start `cfid rig sim` here, or delete this file for the devices of rig.toml." in " ".join(ended.err.split())
    assert list(lab.folder.glob("runs/*")) == []
    assert "the devices are the real ones of rig.toml" in " ".join(lab.cfid("rig", "check").err.split())
    (lab.folder / SIM_FILE).unlink()
    assert lab.cfid("log", "encoder", "--for", 0.3).code == 0
    assert not lab.run().header.simulated
    with rig_sim(lab):  # the next simulated rig takes its place
        assert lab.cfid("rig", "check").err.startswith(SIMULATED)


def test_a_second_simulated_rig_is_refused_and_the_first_goes_on(lab: Lab) -> None:
    with rig_sim(lab):
        ended = lab.cfid("rig", "sim")
        checked = lab.cfid("rig", "check")

    assert ended.code == 2
    assert (
        ended.err == f"cfid: {lab.folder / SIM_FILE}: another simulated rig serves this campaign. End that one first.\n"
    )
    assert checked.code == 0


def test_a_simulated_rig_that_ends_under_a_log_is_a_lost_device(lab: Lab) -> None:
    with rig_sim(lab) as sim:
        loadcell = lab.start("log", "loadcell")
        loadcell.wait_for_rows(100)
        encoder = lab.start("log", "encoder")
        encoder.wait_until_said("recording into")
        encoder.wait_for_rows(30)
        assert sim.ask_to_end().code == 0
        encoder.wait_until_said("unplugged; waiting for the encoder")
        assert encoder.ask_to_end().code == 3
        assert loadcell.end().code == 3

    assert "not plugged in again" in encoder.err
    assert "sent nothing more for" in loadcell.err
    states = [run["state"] for run in json.loads(lab.cfid("runs", "--json").out)["runs"]]
    assert states == ["failed", "failed"]


def test_a_signal_ends_a_simulated_rig_and_nothing_is_left(lab: Lab) -> None:
    with rig_sim(lab) as sim:
        ended = sim.ask_to_end(signal.SIGTERM)

    assert ended.code == 0
    assert not (lab.folder / SIM_FILE).exists()
    assert list(lab.folder.glob("cfid-sim-*")) == []


def test_a_simulated_rig_ends_after_its_time(lab: Lab) -> None:
    ended = lab.cfid("rig", "sim", "--for", 0.2)

    assert ended.code == 0
    assert not (lab.folder / SIM_FILE).exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--fault loadcell.drop=1", "there is no fault 'loadcell.drop'. Known faults: encoder.drop_every,"),
        ("--spin 1,2,3", "--spin 1,2,3: expected four motor commands"),
        ("--for 0", "--for 0: has to be above zero."),
        ("--axis q", "there is no 'q'. There are: x,"),
        ("--truth nowhere.toml", "nowhere.toml"),
        ("--trace no/such/folder", "no/such/folder: cannot be written: No such file or directory."),
    ],
)
def test_a_simulation_that_cannot_be_meant_so_is_told(lab: Lab, words: str, expected: str) -> None:
    ended = lab.cfid("rig", "sim", *words.split())

    assert ended.code == 2
    assert expected in ended.err
    assert not (lab.folder / SIM_FILE).exists()
