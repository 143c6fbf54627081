"""Logs of the uSD-card deck as the firmware's writer composes them, byte by byte."""

import struct
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

Event = tuple[int, str, Sequence[str]]
Record = tuple[int, int, Sequence[float]]
FIXED: Event = (65535, "fixedFrequency", ("gyro.x(f)", "motor.m1(I)", "pm.state(b)", "acc.z(f)"))
POSE: Event = (3, "estPosition", ("source(B)", "x(e)", "count(H)", "low(h)", "wide(i)"))


def bytes_of(events: Sequence[Event], records: Iterable[Record], *, version: int = 2) -> bytes:
    """Return the bytes of a log as the firmware's writer composes it."""
    header = struct.pack("<BHH", 0xBC, version, len(events))
    letters = {}
    for number, name, variables in events:
        letters[number] = "".join(variable[-2] for variable in variables)
        header += struct.pack("<H", number) + name.encode() + b"\0" + struct.pack("<H", len(variables))
        header += b"".join(variable.encode() + b"\0" for variable in variables)
    stamp = "I" if version == 1 else "Q"
    body = b"".join(struct.pack(f"<H{stamp}{letters[event]}", event, at, *values) for event, at, values in records)
    return header + body + struct.pack("<I", zlib.crc32(header + body))


def written(folder: Path, content: bytes) -> Path:
    (folder / "LOG00.BIN").write_bytes(content)
    return folder / "LOG00.BIN"


def rows(count: int, step: int = 1000) -> list[Record]:
    return [(65535, 5_000_000 + step * at, (at / 8, 60 * at, at % 100 - 50, -1.5)) for at in range(count)]


def single(count: int = 100, **changes: Any) -> bytes:
    return bytes_of([FIXED], rows(count), **changes)
