"""The vehicle's parameters, as its parameter port tells and sets them."""

import errno
import struct
from collections.abc import Sequence
from typing import NamedTuple

from cfid.sim.crazyflie_toc import TOC_CHANNEL, Entry, Toc, number_in
from cfid.wire.crtp import READ_CHANNEL, WRITE_CHANNEL

_MISC_CHANNEL = 3
_SET_BY_NAME = 0
_EXTENDED_TYPE, _EXTENDED_TYPE_V2 = 2, 7  # the second has an error byte before the type
_PERSISTENT = 1
_NO_SUCH_ENTRY = bytes([errno.ENOENT])

_CODES = {"b": 0, "h": 1, "i": 2, "f": 6, "B": 8, "H": 9, "I": 10}
_HAS_EXTENDED_TYPE, _READ_ONLY = 0x10, 0x40


class Parameter(NamedTuple):
    """A name, a type as a letter of Python's struct, and the value after a start."""

    name: str
    kind: str
    value: float
    read_only: bool = False
    persistent: bool = False


class Parameters:
    """Values by name, and what the port answers."""

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        """Begin with the values after a start."""
        self._parameters = parameters
        self._values = {parameter.name: parameter.value for parameter in parameters}
        self._toc = Toc([Entry(parameter.name, _code(parameter)) for parameter in parameters])

    def __getitem__(self, name: str) -> float:
        """Return the value that is set."""
        return self._values[name]

    def answer(self, channel: int, payload: bytes) -> bytes | None:
        """Return what comes back on the same channel, None for nothing."""
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
        value = struct.Struct("<" + parameter.kind)
        if channel == READ_CHANNEL:
            return payload[:2] + b"\0" + value.pack(self._values[parameter.name])
        if channel != WRITE_CHANNEL or parameter.read_only or len(payload) < 2 + value.size:
            return None
        self._values[parameter.name] = value.unpack_from(payload, 2)[0]
        return payload

    def _set_by_name(self, payload: bytes) -> bytes | None:
        """Return the request with an error number in the place of type and value; nothing where names do not end."""
        _, _, names = payload.partition(bytes([_SET_BY_NAME]))
        group, _, names = names.partition(b"\0")
        name, _, rest = names.partition(b"\0")
        if not rest:
            return None
        complete = f"{group.decode(errors='replace')}.{name.decode(errors='replace')}"
        parameter = next((there for there in self._parameters if there.name == complete), None)
        error = errno.ENOENT
        if parameter is not None:
            value = struct.Struct("<" + parameter.kind)
            error = errno.EINVAL if rest[0] != _CODES[parameter.kind] else errno.EACCES if parameter.read_only else 0
            if not error:
                self._values[complete] = value.unpack_from(rest.ljust(1 + value.size, b"\0"), 1)[0]
        return payload[: 3 + len(group) + len(name)] + bytes([error])

    def _misc(self, payload: bytes) -> bytes | None:
        if payload[:1] == bytes([_SET_BY_NAME]):
            return self._set_by_name(payload)
        number = number_in(payload[1:])
        if number is None or payload[0] not in (_EXTENDED_TYPE, _EXTENDED_TYPE_V2):
            return None
        if number >= len(self._parameters):
            return payload[:3] + _NO_SUCH_ENTRY
        error = b"\0" if payload[0] == _EXTENDED_TYPE_V2 else b""
        return payload[:3] + error + bytes([_PERSISTENT * self._parameters[number].persistent])


def _code(parameter: Parameter) -> int:
    return _CODES[parameter.kind] | _HAS_EXTENDED_TYPE * parameter.persistent | _READ_ONLY * parameter.read_only
