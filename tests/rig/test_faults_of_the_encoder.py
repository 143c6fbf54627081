"""Each fault of the encoder, its interface or its cable leads to a sentence, an exit code and correct rows."""

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import serial
from serial.tools import list_ports

from cfid.wire.e201 import CONTINUOUS, PRODUCT, USB_VENDOR
from cfid.wire.rls import STEPS_PER_TURN, decode_words
from tests.known import known
from tests.virtual_lab import ENCODER_HZ, Lab, lab_in

LOG = ("log", "encoder")
FIRST = ENCODER_HZ // 3  # rows to wait for


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with lab_in(tmp_path) as lab:
        yield lab


def rows_of(lab: Lab) -> pd.DataFrame:
    return pd.read_csv(lab.run().device_file("encoder"))


def check_rows(lab: Lab) -> None:
    """Check that every poll is a row or a loss, and every row is an angle of an axis that turns at 0.5 rad/s."""
    rows = rows_of(lab)
    record = lab.run().header.devices["encoder"]
    facts = lab.facts("encoder")
    words = decode_words(rows["phi"].to_numpy())
    turned = np.unwrap(2 * np.pi * words.position / STEPS_PER_TURN)
    stamped_s = 1e-6 * rows["device_us"].to_numpy()
    assert record.rows == len(rows)
    assert facts["polls"] + facts["losses"]["missing_in_gaps"] == len(rows) + known(record.lost)
    assert words.valid.all()
    assert np.allclose(turned - turned[0], 0.5 * (stamped_s - stamped_s[0]), atol=4 * np.pi / STEPS_PER_TURN)
    assert np.all(np.diff(rows["t"]) > 0)


def check_nothing_mixed_up(lab: Lab) -> None:
    """Check that no answer is lost, except where a busy computer did not receive it within 50 ms."""
    losses = lab.facts("encoder")["losses"]
    assert losses["garbled_replies"] == losses["unasked"] == losses["failed_check"] == losses["missing_in_gaps"] == 0
    assert lab.run().header.devices["encoder"].lost <= losses["late_replies"] <= 5


# Replies


def test_replies_that_never_come_are_losses(lab: Lab) -> None:
    lab.encoder_suffers(drop_every=20)

    ended = lab.cfid(*LOG, "--for", 1.5)
    lost = lab.run().header.devices["encoder"].lost

    assert ended.code == 0
    assert lost == pytest.approx(lab.encoder.mishaps.dropped, abs=1)
    assert f"{lost} lost ({lost} polls without position" in ended.out
    check_rows(lab)


def test_garbled_replies_are_losses_and_never_rows(lab: Lab) -> None:
    lab.encoder_suffers(corrupt_every=12)

    ended = lab.cfid(*LOG, "--for", 1.5)

    assert ended.code == 0
    assert "garbled replies" in ended.out
    assert known(lab.run().header.devices["encoder"].lost) >= lab.encoder.mishaps.garbled - 1 > 3
    check_rows(lab)


def test_replies_in_two_pieces_are_whole_rows(lab: Lab) -> None:
    lab.encoder_suffers(split=True)

    ended = lab.cfid(*LOG, "--for", 1)

    assert ended.code == 0
    check_rows(lab)
    check_nothing_mixed_up(lab)


def test_slow_replies_are_fewer_rows_and_no_losses(lab: Lab) -> None:
    lab.encoder_suffers(slow_s=0.02)

    ended = lab.cfid(*LOG, "--for", 1)

    assert ended.code == 0
    assert len(rows_of(lab)) < 50
    check_rows(lab)


def test_replies_that_are_too_slow_are_told_before_a_run(lab: Lab) -> None:
    lab.encoder_suffers(slow_s=0.2)

    ended = lab.cfid(*LOG)
    checked = lab.cfid("rig", "check")

    message = r"replies after 2\d\d ms \(limit 50 ms\), too late to time a position"
    assert ended.code == checked.code == 3
    assert re.search(message, ended.err)
    assert re.search(message, checked.out)
    assert lab.run_folder() is None


