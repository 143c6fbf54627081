"""A campaign whose encoder and load cell are simulated in virtual time, and on which `cfid` runs as for an operator."""

import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from cfid.records.files import RIG_FILE, RUNS_FOLDER
from cfid.records.rig_file import EncoderPort, load_rig, new_rig_text
from cfid.records.run import Label, Run, read_run
from cfid.rig.instrument import Instrument
from cfid.rig.run import Plan, record_run
from cfid.sim.devices import SimulatedRig
from cfid.sim.e201 import E201Device, Reply
from cfid.sim.faults import SOUND_ENCODER, SOUND_LOADCELL, EncoderFaults, FaultyNetFT, FaultySerial, LoadCellFaults
from cfid.sim.loadcell import LoadCellTruth, SimulatedLoadCell
from cfid.sim.netft import Address, Datagram, NetFTBox
from cfid.sim.virtual import Virtual
from cfid.wire.e201 import STOP_CONTINUOUS
from cfid.wire.rdt import Command as RdtCommand
from cfid.wire.rdt import Request, encode_request
from tests.lab import ROOT
from tests.virtual_command import Command, PausingClock

LOADCELL_HZ = 700  # instead of 7000: a tenth of the work with the same code
ENCODER_HZ = 100
USUAL_DEVICES = f"[devices.encoder]\nrate_hz = {ENCODER_HZ}\n[devices.loadcell]\nrate_hz = {LOADCELL_HZ}\n"
UNIX_S, STARTED_S = 1_763_712_345.0, 1.0  # when a lab is opened, also on the clock of its hardware

SENTENCE = re.compile(r"(note: |cfid: |recording into |figure: |\S*rig.sim.toml: |\S+/port: )")
Array = npt.NDArray[np.float64]


class Box(FaultyNetFT):
    """A box that remembers its last client.

    A `thief` takes the stream from its present client once the stream has started.
    """

    client: Address = ("", 0)
    thief: Address | None = None

    def due(self, now_s: float) -> list[Datagram]:
        """Return the datagrams that leave for the client now."""
        datagrams = super().due(now_s)
        if datagrams and self.thief is not None:
            self.box.request(encode_request(Request(RdtCommand.REAL_TIME, 1)), self.thief, now_s)
        return [datagram for datagram in datagrams if datagram[1] != self.thief]

    def request(self, datagram: bytes, client: Address, now_s: float) -> None:
        """Handle an RDT request."""
        self.client = client
        super().request(datagram, client, now_s)


class Interface(FaultySerial):
    """An encoder's interface that counts requests; if `unstoppable`, it ignores stops."""

    contacts = 0
    unstoppable = False

    def received(self, data: bytes, now_s: float) -> list[Reply]:
        """Return the replies to `data`, each with its delay."""
        self.contacts += 1
        return super().received(data.replace(STOP_CONTINUOUS, b"") if self.unstoppable else data, now_s)


class Said(NamedTuple):
    """The exit code and the output of a command that has ended."""

    code: int
    out: str
    err: str


class LabCommand(Command):
    """A command that records, or asks devices."""

    def __init__(self, lab: "Lab", words: tuple[object, ...], **options: Any) -> None:
        super().__init__(lab.hardware, lab.folder, words, **options)
        self._lab = lab

    def wait_for_rows(self, count: int) -> None:
        """Wait for `count` more rows in the file of the run that was started last."""
        self.wait_until(lambda: self._lab.rows() is not None, "a run")
        before = self._lab.rows() or 0
        self.wait_until(lambda: (self._lab.rows() or 0) >= before + count, f"{count} rows")

    def ask_to_end(self, number: signal.Signals = signal.SIGINT) -> Said:
        self.request_end(number.name)
        return self.end()

    def end(self, *, streaming: bool = False) -> Said:
        """Wait for the end; check that each line is a sentence, and that the box no longer streams."""
        code = self.run_to_end()
        if code != 2:  # the usage of a command is printed in a frame
            assert all(SENTENCE.match(line) for line in self.err.splitlines()), self.err
        assert self._lab.box.streaming == streaming
        return Said(code, self.out, self.err)


