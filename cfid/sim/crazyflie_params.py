"""Simulates the vehicle's parameter port: lists, reads and sets parameters."""

import errno
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from cfid.sim.crazyflie_toc import TOC_CHANNEL, Entry, Toc, number_in
from cfid.wire.crtp import READ_CHANNEL, WRITE_CHANNEL

_MISC_CHANNEL = 3
_SET_BY_NAME, _EXTENDED_TYPE, _STORE, _STATE, _CLEAR, _DEFAULT, _EXTENDED_TYPE_V2, _DEFAULT_V2 = 0, 2, 3, 4, 5, 6, 7, 8
_WITH_STATUS = (_EXTENDED_TYPE_V2, _DEFAULT_V2)  # whose answer has a status byte before the value
_PERSISTENT = 1
_NOT_STORED = b"\0"
_NO_SUCH_ENTRY = bytes([errno.ENOENT])

_CODES = {"b": 0, "h": 1, "i": 2, "f": 6, "B": 8, "H": 9, "I": 10}
_HAS_EXTENDED_TYPE, _CORE, _READ_ONLY = 0x10, 0x20, 0x40


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


class Parameters(Mapping[str, float]):
    """Values by name, and the port's answers. Nothing is stored beyond a power cycle."""

    def __init__(self, parameters: Sequence[FirmwareParameter]) -> None:
        """Start with the default values."""
        self._parameters = parameters
        self._values = {parameter.name: parameter.value for parameter in parameters}
        self._toc = Toc([Entry(parameter.name, _code(parameter)) for parameter in parameters])

    def __getitem__(self, name: str) -> float:
        """Return the present value."""
        return self._values[name]

    def __setitem__(self, name: str, value: float) -> None:
        """Set a value as the firmware itself does."""
        self._values[name] = value

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names, in the order of the table."""
        return iter(self._values)

    def __len__(self) -> int:
        """Return the number of parameters."""
        return len(self._values)

    def answer(self, channel: int, payload: bytes) -> bytes | None:
        """Return the answer on the same channel, None for none."""
        if channel == TOC_CHANNEL:
            return self._toc.answer(payload)
        return self._misc(payload) if channel == _MISC_CHANNEL else self._value(channel, payload)

    def _value(self, channel: int, payload: bytes) -> bytes | None:
        number = number_in(payload)
        if number is None:
            return None
        if number >= len(self._parameters):
            return payload[:2] + _NO_SUCH_ENTRY
        parameter = self._parameters[number]
        if channel == READ_CHANNEL:
            return payload[:2] + b"\0" + struct.pack("<" + parameter.kind, self._values[parameter.name])
        if channel != WRITE_CHANNEL or parameter.read_only or not self._set(parameter, payload[2:]):
            return None
        return payload

    def _set(self, parameter: FirmwareParameter, value: bytes) -> bool:
        layout = struct.Struct("<" + parameter.kind)
        if len(value) < layout.size:
            return False
        self._values[parameter.name] = layout.unpack_from(value)[0]
        return True

    def _misc(self, payload: bytes) -> bytes | None:
        if payload[:1] == bytes([_SET_BY_NAME]):
            return self._set_by_name(payload)
        number = number_in(payload[1:])
        if number is None:
            return None
        known = number < len(self._parameters)
        answer = self._answer_misc(payload[0], self._parameters[number]) if known else _NO_SUCH_ENTRY
        return None if answer is None else payload[:3] + answer

    def _answer_misc(self, command: int, parameter: FirmwareParameter) -> bytes | None:
        """Return what follows a parameter's number in the answer, None for no answer."""
        status = b"\0" if command in _WITH_STATUS else b""
        if command in (_EXTENDED_TYPE, _EXTENDED_TYPE_V2):
            return status + bytes([_PERSISTENT]) if parameter.persistent else _NO_SUCH_ENTRY
        if command in (_DEFAULT, _DEFAULT_V2):
            return _NO_SUCH_ENTRY if parameter.read_only else status + parameter.packed
        if command == _STATE:
            return _NOT_STORED + parameter.packed
        return b"\0" if command in (_STORE, _CLEAR) else None

    def _set_by_name(self, payload: bytes) -> bytes | None:
        """Set the parameter of a group and a name, each ending in a zero byte, if the type given is its own."""
        group, ends, rest = payload[1:].partition(b"\0")
        name, ends_too, rest = rest.partition(b"\0")
        if not (ends and ends_too):
            return None
        full_name = (group + b"." + name).decode(errors="replace")
        found = next((parameter for parameter in self._parameters if parameter.name == full_name), None)
        error = errno.ENOENT
        if found is not None:
            same = rest[:1] == bytes([_CODES[found.kind]])
            error = errno.EINVAL
            if same:
                error = errno.EACCES if found.read_only else 0 if self._set(found, rest[1:]) else errno.EINVAL
        return payload[: len(payload) - len(rest)] + bytes([error])


def _code(parameter: FirmwareParameter) -> int:
    flags = _HAS_EXTENDED_TYPE * parameter.persistent | _CORE * parameter.core | _READ_ONLY * parameter.read_only
    return _CODES[parameter.kind] | flags
