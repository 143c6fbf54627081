"""Encodes and decodes payloads whose fields always have the same places."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Record = TypeVar("Record")


@dataclass(frozen=True)
class Layout(Generic[Record]):
    """The fields of a payload in the notation of `struct`, the record that they make, and the values of the first."""

    format: str
    record: Callable[..., Record]
    mark: tuple[int | bytes, ...] = ()

    def encode(self, *fields: Any) -> bytes:
        """Return the payload of the fields after the mark. Raises struct.error for a value that a field cannot hold."""
        return struct.pack(self.format, *self.mark, *fields)

    def decode(self, payload: bytes) -> Record | None:
        """Return the record in a payload, or None for one of another length or with another mark."""
        if len(payload) != struct.calcsize(self.format):
            return None
        fields = struct.unpack(self.format, payload)
        marks = len(self.mark)
        return self.record(*fields[marks:]) if fields[:marks] == self.mark else None
