"""Records the load cell: requests a stream from its box, renews it, and stops it."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from cfid.errors import DeviceError
from cfid.rig.clock import HostClock
from cfid.rig.rdt_port import RECEIVE_BUFFER_BYTES, Inbox
from cfid.rig.rdt_status_watch import StatusWatch
from cfid.rig.rdt_times import RecordTimes, TimedArrivals, arrivals_of
from cfid.rig.recorder import Block, Say, no_rows, sleep
from cfid.wire import rdt
from cfid.wire.netft import Settings
from cfid.wire.rdt_order import RecordOrder

COLUMNS = ("t", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "rdt_sequence", "ft_sequence", "status")

_SILENT_S = 1.0  # without a record, and at least four datagrams long: then the stream is requested again
_BROKEN_S = 0.4  # without a record while motors run, after which they are stopped
_ABSENT_S = 3.0  # of silence at the start, after which the stream is given up
_DEAD_S = 10.0  # of silence later on, which leaves time to plug a cable in again
_BREAKS_WITHIN_S = 30.0
_MOST_BREAKS = 3  # of a stream within that time, after which another client must be taking it
_PAUSE_S = 0.05  # without a record at the end, in addition to four datagrams, which counts as a gap
_QUIET_S = 0.03  # without a datagram, after which the box has stopped: a full buffer takes 20 ms
_STOPS = 5
_LONGEST_STOP_S = 1.4


class StreamPort(Protocol):
    """Sends requests to the box and fills the inbox: a UDP port, or a simulated one in a test."""

    buffer_bytes: int

    def send(self, datagram: bytes) -> None:
        """Send to the box."""

    def drain(self) -> None:
        """Move received datagrams into the inbox."""

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
        patient: bool = True,
    ) -> None:
        """Take the box' settings as read, and an open port with its inbox.

        Without `patient` a stream that breaks off ends the run at once, as it must while motors run.
        """
        self._settings, self._inbox, self._port, self._where = settings, inbox, port, where
        self._loop, self._clock, self._say = loop, clock, say
        self._command = rdt.Command.BUFFERED if buffered else rdt.Command.REAL_TIME
        self._patient = patient
        self._given_up = False
        self._order = RecordOrder()
        self._times = RecordTimes(rate_hz=settings.rate_hz)
        self._status = StatusWatch(where=where, family=settings.family, say=say)
        self._received_s = self._requested_s = 0.0
        self._last_ft: int | None = None
        self._fresh = True
        self._missing = self._counted = 0
        self._breaks_s: list[float] = []
        self._gaps: list[dict[str, float | str]] = []
        self._streaming = False
        self._datagram_s = settings.buffer_size / settings.rate_hz if buffered else 1 / settings.rate_hz
        self._silent_s = max(_SILENT_S, 4 * self._datagram_s)
        self._broken_s = max(_BROKEN_S, 4 * self._datagram_s)

    def start(self) -> None:
        """Request the stream."""
        if self._port.buffer_bytes < RECEIVE_BUFFER_BYTES:
            self._say(
                f"the system caps the receive buffer at {self._port.buffer_bytes >> 10} KiB where "
                f"{RECEIVE_BUFFER_BYTES >> 10} are needed: a busy computer may lose samples. "
                f"`sysctl net.core.rmem_max={RECEIVE_BUFFER_BYTES}` allows them."
            )
        self._streaming = True
        self._received_s = self._loop.seconds()
        self._request()

    def take(self) -> Block:
        """Return the new records, in order and timed by the box' own count."""
        self._port.drain()
        inbox, now_s = self._inbox, self._loop.seconds()
        every = rdt.decode_records(inbox.data)
        ends, came_s = np.array(inbox.ends, np.intp), np.array(inbox.arrivals_s)
        inbox.empty()
        lost_before, jumped_before = self._order.arrivals.lost, self._times.jumped
        records = self._order.take(every)
        if not len(records):
            self._watch(now_s)
            return Block(no_rows(len(COLUMNS)), self._newly_lost())
        assert self._order.step is not None  # once records were taken
        self._times.learn(self._order.step)
        arrivals = arrivals_of(records, every["ft_sequence"][ends], came_s, read_s=now_s)
        if self._fresh and self._last_ft is not None:
            self._resume(records, arrivals)
        instants_s = self._times.instants_s(records, arrivals)
        if self._times.jumped > jumped_before:
            self._break(now_s, self._order.arrivals.lost - lost_before)
        self._fresh, self._received_s, self._last_ft = False, now_s, int(records["ft_sequence"][-1])
        counts = records["counts"]
        return Block(
            (
                self._clock.unix_s(instants_s),
                *(counts[:, axis] for axis in range(6)),
                records["rdt_sequence"],
                records["ft_sequence"],
                records["status"],
            ),
            self._newly_lost(),
            self._status.fault(records["status"]),
        )

    async def stop(self) -> None:
        """Ask the box to stop until it is quiet; report a box that does not stop.

        Raises DeviceError when the box had fallen silent already: the recording has no end then.
        """
        if not self._streaming:
            return
        self._streaming = False
        self._port.drain()
        now_s = self._loop.seconds()
        silent_s = 0.0 if self._inbox.ends else now_s - self._received_s
        if self._last_ft is not None and silent_s > _PAUSE_S + 4 * self._datagram_s:
            self._missing += round(silent_s * self._times.rate_hz)
            self._note_gap(now_s, "silent at the end")
        await self._quieten()
        if self._last_ft is not None and silent_s > self._silent_s and not self._given_up:
            raise DeviceError(self._silence(silent_s))

    async def _quieten(self) -> None:
        """Ask the box to stop, at least twice, until it has been silent for the time of two datagrams."""
        needed_s = max(_QUIET_S, 2 * self._datagram_s)
        every_s = min(needed_s, _LONGEST_STOP_S / _STOPS)
        quiet_s = 0.0
        for request in range(_STOPS):
            arrived = len(self._inbox.ends)
            self._port.send(rdt.encode_request(rdt.Request(rdt.Command.STOP)))
            await sleep(self._loop, every_s)
            self._port.drain()
            quiet_s = quiet_s + every_s if len(self._inbox.ends) == arrived else 0.0
            if request and quiet_s >= needed_s:
                return
        if not quiet_s:
            self._say(f"{self._where} keeps streaming after {_STOPS} requests to stop: switch it off and on.")

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def facts(self) -> Mapping[str, Any]:
        """Return losses by kind, gaps, and the clock."""
        arrivals = self._order.arrivals
        return {
            "arrivals": {
                "lost": arrivals.lost + self._missing,
                "late": arrivals.late,
                "reordered": arrivals.reordered,
                "duplicates": arrivals.duplicates,
                "rejected": arrivals.rejected,
                "malformed_datagrams": self._inbox.malformed,
                "foreign_datagrams": self._inbox.foreign,
                "datagrams_dropped_by_this_computer": self._inbox.overflowed,
            },
            "gaps": self._gaps,
            "receive_buffer_bytes": self._port.buffer_bytes,
            "said": sorted(self._status.reported),
        }

    def _request(self) -> None:
        self._order.begin()
        self._fresh = True
        self._requested_s = self._loop.seconds()
        self._port.send(rdt.encode_request(rdt.Request(self._command)))

    def _newly_lost(self) -> int:
        lost = self._order.arrivals.lost + self._missing
        newly, self._counted = lost - self._counted, lost
        return newly

    def _watch(self, now_s: float) -> None:
        """Request again a stream that broke off; give up one that does not return, or that breaks off repeatedly."""
        silent_s = now_s - self._received_s
        if self._streaming and not self._patient and self._last_ft is not None and silent_s > self._broken_s:
            self._given_up = True
            raise DeviceError(self._silence(silent_s))
        if not self._streaming or silent_s <= self._silent_s:
            return
        if silent_s > (_ABSENT_S if self._last_ft is None else _DEAD_S) + self._silent_s - _SILENT_S:
            self._given_up = True
            raise DeviceError(self._silence(silent_s))
        if self._last_ft is not None and not self._fresh:
            self._say(f"{self._where} is silent; requesting the stream again")
            self._breaks_s = [past_s for past_s in self._breaks_s if now_s - past_s < _BREAKS_WITHIN_S] + [now_s]
        if len(self._breaks_s) >= _MOST_BREAKS:
            self._given_up = True
            raise DeviceError(
                f"{self._where}: the stream broke off {_MOST_BREAKS} times in {_BREAKS_WITHIN_S:g} s: another client "
                "takes it, and the box serves only one. End that program; `cfid rig check` shows more."
            )
        if now_s - self._requested_s > self._silent_s:
            self._request()

    def _silence(self, silent_s: float) -> str:
        unread = {
            "datagrams from other addresses": self._inbox.foreign,
            "datagrams that are no records": self._inbox.malformed,
            "records that contradict the stream": self._order.arrivals.rejected,
        }
        others = "".join(f" {count} {name} came." for name, count in unread.items() if count)
        what = "sent nothing" if self._last_ft is None else f"sent nothing more for {silent_s:.1f} s"
        requested = ", despite repeated requests" if self._patient else ""
        return (
            f"{self._where} {what}{requested}.{others} Likely causes: no power, no network, another client, or a "
            "firewall that blocks UDP. `cfid rig check` finds which."
        )

    def _resume(self, records: rdt.Records, arrivals: TimedArrivals) -> None:
        """At the first records of a new request, note the gap and count the samples that the box took in it."""
        assert self._last_ft is not None and self._order.step is not None
        now_s, step = arrivals.read_s, self._order.step
        passed = (int(records["ft_sequence"][0]) - self._last_ft) % (1 << 32)
        most = (now_s - self._received_s + _SILENT_S) * self._times.rate_hz * step
        if passed > most or self._times.began_anew(records, arrivals):
            reason = "the box was restarted"
            self._times.restart()
        else:
            reason = "the stream broke off"
            self._missing += max(passed // step - int(records["rdt_sequence"][0]), 0)
        self._note_gap(now_s, reason)
        self._say(f"{self._where}: {reason}; records again after {now_s - self._received_s:.1f} s")

    def _break(self, now_s: float, counted: int) -> None:
        """Note a gap where the box' count jumped; how many of the samples `counted` as lost were taken is unknown."""
        self._missing -= counted
        self._note_gap(now_s, "the box' count jumped")
        self._say(f"{self._where}: its count of samples jumped against this computer's clock: a new count begins")

    def _note_gap(self, end_s: float, reason: str) -> None:
        begin_s, to_s = self._clock.unix_s(np.array([self._received_s, end_s])).tolist()
        self._gaps.append({"from_s": begin_s, "to_s": to_s, "reason": reason})