def test_a_silence_that_ends_is_a_gap_with_its_losses(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.encoder_suffers(silent_after_s=0)
    silenced = lab.encoder.mishaps.silenced
    log.wait_until(lambda: lab.encoder.mishaps.silenced > silenced + 7, "questions without a reply")
    lab.encoder_suffers()
    log.wait_for_rows(FIRST)
    ended = log.ask_to_end()
    gaps = lab.facts("encoder")["gaps"]  # one, or more if the computer was busy
    gaps_s = [gap["to_s"] - gap["from_s"] for gap in gaps]

    assert ended.code == 0
    assert {gap["reason"] for gap in gaps} == {"no position came"}
    assert min(gaps_s) > 0.25
    assert lab.run().header.devices["encoder"].lost == pytest.approx(sum(gaps_s) * ENCODER_HZ, abs=3 * len(gaps))
    check_rows(lab)


def test_replies_that_come_late_for_a_while_are_losses_and_no_rows_of_other_polls(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.encoder_suffers(slow_s=0.2)
    asked = lab.encoder.introductions
    log.wait_until(lambda: lab.encoder.introductions > asked + 8, "late replies")
    lab.encoder_suffers()
    log.wait_for_rows(FIRST)
    ended = log.ask_to_end()
    rows = rows_of(lab)
    behind_s = rows["t"] - 1e-6 * rows["device_us"]

    assert ended.code == 0
    assert "late replies" in ended.out
    assert behind_s.max() - behind_s.min() < 0.05
    check_rows(lab)


def test_a_silence_for_good_fails_the_run_with_its_rows_kept(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.encoder_suffers(silent_after_s=0)
    ended = log.end()

    assert ended.code == 3
    assert "sent no position for 3 s, though polled: unplug it and plug it in again; `cfid rig check`" in ended.err
    assert lab.run().header.state == "failed"
    assert "sent no position" in lab.run().header.reason
    assert len(rows_of(lab)) >= FIRST
    check_rows(lab)


# The plug


def test_a_plug_pulled_and_put_back_is_a_gap(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.pull_plug()
    log.wait_until_said("unplugged; waiting for the encoder S00042 to come back")
    lab.put_plug_back()
    log.wait_until_said("the encoder is back after")
    log.wait_for_rows(FIRST)
    ended = log.ask_to_end()
    (gap,) = (gap for gap in lab.facts("encoder")["gaps"] if gap["reason"] == "unplugged")
    times = rows_of(lab)["t"]

    assert ended.code == 0
    assert ((times <= gap["from_s"]).sum() >= FIRST) & ((times >= gap["to_s"]).sum() >= FIRST)
    check_rows(lab)


def test_a_plug_that_is_pulled_twice_is_two_gaps(lab: Lab) -> None:
    log = lab.start(*LOG)
    for pulled in (1, 2):
        log.wait_for_rows(FIRST)
        lab.pull_plug()
        log.wait_until_said("to come back", times=pulled)
        lab.put_plug_back()
        log.wait_until_said("is back after", times=pulled)
    log.wait_for_rows(FIRST)
    ended = log.ask_to_end()

    assert ended.code == 0
    assert [gap["reason"] for gap in lab.facts("encoder")["gaps"]].count("unplugged") == 2
    check_rows(lab)


def test_something_else_in_the_place_of_the_plug_is_not_taken_for_the_encoder(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.pull_plug()
    log.wait_until_said("to come back")
    lab.encoder_suffers(not_an_e201=True)
    lab.put_plug_back()
    asked = lab.encoder.introductions
    log.wait_until(lambda: lab.encoder.introductions > asked, "the question who it is")
    ended = log.ask_to_end()

    assert ended.code == 3
    assert "is back" not in ended.err
    check_rows(lab)


def test_something_that_sends_without_end_in_the_place_of_the_plug_keeps_no_log_from_ending(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.pull_plug()
    log.wait_until_said("to come back")
    lab.encoder.unstoppable = True
    lab.put_plug_back()
    lab.in_reactor(lambda: lab.plug.received(CONTINUOUS))
    asked = lab.encoder.contacts
    log.wait_until(lambda: lab.encoder.contacts > asked, "the request to stop")
    ended = log.ask_to_end()

    assert ended.code == 3
    assert "is back" not in ended.err
    assert "and not plugged in again" in ended.err
    check_rows(lab)


def test_a_plug_pulled_and_never_put_back_fails_the_run_with_its_rows_kept(lab: Lab) -> None:
    log = lab.start(*LOG)
    log.wait_for_rows(FIRST)
    lab.pull_plug()
    log.wait_until_said("to come back")
    ended = log.ask_to_end(signal.SIGTERM)

    assert ended.code == 3
    assert "s before the end, and not plugged in again" in ended.err
    assert lab.run().header.state == "failed"
    assert len(rows_of(lab)) >= FIRST
    check_rows(lab)


# The word


def test_a_wrong_width_of_word_is_told_by_check_and_set_by_log(lab: Lab) -> None:
    lab.e201.word_bits = 18

    checked = lab.cfid("rig", "check")
    width = lab.e201.word_bits
    ended = lab.cfid(*LOG, "--for", 0.5)

    assert checked.code == 0
    assert width == 18
    assert "warning  18 bits" in checked.out
    assert "counts_per_turn needs 22 bits: `cfid log encoder` sets them" in checked.out
    assert ended.code == 0
    assert lab.e201.word_bits == 22
    check_rows(lab)


def test_words_of_another_kind_are_told_by_log_and_by_check(lab: Lab) -> None:
    lab.e201.stuck_at_bits = 18

    ended = lab.cfid(*LOG)
    checked = lab.cfid("rig", "check")

    assert ended.code == checked.code == 3
    assert "fail the check of a 13-bit position in 22 bits: another encoder or word width" in ended.err
    assert lab.run().header.state == "failed"
    assert lab.facts("encoder")["losses"]["failed_check"] > 20
    assert "no 13-bit position in 22 bits: set encoder.counts_per_turn in rig.toml" in checked.out


def test_an_interface_without_an_encoder_is_told(lab: Lab) -> None:
    lab.in_reactor(lambda: lab.e201.received(b"f", 0.0))

    ended = lab.cfid(*LOG)
    checked = lab.cfid("rig", "check")

    message = "an E201, but it reports no position: is the encoder plugged into it, and powered?"
    assert ended.code == checked.code == 3
    assert message in ended.err
    assert message in checked.out
    assert lab.run_folder() is None


# The port


def test_an_output_that_a_killed_log_left_on_is_switched_off(lab: Lab) -> None:
    log = lab.start(*LOG, "--continuous")
    log.wait_for_rows(FIRST)
    log.process.kill()
    log.process.wait()
    still_on = lab.e201.continuous

    checked = lab.cfid("rig", "check")
    ended = lab.cfid(*LOG, "--for", 0.5)

    assert still_on
    assert checked.code == ended.code == 0
    assert not lab.e201.continuous


def test_a_device_that_sends_by_itself_is_told_by_log_and_by_check(lab: Lab) -> None:
    lab.encoder.unstoppable = True
    lab.in_reactor(lambda: lab.plug.received(CONTINUOUS))

    ended = lab.cfid(*LOG)
    checked = lab.cfid("rig", "check")

    message = "sends unprompted, even after the command to stop: not an E201."
    assert ended.code == checked.code == 3
    assert message in ended.err
    assert message in checked.out
    assert lab.run_folder() is None


def test_an_interface_without_stamps_is_polled_without_them(lab: Lab) -> None:
    lab.e201.stamps = False

    checked = lab.cfid("rig", "check")
    ended = lab.cfid(*LOG, "--for", 0.5)

    assert checked.code == ended.code == 0
    assert "without stamps" in checked.out
    assert list(rows_of(lab).columns) == ["t", "phi"]
    check_nothing_mixed_up(lab)


def test_another_device_on_the_port_is_told_by_log_and_by_check(lab: Lab) -> None:
    lab.encoder_suffers(not_an_e201=True)

    ended = lab.cfid(*LOG)
    checked = lab.cfid("rig", "check")

    message = "answers 'Virtual ComPort V2.0' where an E201 encoder interface sends its name: another device."
    assert ended.code == checked.code == 3
    assert message in ended.err
    assert message in checked.out
    assert lab.run_folder() is None


def test_a_device_that_says_nothing_is_told(lab: Lab) -> None:
    lab.encoder_suffers(silent_after_s=0)

    ended = lab.cfid(*LOG)
    checked = lab.cfid("rig", "check")

    message = "gives no answer where an E201 encoder interface sends its name"
    assert ended.code == checked.code == 3
    assert message in ended.err
    assert message in checked.out


def test_a_port_that_is_not_there_is_told_with_those_there_are(lab: Lab) -> None:
    ended = lab.cfid(*LOG, "--port", lab.folder / "nothing")
    lab.point_at(lab.ports, port=lab.folder / "nothing")
    checked = lab.cfid("rig", "check")

    message = f"{lab.folder / 'nothing'}: no such port. Available: "
    assert ended.code == checked.code == 3
    assert message in ended.err
    assert message in checked.out


@pytest.mark.parametrize("name", ["rig.toml", ".", os.devnull])
def test_a_port_that_is_no_terminal_is_told(lab: Lab, name: str) -> None:
    path = lab.folder / name

    ended = lab.cfid(*LOG, "--port", path)
    lab.point_at(lab.ports, port=path)
    checked = lab.cfid("rig", "check")

    assert ended.code == checked.code == 3
    assert ended.err == f"cfid: {path}: this is not a serial port.\n"
    assert f"{path}: this is not a serial port." in checked.out


def test_a_port_that_another_program_has_open_is_told(lab: Lab) -> None:
    with serial.Serial(str(lab.port), exclusive=True):
        ended = lab.cfid(*LOG)
        checked = lab.cfid("rig", "check")

    assert ended.code == checked.code == 3
    assert ended.err == f"cfid: {lab.port}: another program has it open: close that first.\n"
    assert f"{lab.port}: another program has it open: close that first." in checked.out


def test_no_encoder_plugged_in_at_all_is_told(lab: Lab) -> None:
    if any(port.vid == USB_VENDOR or PRODUCT in (port.product or "") for port in list_ports.comports()):
        pytest.skip("something that may be an encoder is plugged in")
    lab.point_at(lab.ports, port="")

    ended = lab.cfid(*LOG)
    checked = lab.cfid("rig", "check")

    assert ended.code == checked.code == 3
    assert "no encoder interface is plugged in" in ended.err
    assert "Plug it in, or set its port: devices.encoder.port in rig.toml, or --port." in ended.err
    assert "no encoder interface is plugged in" in checked.out


def test_an_encoder_that_is_held_is_told_with_who_holds_it_and_left_alone(lab: Lab) -> None:
    log = lab.start(*LOG, anew=True)
    log.wait_for_rows(FIRST)
    second = lab.cfid(*LOG)
    checked = lab.cfid("rig", "check")
    log.wait_for_rows(FIRST)
    ended = log.ask_to_end()

    assert second.code == 3
    assert f"{lab.port} is held by process {log.process.pid} (cfid log encoder). End that first." in second.err
    assert checked.code == ended.code == 0
    assert f"port            ok       {lab.port} is held by process {log.process.pid} (cfid log encoder)" in checked.out
    check_rows(lab)
    check_nothing_mixed_up(lab)


# Ends


def test_ctrl_c_ends_a_run_that_is_complete(lab: Lab) -> None:
    log = lab.start(*LOG, "--for", 60)
    log.wait_for_rows(FIRST)
    ended = log.ask_to_end()

    assert ended.code == 0
    assert lab.run().header.state == "complete"
    assert lab.run().header.reason.startswith("ended by SIGINT after")
    check_rows(lab)


def test_a_disk_that_takes_no_more_fails_the_run(lab: Lab) -> None:
    limited = ("bash", "-c", 'ulimit -f 20; exec "$@"', "limited")  # KiB: half a second of rows
    ended = lab.start(*LOG, "--rate-hz", 1000, wrapper=limited).end()

    assert ended.code == 4
    assert "encoder.csv: File too large after" in ended.err
    assert lab.run().header.state == "failed"
    assert lab.run().header.devices["encoder"].rows == len(rows_of(lab)) > 50
