"""An encoder polled on a clock that the test turns: every poll is a row or a loss, and no row is another poll's."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.errors import DeviceError
from cfid.run import Run
from cfid.sim.faults import EncoderFaults
from cfid.wire.rls import STEPS_PER_TURN, decode_words
from tests.rig.virtual import UNIX_S, Session, encoder, rows_of

SOUND = EncoderFaults()
TURN = 2 * np.pi


def facts(run: Run) -> dict[str, Any]:
    return dict(run.header.devices["encoder"].model_extra or {})


def check_angles(rows: pd.DataFrame, *, late_s: float = 2e-3) -> None:
    """Every row says where the axis, which turns at 0.5 rad/s, was when it was stamped or a little before."""
    words = decode_words(rows["phi"].to_numpy())
    angle = np.unwrap(words.position / STEPS_PER_TURN * TURN)
    true = 0.5 * (rows["t"].to_numpy() - UNIX_S)
    behind_rad = true - angle
    assert words.valid.all()
    assert np.all(behind_rad > -1e-6)
    assert np.all(behind_rad < TURN / STEPS_PER_TURN + 0.5 * late_s)


def test_every_poll_of_ten_minutes_is_a_row(session: Session) -> None:
    instrument, _ = encoder(session, SOUND)

    run, failure = session.record(instrument, for_s=600)
    rows = rows_of(run, "encoder")

    assert failure is None
    assert run.header.devices["encoder"].lost == 0
    assert facts(run)["polls"] == len(rows)
    assert len(rows) == pytest.approx(60_000, abs=2)
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
    assert len(rows) + run.header.devices["encoder"].lost == facts(run)["polls"]
    assert garbled <= run.header.devices["encoder"].lost <= 2 * garbled  # a lost end takes the next reply with it
    check_angles(rows, late_s=0.006)


def test_a_reply_that_comes_too_late_is_not_taken_for_the_next_polls(session: Session) -> None:
    instrument, _ = encoder(session, EncoderFaults(slow_s=0.06))

    run, failure = session.record(instrument, for_s=None)

    assert isinstance(failure, DeviceError)
    assert "gives no position" in str(failure)
    assert len(rows_of(run, "encoder")) == 0
    assert run.header.devices["encoder"].lost > 20


def test_a_slow_device_is_polled_as_fast_as_it_answers(session: Session) -> None:
    instrument, _ = encoder(session, EncoderFaults(slow_s=0.02))

    run, failure = session.record(instrument, for_s=20)
    rows = rows_of(run, "encoder")

    assert failure is None
    assert run.header.devices["encoder"].lost == 0
    assert 20 * 25 < len(rows) < 20 * 50
    check_angles(rows, late_s=0.026)


def test_a_silence_of_a_second_is_bridged(session: Session) -> None:
    instrument, _ = encoder(session, EncoderFaults(silent_after_s=5, silent_for_s=1))

    run, failure = session.record(instrument, for_s=10)
    rows = rows_of(run, "encoder")

    assert failure is None
    assert rows["t"].diff().max() == pytest.approx(1, abs=0.15)
    assert run.header.devices["encoder"].lost > 5
    check_angles(rows, late_s=0.006)


def test_an_encoder_that_stays_silent_is_given_up_with_its_rows_kept(session: Session) -> None:
    instrument, wires = encoder(session, EncoderFaults(silent_after_s=5))

    run, failure = session.record(instrument, for_s=None)

    assert isinstance(failure, DeviceError)
    assert session.clock.seconds() < 9
    assert len(rows_of(run, "encoder")) == pytest.approx(500, abs=5)
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
