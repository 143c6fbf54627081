"""No motor ever runs 500 ms or more after the last keep-alive, after a stop, or without the supervisor's consent."""

from itertools import pairwise

from hypothesis import Phase, find, given, settings

from cfid.sim.app_core import PING
from cfid.sim.propulsion import STILL
from cfid.wire.app import Flags, PingChannel, decode_state
from tests.firmware.events import BEGIN_US, Event, Outcome, events, outcomes
from tests.firmware.stand import new_core

MANY = settings(max_examples=500, deadline=None, derandomize=True)


def is_keep_alive(event: Event) -> bool:
    return event.packet is not None and event.packet[:2] == (PING, PingChannel.ALIVE) and len(event.packet[2]) in (4, 8)


def counts(outcome: Outcome) -> bool:
    """Return whether the answer to a keep-alive accepts it as one of the owner's."""
    state = decode_state(outcome.sent[-1][2])
    assert state is not None
    return Flags.NOT_OWNER not in state.flags


def is_stop(event: Event) -> bool:
    return event.packet is not None and event.packet[:2] == (PING, PingChannel.STOP)


@MANY
@given(happening=events)
def test_no_motor_runs_without_a_fresh_keep_alive_or_without_consent(happening: list[Event]) -> None:
    core, now_us, heard_us = new_core(), BEGIN_US, float("-inf")
    for event, outcome in zip(happening, outcomes(core, happening, drained_every=1), strict=True):
        now_us += event.after_us
        if is_keep_alive(event) and counts(outcome):
            heard_us = now_us
        if is_stop(event):
            heard_us = float("-inf")
        fresh = now_us - heard_us < 500_000
        if event.packet is None:
            assert (outcome.commands is not None) == fresh
            assert (fresh and event.allowed) or not any(outcome.commands or STILL)
        assert all(len(payload) <= 30 for _, _, payload in outcome.sent)


def test_the_events_that_show_this_run_motors_until_they_must_stop() -> None:
    def stopped_while_running(happening: list[Event]) -> bool:
        ticks = [
            o.commands
            for e, o in zip(happening, outcomes(new_core(), happening, drained_every=1), strict=True)
            if e.packet is None
        ]
        return any(before and any(before) and after is None for before, after in pairwise(ticks))

    assert find(events, stopped_while_running, settings=settings(MANY, phases=[Phase.generate]))
