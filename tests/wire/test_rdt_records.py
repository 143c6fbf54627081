"""RDT requests and records, byte by byte."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cfid.wire.rdt import (
    Command,
    Records,
    Request,
    decode_records,
    decode_request,
    encode_records,
    encode_request,
    is_block,
)

FEW = settings(max_examples=200, deadline=None, derandomize=True)
MANY = settings(FEW, max_examples=100_000, suppress_health_check=list(HealthCheck))

REQUESTS = [
    (Request(Command.STOP), "1234 0000 00000000"),
    (Request(Command.REAL_TIME, 1), "1234 0002 00000001"),
    (Request(Command.BUFFERED), "1234 0003 00000000"),
    (Request(Command.MULTI_UNIT, 258), "1234 0004 00000102"),
    (Request(Command.RESET_THRESHOLD), "1234 0041 00000000"),
    (Request(Command.BIAS, 4294967295), "1234 0042 FFFFFFFF"),
]
RECORD = bytes.fromhex(
    "00000001 000186A0 80010000"  # the first record of its request, sample 100000, a latched threshold
    "000F4240 FFF0BDC0 00000000 FFFFFFFF 00000100 FFFFFF00"
)
BLOCK = bytes.fromhex(
    "FFFFFFFF FFFFFFF9 00000000 7FFFFFFF 80000000 00000001 FFFFFFFE 01020304 FEFDFCFC"
    "00000000 00000000 FFFFFFFF 00000000 80000001 7FFFFFFE 00010000 FFFF0000 000000FF"
)

words = st.integers(0, 2**32 - 1)
counts = st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 6)
rows = st.lists(st.tuples(words, words, words, counts), max_size=4)
datagrams = st.binary(max_size=10) | st.binary(max_size=6).map(lambda end: b"\x12\x34" + end)


def records_of(given_rows: list[tuple[int, int, int, tuple[int, ...]]]) -> Records:
    rdt, ft, status, values = zip(*given_rows, strict=True) if given_rows else ((), (), (), ())
    return Records(
        np.array(rdt, np.uint32),
        np.array(ft, np.uint32),
        np.array(status, np.uint32),
        np.array(values, np.int32).reshape(-1, 6),
    )


def check_that_records_survive(given_rows: list[tuple[int, int, int, tuple[int, ...]]], datagram: bytes) -> None:
    data = encode_records(records_of(given_rows))
    assert len(data) == 36 * len(given_rows)
    decoded = decode_records(data)
    found = list(zip(*(column.tolist() for column in decoded), strict=True))
    assert found == [(rdt, ft, status, list(values)) for rdt, ft, status, values in given_rows]
    request = decode_request(datagram)
    assert (request is not None) == (len(datagram) == 8 and datagram.startswith(b"\x12\x34"))
    assert request is None or encode_request(request) == datagram


@FEW
@given(given_rows=rows, datagram=datagrams)
def test_records_and_requests_survive_the_wire_and_garbage_is_no_request(
    given_rows: list[tuple[int, int, int, tuple[int, ...]]], datagram: bytes
) -> None:
    check_that_records_survive(given_rows, datagram)


@pytest.mark.slow
@MANY
@given(given_rows=rows, datagram=datagrams)
def test_very_many_records_and_requests_survive_the_wire(
    given_rows: list[tuple[int, int, int, tuple[int, ...]]], datagram: bytes
) -> None:
    check_that_records_survive(given_rows, datagram)


@pytest.mark.parametrize(("request_", "data"), REQUESTS)
def test_a_request_is_its_header_command_and_count(request_: Request, data: str) -> None:
    assert encode_request(request_) == bytes.fromhex(data)
    assert decode_request(bytes.fromhex(data)) == request_


@pytest.mark.parametrize(
    "data", ["", "1234 0002 000000", "1234 0002 00000001 00", "3412 0002 00000001", "1235 0002 00000001"]
)
def test_what_is_no_request_is_told(data: str) -> None:
    assert decode_request(bytes.fromhex(data)) is None


def test_a_record_is_read_field_by_field() -> None:
    records = decode_records(RECORD)
    assert (records.rdt_sequence.tolist(), records.ft_sequence.tolist()) == ([1], [100000])
    assert records.status.tolist() == [0x80010000]
    assert records.counts.tolist() == [[1000000, -1000000, 0, -1, 256, -256]]


def test_a_block_of_two_records_with_extreme_values_is_read() -> None:
    records = decode_records(BLOCK)
    assert records.rdt_sequence.tolist() == [4294967295, 0]
    assert records.ft_sequence.tolist() == [4294967289, 0]
    assert records.status.tolist() == [0, 4294967295]
    assert records.counts.tolist() == [
        [2147483647, -2147483648, 1, -2, 16909060, -16909060],
        [0, -2147483647, 2147483646, 65536, -65536, 255],
    ]


@pytest.mark.parametrize("data", [RECORD, BLOCK, RECORD + BLOCK])
def test_records_are_written_as_they_were_read(data: bytes) -> None:
    assert encode_records(decode_records(data)) == data
    assert encode_records(decode_records(memoryview(bytearray(data)))) == data


def test_what_was_decoded_does_not_change_with_the_buffer_it_came_from() -> None:
    buffer = bytearray(RECORD)
    records = decode_records(buffer)
    buffer[:] = bytes(36)
    assert records.rdt_sequence.tolist() == [1]
    assert [column.dtype.isnative for column in records] == [True] * 4


def test_a_datagram_is_a_block_when_it_holds_1_to_40_whole_records() -> None:
    assert [size for size in range(-40, 3000) if is_block(size)] == [36 * records for records in range(1, 41)]


@pytest.mark.parametrize("size", [1, 35, 37, 71, 1439])
def test_bytes_that_are_no_whole_records_are_refused(size: int) -> None:
    with pytest.raises(ValueError):
        decode_records(bytes(size))


def test_no_bytes_are_no_records() -> None:
    assert decode_records(b"").counts.shape == (0, 6)
