"""Read the binary logs of the Crazyflie's uSD-card deck, in all three releases of their format.

Version 1 (2021) and 2 (since): a header names event types and their variables with Python's struct letters; records of
event id, stamp and values follow; a CRC32 of everything before it ends the file. Before 2021 there was one event: names
between commas, then sets of up to 255 records, a CRC32 after each. All numbers are little-endian.
"""

import mmap
import re
import struct
import zlib
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding
from cfid.large import empty
from cfid.recordings.crazyflie import CLOCK_RATES, crazyflie_unit, printable
from cfid.recordings.recording import Clock, Column, Facts, How, Recording, Series
from cfid.records.files import sha256_of
from cfid.records.parameters import Source

MAGIC = 0xBC
OLD_BEGIN = re.compile(rb".tick\(I\),", re.DOTALL)

_CRC_BYTES = 4
_LETTERS = "BbHhIiQqefd"  # of numbers, of the same size in numpy as in Python's struct
_LONGEST_NAME = 200  # bytes; where a name does not end within them, the header is damaged
_PART_ROWS = 1 << 16
_FIXED_FREQUENCY = "fixedFrequency"  # the event whose rows the scheduler triggers

# The timer of a Crazyflie 2.x runs at 84/85 of real time with firmware up to 2026.08. The firmware logs the rows of a
# fixed frequency f, a whole number of Hz, every floor(1000/f) ms of other clocks, the scheduler's or the gyro's. These
# periods differ by more than 1/85 from each other, but for the shortest ones, which differ by whole milliseconds.
# Below 20 Hz, 1000/f that is not rounded down is a period as well: 66.7 ms of the slow clock look like 66 true ones.
_MOST_ROWS = 1 << 18  # enough to identify a clock
_FEWEST_ROWS = 50  # of 1 ms: one that is late by 1 ms changes the interval by 0.24 %
_CLOSE = 4e-3  # of the interval: a gyro's rate is off by 2e-3 in public logs, the slow timer by 1.2e-2
_PERIODS_MS = np.unique(np.concatenate([1000 // np.arange(1, 1001), 1000 / np.arange(1, 20)]))
Stamps = npt.NDArray[np.uint64]
Offsets = npt.NDArray[np.int64]


@dataclass(frozen=True)
class _Event:
    """An event type: its name, its variables, and the layout of a record, with its stamp and the values by number."""

    name: str
    variables: tuple[str, ...]
    record: np.dtype[np.void]


@dataclass(frozen=True)
class _Content:
    """Events by their ids, where the records of each begin, how many stamps are a second, and findings on damage."""

    version: str
    per_s: float
    events: dict[int, _Event]
    offsets: dict[int, Offsets]
    findings: tuple[Finding, ...]


def is_usd(begin: bytes) -> bool:
    """Return whether the first bytes of a file are those of a uSD-card log."""
    return begin[:1] == bytes([MAGIC]) or OLD_BEGIN.match(begin) is not None


def read_usd(path: Path, how: How | None = None) -> Recording:
    """Read a log. From a cut or damaged one, read the whole records before the fault, which a finding names.

    Where rows do not show which clock stamped them, `facts.clock` is "unknown". Raises ConfigError for `clock` where
    the log is in milliseconds, DataError for a damaged header and for a log without a whole record.
    """
    how = how or How()
    how.refuse_unused(path, "clock", "props_out")
    with path.open("rb") as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)  # a large file stays on the disk
    content = _records(path, data) if data[0] == MAGIC else _sets(path, data)
    offsets, damage = _in_order(path, data, content)
    if not any(map(len, offsets.values())):
        faults = " ".join(one.sentence for one in (*content.findings, *damage))
        raise DataError(f"{path}: a uSD-card log without one whole record. {faults}".rstrip())
    per_s, judged = content.per_s, tuple[Finding, ...]()
    clock: Clock = "true"
    if per_s == 1e6:
        per_s, clock, judged = _microseconds(path, _stamps_of_fixed_rate(data, content, offsets), how)
    elif how.clock is not None:
        raise ConfigError(f"{path}: `clock` is for logs in microseconds: these are milliseconds of the scheduler.")
    series = {
        event.name: _series(path, data, event, offsets[number], per_s)
        for number, event in content.events.items()
        if len(offsets[number])
    }
    return Recording(
        path=path,
        source=Source(str(path), sha256_of(path)),
        facts=Facts(program=f"Crazyflie uSD-card log, {content.version}", clock=clock, props_out=how.props_out),
        series=series,
        findings=tuple(one.at(path.name) for one in (*content.findings, *damage, *judged)),
    )


def _records(path: Path, data: mmap.mmap) -> _Content:
    """Return the content of version 1 or 2: records of several events, and one CRC32 at the end of the file."""
    if len(data) < 5:
        raise DataError(f"{path}: a uSD-card log that was cut after {len(data)} bytes, in its header.")
    version, count = struct.unpack_from("<HH", data, 1)
    if version not in (1, 2):
        raise DataError(f"{path}: a uSD-card log of version {version}; versions 1 and 2 are known.")
    head = [("id", "<u2"), ("stamp", "<u4" if version == 1 else "<u8")]
    events: dict[int, _Event] = {}
    place = 5
    try:
        for _ in range(count):
            (number,) = struct.unpack_from("<H", data, place)
            name, place = _text(data, place + 2)
            (variables,) = struct.unpack_from("<H", data, place)
            place += 2
            words = []
            for _ in range(variables):
                word, place = _text(data, place)
                words.append(word)
            if number in events:
                raise ValueError(f"two event types have the id {number}")
            events[number] = _event(name, words, head)
    except (ValueError, struct.error) as fault:
        raise DataError(f"{path}: the header of this uSD-card log is cut or damaged: {fault}.") from None
    if not events:
        raise DataError(f"{path}: a uSD-card log without event types: nothing was configured to be logged.")
    end = len(data) - _CRC_BYTES
    whole = end >= place and _is_checksum(data, 0, end)
    offsets, end = _walked(data, events, place, end if whole else len(data))
    rows = sum(map(len, offsets.values()))
    findings: tuple[Finding, ...] = ()
    if len(data) - end != _CRC_BYTES and _is_checksum(data, 0, end):
        findings = (finding("log-bytes-behind", rows=rows, end=end + _CRC_BYTES, size=len(data)),)
    elif not whole or end + _CRC_BYTES < len(data):
        if end + 2 <= len(data) - _CRC_BYTES and int.from_bytes(data[end : end + 2], "little") not in events:
            last = max(offsets, key=lambda one: offsets[one][-1] if len(offsets[one]) else -1)
            offsets[last] = offsets[last][:-1]  # bytes may be lost in the record before an unknown one
            rows = max(rows - 1, 0)
        findings = (finding("log-damaged", rows=rows, end=end, size=len(data)),)
    return _Content(f"version {version}", 1e3 if version == 1 else 1e6, events, offsets, findings)


def _sets(path: Path, data: mmap.mmap) -> _Content:
    """Return the content of the format before 2021: records of one event in sets that have a CRC32 each."""
    words, place = [], 1
    try:
        for _ in range(data[0]):
            end = data.find(b",", place, place + _LONGEST_NAME)
            if end < 0:
                raise ValueError(f"no end of the name at byte {place}")
            words.append(printable(data[place:end].decode("ascii", "replace"), _LONGEST_NAME))
            place = end + 1
        event = _event("log", words[1:], [("stamp", "<u4")])
    except ValueError as fault:
        raise DataError(f"{path}: the header of this uSD-card log is cut or damaged: {fault}.") from None
    if not _is_checksum(data, 0, place):
        raise DataError(f"{path}: the header of this uSD-card log is cut or damaged: its CRC32 does not match.")
    place += _CRC_BYTES
    size, offsets = event.record.itemsize, array("q")
    while place < len(data):
        end = place + 1 + data[place] * size
        if end + _CRC_BYTES > len(data) or not _is_checksum(data, place, end):
            break
        offsets.extend(range(place + 1, end, size))
        place = end + _CRC_BYTES
    damage = (finding("log-damaged", rows=len(offsets), end=place, size=len(data)),) if place < len(data) else ()
    return _Content("before version 1", 1e3, {0: event}, {0: np.array(offsets, np.int64)}, damage)


def _text(data: mmap.mmap, begin: int) -> tuple[str, int]:
    end = data.find(b"\0", begin, begin + _LONGEST_NAME)
    if end < 0:
        raise ValueError(f"no end of the name at byte {begin}")
    return printable(data[begin:end].decode("ascii", "replace"), _LONGEST_NAME), end + 1


def _event(name: str, words: Sequence[str], head: Sequence[tuple[str, str]]) -> _Event:
    """Return an event of variables such as `gyro.x(f)`; a second one of the same name gets a number."""
    names: list[str] = []
    layout = list(head)
    for place, word in enumerate(words, start=1):
        letter = word[-2:-1]
        if not letter or word[-3:] != f"({letter})" or letter not in _LETTERS:
            raise ValueError(f"'{word}' is no variable with its type")
        names.append(f"{word[:-3]}_{place}" if word[:-3] in names else word[:-3])
        layout.append((str(place), f"<{letter}"))
    return _Event(name, tuple(names), np.dtype(layout))


def _walked(data: mmap.mmap, events: dict[int, _Event], place: int, end: int) -> tuple[dict[int, Offsets], int]:
    """Return where the records of each event begin, and where the walk from record to record ends."""
    sizes = {number: event.record.itemsize for number, event in events.items()}
    offsets = {number: array("q") for number in events}
    while place + 2 <= end:
        number = data[place] | data[place + 1] << 8
        size = sizes.get(number)
        if size is None or place + size > end:
            break
        offsets[number].append(place)
        place += size
    return {number: np.array(places, np.int64) for number, places in offsets.items()}, place


def _is_checksum(data: mmap.mmap, begin: int, end: int) -> bool:
    """Return whether the CRC32 of the bytes between two places follows them."""
    crc = zlib.crc32(memoryview(data)[begin:end])
    return crc == int.from_bytes(data[end : end + _CRC_BYTES], "little") and end + _CRC_BYTES <= len(data)


def _in_order(path: Path, data: mmap.mmap, content: _Content) -> tuple[dict[int, Offsets], tuple[Finding, ...]]:
    """Return the records before the first one, of any event, whose stamp is damaged or of another recording."""
    stop, damage = len(data), tuple[Finding, ...]()
    for number, event in content.events.items():
        offsets = content.offsets[number]
        stamps = _stamps(data, event, offsets)
        back = np.flatnonzero(stamps[1:] < stamps[:-1])
        if not len(back):
            continue
        at = int(back[0])
        # A stamp that jumps ahead is the damaged one where the next one follows the one before it.
        first = at if at and stamps[at + 1] >= stamps[at - 1] else at + 1
        if offsets[first] < stop:
            stop = int(offsets[first])
            damage = (finding("log-time-back", event=event.name, row=first + 1, rows=len(offsets), end=stop),)
    return {
        number: offsets[: int(np.searchsorted(offsets, stop))] for number, offsets in content.offsets.items()
    }, damage


def _stamps(data: mmap.mmap, event: _Event, offsets: Offsets) -> Stamps:
    """Return the stamps (n,) of records."""
    stamps = np.empty(len(offsets), np.uint64)
    for part, rows in _parts(data, event, offsets):
        stamps[part] = rows["stamp"]
    return stamps


def _parts(data: mmap.mmap, event: _Event, offsets: Offsets) -> Iterator[tuple[slice, npt.NDArray[np.void]]]:
    """Yield the records (m,) that begin at offsets (n,), part by part."""
    view, size = np.frombuffer(data, np.uint8), event.record.itemsize
    for at in range(0, len(offsets), _PART_ROWS):
        part = slice(at, at + _PART_ROWS)
        yield part, view[offsets[part, np.newaxis] + np.arange(size)].view(event.record)[:, 0]


def _stamps_of_fixed_rate(data: mmap.mmap, content: _Content, offsets: dict[int, Offsets]) -> Stamps:
    fixed = (number for number, event in content.events.items() if event.name == _FIXED_FREQUENCY)
    number = next(fixed, None)
    if number is None:
        return np.zeros(0, np.uint64)
    return _stamps(data, content.events[number], offsets[number][:_MOST_ROWS])


def _series(path: Path, data: mmap.mmap, event: _Event, offsets: Offsets, per_s: float) -> Series:
    columns = empty(1 + len(event.variables), len(offsets))
    names = ["stamp", *(str(1 + at) for at in range(len(event.variables)))]
    for part, rows in _parts(data, event, offsets):
        with np.errstate(invalid="ignore"):  # damaged floats that are signalling NaN become quiet ones
            for column, name in zip(columns, names, strict=True):
                column[part] = rows[name]
    begin = float(columns[0][0])
    return Series(
        name=event.name,
        path=path,
        columns=tuple(
            Column(name=name, unit=crazyflie_unit(name), values=values)
            for name, values in zip(event.variables, columns[1:], strict=True)
        ),
        rows=len(offsets),
        time_s=(columns[0] - begin) / per_s,  # a product with 1e-6 would not be exact
        begin_s=begin / per_s,
    )


def _microseconds(path: Path, stamps: Stamps, how: How) -> tuple[float, Clock, tuple[Finding, ...]]:
    """Return how many microseconds of a log are a second, its clock, and a finding on how that is known.

    It is as given, or as the stamps (n,) of the rows of a fixed frequency show; "unknown" where they fit neither clock,
    or both.
    """
    if how.clock is not None:
        stated = finding("log-clock", clock=how.clock, why="as `clock` states")
        return 1e6 * CLOCK_RATES[how.clock], how.clock, (stated,)
    interval_ms = _interval_ms((stamps - stamps[:1]).astype(np.float64) * 1e-3)
    fitting = {
        clock: period_ms
        for clock, rate in CLOCK_RATES.items()
        for period_ms in _PERIODS_MS[np.abs(interval_ms / rate / _PERIODS_MS - 1) < _CLOSE]
    }
    if len(fitting) != 1:
        return 1e6, "unknown", (finding("log-clock-unknown"),)
    clock: Clock = "true" if "true" in fitting else "84/85"
    period_ms = fitting[clock]
    why = f"rows of {period_ms:.4g} ms lie {interval_ms:.3f} ms apart by them"
    return 1e6 * CLOCK_RATES[clock], clock, (finding("log-clock", clock=clock, why=why),)


def _interval_ms(time_ms: npt.NDArray[np.float64]) -> float:
    """Return the interval of rows at times (n,), of which some may be missing, NaN where there are too few."""
    steps = np.diff(time_ms)
    usual = float(np.median(steps)) if len(time_ms) >= _FEWEST_ROWS else 0.0
    if usual <= 0:
        return np.nan
    place = np.concatenate([[0.0], np.cumsum(np.rint(steps / usual))])
    return float(np.polyfit(place, time_ms, 1)[0]) if np.ptp(place) > 0 else np.nan
