"""Simulates what a Crazyflie's firmware answers on its link: parameters, log, platform, memories and echoes.

An answer is a payload for the channel of the request; where there is None, the firmware says nothing.
"""

import errno
import math
import struct
import zlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

from cfid.sim.supervisor import SimulatedSupervisor
from cfid.wire.crtp import (
    ECHO_CHANNEL,
    LOG_CONTROL_CHANNEL,
    LOG_PORT,
    LONGEST_LOG_ROW,
    LONGEST_PAYLOAD,
    PARAMETER_PORT,
    READ_CHANNEL,
    WRITE_CHANNEL,
)

MEMORY_PORT, SUPERVISOR_PORT, PLATFORM_PORT = 4, 9, 13
IDLE = "powerDist.idleThrust"

_TOC_CHANNEL = 0
_TOC_ITEM, _TOC_INFO = 2, 3  # those with 16-bit numbers, since protocol version 4
_NUMBER = struct.Struct("<H")

_MISC_CHANNEL = 3
_SET_BY_NAME, _EXTENDED_TYPE, _STORE, _STATE, _CLEAR, _DEFAULT, _EXTENDED_TYPE_V2, _DEFAULT_V2 = 0, 2, 3, 4, 5, 6, 7, 8
_WITH_STATUS = (_EXTENDED_TYPE_V2, _DEFAULT_V2)  # whose answer has a status byte before the value
_PERSISTENT = 1
_NOT_STORED = b"\0"
_NO_SUCH_ENTRY = bytes([errno.ENOENT])
_PARAMETER_CODES = {"b": 0, "h": 1, "i": 2, "f": 6, "B": 8, "H": 9, "I": 10}
_HAS_EXTENDED_TYPE, _CORE, _READ_ONLY = 0x10, 0x20, 0x40

_MOST_BLOCKS, _MOST_VARIABLES = 16, 128  # the latter in all blocks together
_DELETE, _START, _STOP, _RESET, _CREATE, _APPEND, _START_MS = 2, 3, 4, 5, 6, 7, 8
_OF_A_BLOCK = (_DELETE, _START, _STOP, _CREATE, _APPEND, _START_MS)
_START_UNIT_MS = 10  # of the older command
_LOG_KINDS = dict(enumerate("BHIbhife", 1))
_LOG_CODES = {kind: code for code, kind in _LOG_KINDS.items()}
_ENTRY = struct.Struct("<BH")  # of a block: types of storage and transmission, number in the table
_STAMP_BYTES = 3
_LARGEST_HALF = 65504.0

_COMMAND_CHANNEL, _VERSION_CHANNEL = 0, 1
_ARM, _RECOVER, _NOTIFY = 1, 2, 3

_COUNT, _INFO = 1, 2
_INFO_CHANNEL, _MEMORY_READ_CHANNEL, _MEMORY_WRITE_CHANNEL = range(3)
_PLACE = struct.Struct("<BI")  # memory and address, of reading and writing
_SERIAL_BYTES = 8
_LONGEST_READ = 24

_SOURCE_CHANNEL, _NULL_CHANNEL = 1, 3
# Answers in a packet of their own lack the link's bits in the header; others are the request's packet, filled in.
_OF_THEIR_OWN = {(PARAMETER_PORT, 0), (LOG_PORT, 0)} | {
    (port, channel) for port in (MEMORY_PORT, SUPERVISOR_PORT) for channel in range(4)
}


def framed(answer: bytes, *, port: int, channel: int, header: int) -> bytes:
    """Return the packet of an answer to a request with this header."""
    return new_packet(port, channel, answer) if (port, channel) in _OF_THEIR_OWN else bytes([header]) + answer


def new_packet(port: int, channel: int, payload: bytes) -> bytes:
    """Return a packet that originates in the vehicle."""
    return bytes([port << 4 | channel]) + payload


