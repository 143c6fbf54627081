"""Simulates a Net F/T box: RDT requests to datagrams, single readings and settings. No port, no clock, no faults."""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.sim.loadcell import SimulatedLoadCell
from cfid.sim.netft_settings import BoxSettings, Configuration, configurations_of
from cfid.sim.stepping import Array
from cfid.wire.netft import LoadReading, encode_reading
from cfid.wire.rdt import INTERNAL_HZ, RECORD, RECORD_BYTES, Command, decode_request, encode_records

Address = tuple[str, int]
Plant = Callable[[Array], Array]

LONGEST_STALL_S = 2.0
COMMAND_BYTES = 20  # of a command over TCP

_ANY_ERROR = 1 << 31
_LATCHED_THRESHOLD = 1 << 16
_INT16_MAX = 32767
_READ_CALIBRATION = 1
_SCALES = struct.Struct(">HBBII6H")
_HEADER = 0x1234
# Manual of the Net F/T, READCALINFO: the codes of units.
_FORCE_CODES = {"lbf": 1, "N": 2, "klbf": 3, "kN": 4, "kgf": 5}
_TORQUE_CODES = {"lbf-in": 1, "lbf-ft": 2, "Nm": 3, "Nmm": 4, "kgf-cm": 5, "kNm": 6}


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
    """The box from power-up on.

    `plant` returns the wrench (n, 6) in N and Nm at times (n,) of the clock of `now_s`, which never decrease.
    Like the real box it has one client: a request takes the stream from any other client. Samples lie on a grid
    of `internal_hz` since power-up, which ft_sequence counts from `first_ft_sequence`; a new rate or buffer
    applies from the next request on. `skipped_records` counts records omitted because `due` was not called.
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
        configurations: Sequence[Configuration] | None = None,
        active: int = 1,
    ) -> None:
        """Power up at `powered_s`."""
        self.load_cell = load_cell
        self.settings = BoxSettings(
            internal_hz=internal_hz,
            rate_hz=rate_hz,
            buffer_size=buffer_size,
            configurations=configurations or configurations_of(load_cell.truth),
            active=active,
        )
        self.status = status
        self.skipped_records = 0
        self._plant = plant
        self._internal_hz = internal_hz
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
        if request.command in (Command.REAL_TIME, Command.BUFFERED) and self.settings.enabled:
            step = self.settings.step
            self._stream = _Stream(
                client=client,
                block=self.settings.buffer_size if request.command == Command.BUFFERED else 1,
                step=step,
                remaining=request.records or None,
                next_tick=(self._tick(now_s) // step + 1) * step,
            )

    def due(self, now_s: float) -> list[tuple[bytes, Address]]:
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
        """Return netftapi2.xml for a configuration, or for the active one without an index."""
        return self.settings.page(index, status=self.status)

    def apply(self, path_and_query: str) -> bool:
        """Apply a setting; return whether its page exists."""
        known = self.settings.apply(path_and_query)
        self.load_cell.set_bias(self.settings.bias_counts)
        if not self.settings.enabled:
            self._stream = None
        return known

    def answer(self, command: bytes, now_s: float) -> bytes:
        """Return the answer to a command of 20 bytes over TCP: READFT, READCALINFO, else nothing."""
        if len(command) != COMMAND_BYTES or command[0] > _READ_CALIBRATION:
            return b""
        shown = self.settings.configuration
        counts_per_unit = np.repeat([shown.counts_per_force, shown.counts_per_torque], 3)
        divisors = np.ceil(counts_per_unit * shown.ranges / _INT16_MAX).astype(np.int64)
        if command[0] == _READ_CALIBRATION:
            units = _FORCE_CODES[shown.force_unit], _TORQUE_CODES[shown.torque_unit]
            per_unit = shown.counts_per_force, shown.counts_per_torque
            return _SCALES.pack(_HEADER, *units, *per_unit, *divisors.tolist())
        counts, status = self._current(now_s)
        values = np.clip(counts // divisors, -_INT16_MAX, _INT16_MAX)
        return encode_reading(LoadReading(status >> 16, tuple(values.tolist())))

    def restart(self, powered_s: float) -> None:
        """Lose power and start again at `powered_s`: no stream, ft_sequence from zero; settings are kept."""
        self._stream = None
        self._first_ft_sequence = 0
        self._powered_s = powered_s

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
        total = self.load_cell.software_bias + counts
        self.settings.bias_counts = tuple(total.tolist())
        self.load_cell.set_bias(total)

    def _reset_latch(self) -> None:
        self.status &= ~_LATCHED_THRESHOLD
        if self.status == _ANY_ERROR:
            self.status = 0
