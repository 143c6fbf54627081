"""Single readings over TCP, byte by byte."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cfid.wire.netft import READ_FORCES, LoadReading, encode_reading, read_reading
from cfid.wire.rdt_status import read_status

FEW = settings(max_examples=200, deadline=None, derandomize=True)
ANSWER = bytes.fromhex("1234 8001 0001 FFFF 7FFF 8000 0100 FF00")


def test_a_reading_is_asked_for_with_20_zero_bytes() -> None:
    assert bytes.fromhex("00" * 20) == READ_FORCES


def test_an_answer_is_the_upper_half_of_the_status_word_and_six_counts() -> None:
    reading = read_reading(ANSWER)
    assert reading == LoadReading(0x8001, (1, -1, 32767, -32768, 256, -256))
    assert read_status(reading.status << 16, "netft").warnings == ("a threshold is latched",)
    assert encode_reading(reading) == ANSWER


@pytest.mark.parametrize("data", [b"", ANSWER[:15], ANSWER + b"\x00", b"\x34\x12" + ANSWER[2:], bytes(16)])
def test_anything_else_is_refused_with_its_size(data: bytes) -> None:
    with pytest.raises(ValueError, match=f"^{len(data)} bytes"):
        read_reading(data)


@FEW
@given(data=st.binary(min_size=14, max_size=14).map(lambda rest: b"\x12\x34" + rest))
def test_any_answer_survives_reading_and_writing(data: bytes) -> None:
    assert encode_reading(read_reading(data)) == data