def answer_link(channel: int, payload: bytes) -> bytes | None:
    """Return an echo, even of the empty packet that searches for vehicles, or the vehicle's name."""
    if channel == _SOURCE_CHANNEL:
        return b"Bitcraze Crazyflie".ljust(LONGEST_PAYLOAD, b"\0")
    return payload if channel == ECHO_CHANNEL or (channel == _NULL_CHANNEL and not payload) else None


class Toc:
    """A table of contents: names `group.name` with their type bytes, numbered in order, sent entry by entry."""

    def __init__(self, entries: Sequence[tuple[str, int]], *, tail: bytes = b"") -> None:
        """Compute the checksum by which a client recognizes the table; `tail` ends the answer about the whole table."""
        encoded = [bytes([code]) + name.replace(".", "\0").encode() + b"\0" for name, code in entries]
        self._entries = encoded
        self._info = bytes([_TOC_INFO]) + struct.pack("<HI", len(encoded), zlib.crc32(b"".join(encoded))) + tail

    def answer(self, request: bytes) -> bytes | None:
        """Return the answer; one about an entry that does not exist contains none."""
        if request[:1] == bytes([_TOC_INFO]):
            return self._info
        if request[:1] != bytes([_TOC_ITEM]):
            return None
        number = _number_in(request[1:])
        known = number is not None and number < len(self._entries)
        return request[:3] + self._entries[number] if known and number is not None else request[:1]


def _number_in(payload: bytes) -> int | None:
    """Return the number that a payload begins with, None when it is too short for one."""
    return int(_NUMBER.unpack_from(payload)[0]) if len(payload) >= _NUMBER.size else None


class FirmwareParameter(NamedTuple):
    """A name, a type as a letter of Python's struct, and the value after a start."""

    name: str
    kind: str
    value: float
    read_only: bool = False
    persistent: bool = False
    core: bool = False  # of the firmware's stable interface

    @property
    def packed(self) -> bytes:
        """The value after a start, as the link carries it."""
        return struct.pack("<" + self.kind, self.value)

    @property
    def code(self) -> int:
        """The type byte of the table."""
        flags = _HAS_EXTENDED_TYPE * self.persistent | _CORE * self.core | _READ_ONLY * self.read_only
        return _PARAMETER_CODES[self.kind] | flags


def parameters(*, rpm_deck: bool, idle: int = 0) -> list[FirmwareParameter]:
    """Return a selection of the firmware's parameters with their values after a start, `idle` that of IDLE."""
    return [
        FirmwareParameter("motorPowerSet.enable", "B", 0),
        *(FirmwareParameter(f"motorPowerSet.m{motor}", "H", 0) for motor in (1, 2, 3, 4)),
        FirmwareParameter("pm.lowVoltage", "f", 3.2, persistent=True),
        FirmwareParameter("pm.criticalLowVoltage", "f", 3.0, persistent=True),
        FirmwareParameter("system.selftestPassed", "b", 1, read_only=True, core=True),
        FirmwareParameter("system.assertInfo", "B", 0),
        FirmwareParameter("supervisor.infdmp", "B", 0),
        FirmwareParameter("supervisor.tmblChckEn", "B", 1, persistent=True),
        FirmwareParameter("stabilizer.stop", "B", 0, core=True),
        FirmwareParameter("stabilizer.estimator", "B", 1, core=True),
        FirmwareParameter("stabilizer.controller", "B", 1, core=True),
        FirmwareParameter("commander.enHighLevel", "B", 0, core=True),
        FirmwareParameter("flightmode.althold", "B", 0, core=True),
        FirmwareParameter("pid_rate.roll_kp", "f", 250.0, persistent=True),
        FirmwareParameter(IDLE, "I", idle, persistent=True, core=True),
        FirmwareParameter("health.startPropTest", "B", 0),
        FirmwareParameter("crtpsrv.echoDelay", "H", 0),
        FirmwareParameter("deck.bcRpm", "B", rpm_deck, read_only=True),
        FirmwareParameter("firmware.revision0", "I", 0x2A18FC29, read_only=True, core=True),
        FirmwareParameter("firmware.revision1", "H", 0x9D7B, read_only=True, core=True),
        FirmwareParameter("firmware.modified", "B", 0, read_only=True, core=True),
        FirmwareParameter("supervisor.prefltTimeout", "H", 30000, persistent=True),
        FirmwareParameter("supervisor.landedTimeout", "H", 3000, persistent=True),
        FirmwareParameter("supervisor.spinupTimeout", "H", 2000, persistent=True),
    ]


