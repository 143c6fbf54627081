"""An encoder behind an E201: every poll is a row or a loss, no row has another poll's angle, and faults are told."""

import os
import pty
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial

from cfid.errors import DeviceError
from cfid.records.rig_file import EncoderPort
from cfid.records.run import losses
from cfid.rig.check import check_encoder
from cfid.rig.encoder import find_encoder, ports_to_ask, ready_encoder, word_bits
from cfid.rig.hardware import Real
from cfid.rig.lock import DeviceLock
from cfid.sim.e201 import E201Device, Reply
from cfid.sim.faults import EncoderFaults, FaultySerial
from cfid.wire.e201 import CONTINUOUS, POWER_OFF, PRODUCT, VERSION
from cfid.wire.rls import RLS_13BIT_IN_22, STEPS_PER_TURN, decode_words
from tests.virtual_lab import UNIX_S, Lab, Logged, held_elsewhere, lab_in, recorded

LOG = ("log", "encoder")
STARTS_S = 0.175  # of questions before the first poll
RAD_PER_S = 0.5  # of the simulated axis
STEP_RAD = 2 * np.pi / STEPS_PER_TURN
SILENT = EncoderFaults(silent_after_s=0)
NOTHING: dict[float, EncoderFaults] = {}


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with lab_in(tmp_path) as lab:
        yield lab


class Recording(Logged):
    """A recording of the encoder; faults begin and end `at` seconds from its first poll."""

    def __init__(self, lab: Lab, *words: object, at: Mapping[float, EncoderFaults | Callable[[], object]] = NOTHING):
        acts = {
            STARTS_S + seconds: partial(setattr, lab.encoder, "faults", act) if isinstance(act, EncoderFaults) else act
            for seconds, act in at.items()
        }
        super().__init__(lab, "encoder", *words, at=acts)
        self.times_s += self.begun_s  # on the clock of the hardware

    def check(self, *, late_s: float = 2e-3) -> None:
        """Check that every poll is a row or a loss, and each angle that of its time or of `late_s` before."""
        assert self.device.rows == len(self.rows)
        assert self.facts["polls"] + self.losses["missing_in_gaps"] == len(self.rows) + self.lost
        words = decode_words(self.rows["phi"].to_numpy())
        assert words.valid.all()
        behind_rad = RAD_PER_S * self.times_s - np.unwrap(words.position * STEP_RAD)
        behind_rad -= 2 * np.pi * np.round(behind_rad[0] / (2 * np.pi))
        assert behind_rad.min() > -1e-6
        assert behind_rad.max() < STEP_RAD + RAD_PER_S * late_s
        assert np.all(np.diff(self.times_s) > 0)
        if "device_us" in self.rows:
            assert np.ptp(self.times_s - 1e-6 * self.rows["device_us"]) < late_s

    def check_grid(self, *, seconds: float, rate_hz: float = 100) -> None:
        """Check that every place of the grid is a row, a loss, or was skipped."""
        places = len(self.rows) + self.lost + (self.device.skipped or 0)
        assert places == pytest.approx(seconds * rate_hz, abs=3)


# Replies


@pytest.mark.parametrize(
    ("rate_hz", "for_s", "faults"),
    [(100, 10, {}), (1000, 2, {}), (7, 20, {}), (0.5, 21, {}), (100, 5, {"split": True})],
)
def test_every_poll_is_a_row_on_its_place_of_the_grid(
    lab: Lab, rate_hz: float, for_s: float, faults: dict[str, Any]
) -> None:
    lab.encoder_suffers(**faults)
    log = Recording(lab, "--rate-hz", rate_hz, "--for", for_s)

    assert log.ended.code == 0
    assert log.run.header.state == "complete"
    assert log.lost == log.device.skipped == 0
    assert log.gaps == []
    log.check(late_s=0.005)
    log.check_grid(seconds=for_s, rate_hz=rate_hz)
    grid_s = log.times_s[0] + np.arange(len(log.rows)) / rate_hz
    assert np.abs(log.times_s - grid_s).max() < 0.005


def test_the_devices_stamps_go_on_over_their_wrap(lab: Lab) -> None:
    first_us = 2**32 - 3_000_000
    lab.e201._first_stamp_us = first_us
    stamps_us = Recording(lab, "--for", 8).rows["device_us"]

    assert stamps_us.iloc[0] == pytest.approx(first_us + 1e6 * STARTS_S, abs=200_000)
    assert np.all(np.abs(np.diff(stamps_us) - 10_000) < 1000)


def test_replies_that_never_come_are_counted_poll_by_poll(lab: Lab) -> None:
    mishaps = lab.encoder.mishaps
    log = Recording(lab, "--for", 10, at={0.5: EncoderFaults(drop_every=20)})

    assert log.ended.code == 0
    assert log.losses["polls_without_position"] == pytest.approx(mishaps["drop_every"], abs=1)
    assert mishaps["drop_every"] > 30
    log.check()
    log.check_grid(seconds=10)


