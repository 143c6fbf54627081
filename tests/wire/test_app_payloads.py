"""The bytes of the services: the C structs of the thesis, written out by hand, followed by what the app appends."""

import math
import struct
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.wire import app
from cfid.wire.app import AppState, Crossing, Done, Flags, Hello, SineAnswer, SineRequest, ThrustAnswer, ThrustRequest

U16, U32, U64 = (st.integers(0, 2**bits - 1) for bits in (16, 32, 64))
FOUR = st.tuples(U16, U16, U16, U16)


# struct thrustCrtpValues { uint16_t thrust; int motorID; } packed (C.2.1)
@pytest.mark.parametrize(
    ("request_", "golden"),
    [
        (ThrustRequest(0, 4), "0000 04000000"),
        (ThrustRequest(30000, 0), "3075 00000000"),
        (ThrustRequest(65535, 3), "ffff 03000000"),
        (ThrustRequest(28000, -1), "606d ffffffff"),
    ],
)
def test_a_thrust_request_has_the_bytes_of_the_thesis_struct(request_: ThrustRequest, golden: str) -> None:
    assert app.encode_thrust(request_) == bytes.fromhex(golden)


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


def test_omega_travels_as_a_float32() -> None:
    omega = app.omega_of(12, 4000)
    assert omega == pytest.approx(2 * math.pi * 12 / 4000)
    (received,) = struct.unpack("<f", app.encode_sine(SineRequest(1, 20000, omega, 4000))[4:8])
    assert received != omega
    assert received == pytest.approx(omega, rel=6e-8)


def test_a_crossing_begins_with_its_command_as_in_the_thesis() -> None:
    assert app.decode_crossing(bytes.fromhex("50c3")) is None
    assert app.decode_crossing(bytes.fromhex("50c3 00010000 40420f00 0200")) == Crossing(50000, 256, 1_000_000, 2)


def test_the_end_of_a_sine_is_the_letter_a_and_what_the_app_adds() -> None:
    assert app.decode_done(b"a") is None
    assert app.decode_done(bytes.fromhex("61 00 a00f0000 05000000")) == Done(0, 4000, 5)
    assert app.decode_done(b"b") is None
    assert app.decode_done(b"") is None


def test_a_hello_is_told_from_any_other_answer() -> None:
    assert app.decode_hello(b"") is None
    told = bytes.fromhex("63666964 01 f401 f401 4042 0f00 0000 0000")
    assert app.decode_hello(told) == Hello(1, 500, 500, 1_000_000)
    assert app.decode_hello(b"x" + told[1:]) is None


def test_a_state_and_a_thrust_answer_have_their_fields_where_the_app_puts_them() -> None:
    state = bytes.fromhex("07000000 05 0100 0200 0300 0400 40420f00")
    assert app.decode_state(state) == AppState(7, Flags.MOTORS_ALLOWED | Flags.SINE_RUNNING, (1, 2, 3, 4), 1_000_000)
    answer = bytes.fromhex("3075 00000000 00 3075 0000 0000 0000 40420f00")
    assert app.decode_thrust_answer(answer) == ThrustAnswer(30000, 0, 0, (30000, 0, 0, 0), 1_000_000)


def test_an_empty_ping_is_answered_with_nothing_and_any_other_with_the_time() -> None:
    assert app.encode_ping_answer(b"", 5) == b""
    assert app.encode_ping_answer(b"\x01\x02", 1_000_000) == bytes.fromhex("0102 40420f0000000000")
    assert app.decode_ping_answer(b"\x01\x02", bytes.fromhex("0102 40420f0000000000")) == 1_000_000
    assert app.decode_ping_answer(b"\x01\x03", bytes.fromhex("0102 40420f0000000000")) is None
    assert app.decode_ping_answer(b"", b"") is None


def thrust_answer(answer: ThrustAnswer) -> bytes:
    """Return the bytes that the app packs: the request, its verdict, four commands and the time."""
    return struct.pack("<HiB4HI", *answer[:3], *answer.commands, answer.microseconds)


def sine_answer(answer: SineAnswer) -> bytes:
    """Return the bytes that the app packs: the request, its verdict, whether the sine clips, and the periods."""
    return struct.pack("<HHfIBBI", *answer)


def hello(answer: Hello) -> bytes:
    """Return the bytes that the app packs: its mark, the protocol, two rates and the time."""
    return struct.pack("<4sBHHQ", b"cfid", *answer)


def crossing(report: Crossing) -> bytes:
    """Return the bytes that the app packs: the command, then sample, time and number."""
    return struct.pack("<HIIH", *report)


def done(end: Done) -> bytes:
    """Return the bytes that the app packs: the letter a, then how the sine ended."""
    return struct.pack("<BBII", ord("a"), *end)


SINES = st.builds(SineRequest, U16, U16, st.floats(width=32, allow_nan=False), U32)
CODECS: list[tuple[Callable[[Any], bytes], Callable[[bytes], Any], st.SearchStrategy[Any]]] = [
    (
        thrust_answer,
        app.decode_thrust_answer,
        st.builds(ThrustAnswer, U16, st.integers(-(2**31), 2**31 - 1), st.integers(0, 255), FOUR, U32),
    ),
    (
        sine_answer,
        app.decode_sine_answer,
        st.builds(lambda sine, *more: SineAnswer(*sine, *more), SINES, st.integers(0, 255), st.booleans(), U32),
    ),
    (crossing, app.decode_crossing, st.builds(Crossing, U16, U32, U32, U16)),
    (done, app.decode_done, st.builds(Done, st.integers(0, 255), U32, U32)),
    (hello, app.decode_hello, st.builds(Hello, st.integers(0, 255), U16, U16, U64)),
    (app.encode_state, app.decode_state, st.builds(AppState, U32, st.integers(0, 7).map(Flags), FOUR, U32)),
]
EVERY = pytest.mark.parametrize(
    ("encode", "decode", "records"), CODECS, ids=lambda value: getattr(value, "__name__", "")
)


@EVERY
@given(data=st.data())
def test_what_is_encoded_is_decoded_and_fits_a_packet(
    encode: Callable[[Any], bytes], decode: Callable[[bytes], Any], records: st.SearchStrategy[Any], data: st.DataObject
) -> None:
    record = data.draw(records)
    assert len(encode(record)) <= 30
    assert decode(encode(record)) == record


@EVERY
@given(data=st.data())
def test_a_payload_that_was_cut_or_grew_is_never_read(
    encode: Callable[[Any], bytes], decode: Callable[[bytes], Any], records: st.SearchStrategy[Any], data: st.DataObject
) -> None:
    payload = encode(data.draw(records))
    length = data.draw(st.integers(0, 30).filter(lambda n: n != len(payload)))
    changed = (payload + bytes(30))[:length]
    assert decode(changed) is None


@given(payload=st.binary(max_size=30))
def test_any_bytes_are_decoded_or_refused_but_never_raise(payload: bytes) -> None:
    for _, decode, _ in CODECS:
        decode(payload)
    app.decode_ping_answer(payload[:4], payload)


def test_alive_is_a_number_of_four_bytes() -> None:
    assert app.encode_alive(258) == bytes.fromhex("02010000")
    with pytest.raises(struct.error):
        app.encode_alive(2**32)
