"""Lines of numbers in any slicing and with any damage: only a whole line of the stated form is a reading."""

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.wire.lines import LONGEST_LINE, LineReader, Value, printable
from tests.wire.pieces import FEW, flipped, sliced, slicings

TWO = (Value(whole=True), Value())
GOOD = b"1024,-3.5\r\n"


def read(data: bytes, *, values: tuple[Value, ...] = TWO, pattern: str = "") -> tuple[list[tuple[float, ...]], int]:
    reader = LineReader(values, pattern=pattern)
    return reader.feed(b"\n" + data), reader.rejected


@pytest.mark.parametrize(
    "line",
    [
        b"1024,-3.5",
        b" 1024 ; -3.5 ",
        b"1024\t-3.50",
        b"+1024   -35e-1",
        b"1024,-3.5*2E",
        b"1024,-3.5*2e",
        b'"1024","-3.5"',
        b'"1024"; "-3,5"',
        b'1024 "-3.5"',
    ],
)
@pytest.mark.parametrize("end", [b"\r\n", b"\n", b"\r"])
def test_numbers_with_a_separator_are_a_reading(line: bytes, end: bytes) -> None:
    assert read(line + end) == ([(1024, -3.5)], 0)


@pytest.mark.parametrize(
    "line",
    [
        *(b"1024", b"1024,-3.5,7", b"1024,-3.5,", b"1024.5,-3.5", b"1024,nan", b"1024,inf", b"1024,1e999", b"1024,1_0"),
        b"1024,0x10",
        b"1024,\xd9\xa3",  # an Arabic digit three, which Python reads as a number
        *(b"1024,-3.5\x00", b'1024,"-3.5', b'1024,"-3,5"', b'1024,""', b"\x1b[2J1024,-3.5", b"1024,-3.5*2F", b"hello"),
        *(b"1" * 30 + b",1", b" " * LONGEST_LINE + b"1024,-3.5"),
    ],
)
def test_anything_else_is_counted_and_left_out(line: bytes) -> None:
    assert read(GOOD + line + b"\n" + GOOD) == ([(1024, -3.5)] * 2, 1)


@pytest.mark.parametrize("line", [b"27206000;27,136", b"27206000; 27,136", b"27206000\t27,136"])
def test_a_comma_beside_semicolons_or_tabs_is_a_decimal_comma(line: bytes) -> None:
    assert read(line + b"\n") == ([(27206000, 27.136)], 0)
    assert read(line + b"\n", values=(*TWO, Value(used=False))) == ([], 1)


def test_a_comma_that_may_be_a_decimal_one_or_a_separator_is_not_read() -> None:
    assert read(b"27206000 27,136\n", values=(*TWO, Value(used=False))) == ([], 1)
    assert read(b"27206000,27 g\n27206000, 27, 136\n", values=(*TWO, Value(used=False))) == (
        [(27206000, 27), (27206000, 27)],
        0,
    )


def test_the_first_line_may_have_lost_its_beginning_and_is_dropped() -> None:
    reader = LineReader(TWO)

    assert reader.feed(b"24,-3.5\r\n" + GOOD) == [(1024, -3.5)]
    assert reader.rejected == 0
    reader.forget()
    assert reader.feed(b"4,-3.5\r\n" + GOOD) == [(1024, -3.5)]


@pytest.mark.parametrize("damaged", flipped(b"1024,-3.5*2E"))
def test_a_flipped_bit_of_a_line_with_a_checksum_makes_no_other_reading(damaged: bytes) -> None:
    found, _ = read(b"1024,-3.5*2E\n" + damaged + b"\n")
    assert set(found) == {(1024, -3.5)}


@FEW
@given(slicings)
def test_pieces_of_any_size_give_the_same(sizes: list[int]) -> None:
    reader = LineReader(TWO)
    readings = [reading for piece in sliced(b"\n" + GOOD * 3, sizes) for reading in reader.feed(piece)]
    assert readings == [(1024, -3.5)] * 3


@FEW
@given(st.binary(max_size=400) | st.just(b"7" * 100_000))
def test_junk_never_fails_and_a_line_without_end_takes_no_memory(data: bytes) -> None:
    reader = LineReader(TWO)
    reader.feed(data)

    assert len(pickle.dumps(reader)) < 2000
    assert printable(reader.last_rejected).isprintable()
    assert reader.feed(b"\n" + GOOD)[-1:] == [(1024, -3.5)] or b"*" in data