class Parameters(dict[str, float]):
    """The present values by name, in the order of the table, and the port's answers; a power cycle loses all."""

    def __init__(self, table: Sequence[FirmwareParameter]) -> None:
        """Start with the default values."""
        super().__init__((parameter.name, parameter.value) for parameter in table)
        self._table = table
        self._toc = Toc([(parameter.name, parameter.code) for parameter in table])

    def answer(self, channel: int, payload: bytes) -> bytes | None:
        """Return the answer to a request about the table or about values."""
        if channel == _TOC_CHANNEL:
            return self._toc.answer(payload)
        return self._misc(payload) if channel == _MISC_CHANNEL else self._value(channel, payload)

    def _value(self, channel: int, payload: bytes) -> bytes | None:
        number = _number_in(payload)
        if number is None:
            return None
        if number >= len(self._table):
            return payload[:2] + _NO_SUCH_ENTRY
        parameter = self._table[number]
        if channel == READ_CHANNEL:
            return payload[:2] + b"\0" + struct.pack("<" + parameter.kind, self[parameter.name])
        if channel != WRITE_CHANNEL or parameter.read_only or not self._set(parameter, payload[2:]):
            return None
        return payload

    def _set(self, parameter: FirmwareParameter, value: bytes) -> bool:
        layout = struct.Struct("<" + parameter.kind)
        if len(value) < layout.size:
            return False
        self[parameter.name] = layout.unpack_from(value)[0]
        return True

    def _misc(self, payload: bytes) -> bytes | None:
        if payload[:1] == bytes([_SET_BY_NAME]):
            return self._set_by_name(payload)
        number = _number_in(payload[1:])
        if number is None:
            return None
        known = number < len(self._table)
        answer = _answer_misc(payload[0], self._table[number]) if known else _NO_SUCH_ENTRY
        return None if answer is None else payload[:3] + answer

    def _set_by_name(self, payload: bytes) -> bytes | None:
        """Set the parameter of a group and a name, each ending in a zero byte, if the type given is its own."""
        group, ends, rest = payload[1:].partition(b"\0")
        name, ends_too, rest = rest.partition(b"\0")
        if not (ends and ends_too):
            return None
        full_name = (group + b"." + name).decode(errors="replace")
        parameter = next((parameter for parameter in self._table if parameter.name == full_name), None)
        if parameter is None:
            error = errno.ENOENT
        elif rest[:1] != bytes([_PARAMETER_CODES[parameter.kind]]):
            error = errno.EINVAL
        elif parameter.read_only:
            error = errno.EACCES
        else:
            error = 0 if self._set(parameter, rest[1:]) else errno.EINVAL
        return payload[: len(payload) - len(rest)] + bytes([error])


def _answer_misc(command: int, parameter: FirmwareParameter) -> bytes | None:
    """Return what follows a parameter's number in the answer."""
    status = b"\0" if command in _WITH_STATUS else b""
    if command in (_EXTENDED_TYPE, _EXTENDED_TYPE_V2):
        return status + bytes([_PERSISTENT]) if parameter.persistent else _NO_SUCH_ENTRY
    if command in (_DEFAULT, _DEFAULT_V2):
        return _NO_SUCH_ENTRY if parameter.read_only else status + parameter.packed
    if command == _STATE:
        return _NOT_STORED + parameter.packed
    return b"\0" if command in (_STORE, _CLEAR) else None


