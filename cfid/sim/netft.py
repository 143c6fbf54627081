"""Simulates a Net F/T box: RDT, pages, single readings, and the settings behind them; no port and no clock."""

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit
from xml.sax.saxutils import escape

import numpy as np
import numpy.typing as npt

from cfid.sim.loadcell import SimulatedLoadCell
from cfid.sim.stepping import Array
from cfid.wire.netft import CONFIGURATION_PATH, LoadReading, encode_reading
from cfid.wire.rdt import (
    INTERNAL_HZ,
    LONGEST_BUFFER,
    RECORD,
    RECORD_BYTES,
    Command,
    decode_request,
    encode_records,
)

Address = tuple[str, int]
Datagram = tuple[bytes, Address]
Plant = Callable[[Array], Array]

LONGEST_STALL_S = 2.0
COMMAND_BYTES = 20  # of a command over TCP
DONE = "<html>done</html>"

_UNBIASED = (0,) * 6
_ANY_ERROR = 1 << 31
_LATCHED_THRESHOLD = 1 << 16
_INT16_MAX = 32767
_READ_CALIBRATION = 1
_SCALES = struct.Struct(">HBBII6H")
_HEADER = 0x1234
_N, _NM = 2, 3  # codes of units (manual of the Net F/T, READCALINFO)
_ACTIVE = 1  # configuration


@dataclass(kw_only=True)
class _Stream:
    """An answered request: its client, records a datagram, records left (None: endless), next tick and number."""

    client: Address
    block: int
    step: int
    remaining: int | None
    next_tick: int
    sequence: int = 1


