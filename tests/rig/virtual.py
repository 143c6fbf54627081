"""Instruments coupled to simulated devices inside one process, on a clock that the test advances."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
from twisted.internet.defer import Deferred
from twisted.internet.task import Clock
from twisted.python.failure import Failure

from cfid.records.run import DeviceRecord, Label, Run, read_run
from cfid.records.run_writer import create_run
from cfid.rig.clock import HostClock
from cfid.rig.e201_port import FoundPort
from cfid.rig.encoder import Encoder, Receiver, SerialLine
from cfid.rig.loadcell import LoadCell
from cfid.rig.loop import Ending
from cfid.rig.rdt_port import RECEIVE_BUFFER_BYTES, Inbox
from cfid.rig.recorder import Instrument, Recorder
from cfid.sim.e201 import E201Device
from cfid.sim.faults import EncoderFaults, FaultyE201, FaultyNetFT, LoadCellFaults
from cfid.sim.loadcell import LoadCellTruth
from cfid.sim.loadcell import SimulatedLoadCell as SimulatedCell
from cfid.sim.netft import NetFTBox
from cfid.sim.pty import InOrder
from cfid.wire.netft import read_settings

UNIX_S = 1_763_712_345.0
BOX = ("192.0.2.9", 49152)
CLIENT = ("192.0.2.10", 50000)
STEP_S = 0.005

Array = npt.NDArray[np.float64]


class RdtWire:
    """A network without delay between a load cell and its box."""

    buffer_bytes = RECEIVE_BUFFER_BYTES

    def __init__(self, box: FaultyNetFT, inbox: Inbox, clock: Clock) -> None:
        self.box, self.inbox, self.clock = box, inbox, clock
        self.deliver: Callable[[bytes, tuple[str, int], float], None] = inbox.add
        self.closed = False

    def send(self, datagram: bytes) -> None:
        self.drain()  # the box has sent all that was due before it receives a request
        self.box.request(datagram, CLIENT, self.clock.seconds())

    def drain(self) -> None:
        now_s = self.clock.seconds()
        for data, client in self.box.due(now_s):
            assert client == CLIENT
            self.deliver(data, BOX, now_s)

    def close(self) -> None:
        self.closed = True


class Session:
    """A run recorded from instruments in virtual time."""

    def __init__(self, runs_folder: Path, clock: Clock) -> None:
        self.clock = clock
        self.said: list[str] = []
        self.ending = Ending(clock)
        self.host = HostClock(UNIX_S)
        self._runs_folder = runs_folder

    def record(
        self,
        *instruments: Instrument,
        for_s: float | None,
        also: Callable[[float], None] = lambda now_s: None,
        step_s: float = STEP_S,
    ) -> tuple[Run, Exception | None]:
        """Record until the end, calling `also` at every step of the clock; return the run and the exception or None."""
        records = {one.name: DeviceRecord(file=f"{one.name}.csv", columns=one.columns) for one in instruments}
        run = create_run(
            self._runs_folder,
            kind="test",
            label=Label(),
            devices=records,
            started=datetime.fromtimestamp(UNIX_S, UTC),
            cfid_version="0",
        )
        recorder = Recorder(instruments, run, loop=self.clock, show=lambda: None)
        done: list[object] = []
        Deferred.fromCoroutine(recorder.record(lambda: self.ending.within(for_s))).addBoth(done.append)
        while not done:
            assert self.clock.seconds() < (for_s or 0.0) + 3600, "the recording does not end"
            self.clock.advance(step_s)
            also(self.clock.seconds())
        failure = done[0].value if isinstance(done[0], Failure) else None
        assert failure is None or isinstance(failure, Exception)
        run.close("failed" if failure else "complete", reason=str(failure or ""))
        return read_run(run.folder), failure


def loadcell(
    session: Session, faults: LoadCellFaults, *, buffered: bool = True, rate_hz: int = 700, first_ft: int = 1000
) -> tuple[LoadCell, FaultyNetFT, RdtWire]:
    """Couple a load cell to a simulated box, at a rate that keeps tests fast."""
    cell = SimulatedCell(LoadCellTruth(), np.random.default_rng(4))
    box = NetFTBox(
        load_cell=cell,
        plant=lambda time_s: np.outer(np.sin(time_s), (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)).astype(np.float64),
        rate_hz=rate_hz,
        buffer_size=14 if buffered else 1,
        first_ft_sequence=first_ft,
    )
    faulty = FaultyNetFT(box, faults, opened_s=session.clock.seconds(), rng=np.random.default_rng(5))
    inbox = Inbox(BOX)
    wire = RdtWire(faulty, inbox, session.clock)
    instrument = LoadCell(
        read_settings(box.page()),
        inbox,
        wire,
        where="box",
        loop=session.clock,
        clock=session.host,
        say=session.said.append,
        buffered=buffered,
    )
    return instrument, faulty, wire


def rows_of(run: Run, device: str) -> pd.DataFrame:
    return pd.read_csv(run.device_file(device))


class SerialWire:
    """A cable between an encoder and its interface, with the delays of the device.

    `held_s` returns for how long the computer holds up a reply that would arrive at a given time.
    """

    def __init__(
        self, device: FaultyE201, receiver: Receiver, clock: Clock, held_s: Callable[[float], float] | None = None
    ) -> None:
        self.device, self.receiver, self.clock, self._held_s = device, receiver, clock, held_s
        self.plugged = True
        self._replies = InOrder(self._deliver, clock=clock)

    def write(self, data: bytes) -> None:
        self._replies.send(self.device.received(data, self.clock.seconds()))

    def flow(self) -> None:
        """Deliver what a continuous output has sent."""
        if self.plugged and self.device.continuous:
            for _, reply in self.device.due(self.clock.seconds()):
                self.receiver.received(reply)

    def close(self) -> None:
        self.plugged = False

    def _deliver(self, reply: bytes) -> None:
        held_s = self._held_s(self.clock.seconds()) if self._held_s is not None else 0.0
        if held_s:
            self.clock.callLater(held_s, self._received, reply)
        else:
            self._received(reply)

    def _received(self, reply: bytes) -> None:
        if self.plugged:
            self.receiver.received(reply)


def encoder(
    session: Session,
    faults: EncoderFaults,
    *,
    continuous: bool = False,
    stamped: bool = True,
    first_stamp_us: int = 0,
    rate_hz: float = 100,
    held_s: Callable[[float], float] | None = None,
) -> tuple[Encoder, list[SerialWire]]:
    """Couple an encoder to a simulated interface on a slowly turning axis; the list collects every cable plugged in."""
    wires: list[SerialWire] = []
    device = E201Device(lambda time_s: 0.5 * time_s, reply_s=5e-4, first_stamp_us=first_stamp_us)
    device.stamps = stamped

    def plug(port: str, receiver: Receiver) -> SerialLine:
        wires.append(SerialWire(FaultyE201(device, faults, opened_s=0.0), receiver, session.clock, held_s))
        return wires[-1]

    found = FoundPort("port", "E201", "42", word_bits=22, positions=(0,), stamped=stamped)
    instrument = Encoder(
        found,
        open_line=plug,
        find=lambda: found,
        counts_per_turn="rls-13bit-in-22",
        rate_hz=rate_hz,
        continuous=continuous,
        loop=session.clock,
        clock=session.host,
        say=session.said.append,
    )
    return instrument, wires
