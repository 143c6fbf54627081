"""Encodes and decodes ATI's RDT protocol over UDP port 49152: requests, and records of 36 bytes, both big-endian.

`rdt_order` finds the order of records and what is missing, `rdt_status` interprets status words.
"""

from enum import IntEnum
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from cfid.wire.layout import Layout

RECORD_BYTES = 36
LONGEST_BUFFER = 40  # records in one datagram
INTERNAL_HZ = 7000  # what a Net F/T counts in ft_sequence, whatever rate it sends at


# A record: its numbers since the request and since power-up, its status, and Fx to Tz in counts.
RECORD = np.dtype(
    [("rdt_sequence", np.uint32), ("ft_sequence", np.uint32), ("status", np.uint32), ("counts", np.int32, 6)]
)
Records: TypeAlias = npt.NDArray[np.void]  # n of them
_SENT = RECORD.newbyteorder(">")


class Command(IntEnum):
    """Commands of a request; each replaces the previous one."""

    STOP = 0
    REAL_TIME = 2
    BUFFERED = 3
    MULTI_UNIT = 4
    RESET_THRESHOLD = 0x41
    BIAS = 0x42


class Request(NamedTuple):
    """A command and the number of records it requests, 0 for an endless stream."""

    command: int
    records: int = 0


_REQUEST = Layout(">HHI", Request, mark=(0x1234,))

decode_request = _REQUEST.decode


def encode_request(request: Request) -> bytes:
    """Return a request's 8 bytes."""
    return _REQUEST.encode(*request)


def is_block(size: int) -> bool:
    """Return whether a datagram of this size in bytes can be a block of records."""
    return 0 < size <= LONGEST_BUFFER * RECORD_BYTES and size % RECORD_BYTES == 0


def encode_records(records: Records) -> bytes:
    """Return the bytes of n records."""
    return records.astype(_SENT).tobytes()


def decode_records(data: bytes | bytearray | memoryview) -> Records:
    """Return the records of one or several datagrams laid end to end.

    Raises ValueError when they are not whole records, which `is_block` checks beforehand.
    """
    return np.frombuffer(data, _SENT).astype(RECORD)
