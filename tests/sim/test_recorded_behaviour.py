"""Behaviour recorded from the firmware's own code is replayed on the simulated vehicle: equal states and answers.

Times count as equal within 60 ms: one update of the supervisor, 40 ms, and one poll, 20 ms. Where the app drove motors,
it was that of protocol 1: its own answers are not compared, and `WITH_PROTOCOL_2` lists the states that differ now.
"""

from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.lab import DATA
from tests.sim.replay import ROW, Change, Trace, replay

TRACES = sorted((DATA / "supervisor").glob("*.jsonl"))

pytestmark = pytest.mark.skipif(not TRACES, reason="the recorded traces are not here (CFID_DATA)")

EQUAL_MS = 60
ROWS_MORE_OR_LESS = 1  # of a log block, since its timer races with its end
FREED_BLOCK = 0xFF  # a row that the recorded firmware sent while it deleted its block


class Mask(NamedTuple):
    """Bytes that are not compared, in answers on a port and channel that begin with one of `commands`, if any."""

    place: tuple[int, int]
    begin: int
    end: int | None
    why: str
    commands: tuple[int, ...] | None = None


MASKS = (
    Mask((2, 0), 1, 7, "how many parameters this build has, and their sum", (3,)),
    Mask((5, 0), 1, 7, "how many variables this build has, and their sum", (3,)),
    Mask(
        (5, 1), 1, 2, "left over in the buffer: the request, a reset or an unknown command, has no such byte", (5, 0x63)
    ),
    Mask((2, 3), 3, None, "default values lie in flash storage, which the recorded host lacks", (4, 6, 8)),
    Mask((13, 1), 1, None, "names of the recorded host's build", (1, 2)),
    Mask((10, 2), -4, None, "microseconds"),
    Mask((12, 0), -8, None, "microseconds", tuple(range(256))),
    Mask((12, 1), 4, 5, "the app's protocol"),
    Mask((12, 1), -8, None, "microseconds"),
    Mask((12, 2), 0, 4, "which of several equal answers to keep-alives is listed"),
    Mask((12, 2), -4, None, "microseconds"),
    Mask((12, 3), -4, None, "microseconds"),
    Mask(ROW, 1, 4, "milliseconds"),
)

BY_DISARMING = ("flying", "reset", "preflight_not_passed", "preflight_passed")
ANEW = ("reset", "preflight_not_passed", "preflight_passed", "arming", "ready_to_fly")
# States from the first "flying" on. A Brushless stops by disarming, and a setpoint that a client left behind never
# becomes stale in flight.
WITH_PROTOCOL_2: dict[str, Sequence[str]] = {
    **{
        f"{scenario}.cf21bl_app": BY_DISARMING
        for scenario in (
            "s03_thrust_link_kept",
            "s03b_thrust_keepalives_go_on",
            "s04_close_after_200ms",
            "s04_close_after_500ms",
            "s04_close_after_1000ms",
            "s04_close_after_1500ms",
            "s04_close_after_2500ms",
            "s08_keepalive_lost",
            "s11_app_after_stale_setpoint",
        )
    },
    **{f"s04_close_after_{after}ms.cf2_app": ("flying", "landed") for after in (200, 500, 1000, 1500)},
    "s06_tumble_check_off.cf21bl_app": (*BY_DISARMING, "preflight_not_passed"),
    "s10_power_cycle_in_run.cf21bl_app": (
        *("flying", "not_initialized", "preflight_not_passed", "preflight_passed", "arming", "ready_to_fly"),
        *BY_DISARMING,
    ),
    "s13_level_out_app_again.cf2_app": ("flying", "landed", *ANEW),
    "s13_level_out_disarm.cf2_app": ("flying", *ANEW, "flying", "landed"),
    "s13_level_out_new_setpoint.cf2_app": ("flying", "landed", *ANEW),
    "s13_level_out_upside_down.cf2_app": ("flying", "crashed"),
}


