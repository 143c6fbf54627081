"""The bytes of the services: the C structs of the thesis, written out by hand, followed by what the app appends."""

from collections.abc import Callable
from typing import Any

import pytest

from cfid.wire import app
from cfid.wire.app import AppState, Crossing, Done, Flags, Hello, SineAnswer, SineRequest, ThrustAnswer, ThrustRequest

ANSWERS: list[tuple[Callable[[bytes], Any], str, Any]] = [
    (
        app.decode_thrust_answer,
        "3075 ffffffff 02 3075 0000 0100 ffff 40420f00",
        ThrustAnswer(30000, -1, 2, (30000, 0, 1, 65535), 1_000_000),
    ),
    (
        app.decode_sine_answer,
        "0100 204e 0000003f a00f0000 08 01 0c000000",
        SineAnswer(1, 20000, 0.5, 4000, 8, True, 12),
    ),
    (app.decode_crossing, "50c3 00010000 40420f00 0200", Crossing(50000, 256, 1_000_000, 2)),
    (app.decode_done, "61 00 a00f0000 05000000", Done(0, 4000, 5)),
    (app.decode_hello, "63666964 01 f401 f401 4042 0f00 0000 0000", Hello(1, 500, 500, 1_000_000)),
    (
        app.decode_state,
        "07000000 05 0100 0200 0300 0400 40420f00",
        AppState(7, Flags.MOTORS_ALLOWED | Flags.SINE_RUNNING, (1, 2, 3, 4), 1_000_000),
    ),
]


# struct thrustCrtpValues { uint16_t thrust; int motorID; } packed (C.2.1)
@pytest.mark.parametrize(
    ("request_", "golden"),
    [
        (ThrustRequest(0, 4), "0000 04000000"),
        (ThrustRequest(30000, 0), "3075 00000000"),
        (ThrustRequest(28000, -1), "606d ffffffff"),
    ],
)
def test_a_thrust_request_has_the_bytes_of_the_thesis_struct(request_: ThrustRequest, golden: str) -> None:
    assert app.encode_thrust(request_) == bytes.fromhex(golden)
    assert app.encode_thrust(request_, owner=258) == bytes.fromhex(golden + "02010000")


# struct sineCrtpValues { uint16_t motorID; uint16_t ampl; float omega; uint32_t N; } packed (C.2.4)
@pytest.mark.parametrize(
    ("request_", "golden"),
    [
        (SineRequest(3, 20000, 0.0, 8000), "0300 204e 00000000 401f0000"),
        (SineRequest(1, 20000, 0.5, 4000), "0100 204e 0000003f a00f0000"),
        (SineRequest(0, 30000, 3.0, 4294967295), "0000 3075 00004040 ffffffff"),
    ],
)
def test_a_sine_request_has_the_bytes_of_the_thesis_struct(request_: SineRequest, golden: str) -> None:
    assert app.encode_sine(request_) == bytes.fromhex(golden)
    assert app.encode_sine(request_, owner=258) == bytes.fromhex(golden + "02010000")


@pytest.mark.parametrize(("decode", "golden", "record"), ANSWERS)
def test_an_answer_is_read_field_by_field_and_in_no_other_length(
    decode: Callable[[bytes], Any], golden: str, record: Any
) -> None:
    payload = bytes.fromhex(golden)
    assert decode(payload) == record
    assert [decode((payload + bytes(30))[:length]) for length in range(31) if length != len(payload)] == [None] * 30
    if decode in (app.decode_done, app.decode_hello):
        assert decode(b"b" + payload[1:]) is None  # it does not begin with its mark


def test_a_keep_alive_has_a_number_and_its_owner_and_a_state_the_bytes_that_are_read() -> None:
    assert app.encode_alive(258) == bytes.fromhex("02010000")
    assert app.encode_alive(258, owner=1) == bytes.fromhex("02010000 01000000")
    _, golden, state = ANSWERS[-1]
    assert app.encode_state(state) == bytes.fromhex(golden)