def test_garbled_replies_are_losses_and_never_rows(lab: Lab) -> None:
    log = Recording(lab, "--for", 10, at={0.5: EncoderFaults(corrupt_every=12)})

    assert log.ended.code == 0
    assert log.lost >= lab.encoder.mishaps["corrupt_every"] - 1 > 40
    log.check()


LATE = [{1.0: 0.06}, {1.0: 0.08}, {1.0: 0.1}, {1.0: 0.2}, {1.0: 0.35}, {1.0: 0.5}, {1.0: 0.075, 1.02: 0.02, 1.08: 0.0}]


@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize("slow_s", LATE, ids=str)
def test_replies_that_come_late_for_a_while_are_never_rows_of_other_polls(
    lab: Lab, slow_s: dict[float, float], stamped: bool
) -> None:
    lab.e201.stamps = stamped
    faults = {at_s: EncoderFaults(slow_s=for_s) for at_s, for_s in slow_s.items()}
    log = Recording(lab, "--for", 5, at={**faults, 3.0: EncoderFaults()})

    assert log.ended.code == 0
    assert log.losses["late_replies"] > 0
    assert log.lost > 5
    assert ("device_us" in log.rows) == stamped
    assert len(log.rows) > 500 - 100 * (2 + 2 * max(slow_s.values()) + 0.3)
    log.check(late_s=0.045)  # of answers that were slow but in time
    log.check_grid(seconds=5)


def test_a_name_of_two_lines_is_one_answer(lab: Lab) -> None:
    answers = lab.e201.received

    def in_two_lines(data: bytes, now_s: float) -> list[Reply]:
        second = [(0.003, b"V1.30\r")] if VERSION in data else []
        return [*answers(data, now_s), *second]

    lab.e201.received = in_two_lines  # type: ignore[method-assign]
    log = Recording(lab, "--for", 10, at={0.5: EncoderFaults(drop_every=50)})

    assert log.ended.code == 0
    assert log.losses["unasked"] == 0
    assert log.losses["polls_without_position"] == pytest.approx(lab.encoder.mishaps["drop_every"], abs=1)
    log.check()


def test_a_slow_device_is_polled_as_fast_as_it_answers_and_what_is_skipped_is_no_loss(lab: Lab) -> None:
    lab.encoder_suffers(slow_s=0.022)
    log = Recording(lab, "--for", 10)

    assert log.ended.code == 0
    assert log.lost == 0
    assert log.device.skipped == pytest.approx(10 * (100 - 44), rel=0.02)
    assert str(log.device.achieved).endswith(" of 100 Hz")
    assert losses(log.run, log.device, len(log.rows))
    log.check(late_s=0.03)
    log.check_grid(seconds=10)


def test_a_delay_of_a_few_milliseconds_is_made_up_for_at_1_khz(lab: Lab) -> None:
    held = {0.5 * k: EncoderFaults(slow_s=0.008) for k in range(1, 8)}
    free = {at_s + 0.001: EncoderFaults() for at_s in held}
    log = Recording(lab, "--rate-hz", 1000, "--for", 4, at={**held, **free})

    assert log.device.skipped == log.lost == 0
    assert np.diff(log.times_s).max() > 0.008
    log.check(late_s=0.01)
    log.check_grid(seconds=4, rate_hz=1000)


# Silence


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_a_silence_is_a_gap_in_which_all_that_the_rate_would_have_had_is_lost(lab: Lab, rate_hz: float) -> None:
    log = Recording(lab, "--rate-hz", rate_hz, "--for", 5, at={1.0: SILENT, 3.0: EncoderFaults()})
    (gap,) = log.gaps

    assert log.ended.code == 0
    assert gap["reason"] == "no position came"
    gap_s = gap["to_s"] - gap["from_s"]
    assert 2.0 < gap_s < 2.7  # it may take until the next question for a name
    assert np.diff(log.times_s).max() == pytest.approx(gap_s, abs=1e-3)
    assert log.lost == pytest.approx(gap_s * rate_hz, abs=2 + 0.01 * rate_hz)
    log.check()
    log.check_grid(seconds=5, rate_hz=rate_hz)


def test_a_silence_at_the_end_is_a_gap_with_its_losses(lab: Lab) -> None:
    log = Recording(lab, "--for", 5, at={3.0: SILENT})
    (gap,) = log.gaps

    assert log.ended.code == 0
    assert gap["reason"] == "silent at the end"
    assert log.lost == pytest.approx(200, abs=10)
    log.check_grid(seconds=5)


