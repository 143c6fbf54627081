"""Records hand-held instruments, a UT372 tachometer and scales, and typed readings; opens no port itself."""

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import numpy as np

from cfid.counted import counted
from cfid.errors import DeviceError
from cfid.rig.clock import HostClock
from cfid.rig.listening import Listen, Port
from cfid.rig.recorder import Block, no_rows
from cfid.wire import ut372
from cfid.wire.scales import ScalesReader

_SILENT_S = 10.0
_SHOWN_BYTES = 30  # of unreadable data: a packet of the tachometer, or a line of scales


class _Rows:
    """Collects rows until they are taken."""

    def __init__(self, columns: int, clock: HostClock) -> None:
        self._columns, self._clock = columns, clock
        self._rows: list[tuple[float, ...]] = []

    def add(self, now_s: float, *values: float) -> None:
        self._rows.append((now_s, *values))

    def take(self) -> Block:
        rows, self._rows = self._rows, []
        if not rows:
            return Block(no_rows(self._columns))
        times_s, *values = (np.array(column) for column in zip(*rows, strict=True))
        return Block((self._clock.unix_s(times_s), *values))


class Readings:
    """Readings that the operator types at a motor command; `t` is when a reading was typed.

    A row with `withdrawn` 1 repeats the row that it withdraws, which is already on disk. `whole` is set once all
    requested readings are there, and the run may end.
    """

    def __init__(self, name: str, value_name: str, *, loop: Any, clock: HostClock) -> None:
        """Take the names of the file and of its last column."""
        self.name, self.columns = name, ("t", "command", value_name, "withdrawn")
        self._loop, self._rows = loop, _Rows(4, clock)
        self._kept: list[tuple[int, float]] = []
        self.whole = False

    def start(self) -> None:
        """Do nothing: rows come when they are typed."""

    def add(self, command: int, value: float) -> None:
        """Note a reading at a command."""
        self._kept.append((command, value))
        self._rows.add(self._loop.seconds(), command, value, 0)

    @property
    def values(self) -> list[float]:
        """The readings that were not withdrawn, in order."""
        return [value for _, value in self._kept]

    @property
    def commands(self) -> list[int]:
        """The commands of `values`."""
        return [command for command, _ in self._kept]

    def withdraw(self) -> tuple[int, float] | None:
        """Withdraw the last reading; return its command and its value, None where there is none."""
        if not self._kept:
            return None
        command, value = self._kept.pop()
        self._rows.add(self._loop.seconds(), command, value, 1)
        return command, value

    def take(self) -> Block:
        """Return the readings typed since the last call."""
        return self._rows.take()

    async def stop(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def facts(self) -> Mapping[str, Any]:
        """Return nothing: the rows are complete."""
        return {}


class RowParser(Protocol):
    """Turns the bytes that an instrument sends unprompted, several times a second, into rows."""

    name: str

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of its rows, the time first."""

    @property
    def rejected(self) -> int:
        """How many packets or lines held no reading."""

    def read(self, data: bytes) -> Iterable[tuple[float, ...]]:
        """Take bytes, and return the values of rows without their time."""

    def explain(self) -> str:
        """Return the likely cause when bytes arrive but no row does."""

    def facts(self) -> Mapping[str, Any]:
        """Return what goes into run.toml at the end."""


class Ut372Parser:
    """Parses a UT372's packets. Rows are present speeds in revolutions per minute, not counts, holds or statistics.

    A row's time is when its last byte arrived, a tenth of a second after the first.
    """

    name = "tachometer"
    columns = ("t", "rpm")

    def __init__(self) -> None:
        """Start without data."""
        self._reader = ut372.Ut372Reader()
        self._set_aside = 0
        self._shows_else = False

    @property
    def rejected(self) -> int:
        """How many packets were invalid."""
        return self._reader.rejected

    def read(self, data: bytes) -> Iterable[tuple[float, ...]]:
        """Return speeds, and count other readings without keeping them."""
        for reading in self._reader.feed(data):
            self._shows_else = reading.counted or reading.held or reading.statistic
            self._set_aside += self._shows_else
            if not self._shows_else:
                yield (reading.number,)

    def explain(self) -> str:
        """Return which keys to press."""
        if self._shows_else:
            return "COUNT, HOLD, MAX, MIN or AVE is lit. Press its keys until only RPM is."
        return f"its set-up menu is open, the port does not run at {ut372.BAUD} baud, or it is another device."

    def facts(self) -> Mapping[str, Any]:
        """Return how many packets were invalid, and how many showed something other than the present speed."""
        return {"rejected": self.rejected, "set_aside": self._set_aside}


class ScalesParser:
    """Parses the lines of scales; `stable` is 1 or 0, and -1 where a line does not state it."""

    name = "scales"
    columns = ("t", "grams", "stable")

    def __init__(self) -> None:
        """Start without data."""
        self._reader = ScalesReader()

    @property
    def rejected(self) -> int:
        """How many lines were invalid."""
        return self._reader.rejected

    def read(self, data: bytes) -> Iterable[tuple[float, ...]]:
        """Return weights."""
        for grams, stable in self._reader.feed(data):
            yield grams, -1 if stable is None else int(stable)

    def explain(self) -> str:
        """Return which settings may differ."""
        return "overload, another speed, frame (8N1) or unit (g, kg, mg, lb, oz) than expected, or another device."

    def facts(self) -> Mapping[str, Any]:
        """Return how many lines were invalid."""
        return {"rejected": self.rejected}


class HandHeld:
    """An instrument that sends readings unprompted on a port of its own."""

    def __init__(self, port: str, parser: RowParser, *, listen: Listen, loop: Any, clock: HostClock) -> None:
        """Take a port and the function that opens it, from `ut372_ports` or `serial_ports`; nothing is opened yet."""
        self.name, self.columns = parser.name, parser.columns
        self.latest: tuple[float, float] | None = None  # the last value, and when it arrived on the monotonic clock
        self._where, self._parser, self._listen, self._loop = port, parser, listen, loop
        self._rows = _Rows(len(parser.columns), clock)
        self._port: Port | None = None
        self._received_s = 0.0
        self._unread_bytes = 0
        self._last_bytes = b""
        self._gone = self._stopped = False

    def start(self) -> None:
        """Open the port. Raises DeviceError naming why it cannot be opened."""
        self._received_s = self._loop.seconds()
        self._port = self._listen(self._where, self)

    def received(self, data: bytes) -> None:
        """Take the bytes that the port received."""
        now_s = self._loop.seconds()
        self._unread_bytes += len(data)
        self._last_bytes = (self._last_bytes + data)[-_SHOWN_BYTES:]
        for values in self._parser.read(data):
            self._rows.add(now_s, *values)
            self.latest = values[0], now_s
            self._received_s, self._unread_bytes = now_s, 0

    def disconnected(self) -> None:
        """Note that the plug was pulled."""
        self._gone = True

    def take(self) -> Block:
        """Return the new rows. Raises DeviceError after ten seconds without a reading, or a pulled plug."""
        block = self._rows.take()
        if not len(block.columns[0]) and not self._stopped:
            self._watch()
        return block._replace(lost=None)  # the device states neither a rate nor a clock

    async def stop(self) -> None:
        """Expect no further reading."""
        self._stopped = True

    def close(self) -> None:
        """Close the port."""
        self._stopped = True
        if self._port is not None:
            port, self._port = self._port, None
            port.close()

    def facts(self) -> Mapping[str, Any]:
        """Return how many packets or lines held no reading."""
        return self._parser.facts()

    def _watch(self) -> None:
        silent_s = self._loop.seconds() - self._received_s
        if self._gone:
            raise DeviceError(f"{self._where}: the {self.name} was unplugged: plug it in and start again.")
        if silent_s >= _SILENT_S:
            unread = f"{counted(self._unread_bytes, 'byte')} without a reading, {self._last_bytes!r} the last: "
            nothing = "nothing: it is off, not set to send continuously, or not on this port."
            sent = unread + self._parser.explain() if self._unread_bytes else nothing
            raise DeviceError(f"{self._where}: in {silent_s:.0f} s the {self.name} sent {sent}")
