"""What the app does with a request, when it refuses one, and when a sine begins and ends."""

import math
from collections.abc import Callable

import pytest

from cfid.sim.app_core import PING, SINE
from cfid.sim.propulsion import STILL
from cfid.wire import app
from cfid.wire.app import AppOutcome, AppVerdict
from tests.firmware.stand import BEGIN_US, MAY_NOT_RUN, MAY_RUN, TICK_US, Stand


def started(stand: Stand, motor: int = 1, samples: int = 1000) -> None:
    stand.keep_alive()
    assert stand.sine(motor, 20000, app.omega_of(5, samples), samples).verdict == AppVerdict.ACCEPTED


def test_single_motors_and_all_are_set(stand: Stand) -> None:
    stand.keep_alive()
    for motor in range(4):
        stand.thrust(1000 * (motor + 1), motor)
    assert stand.run(3) == [(1000, 2000, 3000, 4000)] * 3
    stand.thrust(65535, app.ALL_MOTORS_THRUST)
    assert stand.run(1) == [(65535,) * 4]


@pytest.mark.parametrize("motor", [-1, 5, 2**31 - 1, -(2**31)])
def test_a_motor_that_is_not_there_is_refused(stand: Stand, motor: int) -> None:
    stand.keep_alive()
    assert stand.thrust(1000, motor).verdict == AppVerdict.NO_SUCH_MOTOR
    assert stand.thrust(0, motor).verdict == AppVerdict.NO_SUCH_MOTOR
    assert stand.run(1) == [STILL]


def test_a_command_needs_a_keep_alive_and_zero_needs_none(stand: Stand) -> None:
    stand.alive = False
    assert stand.thrust(1, 0).verdict == AppVerdict.NO_KEEP_ALIVE
    assert stand.sine(1, 1, 0.0, 10).verdict == AppVerdict.NO_KEEP_ALIVE
    assert stand.thrust(0, 0).verdict == AppVerdict.ACCEPTED
    assert stand.tick() is None


def test_a_command_needs_the_supervisors_consent_and_zero_needs_none(stand: Stand) -> None:
    stand.keep_alive()
    stand.vehicle = MAY_NOT_RUN
    assert stand.thrust(1, 0).verdict == AppVerdict.MOTORS_NOT_ALLOWED
    assert stand.sine(1, 1, 0.0, 10).verdict == AppVerdict.MOTORS_NOT_ALLOWED
    assert stand.thrust(0, 0).verdict == AppVerdict.ACCEPTED


@pytest.mark.parametrize(
    ("motor", "omega", "samples", "verdict"),
    [
        (5, 0.0, 10, AppVerdict.NO_SUCH_MOTOR),
        (65535, 0.0, 10, AppVerdict.NO_SUCH_MOTOR),
        (1, 0.0, 0, AppVerdict.NO_SAMPLES),
        (1, math.nan, 10, AppVerdict.NO_FREQUENCY),
        (1, math.inf, 10, AppVerdict.NO_FREQUENCY),
        (1, -math.inf, 10, AppVerdict.NO_FREQUENCY),
        (1, -app.omega_of(1, 10), 10, AppVerdict.NO_FREQUENCY),
        (1, app.omega_of(6, 10), 10, AppVerdict.NO_FREQUENCY),
        (1, 3.1415930, 10, AppVerdict.NO_FREQUENCY),  # the next float32 after pi
        (1, 1.0, 10, AppVerdict.NO_WHOLE_PERIODS),
        (1, app.omega_of(1, 8000) * (1 + 1e-6), 8000, AppVerdict.NO_WHOLE_PERIODS),
        (1, 1e-40, 10, AppVerdict.NO_WHOLE_PERIODS),
        (1, math.pi, 3, AppVerdict.NO_WHOLE_PERIODS),
        (1, math.pi, 1, AppVerdict.NO_WHOLE_PERIODS),
        (1, app.omega_of(2**22 + 1, 2**32 - 1), 2**32 - 1, AppVerdict.NO_WHOLE_PERIODS),
    ],
)
def test_nonsense_is_refused(stand: Stand, motor: int, omega: float, samples: int, verdict: AppVerdict) -> None:
    stand.keep_alive()
    answer = stand.sine(motor, 20000, omega, samples)
    assert (answer.verdict, answer.clips, answer.periods) == (verdict, False, 0)
    stand.thrust(5000, 3)
    assert stand.run(2000) == [(0, 0, 0, 5000)] * 2000
    assert stand.crossings() == []


