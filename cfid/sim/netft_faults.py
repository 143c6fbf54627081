"""Adds faults to a simulated Net F/T box, between the box' core and its sockets; no port and no clock."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cfid.sim.faults import LoadCellFaults, within
from cfid.sim.netft import Address, NetFTBox
from cfid.wire.rdt import RECORD_BYTES, Command, Request, decode_request, encode_request

_BIAS = Request(Command.BIAS)
_OTHER_CLIENT: Address = ("192.0.2.1", 49152)  # in the network reserved for examples

Datagram = tuple[bytes, Address]


@dataclass
class NetftMishaps:
    """Counts of faults, in records where a client misses records or gets them twice."""

    dropped_records: int = 0
    silenced_records: int = 0
    duplicated_records: int = 0
    reordered_datagrams: int = 0
    cut_datagrams: int = 0
    flipped_bits: int = 0


class FaultyNetFT:
    """The box with its faults. While it is not `alive`, it takes and sends nothing."""

    def __init__(self, box: NetFTBox, faults: LoadCellFaults, *, opened_s: float, rng: np.random.Generator) -> None:
        """Count the faults' times from `opened_s`."""
        self.box = box
        self.faults = faults
        self.slow_s = faults.slow_s
        self.mishaps = NetftMishaps()
        self._opened_s = opened_s
        self._rng = rng
        self._sent = 0
        self._held: Datagram | None = None
        self._to_come = sorted(
            (
                (after_s, happening)
                for after_s, happening in (
                    (faults.restart_after_s, self._restart),
                    (faults.second_client_after_s, self._lose_stream),
                    (faults.status_after_s, self._show_status),
                    (faults.saturate_after_s, self._saturate),
                )
                if after_s is not None
            ),
            key=lambda event: event[0],
        )

    @property
    def streaming(self) -> bool:
        """Whether `due` returns datagrams, now or later."""
        return self.box.streaming

    def alive(self, now_s: float) -> bool:
        """Return whether the box has power and answers at all."""
        self._happen(now_s)
        return not within(now_s - self._opened_s, self.faults.restart_after_s, self.faults.restart_for_s)

    def request(self, datagram: bytes, client: Address, now_s: float) -> None:
        """Take an RDT request."""
        refused = self.faults.refuse_settings and decode_request(datagram) == _BIAS
        if self.alive(now_s) and not refused:
            self._held = None
            self.box.request(datagram, client, now_s)

    def due(self, now_s: float) -> list[Datagram]:
        """Return the datagrams that leave for the client now."""
        if not self.alive(now_s):
            return []
        datagrams = [datagram for datagram in self.box.due(now_s) if datagram[1] != _OTHER_CLIENT]
        elapsed_s = now_s - self._opened_s
        if self.faults.udp_blocked or within(elapsed_s, self.faults.silent_after_s, self.faults.silent_for_s):
            self.mishaps.silenced_records += _records(datagrams)
            return []
        if not self._touches_datagrams():
            return datagrams
        return [passed for datagram in datagrams for passed in self._pass(datagram)]

    def page(self, index: int | None = None) -> str:
        """Return netftapi2.xml."""
        return self.box.page(index)

    def apply(self, path_and_query: str) -> bool:
        """Apply a setting, or only acknowledge it; return whether its page exists."""
        if self.faults.refuse_settings and path_and_query.startswith("/comm.cgi"):
            return True
        return self.box.apply(path_and_query)

    def answer(self, command: bytes, now_s: float) -> bytes:
        """Return the answer to a command over TCP."""
        return self.box.answer(command, now_s)

    def _touches_datagrams(self) -> bool:
        faults = self.faults
        return any((faults.drop_every, faults.duplicate_every, faults.reorder_every, faults.corrupt_every))

    def _pass(self, datagram: Datagram) -> Iterable[Datagram]:
        """Return what is sent for one datagram, and for one held back before it."""
        self._sent += 1
        held, self._held = self._held, None
        passed = [] if held is None else [held]
        if _is_turn(self._sent, self.faults.drop_every):
            self.mishaps.dropped_records += _records([datagram])
            return passed
        if _is_turn(self._sent, self.faults.corrupt_every):
            datagram = self._corrupted(datagram)
        if held is None and _is_turn(self._sent, self.faults.reorder_every) and self.streaming:
            self._held = datagram
            self.mishaps.reordered_datagrams += 1
            return []
        if _is_turn(self._sent, self.faults.duplicate_every):
            self.mishaps.duplicated_records += _records([datagram])
            return [datagram, datagram, *passed]
        return [datagram, *passed]

    def _corrupted(self, datagram: Datagram) -> Datagram:
        data, client = datagram
        if self.mishaps.cut_datagrams == self.mishaps.flipped_bits:
            self.mishaps.cut_datagrams += 1
            return data[: int(self._rng.integers(1, RECORD_BYTES))], client
        self.mishaps.flipped_bits += 1
        flipped = bytearray(data)
        flipped[self._rng.integers(len(data))] ^= 1 << self._rng.integers(8)
        return bytes(flipped), client

    def _happen(self, now_s: float) -> None:
        while self._to_come and self._to_come[0][0] <= now_s - self._opened_s:
            after_s, happening = self._to_come.pop(0)
            happening(self._opened_s + after_s)

    def _restart(self, at_s: float) -> None:
        self.box.restart(at_s + self.faults.restart_for_s)

    def _lose_stream(self, at_s: float) -> None:
        self.box.request(encode_request(Request(Command.REAL_TIME)), _OTHER_CLIENT, at_s)

    def _show_status(self, _at_s: float) -> None:
        self.box.status |= self.faults.status

    def _saturate(self, _at_s: float) -> None:
        self.box.load_cell.overload()


def _is_turn(number: int, every: int) -> bool:
    return every > 0 and number % every == 0


def _records(datagrams: Iterable[Datagram]) -> int:
    return sum(len(data) for data, _ in datagrams) // RECORD_BYTES