class Board:
    """A device that sends unprompted, from when it is plugged in: what `sent` returns at each place of a grid of time.

    What becomes due while nobody looks waits, and then comes in one piece, as from a system's buffer.
    """

    continuous = True

    def __init__(self, sent: Callable[[int], bytes], *, rate_hz: float) -> None:
        self._sent, self._rate_hz = sent, rate_hz
        self.count = 0
        self._begun_s: float | None = None

    def received(self, data: bytes, now_s: float) -> list[Reply]:
        """Return nothing."""
        return []

    def due(self, now_s: float) -> list[Reply]:
        """Return what is sent up to now."""
        if self._begun_s is None:
            self._begun_s = now_s
        end = int((now_s - self._begun_s) * self._rate_hz + 1e-6) + 1
        places, self.count = range(self.count, end), end
        data = b"".join(map(self._sent, places))
        return [(0.0, data)] if data else []


class Lab:
    """A campaign folder and its rig: a box, and an encoder, or the `devices` that are given as tables of rig.toml."""

    def __init__(self, folder: Path, devices: str = USUAL_DEVICES) -> None:
        self.folder = folder
        content = re.sub(r"(?ms)^\[devices\.\w+\].*?(?=^\[)", "", new_rig_text())
        (folder / RIG_FILE).write_text(f"{content}\n{devices}\n")
        self.time = PausingClock()
        self.hardware = Virtual(self._rig, unix_s=UNIX_S, time=self.time)
        self.port = next(iter(self.hardware.ports))
        self._commands: list[LabCommand] = []

    def _rig(self, seconds: Any) -> SimulatedRig:
        rig = load_rig(self.folder / RIG_FILE).model_copy(update={"mounts": {}})
        simulated = SimulatedRig(rig, seconds=seconds, seed=1)
        netft = NetFTBox(
            load_cell=SimulatedLoadCell(LoadCellTruth(), np.random.default_rng(4)),
            plant=load,
            rate_hz=LOADCELL_HZ,
            buffer_size=14,
            first_ft_sequence=500_000,
            powered_s=seconds(),
        )
        self.box = Box(netft, SOUND_LOADCELL, opened_s=seconds(), rng=np.random.default_rng(5))
        self.e201 = E201Device(lambda time_s: 0.5 * time_s, reply_s=5e-4, powered_s=seconds())
        self.encoder = Interface(self.e201, SOUND_ENCODER, opened_s=seconds())
        simulated.loadcell = self.box
        if isinstance(rig.devices.encoder, EncoderPort):
            simulated.encoder = self.encoder
        return simulated

    def start(self, *words: object, **options: Any) -> LabCommand:
        self._commands.append(LabCommand(self, words, **options))
        return self._commands[-1]

    def cfid(self, *words: object, streaming: bool = False) -> Said:
        """Run a command to its end."""
        return self.start(*words).end(streaming=streaming)

    def loadcell_suffers(self, **faults: Any) -> None:
        """Set faults of the load cell from now on; timed faults start at once and last until others are set."""
        self.box.faults = LoadCellFaults(**faults)

    def encoder_suffers(self, **faults: Any) -> None:
        self.encoder.faults = EncoderFaults(**faults)

    def plug_in(self, board: Board, path: str = "") -> str:
        """Plug a board in, by default in place of the load cell that sends lines; return its path."""
        path = path or list(self.hardware.ports)[1]
        if path in self.hardware.ports:
            self.hardware.ports[path].close()
        self.hardware.plug_in(path, FaultySerial(board, SOUND_ENCODER, opened_s=self.hardware.seconds()))
        return path

    def unplug(self, path: str) -> None:
        self.hardware.ports[path].unplug()

    def plug_back(self, path: str) -> None:
        """Connect a board again, which went on sending meanwhile."""
        self.hardware.ports[path].plug()

    def cut_power(self, for_s: float) -> None:
        """Restart the box, which counts from zero afterwards."""
        elapsed_s = self.hardware.seconds() - STARTED_S
        self.loadcell_suffers(restart_after_s=elapsed_s, restart_for_s=for_s)

    def pull_plug(self) -> None:
        self.hardware.ports[self.port].close()

    def put_plug_back(self) -> None:
        self.hardware.ports[self.port].begin()

    def run_folder(self) -> Path | None:
        """Return the folder of the run that was started last."""
        return max((self.folder / RUNS_FOLDER).glob("*"), key=lambda path: path.stat().st_mtime_ns, default=None)

    def run(self) -> Run:
        """Return the only run there is."""
        (folder,) = (self.folder / RUNS_FOLDER).iterdir()
        return read_run(folder)

    def rows(self) -> int | None:
        """Return how many rows the last run has so far."""
        folder = self.run_folder()
        files = [] if folder is None else list(folder.glob("*.csv"))
        return max(files[0].read_bytes().count(b"\n") - 1, 0) if files else None

    def facts(self, device: str) -> dict[str, Any]:
        return dict(self.run().header.devices[device].model_extra or {})