def test_a_sine_stops_the_other_motors_and_begins_with_the_next_tick(stand: Stand) -> None:
    stand.keep_alive()
    stand.thrust(7000, app.ALL_MOTORS_THRUST)
    stand.run(10)
    stand.sine(2, 20000, app.omega_of(1, 4), 4)
    assert stand.keep_alive().commands == STILL
    assert stand.run(9) == [
        *[(0, 50000, 0, 0)] * 2,
        *[(0, 30000, 0, 0)] * 2,
        *[(0, 10000, 0, 0)] * 2,
        *[(0, 30000, 0, 0)] * 2,
        STILL,
    ]


def test_samples_come_at_500_hz_and_the_end_is_told_at_once_and_again_a_second_later(stand: Stand) -> None:
    started(stand, motor=0, samples=1000)
    start_us = stand.now_us + TICK_US
    stand.run(3001)
    *reports, end = stand.crossings()
    assert len(reports) == 11
    for report in reports:
        assert report.sample is not None
        assert report.microseconds == (start_us + 2 * TICK_US * report.sample) % 2**32
    off_us = start_us + 2 * TICK_US * 1000
    assert end == app.Crossing(0, 1000, off_us % 2**32, 11)
    assert stand.on(app.SineChannel.CROSSING)[-1][0] == off_us
    [(done_us, done)] = stand.done()
    assert (done_us, done) == (off_us + 1_000_000, app.Done(AppOutcome.FINISHED, 1000, 0))


def test_a_sine_runs_until_its_last_word_and_then_another_may(stand: Stand) -> None:
    started(stand, samples=10)
    for _ in range(1020):
        assert stand.sine(1, 1, 0.0, 1).verdict == AppVerdict.SINE_IS_RUNNING
        assert stand.thrust(1, 0).verdict == AppVerdict.SINE_IS_RUNNING
        assert stand.thrust(0, 0).verdict == AppVerdict.SINE_IS_RUNNING
        assert stand.done() == []
        stand.tick()
    stand.tick()
    assert len(stand.done()) == 1
    assert stand.sine(1, 1, 0.0, 1).verdict == AppVerdict.ACCEPTED


def stop_by_thrust(stand: Stand) -> None:
    assert stand.thrust(0, app.ALL_MOTORS_THRUST).verdict == AppVerdict.ACCEPTED


def stop_by_ping(stand: Stand) -> None:
    stand.stop()


def forbid(stand: Stand) -> None:
    stand.vehicle = MAY_NOT_RUN


def fall_silent(stand: Stand) -> None:
    stand.alive = False


