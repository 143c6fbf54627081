"""CRTP as recorded with real firmware, and the packets that cfid sends on the stock ports."""

import json

import pytest

from cfid.wire import crtp
from cfid.wire.crtp import LogAnswer, Packet, Variable
from tests.lab import DATA

RECORDED = DATA / "crtp"
TRANSCRIPT = RECORDED / "real_firmware_transcript.jsonl"


def test_a_header_holds_port_and_channel_around_the_links_own_bits() -> None:
    assert crtp.encode_packet(Packet(15, 1, b"\x00")) == bytes.fromhex("fd00")
    assert crtp.encode_packet(Packet(5, 0, b"\x03")) == bytes.fromhex("5c03")
    assert crtp.decode_packet(bytes.fromhex("5003")) == Packet(5, 0, b"\x03")  # log answers of real firmware
    assert crtp.decode_packet(b"") is None
    assert crtp.decode_packet(bytes(32)) is None


@pytest.mark.skipif(not TRANSCRIPT.exists(), reason="the recorded exchange with real firmware is not here")
def test_every_packet_that_real_firmware_and_cflib_exchanged_is_read() -> None:
    lines = [json.loads(line) for line in TRANSCRIPT.read_text().splitlines()]
    packets = [(way, crtp.decode_packet(bytes.fromhex(text))) for way, _, text in lines]
    assert len(packets) == 1962
    assert all(packet is not None for _, packet in packets)
    sent = [(packet, text) for (way, packet), (_, _, text) in zip(packets, lines, strict=True) if way == ">"]
    assert all(packet and crtp.encode_packet(packet).hex() == text for packet, text in sent)


def test_an_echo_of_ours_is_told_from_cflibs_own() -> None:
    assert len(crtp.encode_echo(7)) == 9
    assert crtp.encode_echo(7)[0] != 0
    assert crtp.decode_echo(crtp.encode_echo(7)) == 7
    assert crtp.decode_echo(b"\x00" + bytes(8)) is None
    assert crtp.decode_echo(b"") is None


def test_a_parameter_is_set_by_its_name() -> None:
    """Follow param_logic.c of 2026.08: a request has command, group, name, type and value; an answer has an error."""
    begin = bytes.fromhex("00") + b"motorPowerSet\0m1\0"
    assert crtp.encode_set_by_name("motorPowerSet.m1", "H", 30000) == begin + bytes.fromhex("09 3075")
    assert crtp.encode_set_by_name("motorPowerSet.enable", "B", 0) == b"\0motorPowerSet\0enable\0\x08\0"
    assert crtp.decode_set_by_name("motorPowerSet.m1", begin + b"\0") == 0
    assert crtp.decode_set_by_name("motorPowerSet.m1", begin + b"\x02") == 2
    for answer in (b"", begin, begin + bytes(2), b"\0motorPowerSet\0m2\0\0", b"\0motorPowerSet\0m11\0\0"):
        assert crtp.decode_set_by_name("motorPowerSet.m1", answer) is None


def test_parameters_are_written_and_read_by_number() -> None:
    m1 = Variable(0x0123, "H")
    assert crtp.encode_write_parameter(m1, 30000) == bytes.fromhex("2301 3075")
    assert crtp.encode_read_parameter(m1) == bytes.fromhex("2301")
    assert crtp.decode_write_parameter(m1, bytes.fromhex("2301 3075")) == 30000
    assert crtp.decode_read_parameter(m1, bytes.fromhex("2301 00 3075")) == 30000
    assert crtp.decode_read_parameter(m1, bytes.fromhex("2301 02 3075")) is None  # an error
    assert crtp.decode_read_parameter(m1, bytes.fromhex("2401 00 3075")) is None  # about another parameter
    assert crtp.decode_write_parameter(m1, bytes.fromhex("2301 30")) is None
    assert crtp.decode_write_parameter(m1, bytes.fromhex("2401 3075")) is None  # about another parameter


def test_a_log_block_names_its_variables_by_type_and_number() -> None:
    variables = [Variable(5, "f"), Variable(0x0102, "H")]
    assert crtp.encode_create_log(7, variables) == bytes.fromhex("06 07 77 0500 22 0201")
    assert crtp.encode_start_log(7, 1) == bytes.fromhex("08 07 0100")
    assert crtp.encode_stop_log(7) == bytes.fromhex("04 07")
    assert crtp.decode_log_answer(bytes.fromhex("06 07 00")) == LogAnswer(6, 7, 0)
    assert crtp.decode_log_answer(b"\x06") is None


def test_a_log_row_has_a_24_bit_stamp_and_the_blocks_values() -> None:
    variables = [Variable(5, "f"), Variable(6, "H")]
    row = bytes.fromhex("07 010203 00007040 3075")
    assert crtp.decode_log_row(7, variables, row) == (0x030201, (3.75, 30000))
    assert crtp.decode_log_row(8, variables, row) is None
    assert crtp.decode_log_row(7, variables, row[:-1]) is None
