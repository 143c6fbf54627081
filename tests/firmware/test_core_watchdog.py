"""Whatever comes, no motor runs 500 ms after the last keep-alive, after a stop, or without the supervisor's consent."""

from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import Phase, find, given, settings
from hypothesis import strategies as st

from cfid.sim.app_core import AppCore
from cfid.sim.app_core_python import PythonCore
from cfid.sim.crazyflie_modules import PING
from cfid.sim.propulsion import STILL
from cfid.wire.app import PingChannel
from tests.firmware.events import BEGIN_US, Event, events, outcomes
from tests.firmware.stand import CORES, c_core

MANY = settings(max_examples=500, deadline=None, derandomize=True)


def is_keep_alive(event: Event) -> bool:
    return event.packet is not None and event.packet[:2] == (PING, PingChannel.ALIVE) and len(event.packet[2]) == 4


def is_stop(event: Event) -> bool:
    return event.packet is not None and event.packet[:2] == (PING, PingChannel.STOP)


@pytest.mark.parametrize("make", CORES)
@MANY
@given(happening=events)
def test_no_motor_runs_without_a_fresh_keep_alive_or_without_consent(
    make: Callable[[], AppCore], happening: list[Event]
) -> None:
    core, now_us, heard_us = make(), BEGIN_US, float("-inf")
    for event, outcome in zip(happening, outcomes(core, happening, drained_every=1), strict=True):
        now_us += event.after_us
        if is_keep_alive(event):
            heard_us = now_us
        if is_stop(event):
            heard_us = float("-inf")
        fresh = now_us - heard_us < 500_000
        if event.packet is None:
            assert (outcome.commands is not None) == fresh
            assert (fresh and event.allowed) or not any(outcome.commands or STILL)
        assert all(len(payload) <= 30 for _, _, payload in outcome.sent)


@MANY
@given(happening=events, drained_every=st.sampled_from([1, 7, 100]))
def test_the_c_and_the_python_core_agree_packet_for_packet(happening: list[Event], drained_every: int) -> None:
    assert outcomes(c_core(), happening, drained_every=drained_every) == outcomes(
        PythonCore(), happening, drained_every=drained_every
    )


def test_the_events_that_show_this_run_motors_until_they_must_stop() -> None:
    def stopped_while_running(happening: list[Event]) -> bool:
        ticks = [
            o.commands
            for e, o in zip(happening, outcomes(PythonCore(), happening, drained_every=1), strict=True)
            if e.packet is None
        ]
        return any(before and any(before) and after is None for before, after in pairwise(ticks))

    assert find(events, stopped_while_running, settings=settings(MANY, phases=[Phase.generate]))
