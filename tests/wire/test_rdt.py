"""RDT requests, records and status words, byte by byte: which bits are faults, and which are warnings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.wire.rdt import (
    RECORD,
    Command,
    Request,
    decode_records,
    decode_request,
    encode_records,
    encode_request,
    is_block,
)
from cfid.wire.rdt_status import Family, family_of, read_status
from tests.wire.pieces import FEW

REQUESTS = [
    (Request(Command.STOP), "1234 0000 00000000"),
    (Request(Command.REAL_TIME, 1), "1234 0002 00000001"),
    (Request(Command.BUFFERED), "1234 0003 00000000"),
    (Request(Command.MULTI_UNIT, 258), "1234 0004 00000102"),
    (Request(Command.RESET_THRESHOLD), "1234 0041 00000000"),
    (Request(Command.BIAS, 4294967295), "1234 0042 FFFFFFFF"),
]
BLOCKS = [
    (
        "00000001 000186A0 80010000"  # the first record of its request, sample 100000, a latched threshold
        "000F4240 FFF0BDC0 00000000 FFFFFFFF 00000100 FFFFFF00",
        [(1, 100000, 0x80010000, (1000000, -1000000, 0, -1, 256, -256))],
    ),
    (
        "FFFFFFFF FFFFFFF9 00000000 7FFFFFFF 80000000 00000001 FFFFFFFE 01020304 FEFDFCFC"
        "00000000 00000000 FFFFFFFF 00000000 80000001 7FFFFFFE 00010000 FFFF0000 000000FF",
        [
            (4294967295, 4294967289, 0, (2147483647, -2147483648, 1, -2, 16909060, -16909060)),
            (0, 0, 4294967295, (0, -2147483647, 2147483646, 65536, -65536, 255)),
        ],
    ),
    ("", []),
]


@pytest.mark.parametrize(("request_", "data"), REQUESTS)
def test_a_request_is_its_header_command_and_count(request_: Request, data: str) -> None:
    assert encode_request(request_) == bytes.fromhex(data)
    assert decode_request(bytes.fromhex(data)) == request_


@pytest.mark.parametrize(("data", "records"), BLOCKS)
def test_a_block_is_its_records_field_by_field(data: str, records: list[tuple[int, int, int, tuple[int, ...]]]) -> None:
    np.testing.assert_array_equal(decode_records(bytes.fromhex(data)), np.array(records, RECORD), strict=True)
    assert encode_records(np.array(records, RECORD)) == bytes.fromhex(data)


def test_a_datagram_is_a_block_when_it_holds_1_to_40_whole_records() -> None:
    assert [size for size in range(-40, 3000) if is_block(size)] == [36 * records for records in range(1, 41)]


@pytest.mark.parametrize("size", [1, 35, 37, 71, 1439])
def test_bytes_that_are_no_whole_records_are_refused(size: int) -> None:
    with pytest.raises(ValueError):
        decode_records(bytes(size))


FAMILIES: tuple[Family, Family] = ("netft", "axia")
WARNING_BITS = {"netft": 1 << 16, "axia": 1 << 3 | 1 << 16 | 1 << 26 | 1 << 28}  # what the makers call no errors
SUMMARY = 1 << 31


@FEW
@given(word=st.integers(0, 2**32 - 1), family=st.sampled_from(FAMILIES))
def test_each_bit_of_any_word_is_one_fault_or_one_warning(word: int, family: Family) -> None:
    status = read_status(word, family)
    bits = word & ~SUMMARY
    assert len(set(status.faults + status.warnings)) == len(status.faults + status.warnings)
    assert len(status.warnings) == (bits & WARNING_BITS[family]).bit_count()
    assert len(status.faults) == (bits & ~WARNING_BITS[family]).bit_count() + (word == SUMMARY)


@pytest.mark.parametrize(
    ("product", "family"),
    [
        ("Net F/T", "netft"),
        ("Ethernet Axia80", "axia"),
        ("ETHERNET AXIA", "axia"),
        ("AXIA80-M20", "axia"),
        ("", "netft"),
    ],
)
def test_the_product_name_gives_the_family(product: str, family: Family) -> None:
    assert family_of(product) == family