def test_a_time_in_which_the_program_stood_still_is_a_gap_that_says_so(lab: Lab) -> None:
    log = Recording(lab, "--for", 10, at={4.0: lambda: lab.hardware.stand_still(3.0)})
    (gap,) = log.gaps

    assert log.ended.code == 0
    assert gap["stood_s"] == pytest.approx(2.8, abs=0.1)
    assert gap["to_s"] - gap["from_s"] == pytest.approx(3.0, abs=0.1)
    log.check()
    log.check_grid(seconds=10)


@pytest.mark.parametrize("fault", [SILENT, EncoderFaults(slow_s=0.06)], ids=["no answers", "late ones"])
def test_an_encoder_without_positions_is_given_up_after_three_seconds_with_its_rows_kept(
    lab: Lab, fault: EncoderFaults
) -> None:
    log = Recording(lab, at={2.0: fault})

    assert log.ended.code == 3
    assert log.run.header.state == "failed"
    assert len(log.rows) == pytest.approx(200, abs=12)
    assert log.lost == pytest.approx(300, abs=12)
    assert lab.hardware.ports[lab.port].receiver is None
    log.check()


# The plug


def test_a_plug_pulled_and_put_back_is_a_gap_each_time(lab: Lab) -> None:
    acts = {1.0: lab.pull_plug, 2.2: lab.put_plug_back, 4.0: lab.pull_plug, 4.1: lab.put_plug_back}
    log = Recording(lab, "--for", 6, at=acts)

    assert log.ended.code == 0
    assert [gap["reason"] for gap in log.gaps] == ["unplugged"] * 2
    for gap, pulled_s, back_s in zip(log.gaps, (1.0, 4.0), (2.2, 4.1), strict=True):
        assert pulled_s - 0.1 < gap["from_s"] - UNIX_S - STARTS_S < pulled_s + 0.1
        assert (
            back_s < gap["to_s"] - UNIX_S - STARTS_S < back_s + 1.2
        )  # it is looked for twice a second, and questioned
    log.check()
    log.check_grid(seconds=6)


def sends_without_end(lab: Lab) -> None:
    lab.encoder.unstoppable = True
    lab.put_plug_back()
    lab.hardware.ports[lab.port].received(CONTINUOUS)


def is_another(lab: Lab) -> None:
    lab.encoder_suffers(not_an_e201=True)
    lab.put_plug_back()


@pytest.mark.parametrize("act", [sends_without_end, is_another, lambda lab: None], ids=["noise", "another", "none"])
def test_what_is_not_the_encoder_in_its_place_fails_the_run_at_its_end_with_its_rows_kept(
    lab: Lab, act: Callable[[Lab], None]
) -> None:
    asked = lab.encoder.contacts
    log = Recording(lab, "--for", 4, at={1.0: lab.pull_plug, 2.0: lambda: act(lab)})

    assert log.ended.code == 3
    assert log.run.header.state == "failed"
    assert lab.encoder.contacts > asked
    assert log.times_s.max() < 1.0 + STARTS_S + 1.1
    assert [gap["reason"] for gap in log.gaps] == ["unplugged"]
    log.check()
    log.check_grid(seconds=4)


def test_an_encoder_is_found_again_at_another_port_and_that_port_is_locked(lab: Lab) -> None:
    other = f"{lab.port}-again"

    def put_elsewhere() -> None:
        lab.hardware.move(lab.port, other)
        lab.port = other
        lab.put_plug_back()

    lab.hardware.at(2.0, lab.pull_plug)
    lab.hardware.at(2.5, put_elsewhere)
    with ExitStack() as held:
        encoder = ready_encoder(
            EncoderPort(rate_hz=100), lab.hardware, held, counts_per_turn=RLS_13BIT_IN_22, say=lambda _: None
        )
        _, error, _ = recorded(lab.hardware, lab.folder, encoder, for_s=4)
        with pytest.raises(DeviceError, match="held"):
            DeviceLock(other)

    assert error is None


# What answers


def test_a_wrong_width_of_word_is_told_by_check_and_set_by_log(lab: Lab) -> None:
    lab.e201.word_bits = 18
    checked = lab.cfid("rig", "check")
    width = lab.e201.word_bits
    log = Recording(lab, "--for", 0.5)

    assert (checked.code, width) == (0, 18)
    assert "22 bits" in checked.out
    assert (log.ended.code, lab.e201.word_bits) == (0, 22)
    log.check()


def test_words_of_another_kind_end_the_run_within_a_second(lab: Lab) -> None:
    lab.e201.stuck_at_bits = 18
    log = Recording(lab)

    assert log.ended.code == lab.cfid("rig", "check").code == 3
    assert log.run.header.state == "failed"
    assert log.losses["failed_check"] > 20
    assert len(log.rows) < 10
    assert log.facts["polls"] < 100


