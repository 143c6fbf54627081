"""An exchange between cflib and real firmware is replayed on the simulated vehicle: answers have equal shapes.

The recorded firmware (2024, in software) has memories, and more parameters and variables than the simulated one.
"""

import json
import struct
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from cfid.sim.crazyflie import CrazyflieTruth
from cfid.sim.crazyflie_services import parameters
from cfid.wire.crtp import decode_packet
from tests.lab import DATA
from tests.sim.vehicle import CLIENT, OPENED_S, Bench

RECORDED = DATA / "crtp" / "real_firmware_transcript.jsonl"

pytestmark = pytest.mark.skipif(not RECORDED.exists(), reason="the recorded exchange is not here (CFID_DATA)")

PARAMETER_KINDS = {0: "b", 1: "h", 2: "i", 6: "f", 8: "B", 9: "H", 10: "I"}
STREAM = 0x52
OWN = parameters(rpm_deck=False)


class Said(NamedTuple):
    to_vehicle: bool
    time_s: float
    packet: bytes


@pytest.fixture(scope="module")
def recorded() -> list[Said]:
    lines = [json.loads(line) for line in RECORDED.read_text().splitlines()]
    begin_s = lines[0][1]
    return [Said(direction == ">", time_s - begin_s, bytes.fromhex(packet)) for direction, time_s, packet in lines]


def _exchanges(recorded: list[Said]) -> Iterator[tuple[Said, bytes | None]]:
    """Pair each request with the first later answer on its port and channel that no earlier request has taken."""
    answers = [found for found in recorded if not found.to_vehicle and found.packet[0] != STREAM]
    for found in recorded:
        if found.to_vehicle:
            mine = (a for a in answers if a.time_s >= found.time_s and a.packet[0] & 0xF3 == found.packet[0] & 0xF3)
            answer = next(mine, None)
            if answer is not None:
                answers.remove(answer)
            yield found, None if answer is None else answer.packet


def _table(recorded: list[Said], port: int) -> dict[int, tuple[str, int]]:
    """Return name and type by number, as the recorded firmware reported them."""
    items = [found.packet for found in recorded if found.packet[:2] == bytes([port << 4, 2])]
    names = {struct.unpack_from("<H", item, 2)[0]: item[5:-1].decode().replace("\0", ".") for item in items}
    return {number: (names[number], item[4]) for item in items for number in [struct.unpack_from("<H", item, 2)[0]]}


def _translated(packet: bytes, recorded: list[Said], variables: dict[str, tuple[int, str]]) -> bytes:
    """Return a request about the same entries under the simulated vehicle's numbers."""
    if packet[:2] == b"\x5d\x06":
        table = _table(recorded, 5)
        entries = [(kind, variables[table[number][0]][0]) for kind, number in struct.iter_unpack("<BH", packet[3:])]
        return packet[:3] + b"".join(struct.pack("<BH", *entry) for entry in entries)
    if packet[:1] == b"\x2e":
        name = _table(recorded, 2)[struct.unpack_from("<H", packet, 1)[0]][0]
        return packet[:1] + struct.pack("<H", [parameter.name for parameter in OWN].index(name)) + packet[3:]
    return packet


def _is_beyond(packet: bytes, variables: int) -> bool:
    """Return whether a request asks for an entry or a memory that only the recorded vehicle has."""
    place = packet[0] >> 4, packet[0] & 3
    numbered_from = {(2, 0): 2, (2, 1): 1, (2, 3): 2, (5, 0): 2}.get(place)
    if numbered_from is None or len(packet) < numbered_from + 2:
        return packet[:2] == b"\x4c\x02"
    number = struct.unpack_from("<H", packet, numbered_from)[0]
    return bool(number >= (len(OWN) if place[0] == 2 else variables))


def _shape(packet: bytes, kinds: dict[int, str]) -> object:
    """Return the part of an answer that does not depend on a vehicle's tables; `kinds` are the types of parameters."""
    decoded = decode_packet(packet)
    assert decoded is not None
    (*place, payload), header = decoded, packet[0]
    match place:
        case [2 | 5, 0] if payload[0] == 2:
            group, name, rest = payload[4:].split(b"\0")
            return header, payload[:3], bool(group), bool(name), rest
        case [2 | 5, 0]:
            return header, payload[:1], payload[7:], len(payload)
        case [2, 1]:
            number = struct.unpack_from("<H", payload)[0]
            return header, payload[:3], len(payload) - 3 - struct.calcsize(kinds[number])
        case [2, 2]:
            return header, payload[2:]
        case [2, 3] | [4, 0] | [13, 1]:
            is_text = place == [13, 1] and payload[0] == 1
            return header, payload[:1], payload[1:].isascii() if is_text else len(payload)
    return packet


def test_the_simulated_vehicle_answers_in_the_same_shapes(recorded: list[Said]) -> None:
    bench = Bench(CrazyflieTruth(firmware="stock"))
    variables = bench.table()
    theirs = {number: PARAMETER_KINDS[code & 0x0F] for number, (_, code) in _table(recorded, 2).items()}
    mine = {number: parameter.kind for number, parameter in enumerate(OWN)}
    compared = 0
    for (_, time_s, request), expected in _exchanges(recorded):
        if _is_beyond(request, len(variables)) or request == b"\xdd\2":  # the recorded one did not report its device
            continue
        bench.wait(time_s - bench.now_s)
        bench.faulty.received(_translated(request, recorded, variables), CLIENT, OPENED_S + bench.now_s)
        answers = [packet for packet, _ in bench.faulty.due(OPENED_S + bench.now_s) if packet[0] != STREAM]
        shapes = [] if expected is None else [_shape(expected, theirs)]
        assert [_shape(answer, mine) for answer in answers] == shapes, request.hex()
        compared += 1
    assert compared > 150
