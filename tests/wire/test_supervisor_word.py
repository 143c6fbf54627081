"""The supervisor's state word and the requests to arm, byte by byte as firmware 2026.08 and 2024.10 have them."""

import pytest

from cfid.wire.crtp import Packet
from cfid.wire.supervisor import (
    ASK_STATE,
    RELAX_SETPOINT,
    VehicleState,
    decode_arming,
    decode_recovery,
    decode_state,
    encode_arming,
    encode_recovery,
)

# Words in recordings of the real supervisor, and the state that it was in (states that a word cannot distinguish
# share a name).
WORDS = [
    ("8c0000", "not ready"),  # not_initialized
    ("8c0402", "not ready"),  # preflight_not_passed, arms itself
    ("8c2402", "tumbled"),
    ("8c0002", "not ready"),
    ("8c2002", "tumbled"),
    ("8c0702", "arming"),  # preflight_passed, arms itself: armed already
    ("8c0102", "disarmed"),
    ("8c0602", "arming"),
    ("8c0202", "arming"),
    ("8c0e02", "ready"),
    ("8c0a02", "ready"),
    ("8c1e02", "flying"),
    ("8c1a02", "flying"),
    ("8c4402", "locked"),
    ("8c4002", "locked"),
    ("8ca402", "crashed"),
    ("8c8402", "crashed"),
    ("8c8002", "crashed"),
    ("8c000a", "deck fault"),
]


def state_of(payload: str) -> VehicleState:
    state = decode_state(bytes.fromhex(payload))
    assert state is not None
    return state


@pytest.mark.parametrize(("payload", "name"), WORDS)
def test_a_word_names_its_state_and_what_to_do_where_motors_cannot_start(payload: str, name: str) -> None:
    state = state_of(payload)
    assert state.name == name
    assert state.is_passing == (name == "not ready")
    assert state.can_fly == (name in ("ready", "flying"))
    assert bool(state.remedy) == (name in ("locked", "crashed", "tumbled", "deck fault"))


def test_a_word_has_whether_the_vehicle_is_armed_and_by_whom() -> None:
    found = [(state.armed, state.arms_itself) for state in map(state_of, ("8c0702", "8c0102", "8c0402"))]
    assert found == [(True, True), (False, False), (False, True)]


def test_the_requests_are_those_of_the_firmware() -> None:
    assert Packet(9, 0, b"\x0c") == ASK_STATE
    assert Packet(7, 1, bytes(5)) == RELAX_SETPOINT
    assert encode_arming(arm=True, protocol=12) == Packet(9, 1, b"\x01\x01")
    assert encode_arming(arm=False, protocol=12) == Packet(9, 1, b"\x01\x00")
    assert encode_arming(arm=True, protocol=10) == Packet(13, 0, b"\x01\x01")
    assert encode_recovery(protocol=12) == Packet(9, 1, b"\x02")
    assert encode_recovery(protocol=11) == Packet(13, 0, b"\x02")


@pytest.mark.parametrize(
    ("payload", "protocol", "arming", "recovery"),
    [
        ("810101", 12, True, None),
        ("810000", 12, False, None),
        ("810100", 12, True, None),
        ("820101", 12, None, True),  # as recorded from the firmware: granted to an upright vehicle
        ("820000", 12, None, False),  # refused to one that lies on its back
        ("0101", 12, None, None),
        ("020101", 12, None, None),
        ("8101", 12, None, None),
        ("0101", 10, True, None),  # the last of the old port's three bytes is cut off
        ("0100", 10, False, None),
        ("010101", 10, True, None),
        ("020101", 10, None, True),
        ("0200", 10, None, False),
        ("01", 10, None, None),
        ("810101", 10, None, None),
    ],
)
def test_an_answer_is_read_in_either_protocol(
    payload: str, protocol: int, arming: bool | None, recovery: bool | None
) -> None:
    assert decode_arming(bytes.fromhex(payload), protocol=protocol) is arming
    assert decode_recovery(bytes.fromhex(payload), protocol=protocol) is recovery
