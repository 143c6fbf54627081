"""The app's packets byte for byte, written out from the C structs of the thesis, followed by what the app appends.

C.2.1 packs uint16_t thrust, int motorID; C.2.4 uint16_t motorID, uint16_t ampl, float omega, uint32_t N, and sends a
uint16_t at each crossing and one byte when done; C.2.6 answers with nothing. The controller is little-endian.
"""

import ctypes
from typing import TypeVar

import pytest

from cfid.sim.app_core import PING, SINE, THRUST, CorePacket, load_library
from cfid.wire import app
from tests.firmware.stand import BEGIN_US, MAY_RUN, Stand, new_core

Record = TypeVar("Record")

COMMAND_30000_FOR_ALL = bytes.fromhex("3075 04000000")
COMMAND_1000_FOR_MOTOR_3 = bytes.fromhex("e803 02000000")
# Motor 2, amplitude 20000, omega = pi/4 = 0x3f490fdb, N = 8: one whole period of eight samples.
SINE_OF_ONE_PERIOD = bytes.fromhex("0200 204e db0f493f 08000000")
TIME = bytes.fromhex("00f2052a 01000000")  # 5 000 000 000 microseconds
TIME_32 = TIME[:4]


def test_a_thrust_packet_of_2015_sets_the_motors_and_is_repeated_in_the_answer(stand: Stand) -> None:
    stand.keep_alive()
    answer = stand.tell(THRUST, 0, COMMAND_30000_FOR_ALL)
    assert answer == COMMAND_30000_FOR_ALL + bytes.fromhex("00 3075 3075 3075 3075") + TIME_32
    answer = stand.tell(THRUST, 0, COMMAND_1000_FOR_MOTOR_3)
    assert answer == COMMAND_1000_FOR_MOTOR_3 + bytes.fromhex("00 3075 3075 e803 3075") + TIME_32


def test_a_sine_packet_of_2015_plays_and_its_reports_begin_as_they_did(stand: Stand) -> None:
    stand.keep_alive()
    answer = stand.tell(SINE, 0, SINE_OF_ONE_PERIOD)
    assert answer == SINE_OF_ONE_PERIOD + bytes.fromhex("00 00 01000000")
    played = stand.run(1100)
    assert [commands[1] for commands in played[:18:2]] == [50000, 44142, 30000, 15857, 10000, 15857, 30000, 44142, 0]
    reports = [payload for _, payload in stand.on(0)]
    # The value of 2015, then the sample's index, its time (milliseconds 1, 5, 13 and 17), and the report's number.
    assert reports == [
        bytes.fromhex("50c3  00000000 e8f5052a 0000"),
        bytes.fromhex("3075  02000000 8805062a 0100"),
        bytes.fromhex("3075  06000000 c824062a 0200"),
        bytes.fromhex("0000  08000000 6834062a 0300"),
    ]
    assert [payload for _, payload in stand.on(1)] == [b"a" + bytes.fromhex("00 08000000 00000000")]


def test_any_other_ping_comes_back_with_the_time() -> None:
    assert c_answer(b"xyz") == b"xyz" + TIME == app.encode_ping_answer(b"xyz", BEGIN_US)
    assert c_answer(bytes(range(22))) == bytes(range(22)) + TIME
    assert c_answer(bytes(range(30))) == bytes(range(22)) + TIME


def test_a_hello_says_who_answers(stand: Stand) -> None:
    payload = stand.tell(PING, 1)
    assert payload == b"cfid" + bytes.fromhex("02 f401 f401") + TIME
    assert app.decode_hello(payload) == app.Hello(max(app.PROTOCOLS), app.SAMPLES_PER_S, 500, BEGIN_US)


def test_a_keep_alive_and_a_stop_are_answered_with_the_state(stand: Stand) -> None:
    number = bytes.fromhex("78563412")
    assert stand.tell(PING, 2, number) == number + bytes.fromhex("03 0000 0000 0000 0000") + TIME_32
    stand.tell(THRUST, 0, COMMAND_1000_FOR_MOTOR_3)
    assert stand.tell(PING, 2, number) == number + bytes.fromhex("03 0000 0000 e803 0000") + TIME_32
    assert stand.tell(PING, 3, number) == number + bytes.fromhex("01 0000 0000 0000 0000") + TIME_32


@pytest.mark.parametrize("size", range(31))
def test_a_request_of_any_other_length_is_refused_with_zeros_in_its_place(stand: Stand, size: int) -> None:
    stand.keep_alive()
    if size not in (6, 6 + 4):  # an owner's number may follow
        answer = stand.tell(THRUST, 0, b"\1" * size)
        assert answer == bytes(6) + bytes([app.AppVerdict.WRONG_LENGTH]) + bytes(8) + TIME_32
    if size not in (12, 12 + 4):
        assert stand.tell(SINE, 0, b"\1" * size) == bytes(12) + bytes([app.AppVerdict.WRONG_LENGTH]) + bytes(5)


def test_a_keep_alive_of_another_length_is_none_but_a_stop_is_one() -> None:
    core = new_core()
    core.receive(PING, 2, b"12345", now_us=BEGIN_US, vehicle=MAY_RUN)
    assert core.sent() == []
    assert not core.alive(now_us=BEGIN_US)
    core.receive(PING, 2, b"1234", now_us=BEGIN_US, vehicle=MAY_RUN)
    assert core.alive(now_us=BEGIN_US)
    core.receive(PING, 3, b"", now_us=BEGIN_US, vehicle=MAY_RUN)
    assert not core.alive(now_us=BEGIN_US)
    assert [payload[:4] for _, _, payload in core.sent()] == [b"1234", bytes(4)]


def c_answer(request: bytes, service: int = PING, channel: int = 0) -> bytes | None:
    new_core()
    library = load_library()
    answer = CorePacket()
    known = library.cfid_answer_ping(CorePacket.of(service, channel, request), BEGIN_US, ctypes.byref(answer))
    assert not known or (answer.service, answer.channel) == (PING, 0)
    return answer.payload if known else None
