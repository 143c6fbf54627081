"""An encoder polled on a clock that the test advances: every poll is a row or a loss, and no row is of another poll."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.errors import DeviceError
from cfid.records.run import Run, losses
from cfid.rig.recorder import Block
from cfid.sim.faults import EncoderFaults
from cfid.wire.rls import STEPS_PER_TURN, decode_words
from tests.known import known
from tests.rig.virtual import STEP_S, UNIX_S, Session, encoder, rows_of

SOUND = EncoderFaults()
TURN = 2 * np.pi


def facts(run: Run) -> dict[str, Any]:
    return dict(run.header.devices["encoder"].model_extra or {})


def check_angles(rows: pd.DataFrame, *, late_s: float = 2e-3, but: int = 0) -> None:
    """Check that all but `but` rows have an angle that the axis, at 0.5 rad/s, had at their time or shortly before."""
    words = decode_words(rows["phi"].to_numpy())
    angle = np.unwrap(words.position / STEPS_PER_TURN * TURN)
    true = 0.5 * (rows["t"].to_numpy() - UNIX_S)
    behind_rad = true - angle
    assert words.valid.all()
    wrong = (behind_rad < -1e-6) | (behind_rad > TURN / STEPS_PER_TURN + 0.5 * late_s)
    assert np.sum(wrong) <= but


@pytest.mark.parametrize("for_s", [120, pytest.param(600, marks=pytest.mark.slow)])
def test_every_poll_of_minutes_is_a_row(session: Session, for_s: int) -> None:
    instrument, _ = encoder(session, SOUND)

    run, failure = session.record(instrument, for_s=for_s)
    rows = rows_of(run, "encoder")

    assert failure is None
    assert run.header.devices["encoder"].lost == 0
    assert facts(run)["polls"] == len(rows)
    assert len(rows) == pytest.approx(for_s * 100, abs=2)
    check_angles(rows, late_s=0.006)  # the test's clock steps by 5 ms


def test_the_devices_stamps_go_on_over_their_wrap(session: Session) -> None:
    instrument, _ = encoder(session, SOUND, first_stamp_us=2**32 - 3_000_000)

    run, _ = session.record(instrument, for_s=8)
    stamps = rows_of(run, "encoder")["device_us"]

    assert stamps.iloc[0] == pytest.approx(2**32 - 3_000_000, abs=20_000)
    assert stamps.iloc[-1] > 2**32
    assert np.all(np.diff(stamps) == pytest.approx(10_000, abs=5_000))


def test_replies_that_never_come_are_counted_poll_by_poll(session: Session) -> None:
    instrument, wires = encoder(session, EncoderFaults(drop_every=50))

    run, failure = session.record(instrument, for_s=60)
    rows = rows_of(run, "encoder")

    assert failure is None
    assert run.header.devices["encoder"].lost == wires[0].device.mishaps.dropped
    assert facts(run)["polls"] == len(rows) + wires[0].device.mishaps.dropped
    check_angles(rows, late_s=0.006)


def test_replies_in_pieces_are_whole_rows(session: Session) -> None:
    instrument, _ = encoder(session, EncoderFaults(split=True))

    run, failure = session.record(instrument, for_s=20)

    assert failure is None
    assert run.header.devices["encoder"].lost == 0
    check_angles(rows_of(run, "encoder"), late_s=0.011)


def test_garbled_replies_are_losses_and_never_rows(session: Session) -> None:
    instrument, wires = encoder(session, EncoderFaults(corrupt_every=20))

    run, failure = session.record(instrument, for_s=120)
    rows = rows_of(run, "encoder")
    garbled = wires[0].device.mishaps.garbled

    assert failure is None
    assert garbled > 300
    assert len(rows) + known(run.header.devices["encoder"].lost) == facts(run)["polls"]
    assert garbled - 2 <= known(run.header.devices["encoder"].lost) <= garbled  # at times it is the device's name
    check_angles(rows, late_s=0.006, but=2)  # of words that lost digits, one in 512 passes the word's check


@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize("delay_s", [0.06, 0.08, 0.1, 0.2, 0.35, 0.5])
def test_replies_that_come_late_for_a_while_are_never_taken_for_other_polls(
    session: Session, delay_s: float, stamped: bool
) -> None:
    instrument, wires = encoder(session, SOUND, stamped=stamped)
    begin_s = 4.0

    def delay(now_s: float) -> None:
        wires[0].device.faults = EncoderFaults(slow_s=delay_s if begin_s < now_s % 10 < begin_s + 2 else 0.0)

    run, failure = session.record(instrument, for_s=30, also=delay)
    rows = rows_of(run, "encoder")

    assert failure is None
    assert len(facts(run)["gaps"]) == 3
    assert facts(run)["losses"]["late_replies"] > 3
    assert 30 * 100 - 3 * 100 * (2 + 2 * delay_s + 0.3) < len(rows) < 30 * 100 - 3 * 100 * 1.9
    check_angles(rows, late_s=0.006)


def test_a_name_of_two_lines_is_one_answer(session: Session) -> None:
    instrument, wires = encoder(session, EncoderFaults(drop_every=50))
    received = instrument.received

    def two_lines(data: bytes) -> None:
        received(data)
        if b"E201" in data:
            session.clock.callLater(0.002, received, b"V1.30\r")

    instrument.received = two_lines  # type: ignore[method-assign]
    run, failure = session.record(instrument, for_s=20, step_s=1e-3)

    assert failure is None
    assert run.header.devices["encoder"].lost == wires[0].device.mishaps.dropped
    check_angles(rows_of(run, "encoder"))


def test_replies_that_always_come_too_late_are_told(session: Session) -> None:
    instrument, _ = encoder(session, EncoderFaults(slow_s=0.06))

    run, failure = session.record(instrument, for_s=None)

    assert isinstance(failure, DeviceError)
    assert "sent no position for 3 s, though polled (its answers take longer than 50 ms)" in str(failure)
    assert len(rows_of(run, "encoder")) == 0


def test_a_slow_device_is_polled_as_fast_as_it_answers(session: Session) -> None:
    instrument, _ = encoder(session, EncoderFaults(slow_s=0.02))

    run, failure = session.record(instrument, for_s=20)
    rows = rows_of(run, "encoder")

    assert failure is None
    assert run.header.devices["encoder"].lost == 0
    assert 20 * 25 < len(rows) < 20 * 50
    check_angles(rows, late_s=0.026)


def check_grid(run: Run, *, places: int) -> None:
    """Check that every place of the grid is a row, a loss, or was skipped."""
    rows = rows_of(run, "encoder")
    lost = run.header.devices["encoder"].lost
    assert len(rows) + known(lost) == pytest.approx(places, abs=3)
    losses = facts(run)["losses"]
    assert lost == losses["polls_without_position"] + losses["missing_in_gaps"]


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_a_silence_is_a_gap_in_which_all_that_the_rate_would_have_had_is_lost(session: Session, rate_hz: float) -> None:
    instrument, _ = encoder(session, EncoderFaults(silent_after_s=2, silent_for_s=2.5), rate_hz=rate_hz)

    run, failure = session.record(instrument, for_s=6, step_s=2.5e-4)
    rows = rows_of(run, "encoder")
    (gap,) = facts(run)["gaps"]

    assert failure is None
    assert gap["reason"] == "no position came"
    assert gap["to_s"] - gap["from_s"] == pytest.approx(2.5, abs=0.2)
    assert rows["t"].diff().max() == pytest.approx(gap["to_s"] - gap["from_s"], abs=1e-4)
    assert run.header.devices["encoder"].lost == pytest.approx(2.5 * rate_hz, rel=0.08)
    check_grid(run, places=int(6 * rate_hz))
    check_angles(rows)


def test_samples_of_a_time_in_which_the_recorder_itself_stood_were_never_taken_and_the_gap_says_so(
    session: Session,
) -> None:
    instrument, _ = encoder(session, SOUND)
    stood: list[float] = []

    def stand(now_s: float) -> None:
        if now_s > 4 and not stood:
            stood.append(now_s)
            session.clock.rightNow += 3.0

    run, failure = session.record(instrument, for_s=10, also=stand)
    rows, device = rows_of(run, "encoder"), run.header.devices["encoder"]
    (gap,) = facts(run)["gaps"]

    assert failure is None
    assert gap["reason"].startswith("cfid itself was suspended")
    assert gap["to_s"] - gap["from_s"] == pytest.approx(3.0, abs=0.05)
    assert known(device.lost) <= 1
    assert device.skipped == pytest.approx(300, abs=3)
    assert len(rows) + known(device.lost) + (device.skipped or 0) == pytest.approx(1000, abs=3)


def test_a_silence_of_the_encoder_skips_nothing_beside_what_is_lost(session: Session) -> None:
    instrument, wires = encoder(session, SOUND)

    def hold_up(now_s: float) -> None:
        wires[0].device.faults = EncoderFaults(slow_s=0.4 if 4 < now_s < 4.02 else 0.0)

    run, _ = session.record(instrument, for_s=10, also=hold_up)
    device = run.header.devices["encoder"]

    assert facts(run)["gaps"][0]["reason"] == "no position came"
    assert known(device.lost) > 30
    assert len(rows_of(run, "encoder")) + known(device.lost) + (device.skipped or 0) == pytest.approx(1000, abs=3)


def test_a_silence_at_the_end_is_a_gap_with_its_losses(session: Session) -> None:
    instrument, _ = encoder(session, EncoderFaults(silent_after_s=3))

    run, failure = session.record(instrument, for_s=5)
    (gap,) = facts(run)["gaps"]

    assert failure is None
    assert gap["reason"] == "silent at the end"
    assert run.header.devices["encoder"].lost == pytest.approx(200, abs=10)
    check_grid(run, places=500)


def test_places_of_the_grid_that_were_skipped_are_counted(session: Session) -> None:
    instrument, _ = encoder(session, EncoderFaults(slow_s=0.022))

    run, failure = session.record(instrument, for_s=20)
    skipped = run.header.devices["encoder"].skipped or 0

    assert failure is None
    assert run.header.devices["encoder"].lost == 0
    assert skipped == pytest.approx(20 * (100 - 40), rel=0.01)  # an answer takes 25 ms on the test's clock
    assert len(rows_of(run, "encoder")) + skipped == pytest.approx(20 * 100, abs=3)
    assert run.header.devices["encoder"].achieved == "40 of 100 Hz"
    notes = losses(run, run.header.devices["encoder"], len(rows_of(run, "encoder")))
    assert f"{skipped} samples were never taken" in " ".join(finding.text for finding in notes)


def test_a_delay_of_a_few_milliseconds_is_made_up_for_at_1_khz(session: Session) -> None:
    instrument, wires = encoder(session, SOUND, rate_hz=1000)

    def hold_up(now_s: float) -> None:
        wires[0].device.faults = EncoderFaults(slow_s=0.008 if now_s % 0.5 < 0.001 else 0.0)

    run, _ = session.record(instrument, for_s=4, also=hold_up, step_s=2.5e-4)
    rows = rows_of(run, "encoder")

    assert len(rows) == pytest.approx(4000, abs=12)  # the last sample may be held up too
    assert run.header.devices["encoder"].skipped == 0
    assert rows["t"].diff().max() > 0.008
    check_angles(rows, late_s=0.01)


def test_polls_keep_their_grid_over_ten_minutes(session: Session) -> None:
    instrument, _ = encoder(session, SOUND, rate_hz=7)

    run, _ = session.record(instrument, for_s=600)
    times_s = rows_of(run, "encoder")["t"] - UNIX_S

    assert run.header.devices["encoder"].skipped == 0
    assert np.abs(times_s - np.arange(len(times_s)) / 7).max() < 3 * STEP_S


def test_an_encoder_that_is_polled_every_two_seconds_is_not_silent(session: Session) -> None:
    instrument, _ = encoder(session, SOUND, rate_hz=0.5)

    run, failure = session.record(instrument, for_s=21)

    assert failure is None
    assert len(rows_of(run, "encoder")) == 11
    assert facts(run)["gaps"] == []
    assert run.header.devices["encoder"].lost == 0


def test_an_encoder_that_stays_silent_is_given_up_with_its_rows_kept(session: Session) -> None:
    instrument, wires = encoder(session, EncoderFaults(silent_after_s=5))

    run, failure = session.record(instrument, for_s=None)

    assert isinstance(failure, DeviceError)
    assert ", though polled: unplug it" in str(failure)
    assert session.clock.seconds() < 9
    assert len(rows_of(run, "encoder")) == pytest.approx(500, abs=5)
    assert run.header.devices["encoder"].lost == pytest.approx(300, abs=30)
    assert not wires[0].plugged


def test_words_of_another_kind_end_the_run_within_a_second(session: Session) -> None:
    instrument, _ = encoder(session, EncoderFaults(wrong_width=18))

    run, failure = session.record(instrument, for_s=60)

    assert isinstance(failure, DeviceError)
    assert "fail the check of a 13-bit position" in str(failure)
    assert session.clock.seconds() < 1
    assert len(rows_of(run, "encoder")) < 10


def test_the_continuous_output_is_recorded_and_switched_off(session: Session) -> None:
    instrument, wires = encoder(session, SOUND, continuous=True)

    def flow(now_s: float) -> None:
        for wire in wires:
            wire.flow()

    run, failure = session.record(instrument, for_s=10, also=flow)
    rows = rows_of(run, "encoder")

    assert failure is None
    assert list(rows.columns) == ["t", "phi"]
    assert len(rows) == pytest.approx(10_000, abs=30)
    assert not wires[0].device.continuous
    check_angles(rows, late_s=0.006)


def test_a_continuous_output_that_falls_silent_is_told_without_polls(session: Session) -> None:
    instrument, _ = encoder(session, EncoderFaults(silent_after_s=0), continuous=True)

    _, failure = session.record(instrument, for_s=None)

    assert "sent no position for 3 s: unplug it" in str(failure)


def test_a_continuous_output_that_goes_on_is_told_to_stop_again(session: Session) -> None:
    instrument, wires = encoder(session, SOUND, continuous=True)
    deaf_to = [2]

    def flow(now_s: float) -> None:
        for wire in wires:
            if now_s > 2 and deaf_to[0] and not wire.device.continuous:
                deaf_to[0] -= 1
                wire.write(b"1")
            wire.flow()

    run, failure = session.record(instrument, for_s=2, also=flow)

    assert failure is None
    assert deaf_to == [0]
    assert not wires[0].device.continuous
    assert session.said == []
    assert np.all(np.diff(rows_of(run, "encoder")["t"]) >= 0)


class Broken:
    """An instrument whose port cannot be opened."""

    name, columns = "scales", ("t", "grams")

    def start(self) -> None:
        raise DeviceError("/dev/ttyUSB0: no such port.")

    def take(self) -> Block:
        return Block((np.empty(0), np.empty(0)))

    async def stop(self) -> None:
        pass

    def close(self) -> None:
        pass

    def facts(self) -> Mapping[str, Any]:
        return {}


def test_an_encoder_that_never_started_has_no_gap_and_lost_nothing(session: Session) -> None:
    session.clock.advance(100_000)  # since the computer was switched on
    instrument, _ = encoder(session, SOUND)

    run, failure = session.record(Broken(), instrument, for_s=1)

    assert isinstance(failure, DeviceError)
    assert run.header.devices["encoder"].lost == 0
    assert facts(run)["gaps"] == []
