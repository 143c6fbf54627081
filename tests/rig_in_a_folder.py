"""A campaign whose rig is simulated inside the test, on real wires, and on which `cfid` runs as for an operator.

The faults of the two devices are set while a log runs, so that no test depends on how quickly a program starts.
"""

import os
import re
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from twisted.internet.posixbase import PosixReactorBase
from twisted.internet.threads import blockingCallFromThread

from cfid.records.files import RIG_FILE, RUNS_FOLDER
from cfid.records.rig_file import new_rig_text
from cfid.records.run import Run, read_run
from cfid.rig.loop import Loop
from cfid.rig.sim_file import SIM_FILE
from cfid.sim.e201 import E201Device
from cfid.sim.faults import (
    SOUND_ENCODER,
    SOUND_LOADCELL,
)
from cfid.sim.loadcell import LoadCellTruth, SimulatedLoadCell
from cfid.sim.netft import NetFTBox
from cfid.sim.pty import PtyPort
from cfid.sim.service import LOOPBACK, NetFTServer
from tests.priority import run_devices
from tests.processes import started
from tests.virtual_lab import ENCODER_HZ, LOADCELL_HZ, SENTENCE, Box, Interface, Said, load

LONGEST_S = 120.0  # any step may take this long on a busy computer

Act = TypeVar("Act")


Devices = TypeVar("Devices")


class Running:
    """A running `cfid`, whose output goes to files in its folder."""

    def __init__(self, words: tuple[object, ...], folder: Path, environment: dict[str, str], **options: Any) -> None:
        self._files = [folder / f".{name}{time.monotonic_ns()}" for name in ("out", "err")]
        with self._files[0].open("wb") as out, self._files[1].open("wb") as err:
            options = {"stdout": out, "stderr": err, **options}
            self.process = started(words, cwd=folder, env=environment, **options)

    @property
    def out(self) -> str:
        """The output so far."""
        return self._files[0].read_text()

    @property
    def err(self) -> str:
        """The output on stderr so far."""
        return self._files[1].read_text()

    def wait(self) -> int:
        """Wait for its end and return its exit code."""
        try:
            return self.process.wait(LONGEST_S)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"does not end\n{self.out}{self.err}") from None

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()


class Command(Running):
    """A command that records, or asks devices."""

    def __init__(self, words: tuple[object, ...], *, lab: "Lab", **options: Any) -> None:
        super().__init__(words, lab.folder, lab.environment, **options)
        self._lab = lab

    def wait_until_said(self, text: str, *, times: int = 1) -> None:
        self.wait_until(lambda: self.err.count(text) >= times, text)

    def wait_until(self, there: Callable[[], object], what: str) -> None:
        """Wait for an event that happens while the command runs."""

        def known() -> bool:
            assert self.process.poll() is None or there(), f"ended before: {what}\n{self.err}"
            return bool(there())

        wait_until(known, f"{what}\n{self.err}")

    def wait_for_rows(self, count: int) -> None:
        """Wait for `count` more rows in the file of the run that was started last."""
        self.wait_until(lambda: self._lab.rows() is not None, "a run")
        before = self._lab.rows() or 0
        self.wait_until(lambda: (self._lab.rows() or 0) >= before + count, f"{count} rows")

    def ask_to_end(self, number: signal.Signals = signal.SIGINT) -> Said:
        self.process.send_signal(number)
        return self.end()

    def end(self, *, streaming: bool = False) -> Said:
        """Wait for the end; check that no traceback is shown and that the box no longer streams.

        With `streaming`, check that the box continues to stream to another log.
        """
        code, out, err = self.wait(), self.out, self.err
        assert "Traceback" not in err
        assert "Unhandled" not in err
        if code != 2:  # the usage of a command is printed in a frame
            assert all(SENTENCE.match(line) for line in err.splitlines()), err
        wait_until(lambda: self._lab.box.streaming == streaming, f"streaming: {streaming}\n{err}")
        return Said(code, out, err)