def masked(place: tuple[int, int], payload: bytes) -> bytes:
    for mask in MASKS:
        if mask.place == place and payload and (mask.commands is None or payload[0] in mask.commands):
            cut = range(*slice(mask.begin, mask.end).indices(len(payload)))
            payload = bytes(byte for at, byte in enumerate(payload) if at not in cut)
    return payload


def until(changes: list[Change], trace: Trace, *, least: int) -> list[Change]:
    """Leave out changes after a trace's end, which the trace may have missed, but keep the first `least` changes."""
    return [change for number, change in enumerate(changes) if number < least or change[0] <= trace.end_ms]


def assert_same(what: str, trace: Trace, expected: list[Change], found: list[Change]) -> None:
    found = until(found, trace, least=len(expected))
    assert [value for _, value in found] == [value for _, value in expected], what
    for (time_ms, value), (found_ms, _) in zip(expected, found, strict=True):
        late_ms = trace.judged_ms(found_ms) - trace.judged_ms(time_ms)
        assert abs(late_ms) <= EQUAL_MS, f"{what}: {value} comes {late_ms:.0f} ms late, at {time_ms:.0f} ms"


def rows_of(payloads: list[bytes]) -> dict[int, list[bytes]]:
    """Return the rows of each log block."""
    rows: dict[int, list[bytes]] = {}
    for payload in payloads:
        if payload[0] != FREED_BLOCK:
            rows.setdefault(payload[0], []).append(masked(ROW, payload))
    return rows


def drives_the_app(path: Path) -> bool:
    return '"thrust' in path.read_text()


@pytest.mark.parametrize("path", [path for path in TRACES if not drives_the_app(path)], ids=lambda path: path.stem)
def test_the_simulated_vehicle_does_what_the_firmware_did(path: Path) -> None:
    trace = Trace(path)
    expected, found = trace.behaviour(), replay(trace)
    assert_same("states", trace, expected.states, found.states)
    assert_same("words", trace, expected.words, found.words)
    assert_same("motors", trace, expected.motors, found.motors)
    for place in sorted({*expected.answers, *found.answers} - {ROW}):
        answers = zip_longest(expected.answers.get(place, []), found.answers.get(place, []), fillvalue=None)
        for number, (wanted, got) in enumerate(answers):
            assert wanted is not None, f"{place}: one answer too many: {got!r}"
            assert got is not None, f"{place}: no answer {number}: {wanted.hex()}"
            assert masked(place, got).hex() == masked(place, wanted).hex(), f"{place}, answer {number}"
    wanted_rows, rows = rows_of(expected.answers.get(ROW, [])), rows_of(found.answers.get(ROW, []))
    assert wanted_rows.keys() == rows.keys()
    for block, wanted_of_block in wanted_rows.items():
        assert set(rows[block]) == set(wanted_of_block)
        assert len(rows[block]) == pytest.approx(len(wanted_of_block), abs=ROWS_MORE_OR_LESS)


@pytest.mark.parametrize("path", [path for path in TRACES if drives_the_app(path)], ids=lambda path: path.stem)
def test_the_simulated_vehicle_with_the_app_does_what_the_firmware_did_or_what_protocol_2_changed(path: Path) -> None:
    trace = Trace(path)
    expected, found = trace.behaviour(), replay(trace)
    if path.stem not in WITH_PROTOCOL_2:
        assert_same("states", trace, expected.states, found.states)
        assert_same("words", trace, expected.words, found.words)
        assert_same("motors", trace, expected.motors, found.motors)
        return
    states = [value for _, value in until(found.states, trace, least=0)]
    assert states[states.index("flying") :] == list(WITH_PROTOCOL_2[path.stem])
    assert [value for _, value in expected.states] != states


def test_of_clients_that_close_after_a_stop_none_finds_the_vehicle_locked_with_protocol_2_and_eight_did() -> None:
    closing = [path for path in TRACES if path.stem.startswith("s04_")]
    locked = {path.stem for path in closing if "locked" in [state for _, state in Trace(path).behaviour().states]}
    assert len(locked) == 8
    assert locked <= WITH_PROTOCOL_2.keys()
    assert not [states for states in WITH_PROTOCOL_2.values() if "locked" in states]
