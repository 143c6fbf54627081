"""Read the binary logs of the Crazyflie's uSD-card deck, versions 1 and 2.

A header names event types and their variables with Python's struct letters; records of event id, stamp and values
follow; a CRC32 of everything before it ends the file. All numbers are little-endian.
"""

import mmap
import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.large import stored_together
from cfid.records.logs.crazyflie_names import assumptions, crazyflie_channel
from cfid.records.logs.log import BLOCK_ROWS, Array, FlightLog, Series, printable
from cfid.records.logs.usd_clock import FIXED_FREQUENCY, MOST_ROWS, Clock, microsecond_clock
from cfid.records.parameters import Source

Bytes = npt.NDArray[np.uint8]

MAGIC = 0xBC

_BEGIN_BYTES = 5  # magic, version, number of events
_CRC_BYTES = 4
_LETTERS = "BbHhIiQqefd"  # of numbers, of the same size in numpy as in Python's struct
_AFTER = 3  # records whose stamps stay earlier; a single one is damaged
_LONGEST_NAME = 200  # bytes; where a name does not end within them, the header is damaged
_UNDECIDED = (
    "the log does not show whether its microseconds are true or run at 84/85 of real time, as on a Crazyflie 2.x with "
    "firmware up to 2026.08, which makes an inertia 2.4 % wrong: give `clock` true or 84/85."
)


class _Version(NamedTuple):
    stamp: str  # of a record, in numpy's notation
    per_s: float
    clock: str


_VERSIONS = {
    1: _Version("<u4", 1e3, "times are milliseconds of the vehicle's scheduler"),
    2: _Version("<u8", 1e6, ""),  # the log shows how many of these are a second
}


@dataclass(frozen=True)
class _Event:
    name: str
    names: tuple[str, ...]
    record: np.dtype[np.void]  # id, stamp, then the values under numbers


class _Records(NamedTuple):
    """Where the whole records of each event begin, where reading ended, and why, "" for the end of the file.

    `checked` is whether the checksum of everything before that place follows: the file then continues after a whole
    log.
    """

    offsets: dict[int, npt.NDArray[np.int64]]
    end: int
    fault: str
    checked: bool


def read_usd(path: Path, source: Source, clock: Clock | None = None) -> FlightLog:
    """Read a log. From a cut or damaged one, read the whole records before the fault, which is noted.

    `clock` states how the log's microseconds relate to real time, instead of what the log shows. Raises ConfigError for
    it where the log is in milliseconds, and without it where the log does not show it; DataError for another file, a
    damaged header, and a log without a whole record.
    """
    with path.open("rb") as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)  # a large file stays on the disk
    version, events, begin = _header(path, data)
    if clock is not None and version.clock:
        raise ConfigError(f"{path}: `clock` is for logs in microseconds: {version.clock}.")
    end = len(data) - _CRC_BYTES
    whole = end >= begin and _is_checksum(data, end)
    found = _records(data, events, begin, end if whole else len(data), whole=whole)
    notes = _faults(found, len(data), whole=whole)
    stop, wrong = min((_first_damage(data, event, found.offsets[number]) for number, event in events.items()))
    notes += (wrong,) if wrong else ()
    if not any(len(_before(offsets, stop)) for offsets in found.offsets.values()):
        raise DataError(" ".join([f"{path}: a uSD-card log without one whole record.", *notes]))
    fixed = next((number for number, event in events.items() if event.name == FIXED_FREQUENCY), None)
    if not version.clock:
        offsets = np.zeros(0, np.int64) if fixed is None else found.offsets[fixed]
        stamps = _stamps(data, next(iter(events.values())), _before(offsets, stop)[:MOST_ROWS])
        decided = microsecond_clock(stamps, clock)
        if decided is None:
            raise ConfigError(f"{path}: {_UNDECIDED}")
        version = version._replace(per_s=decided.per_s, clock=decided.text)
    series = []
    for number, event in events.items():
        offsets = _before(found.offsets[number], stop)
        if len(offsets):
            names, doubled = _distinct(event.names)
            notes += tuple(f"{event.name}: {text}" for text in doubled)
            channels = tuple(map(crazyflie_channel, names))
            blocks = partial(_blocks, data, event, offsets, version.per_s)
            series.append(Series(name=event.name, rows=len(offsets), channels=channels, blocks=blocks))
    empty = [event.name for number, event in events.items() if not len(found.offsets[number])]
    return FlightLog(
        path=path,
        source=source,
        program=f"Crazyflie uSD-card log, version {data[1]}",
        clock=version.clock,
        series=tuple(series),
        assumed=assumptions(tuple(channel for one in series for channel in one.channels)),
        notes=(*notes, *((f"no record of {', '.join(empty)}.",) if empty else ())),
    )


