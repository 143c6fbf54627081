"""An encoder behind an E201: every poll is a row or a loss, no row has another poll's angle, and faults are told."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from cfid.errors import DeviceError
from cfid.records.rig_file import EncoderPort
from cfid.rig.encoder import find_encoder, ports_to_ask, ready_encoder, word_bits
from cfid.rig.lock import DeviceLock
from cfid.sim.e201 import E201Device
from cfid.sim.faults import EncoderFaults, FaultySerial
from cfid.wire.e201 import CONTINUOUS, POWER_OFF, PRODUCT
from cfid.wire.rls import RLS_13BIT_IN_22, STEPS_PER_TURN, decode_words
from tests.virtual_lab import Lab, Logged, held_elsewhere, lab_in, recorded

LOG = ("log", "encoder")
STARTS_S = 0.175  # of questions before the first poll
RAD_PER_S = 0.5  # of the simulated axis
STEP_RAD = 2 * np.pi / STEPS_PER_TURN
Act = Callable[[Lab], object]
NOTHING: dict[float, Act] = {}


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with lab_in(tmp_path) as lab:
        yield lab


class Recording(Logged):
    """A recording of the encoder; faults begin and end `at` seconds from its first poll."""

    def __init__(self, lab: Lab, *words: object, at: Mapping[float, Act] = NOTHING) -> None:
        super().__init__(lab, "encoder", *words, at={STARTS_S + at_s: partial(act, lab) for at_s, act in at.items()})
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


# Faults of the encoder and of its port


@pytest.mark.parametrize(
    ("rate_hz", "for_s", "faults"),
    [(100, 10, {}), (1000, 2, {}), (0.5, 21, {}), (100, 5, {"split": True})],
)
def test_every_poll_is_a_row_on_its_place_of_the_grid(
    lab: Lab, rate_hz: float, for_s: float, faults: dict[str, Any]
) -> None:
    lab.e201._first_stamp_us = 2**32 - 3_000_000  # the device's count wraps
    lab.encoder_suffers(**faults)
    log = Recording(lab, "--rate-hz", rate_hz, "--for", for_s)

    assert log.ended.code == 0
    assert log.run.header.state == "complete"
    assert log.lost == log.device.skipped == 0
    assert log.gaps == []
    assert log.device.rows == len(log.rows)
    log.check_grid(seconds=for_s, rate_hz=rate_hz)
    grid_s = log.times_s[0] + np.arange(len(log.rows)) / rate_hz
    assert np.abs(log.times_s - grid_s).max() < 0.005
    assert np.ptp(log.times_s - 1e-6 * log.rows["device_us"]) < 0.005


def suffers(**faults: Any) -> Act:
    return lambda lab: lab.encoder_suffers(**faults)


def sends_without_end(lab: Lab) -> None:
    lab.encoder.unstoppable = True
    lab.put_plug_back()
    lab.hardware.ports[lab.port].received(CONTINUOUS)


def is_another(lab: Lab) -> None:
    lab.encoder_suffers(not_an_e201=True)
    lab.put_plug_back()


class Fault(NamedTuple):
    """What happens at which seconds of a recording, how many of 100 polls a second are lost, and how it ends."""

    acts: dict[float, Act]
    lost: float  # after a reply that never came, also the polls of the 50 ms in which it might
    reasons: tuple[str, ...] = ()  # of the gaps
    for_s: float | None = 6.0
    is_failed: bool = False
    late_s: float = 2e-3  # of answers that were slow but in time


SOUND, SILENT = suffers(), suffers(silent_after_s=0)
PULL, PUT_BACK = Lab.pull_plug, Lab.put_plug_back
FAULTS = {
    "replies that never come": Fault({0.5: suffers(drop_every=20)}, 24 * 5),
    "garbled replies": Fault({0.5: suffers(corrupt_every=12)}, 104),
    "a silence": Fault({1: SILENT, 3: SOUND}, 230, ("no position came",)),
    "a silence at the end": Fault({3: SILENT}, 300, ("silent at the end",), for_s=5.9),
    "a silence for good": Fault({2: SILENT}, 300, ("silent at the end",), for_s=None, is_failed=True),
    "late replies for good": Fault({2: suffers(slow_s=0.06)}, 300, ("silent at the end",), for_s=None, is_failed=True),
    "a program that stands still": Fault({2: lambda lab: lab.hardware.stand_still(3.0)}, 300, ("no position came",)),
    "a plug put back": Fault({1: PULL, 2.2: PUT_BACK, 4: PULL, 4.1: PUT_BACK}, 230, ("unplugged",) * 2),
    "a plug not put back": Fault({1: PULL}, 500, ("unplugged",), is_failed=True),
    "noise in its place": Fault({1: PULL, 2: sends_without_end}, 500, ("unplugged",), is_failed=True),
    "another device in its place": Fault({1: PULL, 2: is_another}, 500, ("unplugged",), is_failed=True),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_a_fault_takes_is_lost_and_counted_and_all_else_a_right_row(lab: Lab, name: str) -> None:
    fault = FAULTS[name]
    log = Recording(lab, *(() if fault.for_s is None else ("--for", fault.for_s)), at=fault.acts)
    seconds = log.took_s - STARTS_S if fault.for_s is None else fault.for_s

    assert log.ended.code == (3 if fault.is_failed else 0)
    assert log.run.header.state == ("failed" if fault.is_failed else "complete")
    assert log.lost == pytest.approx(fault.lost, abs=60 if fault.reasons else 3)
    assert tuple(log.reasons) == fault.reasons
    assert fault.is_failed or lab.hardware.ports[lab.port].receiver is None
    log.check(late_s=fault.late_s)
    log.check_grid(seconds=seconds)


LATE = [{1.0: 0.06}, {1.0: 0.1}, {1.0: 0.35}, {1.0: 0.075, 1.02: 0.02, 1.08: 0.0}]


@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize("slow_s", LATE, ids=str)
def test_replies_that_come_late_for_a_while_are_never_rows_of_other_polls(
    lab: Lab, slow_s: dict[float, float], stamped: bool
) -> None:
    lab.e201.stamps = stamped
    log = Recording(lab, "--for", 5, at={**{at_s: suffers(slow_s=for_s) for at_s, for_s in slow_s.items()}, 3: SOUND})

    assert log.ended.code == 0
    assert log.losses["late_replies"] > 0
    assert log.lost > 5
    assert ("device_us" in log.rows) == stamped
    assert len(log.rows) > 500 - 100 * (2 + 2 * max(slow_s.values()) + 0.3)
    log.check(late_s=0.045)
    log.check_grid(seconds=5)


def test_a_slow_device_is_polled_as_fast_as_it_answers_and_what_is_skipped_is_no_loss(lab: Lab) -> None:
    lab.encoder_suffers(slow_s=0.022)
    log = Recording(lab, "--for", 10)

    assert log.ended.code == 0
    assert log.lost == 0
    assert log.device.skipped == pytest.approx(10 * (100 - 44), rel=0.02)
    log.check(late_s=0.03)
    log.check_grid(seconds=10)


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
    plug_in(lab, ["/virtual/board"], EncoderFaults(silent_after_s=0), "STM32")
    assert ports_to_ask(lab.hardware, "") == [lab.port]
    assert ports_to_ask(lab.hardware, "/dev/mine") == ["/dev/mine"]
    plug_in(lab, ["/virtual/other"], EncoderFaults())

    assert find(lab).port == lab.port
    with pytest.raises(DeviceError) as caught:
        find(lab, serial_number="S00043")
    assert str(caught.value).count("S00043") == 2


def test_many_ports_that_say_nothing_are_not_all_waited_for(lab: Lab) -> None:
    plug_in(lab, [f"/virtual/{n}" for n in range(12)], EncoderFaults(silent_after_s=0))
    lab.pull_plug()
    begun_s = lab.hardware.seconds()

    with pytest.raises(DeviceError) as caught:
        find(lab)
    asked, left = (str(caught.value).count(words) for words in ("no answer", "not checked"))
    assert asked + left == 12
    assert asked > 5
    assert lab.hardware.seconds() - begun_s < 5