@pytest.mark.parametrize(
    ("way", "outcome", "after_ms"),
    [
        (stop_by_thrust, AppOutcome.STOPPED, 0),
        (stop_by_ping, AppOutcome.STOPPED, 0),
        (forbid, AppOutcome.MOTORS_NOT_ALLOWED, 1),
        (fall_silent, AppOutcome.KEEP_ALIVE_LOST, 500),
    ],
)
def test_an_abort_is_told_like_an_end_with_its_reason(
    stand: Stand, way: Callable[[Stand], None], outcome: AppOutcome, after_ms: int
) -> None:
    started(stand, samples=5000)
    stand.run(300)
    stand.keep_alive()
    off_us = stand.now_us + after_ms * TICK_US
    way(stand)
    commands = stand.run(1600)
    running_ms = max(after_ms - 1, 0)
    assert [any(motors) for motors in commands] == [True] * running_ms + [False] * (1600 - running_ms)
    end = stand.crossings()[-1]
    assert end[:3] == (0, (300 + running_ms + 1) // 2, off_us % 2**32)
    assert stand.done() == [(off_us + 1_000_000, app.Done(outcome, end.sample, 0))]


def test_a_later_keep_alive_does_not_revive_old_commands(stand: Stand) -> None:
    stand.keep_alive()
    stand.thrust(30000, app.ALL_MOTORS_THRUST)
    stand.now_us += 500_000  # without a tick, as when the firmware tests its own motors
    assert stand.keep_alive().commands == STILL
    assert stand.run(100) == [STILL] * 100
    assert stand.thrust(30000, app.ALL_MOTORS_THRUST).verdict == AppVerdict.ACCEPTED


def test_neither_does_a_consent_that_is_given_again(stand: Stand) -> None:
    stand.keep_alive()
    stand.thrust(30000, app.ALL_MOTORS_THRUST)
    stand.vehicle = MAY_NOT_RUN
    stand.run(1)
    stand.vehicle = MAY_RUN
    assert stand.run(100) == [STILL] * 100


def test_motors_run_for_499_ms_after_a_keep_alive_and_no_longer(stand: Stand) -> None:
    stand.keep_alive()
    stand.alive = False
    stand.thrust(30000, 0)
    assert stand.run(499) == [(30000, 0, 0, 0)] * 499
    assert stand.core.alive(now_us=stand.now_us)
    assert stand.tick() is None
    assert not stand.core.alive(now_us=stand.now_us)


def test_the_motors_are_the_stock_controllers_before_the_first_keep_alive_and_after_a_stop(stand: Stand) -> None:
    stand.alive = False
    assert stand.tick() is None
    stand.tell(PING, app.PingChannel.HELLO)
    assert stand.tick() is None
    stand.keep_alive()
    assert stand.tick() == STILL
    stand.stop()
    assert stand.tick() is None


@pytest.mark.parametrize(("service", "channel"), [(0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 0), (3, 0)])
def test_what_is_for_nobody_is_not_answered(stand: Stand, service: int, channel: int) -> None:
    stand.keep_alive()
    stand.say(service, channel, bytes.fromhex("3075 04000000"))
    assert stand.heard == []
    assert stand.tick() == STILL


def test_reports_that_find_the_outbox_full_are_numbered_and_the_last_two_words_wait(stand: Stand) -> None:
    core, now_us = stand.core, BEGIN_US
    request = app.encode_sine(app.SineRequest(1, 20000, app.omega_of(100, 200), 200))  # each sample crosses the middle
    core.receive(PING, 2, app.encode_alive(0), now_us=now_us, vehicle=MAY_RUN)
    core.receive(SINE, 0, request, now_us=now_us, vehicle=MAY_RUN)
    assert len(core.sent()) == 2
    for tick in range(2500):
        now_us += TICK_US
        if tick % 100 == 0:
            core.receive(PING, 2, app.encode_alive(tick), now_us=now_us, vehicle=MAY_RUN)
        core.tick(now_us=now_us, vehicle=MAY_RUN)
    early = core.sent()
    assert len(early) == 16
    numbers = [c.number for _, channel, p in early if channel == 0 and (c := app.decode_crossing(p))]
    assert numbers == list(range(len(numbers)))
    core.tick(now_us=now_us, vehicle=MAY_RUN)
    (end_of, end), (done_of, done) = [(channel, payload) for _, channel, payload in core.sent()]
    assert (end_of, done_of) == (app.SineChannel.CROSSING, app.SineChannel.DONE)
    assert app.decode_crossing(end) == app.Crossing(0, 200, (BEGIN_US + 401 * TICK_US) % 2**32, 200)
    assert app.decode_done(done) == app.Done(AppOutcome.FINISHED, 200, 0)