class NetFTBox:
    """The box from power-up on, which silently ignores invalid settings, as the real one does.

    `plant` returns the wrench (n, 6) in N and Nm at times (n,) of the clock of `now_s`, which never decrease.
    Like the real box it has one client: a request takes the stream from any other client. Samples lie on a grid
    of `internal_hz` since power-up, which ft_sequence counts from `first_ft_sequence`; a new rate or buffer
    applies from the next request on. `skipped_records` counts records omitted because `due` was not called.

    Of two configurations the first is in pounds, as delivered, and the active one in N and Nm, with the cell's true
    scales. Applying the first to the readings of the second gives loads 4.4 times too large.
    """

    def __init__(
        self,
        *,
        load_cell: SimulatedLoadCell,
        plant: Plant,
        internal_hz: int = INTERNAL_HZ,
        rate_hz: float = INTERNAL_HZ,
        buffer_size: int = 1,
        first_ft_sequence: int = 0,
        powered_s: float = 0.0,
        status: int = 0,
    ) -> None:
        """Power up at `powered_s`."""
        self.load_cell = load_cell
        self.status = status
        self.skipped_records = 0
        truth = load_cell.truth
        self._counts_per_unit = round(truth.counts_per_n), round(truth.counts_per_nm)
        self._configurations = (
            _configuration("Default", (1_000_000, 1_000_000), ("lbf", "lbf-in"), (5.0, 5.0, 15.0, 10.0, 10.0, 10.0)),
            _configuration("Thrust stand", self._counts_per_unit, ("N", "Nm"), truth.ranges),
        )
        self.enabled = True
        self.bias_counts: tuple[int, ...] = _UNBIASED
        self._internal_hz, self.buffer_size = internal_hz, buffer_size
        self._step = self._step_of(rate_hz)
        self._plant = plant
        self._first_ft_sequence = first_ft_sequence
        self._powered_s = powered_s
        self._stream: _Stream | None = None

    @property
    def streaming(self) -> bool:
        """Whether `due` returns datagrams, now or later."""
        return self._stream is not None

    def request(self, datagram: bytes, client: Address, now_s: float) -> None:
        """Execute an RDT request; other datagrams, and requests for several units, are ignored."""
        request = decode_request(datagram)
        if request is None or request.command not in set(Command) - {Command.MULTI_UNIT}:
            return
        if request.command == Command.BIAS:
            self._bias(now_s)
        elif request.command == Command.RESET_THRESHOLD:
            self._reset_latch()
        self._stream = None
        if request.command in (Command.REAL_TIME, Command.BUFFERED) and self.enabled:
            self._stream = _Stream(
                client=client,
                block=self.buffer_size if request.command == Command.BUFFERED else 1,
                step=self._step,
                remaining=request.records or None,
                next_tick=(self._tick(now_s) // self._step + 1) * self._step,
            )

    def next_s(self) -> float:
        """Return when the next datagram is complete, infinity without a stream."""
        if self._stream is None:
            return math.inf
        last_tick = self._stream.next_tick + (self._stream.block - 1) * self._stream.step
        return self._powered_s + last_tick / self._internal_hz

    def due(self, now_s: float) -> list[Datagram]:
        """Return the datagrams whose samples have all been taken by now.

        After a stall, records less than LONGEST_STALL_S old are caught up. The real box never stalls, so older records
        count as sent: a client sees them as lost.
        """
        stream = self._stream
        if stream is None:
            return []
        self._skip_stale(stream, now_s)
        count = (self._tick(now_s) - stream.next_tick) // stream.step + 1
        last = stream.remaining is not None and count >= stream.remaining
        if last:
            count = stream.remaining or 0
        else:
            count -= count % stream.block
        if count <= 0:
            return []
        data = self._records(stream, count)
        if last:
            self._stream = None
        size = stream.block * RECORD_BYTES
        return [(data[at : at + size], stream.client) for at in range(0, len(data), size)]

    def page(self, index: int | None = None) -> str:
        """Return netftapi2.xml for a configuration; without an index, or with one too large, for the active one."""
        shown = _ACTIVE if index is None or not 0 <= index < len(self._configurations) else index
        tags: dict[str, object] = {
            "runstat": f"{self.status:08X}",
            "prodname": "Net F/T",
            "mfgdigver": "2.2.62",
            "setcfgsel": _ACTIVE,
            "setbias": _joined(self.bias_counts),
            **self._configurations[shown],
            "cfgtfx": _joined(_UNBIASED),
            "comrdte": "Enabled" if self.enabled else "Disabled",
            # Rounded down: setting the rate that is shown then changes nothing.
            "comrdtrate": self._internal_hz // self._step,
            "comrdtbsiz": self.buffer_size,
        }
        lines = (f"<{name}>{escape(str(text))}</{name}>" for name, text in tags.items())
        return "\n".join(('<?xml version="1.0" encoding="UTF-8"?>', "<netft>", *lines, "</netft>", ""))

    def get(self, path_and_query: str) -> str | None:
        """Return the page at a path, None where there is none; settings in its query are applied."""
        target = urlsplit(path_and_query)
        query = {name: values[-1] for name, values in parse_qs(target.query).items()}
        if target.path == CONFIGURATION_PATH:
            index = query.get("index", "")
            return self.page(int(index) if index.isdecimal() else None)
        if target.path == "/comm.cgi":
            self._set_communication(query)
        elif target.path == "/setting.cgi":
            stated = [_whole(query.get(f"setbias{axis}")) for axis in range(6)]
            counts = [count for count in stated if count is not None]
            if len(counts) == len(stated):
                self._set_bias(counts)
        else:
            return None
        return DONE

    def answer(self, command: bytes, now_s: float) -> bytes:
        """Return the answer to a command of 20 bytes over TCP: READFT, READCALINFO, else nothing."""
        if len(command) != COMMAND_BYTES or command[0] > _READ_CALIBRATION:
            return b""
        counts_per_unit = np.repeat(self._counts_per_unit, 3)
        divisors = np.ceil(counts_per_unit * self.load_cell.truth.ranges / _INT16_MAX).astype(np.int64)
        if command[0] == _READ_CALIBRATION:
            return _SCALES.pack(_HEADER, _N, _NM, *self._counts_per_unit, *divisors.tolist())
        counts, status = self._current(now_s)
        values = np.clip(counts // divisors, -_INT16_MAX, _INT16_MAX)
        return encode_reading(LoadReading(status >> 16, tuple(values.tolist())))

    def restart(self, powered_s: float) -> None:
        """Lose power and start again at `powered_s`: no stream, ft_sequence from zero; settings are kept."""
        self._stream = None
        self._first_ft_sequence = 0
        self._powered_s = powered_s

    def _set_communication(self, query: Mapping[str, str]) -> None:
        rate_hz = _whole(query.get("comrdtrate"))
        if rate_hz is not None and 1 <= rate_hz <= self._internal_hz:
            self._step = self._step_of(rate_hz)
        buffer_size = _whole(query.get("comrdtbsiz"))
        if buffer_size is not None and 1 <= buffer_size <= LONGEST_BUFFER:
            self.buffer_size = buffer_size
        if query.get("comrdte") in ("0", "1"):
            self.enabled = query["comrdte"] == "1"
        if not self.enabled:
            self._stream = None

    def _step_of(self, rate_hz: float) -> int:
        """Return the internal samples a record: other rates become the next faster one that exists."""
        return int(self._internal_hz // rate_hz)

    def _records(self, stream: _Stream, count: int) -> bytes:
        """Take the stream's next samples and return their bytes."""
        steps = np.arange(count, dtype=np.int64)
        ticks = stream.next_tick + stream.step * steps
        records = np.empty(count, RECORD)
        records["rdt_sequence"] = stream.sequence + steps
        records["ft_sequence"] = self._first_ft_sequence + ticks
        records["counts"], records["status"] = self._sample(ticks)
        self._advance(stream, count)
        return encode_records(records)

    def _sample(self, ticks: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.uint32]]:
        time_s = self._powered_s + ticks / self._internal_hz
        counts, status = self.load_cell.read(time_s, self._plant(time_s))
        return counts, status | np.uint32(self.status)

    def _current(self, now_s: float) -> tuple[npt.NDArray[np.int32], int]:
        """Return counts (6,) and status from before the stream's next sample, since the plant cannot go back."""
        tick = self._tick(now_s)
        if self._stream is not None:
            tick = min(tick, self._stream.next_tick - 1)
        counts, status = self._sample(np.array([tick]))
        return counts[0], int(status[0])

    def _advance(self, stream: _Stream, count: int) -> None:
        stream.next_tick += stream.step * count
        stream.sequence += count
        if stream.remaining is not None:
            stream.remaining -= count

    def _skip_stale(self, stream: _Stream, now_s: float) -> None:
        stale = (self._tick(now_s - LONGEST_STALL_S) - stream.next_tick) // stream.step
        stale -= stale % stream.block
        if stream.remaining is not None:
            stale = min(stale, stream.remaining - 1)
        if stale > 0:
            self._advance(stream, stale)
            self.skipped_records += stale

    def _tick(self, now_s: float) -> int:
        return int((now_s - self._powered_s) * self._internal_hz)

    def _bias(self, now_s: float) -> None:
        """Make the present reading zero, whatever the bias was before."""
        counts, _ = self._current(now_s)
        self._set_bias((self.load_cell.software_bias + counts).tolist())

    def _set_bias(self, counts: Sequence[int]) -> None:
        self.bias_counts = tuple(counts)
        self.load_cell.set_bias(counts)

    def _reset_latch(self) -> None:
        self.status &= ~_LATCHED_THRESHOLD
        if self.status == _ANY_ERROR:
            self.status = 0


def _configuration(
    name: str, counts_per_unit: tuple[int, int], units: tuple[str, str], ranges: Sequence[float]
) -> dict[str, object]:
    """Return the tags of one of the box' 16 configurations: counts per unit, units, ranges Fx to Tz in these units."""
    return {
        "cfgnam": name,
        "cfgcalsn": "FT12345",
        "cfgcpf": counts_per_unit[0],
        "cfgcpt": counts_per_unit[1],
        "scfgfu": units[0],
        "scfgtu": units[1],
        "cfgmr": _joined(ranges),
    }


def _whole(text: str | None) -> int | None:
    try:
        return None if text is None else int(text)
    except ValueError:
        return None


def _joined(values: Sequence[float]) -> str:
    return ";".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)