def without_supply(lab: Lab) -> None:
    lab.e201.received(POWER_OFF, 0.0)


@pytest.mark.parametrize(
    ("arrange", "word"),
    [
        (lambda lab: lab.encoder_suffers(not_an_e201=True), "another device"),
        (lambda lab: lab.encoder_suffers(silent_after_s=0), "no answer"),
        (lambda lab: lab.encoder_suffers(slow_s=0.2), "limit 50 ms"),
        (without_supply, "no position"),
        (sends_without_end, "unprompted"),
        (lambda lab: lab.pull_plug(), "no such port"),
    ],
)
def test_what_cannot_be_recorded_is_told_by_log_and_by_check_and_makes_no_run(
    lab: Lab, arrange: Callable[[Lab], None], word: str
) -> None:
    arrange(lab)
    ended, checked = lab.cfid(*LOG), lab.cfid("rig", "check")

    assert ended.code == checked.code == 3
    assert word in ended.err
    assert word in checked.out
    assert lab.run_folder() is None


def test_an_output_that_another_program_left_on_is_switched_off(lab: Lab) -> None:
    lab.hardware.ports[lab.port].received(CONTINUOUS)
    log = Recording(lab, "--for", 0.5)

    assert log.ended.code == 0
    assert not lab.e201.continuous
    log.check()


def test_an_encoder_that_is_held_is_told_with_who_holds_it_and_left_alone(lab: Lab) -> None:
    with held_elsewhere(lab.port) as process:
        ended, checked = lab.cfid(*LOG), lab.cfid("rig", "check")

    assert (ended.code, checked.code) == (3, 0)
    assert f"process {process} " in ended.err
    assert f"process {process} " in checked.out
    assert lab.encoder.contacts == 0


# Ports


def test_counts_that_are_a_power_of_two_ask_for_a_width_that_a_word_has() -> None:
    assert [word_bits(counts) for counts in ("rls-13bit-in-22", 8192.0, 2, 2.0**32)] == [22, 13, 1, 32]
    assert {word_bits(counts) for counts in (4194047, 8192.5, 1.0, 2.0**33, 2.0**80, 0.5)} == {None}


def find(lab: Lab, port: str = "", **options: Any) -> Any:
    return lab.hardware.run(lambda _: find_encoder(lab.hardware, port, counts_per_turn=8192.0, **options))


def plug_in(lab: Lab, paths: list[str], faults: EncoderFaults, product: str = PRODUCT) -> list[E201Device]:
    """Plug further devices in, beside the one that is there; return them."""
    devices = [E201Device(lambda time_s: 0.0) for _ in paths]
    for path, device in zip(paths, devices, strict=True):
        lab.hardware.plug_in(path, FaultySerial(device, faults, opened_s=0.0), product=product)
    return devices


def test_an_encoder_is_told_from_others_by_its_name_and_its_serial_number(lab: Lab) -> None:
    plug_in(lab, ["/virtual/board"], SILENT, "STM32")
    assert ports_to_ask(lab.hardware, "") == [lab.port]
    assert ports_to_ask(lab.hardware, "/dev/mine") == ["/dev/mine"]
    plug_in(lab, ["/virtual/other"], EncoderFaults())

    assert find(lab).port == lab.port
    with pytest.raises(DeviceError) as caught:
        find(lab, serial_number="S00043")
    assert str(caught.value).count("S00043") == 2


def test_many_ports_that_say_nothing_are_not_all_waited_for(lab: Lab) -> None:
    plug_in(lab, [f"/virtual/{n}" for n in range(12)], SILENT)
    lab.pull_plug()
    begun_s = lab.hardware.seconds()

    with pytest.raises(DeviceError) as caught:
        find(lab)
    asked, left = (str(caught.value).count(words) for words in ("no answer", "not checked"))
    assert asked + left == 12
    assert asked > 5
    assert lab.hardware.seconds() - begun_s < 5


def test_ports_that_are_no_encoders_are_told(lab: Lab, tmp_path: Path) -> None:
    """A folder, a file, a terminal that is not there, and one that another program has open."""
    device, host = pty.openpty()
    with serial.Serial(os.ttyname(host), exclusive=True):
        for port in (str(tmp_path), os.devnull, str(tmp_path / "none"), os.ttyname(host)):
            (answer,) = check_encoder(EncoderPort(port=port), Real(), counts_per_turn=8192.0)
            assert answer.state == "fault"
            assert answer.answer.startswith(port)
    os.close(device)
    os.close(host)
    plug_in(lab, ["/virtual/board"], SILENT, "STM32")
    lab.pull_plug()
    (answer,) = check_encoder(EncoderPort(), lab.hardware, counts_per_turn=8192.0)
    assert answer.state == "fault"