class LoggedVariable(NamedTuple):
    """A name, a type as a letter of Python's struct, and the function that reads its value."""

    name: str
    kind: str
    read: Callable[[], float]


_MEMORY = 0xFFFF  # as a number: an address in memory instead of a variable, which the firmware does not check
_IN_MEMORY = LoggedVariable("memory", "I", lambda: 0)


class _Block:
    """Variables, each with the type it is sent as; `period_ms` is None while the block is not started."""

    def __init__(self) -> None:
        self.entries: list[tuple[str, LoggedVariable]] = []
        self.period_ms: int | None = None
        self.next_ms = 0

    @property
    def size(self) -> int:
        return sum(struct.calcsize(kind) for kind, _ in self.entries)


class Log:
    """Blocks of variables that a client creates and starts, sent at a period, and the answers of the log port."""

    def __init__(self, variables: Sequence[LoggedVariable]) -> None:
        """Start without a block."""
        self._variables = variables
        limits = bytes([_MOST_BLOCKS, _MOST_VARIABLES])
        self._toc = Toc([(variable.name, _LOG_CODES[variable.kind]) for variable in variables], tail=limits)
        self._blocks: dict[int, _Block] = {}

    @property
    def streaming(self) -> bool:
        """Whether a block is started."""
        return any(block.period_ms is not None for block in self._blocks.values())

    def reset(self) -> None:
        """Delete all blocks."""
        self._blocks.clear()

    def answer(self, channel: int, payload: bytes, now_ms: int) -> bytes | None:
        """Return the answer; that to a command has the command, the block, and an error or 0."""
        if channel == _TOC_CHANNEL:
            return self._toc.answer(payload)
        if channel != LOG_CONTROL_CHANNEL:
            return None
        command, number = payload[:2].ljust(2, b"\0")
        return bytes([command, number, self._execute(command, number, payload[2:], now_ms)])

    def due(self, now_ms: int) -> list[bytes]:
        """Return the rows of all blocks whose time has come: block, a stamp of 24 bits, and the values."""
        rows = []
        for number, block in self._blocks.items():
            if block.period_ms is not None and block.next_ms <= now_ms:
                stamp = (now_ms % (1 << 8 * _STAMP_BYTES)).to_bytes(_STAMP_BYTES, "little")
                values = b"".join(_packed(kind, variable.read()) for kind, variable in block.entries)
                rows.append(bytes([number]) + stamp + values)
                block.next_ms += block.period_ms
                block.period_ms = block.period_ms or None  # a period of zero sends one row
        return rows

    def _execute(self, command: int, number: int, arguments: bytes, now_ms: int) -> int:
        if command == _RESET:
            self.reset()
            return 0
        if command not in _OF_A_BLOCK:
            return errno.ENOEXEC
        if command == _CREATE:
            if number in self._blocks:
                return errno.EEXIST
            if len(self._blocks) == _MOST_BLOCKS:
                return errno.ENOMEM
            self._blocks[number] = _Block()
        if number not in self._blocks:
            return errno.ENOENT
        return self._execute_on_block(command, number, arguments, now_ms)

    def _execute_on_block(self, command: int, number: int, arguments: bytes, now_ms: int) -> int:
        block = self._blocks[number]
        if command in (_CREATE, _APPEND):
            return self._append(block, arguments)
        if command == _DELETE:
            del self._blocks[number]
        elif command == _STOP:
            block.period_ms = None
        else:
            short, long = arguments[:1], arguments[:2]
            period_ms = int.from_bytes(long if command == _START_MS else short, "little")
            block.period_ms = period_ms * (_START_UNIT_MS if command == _START else 1)
            block.next_ms = now_ms + max(block.period_ms, 1)
        return 0

    def _append(self, block: _Block, arguments: bytes) -> int:
        """Append variables until one does not fit or does not exist; those before it stay, as on the vehicle."""
        for code, number in _ENTRY.iter_unpack(arguments[: len(arguments) // _ENTRY.size * _ENTRY.size]):
            kind = _LOG_KINDS.get(code & 0x0F)
            if kind is None or (number >= len(self._variables) and number != _MEMORY):
                return errno.ENOENT
            if block.size + struct.calcsize(kind) > LONGEST_LOG_ROW:
                return errno.E2BIG
            if sum(len(other.entries) for other in self._blocks.values()) == _MOST_VARIABLES:
                return errno.ENOMEM
            block.entries.append((kind, _IN_MEMORY if number == _MEMORY else self._variables[number]))
        return 0


def _packed(kind: str, value: float) -> bytes:
    """Return a value in the type that the client requested, truncated as in C."""
    if kind == "e" and abs(value) > _LARGEST_HALF:
        value = math.copysign(math.inf, value)
    if kind in "fe":
        return struct.pack("<" + kind, value)
    bits = 8 * struct.calcsize(kind)
    return (int(value) % (1 << bits)).to_bytes(bits // 8, "little")


def answer_platform(
    channel: int, payload: bytes, supervisor: SimulatedSupervisor, *, protocol: int, brushless: bool
) -> bytes | None:
    """Return a version or the device's name; arm, disarm or recover as the supervisor port does; else the request."""
    command = payload[:1]
    if channel == _VERSION_CHANNEL:
        device = b"Crazyflie 2.1 Brushless" if brushless else b"Crazyflie 2.1"
        versions = {b"\0": protocol.to_bytes(4, "little"), b"\1": b"2026.08", b"\2": device}
        return command + versions[command] if command in versions else None
    if channel != _COMMAND_CHANNEL:
        return None
    if command == bytes([_ARM]):
        granted = len(payload) > 1 and supervisor.request_arming(payload[1] != 0)
        return command + bytes([granted, supervisor.armed])
    if command == bytes([_RECOVER]):
        return command + bytes([supervisor.recover(), not supervisor.crashed])
    return b"" if command == bytes([_NOTIFY]) else payload


class AbsentMemoryError(Exception):
    """A request for a memory that does not exist, on which the firmware fails an assertion."""


# Trajectories of the high-level commander, none of them set, and the memory tester, which returns each address.
# Clients with all of cflib read this list before they count as connected.
_TRAJECTORIES, _TESTER = 0x12, 0x15
_MEMORIES = (_TRAJECTORIES, _TESTER)
_MEMORY_BYTES = 4096


def answer_memory(channel: int, payload: bytes) -> bytes | None:
    """Return the answer of a vehicle without decks. Raises AbsentMemoryError."""
    if channel == _INFO_CHANNEL and payload[:1] == bytes([_COUNT]):
        return bytes([_COUNT, len(_MEMORIES)])
    if channel == _INFO_CHANNEL and payload[:1] == bytes([_INFO]):
        kind = _memory(payload[1:2])
        return payload[:2].ljust(2, b"\0") + struct.pack("<BI", kind, _MEMORY_BYTES) + bytes(_SERIAL_BYTES)
    if channel not in (_MEMORY_READ_CHANNEL, _MEMORY_WRITE_CHANNEL) or len(payload) <= _PLACE.size:
        return None
    kind = _memory(payload)
    if channel == _MEMORY_WRITE_CHANNEL:
        return payload[: _PLACE.size] + b"\0"  # nothing here reads it again
    address, count = _PLACE.unpack_from(payload)[1], payload[_PLACE.size]
    if address + count > _MEMORY_BYTES or count > _LONGEST_READ:
        return payload[: _PLACE.size] + bytes([errno.EIO])
    content = bytes(place & 0xFF for place in range(address, address + count)) if kind == _TESTER else bytes(count)
    return payload[: _PLACE.size] + b"\0" + content


def _memory(payload: bytes) -> int:
    """Return the kind of the memory whose number a payload begins with."""
    number = payload[0] if payload else 0
    if number >= len(_MEMORIES):
        raise AbsentMemoryError(f"memory {number} of {len(_MEMORIES)}")
    return _MEMORIES[number]
