"""The load cell as an instrument: asks its box for a stream, keeps it alive, and stops it again."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from cfid.errors import DeviceError
from cfid.rig.clock import Array, HostClock, SampleClock
from cfid.rig.rdt_port import RECEIVE_BUFFER_BYTES, Inbox
from cfid.rig.recorder import Block, Say, no_rows, sleep
from cfid.wire import rdt
from cfid.wire.netft import Settings
from cfid.wire.rdt_order import RecordOrder
from cfid.wire.rdt_status import read_status

COLUMNS = ("t", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "rdt_sequence", "ft_sequence", "status")

_SILENT_S = 1.0  # without a record, after which the stream is asked for again, if four datagrams would have come
_BROKEN_S = 0.4  # without a record beside motors, after which they are stopped
_ABSENT_S = 3.0  # of it at the start, after which it is given up
_DEAD_S = 10.0  # of it later on, which leaves time to put a cable back
_BREAKS_WITHIN_S = 30.0
_MOST_BREAKS = 3  # of a stream within that time, after which someone must be taking it
_RESOLUTION_S = 1e-6  # of the time column
_QUIET_S = 0.03  # without a datagram, after which the box has stopped: a full buffer takes 20 ms
_STOPS = 5


class StreamPort(Protocol):
    """What carries requests to the box and fills the inbox: a UDP port, or a wire inside a test."""

    buffer_bytes: int

    def send(self, datagram: bytes) -> None:
        """Send to the box."""

    def drain(self) -> None:
        """Put into the inbox what has come."""

    def close(self) -> None:
        """Close the port."""


class LoadCell:
    """The stream of a load cell's box, which answers only one client at a time."""

    name = "loadcell"
    columns = COLUMNS

    def __init__(
        self,
        settings: Settings,
        inbox: Inbox,
        port: StreamPort,
        *,
        where: str,
        loop: Any,
        clock: HostClock,
        say: Say,
        buffered: bool = True,
        bias: bool = False,
        patient: bool = True,
    ) -> None:
        """Take the box' settings as read, an open port with its inbox, and whether to bias the box first.

        One that is not `patient` waits for no stream that breaks off: beside motors nothing is worth waiting for.
        """
        self._settings, self._inbox, self._port, self._where = settings, inbox, port, where
        self._loop, self._clock, self._say = loop, clock, say
        self._command = rdt.Command.BUFFERED if buffered else rdt.Command.REAL_TIME
        self._bias = bias
        self._patient = patient
        self._given_up = False
        self._order = RecordOrder()
        self._samples: SampleClock | None = None
        self._heard_s = self._asked_s = 0.0
        self._last_ft: int | None = None
        self._last_s = -np.inf
        self._fresh = True
        self._breaks_s: list[float] = []
        self._gaps: list[dict[str, float | str]] = []
        self._said: set[str] = set()
        self._streaming = False
        self._silent_s = max(_SILENT_S, 4 * settings.buffer_size / settings.rate_hz)
        self._broken_s = max(_BROKEN_S, 4 * settings.buffer_size / settings.rate_hz)

    def start(self) -> None:
        """Ask for the stream; with a bias first if that was wished, since each request replaces the one before."""
        if self._port.buffer_bytes < RECEIVE_BUFFER_BYTES:
            self._say(
                f"the system caps the receive buffer at {self._port.buffer_bytes >> 10} KiB where "
                f"{RECEIVE_BUFFER_BYTES >> 10} are wanted: a busy computer may lose samples. "
                f"`sysctl net.core.rmem_max={RECEIVE_BUFFER_BYTES}` allows them."
            )
        if self._bias:
            self._port.send(rdt.encode_request(rdt.Request(rdt.Command.BIAS)))
        self._streaming = True
        self._heard_s = self._loop.seconds()
        self._ask()

    def take(self) -> Block:
        """Hand over the records that came, in order and timed by the box' own count."""
        self._port.drain()
        inbox = self._inbox
        now_s = self._loop.seconds()
        lost_before = self._lost()
        if not inbox.ends:
            self._watch(now_s)
            return Block(no_rows(len(COLUMNS)), self._lost() - lost_before)
        every = rdt.decode_records(inbox.data)
        ends, arrivals_s = np.array(inbox.ends), np.array(inbox.arrivals_s)
        inbox.empty()
        records = self._order.take(every)
        if not len(records.ft_sequence):
            self._watch(now_s)
            return Block(no_rows(len(COLUMNS)), self._lost() - lost_before)
        if self._fresh and self._last_ft is not None:
            self._resume(records, now_s)
        self._fresh, self._heard_s, self._last_ft = False, now_s, int(records.ft_sequence[-1])
        instants_s = self._instants_s(records, every.ft_sequence[ends], arrivals_s)
        counts = records.counts
        return Block(
            (
                self._clock.unix_s(instants_s),
                *(counts[:, axis] for axis in range(6)),
                records.rdt_sequence,
                records.ft_sequence,
                records.status,
            ),
            self._lost() - lost_before,
            self._fault(records.status),
        )

    async def stop(self) -> None:
        """Ask the box to stop until it is quiet; one that does not stop is said.

        Raises DeviceError when the box had fallen silent already: the recording has no end then.
        """
        if not self._streaming:
            return
        self._streaming = False
        self._port.drain()
        silent_s = 0.0 if self._inbox.ends else self._loop.seconds() - self._heard_s
        await self._quieten()
        if self._last_ft is not None and silent_s > self._silent_s and not self._given_up:
            raise DeviceError(self._silence(silent_s))

    async def _quieten(self) -> None:
        for _ in range(_STOPS):
            self._port.send(rdt.encode_request(rdt.Request(rdt.Command.STOP)))
            await sleep(self._loop, _QUIET_S)
            self._port.drain()
            arrived = len(self._inbox.ends)
            await sleep(self._loop, _QUIET_S)
            self._port.drain()
            if len(self._inbox.ends) == arrived:
                return
        self._say(f"{self._where} goes on streaming after {_STOPS} requests to stop: switch it off and on.")

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def facts(self) -> Mapping[str, Any]:
        """Return losses by kind, gaps, and the clock."""
        arrivals = self._order.arrivals
        return {
            "arrivals": {
                "lost": arrivals.lost,
                "late": arrivals.late,
                "reordered": arrivals.reordered,
                "duplicates": arrivals.duplicates,
                "rejected": arrivals.rejected,
                "malformed_datagrams": self._inbox.malformed,
                "foreign_datagrams": self._inbox.foreign,
                "dropped_by_this_computer": self._inbox.overflowed,
            },
            "gaps": self._gaps,
            "receive_buffer_bytes": self._port.buffer_bytes,
            "said": sorted(self._said),
        }

    def _ask(self) -> None:
        self._order.begin()
        self._fresh = True
        self._asked_s = self._loop.seconds()
        self._port.send(rdt.encode_request(rdt.Request(self._command)))

    def _lost(self) -> int:
        return self._order.arrivals.lost

    def _watch(self, now_s: float) -> None:
        """Ask again for a stream that broke off; give up one that stays away or is taken away again and again."""
        silent_s = now_s - self._heard_s
        if self._streaming and not self._patient and self._last_ft is not None and silent_s > self._broken_s:
            self._given_up = True
            raise DeviceError(self._silence(silent_s))
        if not self._streaming or silent_s <= self._silent_s:
            return
        if silent_s > (_ABSENT_S if self._last_ft is None else _DEAD_S) + self._silent_s - _SILENT_S:
            self._given_up = True
            raise DeviceError(self._silence(silent_s))
        if self._last_ft is not None and not self._fresh:
            self._say(f"{self._where} is silent; asking again")
            self._breaks_s = [past_s for past_s in self._breaks_s if now_s - past_s < _BREAKS_WITHIN_S] + [now_s]
        if len(self._breaks_s) >= _MOST_BREAKS:
            self._given_up = True
            raise DeviceError(
                f"{self._where}: the stream broke off {_MOST_BREAKS} times in {_BREAKS_WITHIN_S:g} s: another client "
                "takes it, and the box answers only one. End that program; `cfid rig check` tells more."
            )
        if now_s - self._asked_s > self._silent_s:
            self._ask()

    def _silence(self, silent_s: float) -> str:
        unread = {
            "datagrams from other addresses": self._inbox.foreign,
            "datagrams that are no records": self._inbox.malformed,
            "records that contradict the stream": self._order.arrivals.rejected,
        }
        others = "".join(f" {count} {name} came." for name, count in unread.items() if count)
        what = "sent nothing" if self._last_ft is None else f"sent no more for {silent_s:.1f} s"
        asked = ", though asked again and again" if self._patient else ""
        return (
            f"{self._where} {what}{asked}.{others} No power, no network, another client, or a "
            "firewall that keeps UDP out: `cfid rig check` tells which."
        )

    def _resume(self, records: rdt.Records, now_s: float) -> None:
        """With the first records of a new request, note the gap and count what the box sampled in it."""
        assert self._last_ft is not None and self._order.step is not None
        step = self._order.step
        passed = (int(records.ft_sequence[0]) - self._last_ft) % (1 << 32)
        most = (now_s - self._heard_s + _SILENT_S) * self._ticks_per_s()
        if passed > most:
            reason = "the box was restarted"
            if self._samples is not None:
                self._samples.restart()
        else:
            reason = "the stream broke off"
            self._order.arrivals.lost += max(passed // step - int(records.rdt_sequence[0]), 0)
        begin_s, end_s = self._clock.unix_s(np.array([self._heard_s, now_s])).tolist()
        self._gaps.append({"from_s": begin_s, "to_s": end_s, "reason": reason})
        self._say(f"{self._where}: {reason}; records again after {end_s - begin_s:.1f} s")

    def _instants_s(self, records: rdt.Records, ended: npt.NDArray[np.uint32], arrivals_s: Array) -> Array:
        """Time the records by ft_sequence; `ended` (m,) are the last counts of datagrams that came at `arrivals_s`."""
        if self._samples is None:
            self._samples = SampleClock(ticks_per_s=self._ticks_per_s())
        first = records.ft_sequence[0]
        passed, passed_at_end = records.ft_sequence - first, ended - first
        place = np.searchsorted(passed, passed_at_end).clip(max=len(passed) - 1)
        there = passed[place] == passed_at_end
        instants_s = self._samples.instants_s(records.ft_sequence, arrived=place[there], arrival_s=arrivals_s[there])
        if instants_s[0] <= self._last_s:  # the anchor after a restart may lie before the end of the gap
            instants_s = instants_s + (self._last_s + _RESOLUTION_S - instants_s[0])
        self._last_s = float(instants_s[-1])
        return instants_s

    def _ticks_per_s(self) -> float:
        """Return what ft_sequence counts in a second; the rate is told in whole hertz, 7000/3 as 2333."""
        told = float(self._settings.rate_hz * (self._order.step or 1))
        return rdt.INTERNAL_HZ if abs(told / rdt.INTERNAL_HZ - 1) < 5e-3 else told

    def _fault(self, status: npt.NDArray[np.uint32]) -> str:
        """Say what the status words say; return what ends the run."""
        if not np.bitwise_or.reduce(status):
            return ""
        faults: list[str] = []
        for word in np.unique(status).tolist():
            read = read_status(word, self._settings.family)
            faults += read.faults
            for warning in read.warnings:
                if warning not in self._said:
                    self._said.add(warning)
                    self._say(f"{self._where}: {warning} (status {word:#010x}); readings are not affected")
        if not faults:
            return ""
        return f"{self._where}: {', '.join(dict.fromkeys(faults))}: the readings from there on are not forces."