class Recorded:
    """The recording of one device: its rows, what it lost, its gaps and facts; `times_s` count from `begun_s`."""

    def __init__(self, run: Run, device: str, *, begun_s: float) -> None:
        self.run, self.device, self.begun_s = run, run.header.devices[device], begun_s
        self.lost: Any = self.device.lost
        self.facts: dict[str, Any] = dict(self.device.model_extra or {})
        self.losses = Counter[str](self.facts.get("losses"))  # a kind that did not happen is left out
        self.gaps: list[dict[str, Any]] = self.facts.get("gaps", [])
        self.reasons = [gap["reason"] for gap in self.gaps]
        self.rows = pd.read_csv(run.device_file(device))
        self.times_s = self.rows["t"].to_numpy() - UNIX_S + STARTED_S - begun_s


class Logged(Recorded):
    """A recording that a command made; things happen `at` seconds from its start."""

    def __init__(self, lab: Lab, device: str, *words: object, at: Mapping[float, Callable[[], object]]) -> None:
        begun_s = lab.hardware.seconds()
        for seconds, act in at.items():
            lab.hardware.at(seconds, act)
        self.ended = lab.cfid("log", device, *words)
        self.took_s = lab.hardware.seconds() - begun_s
        super().__init__(lab.run(), device, begun_s=begun_s)


def recorded(
    hardware: Virtual, folder: Path, *instruments: Instrument, **plan: Any
) -> tuple[Run, Exception | None, list[str]]:
    """Record instruments; return the run, the error that was raised or None, and what was said."""
    said: list[str] = []
    error: Exception | None = None
    try:
        record_run(
            Plan(runs_folder=folder / RUNS_FOLDER, kind="test", label=Label(), **plan),
            instruments,
            hardware,
            show=lambda _: None,
            begun=lambda _: None,
            say=said.append,
        )
    except Exception as raised:
        error = raised
    return read_run(max((folder / RUNS_FOLDER).iterdir())), error, said


@contextmanager
def held_elsewhere(device: str) -> Iterator[int]:
    """Let another process hold a device; yield its number."""
    code = "import sys; from cfid.rig.lock import DeviceLock; _ = DeviceLock(sys.argv[1]); print(); input()"
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", code, device], cwd=ROOT, **pipes) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdout.readline()
        yield process.pid
        process.stdin.write(b"\n")


def load(time_s: Array) -> Array:
    return np.outer(np.sin(time_s), (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)).astype(np.float64)


@contextmanager
def lab_in(folder: Path, devices: str = USUAL_DEVICES) -> Iterator[Lab]:
    """Open a rig in a folder."""
    yield Lab(folder, devices)
