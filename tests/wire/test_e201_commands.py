"""The commands that an E201 gets, and its replies about itself."""

import pytest

from cfid.wire import e201


def test_commands_are_the_single_characters_of_the_protocol() -> None:
    questions = e201.VERSION + e201.SERIAL_NUMBER + e201.SUPPLY + e201.POSITION + e201.STAMPED_POSITION
    assert questions == b"vse?!"
    assert e201.HEX_POSITION + e201.HEX_STAMPED_POSITION + e201.WORD_WIDTH == b"><b"
    assert e201.POWER_ON + e201.POWER_OFF + e201.CONTINUOUS + e201.STOP_CONTINUOUS == b"nf10"


@pytest.mark.parametrize(("bits", "command"), [(1, b"B01\r"), (13, b"B13\r"), (22, b"B22\r"), (32, b"B32\r")])
def test_a_word_width_is_set_with_two_digits_and_an_end(bits: int, command: bytes) -> None:
    assert e201.set_word_width(bits) == command


@pytest.mark.parametrize("bits", [-1, 0, 33, 100])
def test_a_word_width_that_no_word_has_is_refused(bits: int) -> None:
    with pytest.raises(ValueError, match=f"not {bits}"):
        e201.set_word_width(bits)


@pytest.mark.parametrize(("reply", "bits"), [(b"22", 22), (b"B13", 13), (b"SSI bits: 9", 9), (b"0", 0)])
def test_a_word_width_is_read_from_a_reply_with_one_number(reply: bytes, bits: int) -> None:
    assert e201.word_width(reply) == bits


@pytest.mark.parametrize("reply", [b"", b"Error", b"222", b"13 of 22", b"4194047:1"])
def test_a_reply_without_a_number_or_with_more_names_no_word_width(reply: bytes) -> None:
    assert e201.word_width(reply) is None


@pytest.mark.parametrize(
    ("reply", "named"), [(b"E201-9S v1.20", True), (b"RLS E201", True), (b"Crazyflie", False), (b"", False)]
)
def test_an_e201_is_known_by_its_version(reply: bytes, named: bool) -> None:
    assert e201.names_e201(reply) is named