def _distinct(names: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Return distinct names, and a sentence for each name that was repeated."""
    found: list[str] = []
    notes = []
    for place, name in enumerate(names, start=1):
        own, number = name, 2
        while own in found or (own != name and own in names):
            own, number = f"{name}_{number}", number + 1
        if own != name:
            notes.append(f"variable {place} is named {name} again: it is read as {own}.")
        found.append(own)
    return found, notes


def _header(path: Path, data: mmap.mmap) -> tuple[_Version, dict[int, _Event], int]:
    """Return the version, the events by their ids, and where the records begin."""
    if len(data) < _BEGIN_BYTES:
        raise DataError(f"{path}: a uSD-card log that was cut after {len(data)} bytes, in its header.")
    number, count = struct.unpack_from("<HH", data, 1)
    if number not in _VERSIONS:
        raise DataError(f"{path}: a uSD-card log of version {number}; versions 1 and 2 are known.")
    events: dict[int, _Event] = {}
    place = _BEGIN_BYTES
    try:
        for _ in range(count):
            (event,) = struct.unpack_from("<H", data, place)
            name, place = _text(data, place + 2)
            (variables,) = struct.unpack_from("<H", data, place)
            place += 2
            words = []
            for _ in range(variables):
                word, place = _text(data, place)
                words.append(word)
            if event in events:
                raise ValueError(f"two event types have the id {event}")
            events[event] = _event(name, words, _VERSIONS[number])
    except (ValueError, struct.error) as fault:
        raise DataError(f"{path}: the header of this uSD-card log is cut or damaged: {fault}.") from None
    if not events:
        raise DataError(f"{path}: a uSD-card log without event types: nothing was configured to be logged.")
    return _VERSIONS[number], events, place


def _text(data: mmap.mmap, begin: int) -> tuple[str, int]:
    end = data.find(b"\0", begin, begin + _LONGEST_NAME)
    if end < 0:
        raise ValueError(f"no end of the name at byte {begin}")
    return printable(data[begin:end].decode("ascii", "replace"), _LONGEST_NAME), end + 1


def _event(name: str, words: list[str], version: _Version) -> _Event:
    kinds = []
    for word in words:
        letter = word[-2:-1]
        if not letter or word[-3:] != f"({letter})" or letter not in _LETTERS:
            raise ValueError(f"'{word}' is no variable with its type")
        kinds.append(f"<{letter}")
    fields = [("id", "<u2"), ("stamp", version.stamp), *((str(at), kind) for at, kind in enumerate(kinds))]
    return _Event(name, tuple(word[:-3] for word in words), np.dtype(fields))


def _records(data: mmap.mmap, events: dict[int, _Event], begin: int, end: int, *, whole: bool) -> _Records:
    """Walk from record to record; stop at an unknown event, or where the last one is not whole.

    A file whose checksum fails may have lost bytes in the record before an unknown event: that record is left out.
    """
    sizes = {number: event.record.itemsize for number, event in events.items()}
    offsets = {number: array("q") for number in events}
    place, last, fault, checked = begin, -1, "", False
    while place + 2 <= end:
        number = data[place] | data[place + 1] << 8
        size = sizes.get(number)
        if size is None:
            fault = f"no event has the id {number}"
            checked = not whole and end - place > _CRC_BYTES and _is_checksum(data, place)
            if not whole and not checked and last in offsets and end - place > _CRC_BYTES:
                offsets[last].pop()
            break
        if place + size > end:
            fault = "the last record is not whole"
            break
        offsets[number].append(place)
        place, last = place + size, number
    places = [np.frombuffer(each, np.int64) if each else np.zeros(0, np.int64) for each in offsets.values()]
    return _Records(dict(zip(offsets, stored_together(places), strict=True)), place, fault, checked)


def _is_checksum(data: mmap.mmap, place: int) -> bool:
    """Return whether the CRC32 of everything before a place is stored there."""
    crc = zlib.crc32(memoryview(data)[:place])
    return crc == int.from_bytes(data[place : place + _CRC_BYTES], "little")


def _faults(found: _Records, size: int, *, whole: bool) -> tuple[str, ...]:
    if whole and not found.fault:
        return ()
    rows = sum(map(len, found.offsets.values()))
    if whole:
        return (
            f"{found.fault} at byte {found.end} of {size}: "
            f"{counted(rows, 'record before it is', 'records before it are')} used.",
        )
    left = size - found.end
    if found.checked:
        return (
            f"a whole log of {counted(rows, 'record')}, whose CRC32 matches, ends at byte {found.end + _CRC_BYTES} of "
            f"{size}: what is behind it is not used.",
        )
    if left == _CRC_BYTES:
        return (f"its CRC32 does not match: bytes are damaged, or the file was cut. It has {rows} whole records.",)
    if found.fault.startswith("no event") and left > _CRC_BYTES:
        return (
            f"its CRC32 does not match, and {found.fault} at byte {found.end} of {size}: the {rows} records before "
            "the last one there are used.",
        )
    return (
        f"the file was cut, without its CRC32: the {rows} whole records are used, {left} bytes after them are not.",
    )


def _first_damage(data: mmap.mmap, event: _Event, offsets: npt.NDArray[np.int64]) -> tuple[int, str]:
    """Return where an event's first record with an impossible stamp begins, the file's size for none, and a note.

    Stamps that stay earlier are another recording's, of which nothing is used: its rows would mix with the first's.
    """
    stamps = _stamps(data, event, offsets)
    back = np.flatnonzero(stamps[1:] < stamps[:-1])
    if not len(back):
        return len(data), ""
    at = int(back[0])
    after = stamps[at + 1 : at + 1 + _AFTER]
    if len(after) == _AFTER and np.all(after < stamps[max(at - 1, 0)]):
        return int(offsets[at + 1]), (
            f"{event.name}: time goes back from stamp {stamps[at]} to {after[0]} at record {at + 2} of {len(offsets)}: "
            f"the clock was set, or two recordings are in one file. Reading stops there, at byte {offsets[at + 1]} of "
            f"{len(data)}; the {len(offsets) - at - 1} records from there on are not used."
        )
    # A stamp that jumps ahead is the damaged one where the next one follows the one before it.
    first = at if at and stamps[at + 1] >= stamps[at - 1] else at + 1
    return int(offsets[first]), (
        f"{event.name}: the stamp of record {first + 1} of {len(offsets)} is damaged: reading stops there, at byte "
        f"{offsets[first]} of {len(data)}."
    )


def _before(offsets: npt.NDArray[np.int64], stop: int) -> npt.NDArray[np.int64]:
    return offsets[: int(np.searchsorted(offsets, stop))]


def _stamps(data: mmap.mmap, event: _Event, offsets: npt.NDArray[np.int64]) -> npt.NDArray[np.uint64]:
    """Return the stamps (n,) of records."""
    stamp = event.record["stamp"]
    parts = [offsets[at : at + BLOCK_ROWS] for at in range(0, len(offsets), BLOCK_ROWS)]
    each = (_gathered(data, part + 2, stamp.itemsize).view(stamp)[:, 0] for part in parts)
    return np.concatenate([np.zeros(0, np.uint64), *each])


def _blocks(data: mmap.mmap, event: _Event, offsets: npt.NDArray[np.int64], per_s: float) -> Iterator[Array]:
    for begin in range(0, len(offsets), BLOCK_ROWS):
        part = offsets[begin : begin + BLOCK_ROWS]
        rows = _gathered(data, part, event.record.itemsize).view(event.record)[:, 0]
        block = np.empty((len(rows), 1 + len(event.names)))
        block[:, 0] = rows["stamp"] / per_s  # a product with 1e-6 would not be exact
        with np.errstate(invalid="ignore"):  # damaged floats that are signalling NaN become quiet ones
            for at in range(len(event.names)):
                block[:, 1 + at] = rows[str(at)]
        yield block


def _gathered(data: mmap.mmap, offsets: npt.NDArray[np.int64], size: int) -> Bytes:
    """Return the bytes (n, size) from each offset on."""
    found: Bytes = np.frombuffer(data, np.uint8)[offsets[:, None] + np.arange(size)]
    return found