class Lab:
    """A campaign folder and its rig: a box on three ports, and an encoder on a pseudo terminal."""

    def __init__(self, folder: Path, reactor: PosixReactorBase) -> None:
        self.folder = folder
        self.commands: list[Command] = []
        # Locks of devices, and the folder of the simulated rig, are in the folder of the test.
        self.locks = folder / "cfid-locks"
        places = {"TMPDIR": str(folder), "CFID_LOCKS": str(self.locks)}
        self.environment = {**os.environ, **places, "NO_COLOR": "1", "COLUMNS": "100"}
        self._reactor = reactor
        now_s = reactor.seconds()
        cell = SimulatedLoadCell(LoadCellTruth(), np.random.default_rng(4))
        netft = NetFTBox(
            load_cell=cell, plant=load, rate_hz=LOADCELL_HZ, buffer_size=14, first_ft_sequence=500_000, powered_s=now_s
        )
        self.box = Box(netft, SOUND_LOADCELL, opened_s=now_s, rng=np.random.default_rng(5))
        self._server = NetFTServer(self.box, reactor=reactor)
        self.e201 = E201Device(lambda time_s: 0.5 * time_s, reply_s=5e-4, powered_s=now_s)
        self.encoder = Interface(self.e201, SOUND_ENCODER, opened_s=now_s)
        self.plug = PtyPort(self.encoder, reactor=reactor, folder=folder, name="port")
        self.ports = self.in_reactor(self._server.open)
        self.port = self.in_reactor(self.plug.open)
        content = re.sub(r"(?ms)^\[devices\.\w+\].*?(?=^\[)", "", new_rig_text())
        (folder / RIG_FILE).write_text(
            f"{content}\n[devices.encoder]\nport = '{self.port}'\nrate_hz = {ENCODER_HZ}.0\n"
            f"[devices.loadcell]\naddress = '{LOOPBACK}'\nrate_hz = {LOADCELL_HZ}\n"
            f"rdt_port = {self.ports.rdt}\nhttp_port = {self.ports.http}\ntcp_port = {self.ports.tcp}\n"
        )

    def in_reactor(self, act: Callable[[], Act]) -> Any:
        """Run a function in the loop of the devices and return its result."""
        return blockingCallFromThread(self._reactor, act)  # type: ignore[arg-type]  # twisted hides that it is one

    def start(self, *words: object, **options: Any) -> Command:
        self.commands.append(Command(words, lab=self, **options))
        return self.commands[-1]

    def cfid(self, *words: object, streaming: bool = False) -> Said:
        """Run a command to its end."""
        return self.start(*words).end(streaming=streaming)

    def pull_plug(self) -> None:
        self.in_reactor(self.plug.close)

    def close(self) -> None:
        for command in self.commands:
            command.kill()
        self.pull_plug()
        self.in_reactor(self._server.close)

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


@contextmanager
def in_a_loop(make: Callable[[Loop], AbstractContextManager[Devices]]) -> Iterator[Devices]:
    """Make devices on wires, which a loop in a thread of its own runs."""
    loop = Loop()
    thread = threading.Thread(target=run_devices, args=(loop,))
    thread.start()
    try:
        with make(loop) as devices:
            yield devices
    finally:
        loop.callFromThread(loop.stop)
        thread.join(5)
    assert not thread.is_alive()
    loop.close()


def lab_in(folder: Path) -> AbstractContextManager[Lab]:
    """Open a rig in a folder."""
    return in_a_loop(lambda loop: closing(Lab(folder, loop)))


def wait_until(there: Callable[[], object], what: str) -> None:
    end_s = time.monotonic() + LONGEST_S
    while not there():
        assert time.monotonic() < end_s, f"waited in vain for {what}"
        time.sleep(0.02)


@contextmanager
def rig_sim(lab: Lab, *words: object) -> Iterator[Command]:
    """Run `cfid rig sim` in the campaign for as long as the block takes."""
    sim = lab.start("rig", "sim", *words)
    sim.wait_until((lab.folder / SIM_FILE).exists, SIM_FILE)
    sim.wait_until_said("until this ends")
    try:
        yield sim
    finally:
        with suppress(ProcessLookupError):
            sim.process.send_signal(signal.SIGINT)
        sim.process.wait(LONGEST_S)
