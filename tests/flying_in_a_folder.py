"""A campaign whose vehicle and load cell are simulated inside the test, on real wires, and on which `cfid` runs.

The test sees what the motors do, on the clock that it shares with every process of this computer.
"""

import os
import re
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, closing
from pathlib import Path
from typing import Any

from twisted.internet.threads import blockingCallFromThread

from cfid.records.files import RIG_FILE, RUNS_FOLDER
from cfid.records.rig_file import load_rig, new_rig_text
from cfid.records.run import Run, read_run
from cfid.rig.loop import Loop
from cfid.sim.devices import SimulatedRig
from cfid.sim.faults import CrazyflieFaults, LoadCellFaults
from cfid.sim.propulsion import STILL, Four
from cfid.sim.service import ServedRig
from cfid.sim.truth import SimTruth
from tests.priority import kept_waiting_s
from tests.rig_in_a_folder import LONGEST_S, Running, in_a_loop

LOADCELL_HZ = 700


class Pilot(Running):
    """A running `cfid` that may drive motors."""

    def __init__(self, bench: "Bench", words: tuple[object, ...], **options: Any) -> None:
        super().__init__(words, bench.folder, bench.environment, **options)
        self._bench = bench

    def wait_until_motors_run(self, for_s: float = 0.2) -> None:
        """Wait until motors have run for `for_s` seconds."""
        self._bench.wait_until(lambda: any(self._bench.motors) or self.process.poll() is not None, self)
        assert any(self._bench.motors), f"no motor ran\n{self.out}{self.err}"
        time.sleep(for_s)

    def send(self, *numbers: int) -> None:
        for number in numbers:
            self.process.send_signal(number)
            time.sleep(0.02)

    def end(self) -> int:
        """Wait for the end of the program and return its exit code."""
        return self.wait()


class Bench:
    """The campaign's folder, and the simulated rig that runs in parallel with the test."""

    def __init__(self, folder: Path, loop: Loop, *, hung_on: str | None = None, **truth: Any) -> None:
        self.folder = folder
        self.environment = {
            **os.environ,
            "TMPDIR": str(folder),
            "CFID_LOCKS": str(folder / "cfid-locks"),
            "XDG_CACHE_HOME": str(folder / "cache"),
            "NO_COLOR": "1",
            "COLUMNS": "100",
        }
        self.history: list[tuple[float, Four]] = [(0.0, STILL)]
        self._loop = loop
        self._pilots: list[Pilot] = []
        (folder / RIG_FILE).write_text(new_rig_text())
        rig = load_rig(folder / RIG_FILE)
        self.rig = SimulatedRig(
            rig if hung_on else rig.model_copy(update={"mounts": {}}),  # without mounts, no encoder swings
            axis=hung_on,
            seconds=loop.seconds,
            seed=5,
            truth=SimTruth.model_validate(truth),
            on_motors=lambda time_s, motors: self.history.append((time_s, motors)),
        )
        self._served = ServedRig(self.rig, reactor=loop, folder=folder)
        where = self.in_loop(self._served.open)
        self.uri = where.crazyflie_uri
        content = re.sub(r"(?ms)^\[devices\.\w+\].*?(?=^\[|^# The axis)", "", new_rig_text())
        (folder / RIG_FILE).write_text(
            f"{content}\n[devices.loadcell]\naddress = '{where.address}'\nrate_hz = {LOADCELL_HZ}\n"
            f"rdt_port = {where.rdt_port}\nhttp_port = {where.http_port}\ntcp_port = {where.tcp_port}\n"
            f"[devices.crazyflie]\nuri = '{self.uri}'\nstop_below_v = 3.1\n"
        )

    @property
    def motors(self) -> Four:
        """The present state of the motors."""
        return self.history[-1][1]

    def start(self, *words: object, **options: Any) -> Pilot:
        self._pilots.append(Pilot(self, words, **options))
        return self._pilots[-1]

    def vehicle_suffers(self, **faults: Any) -> None:
        """Set faults of the vehicle from now on; timed faults start at once."""
        self.rig.crazyflie.faults = CrazyflieFaults(**faults)

    def loadcell_suffers(self, **faults: Any) -> None:
        self.rig.loadcell.faults = LoadCellFaults(**faults)

    def in_loop(self, act: Callable[[], Any]) -> Any:
        """Run a function in the loop of the devices and return its result."""
        return blockingCallFromThread(self._loop, act)

    def wait_until(self, there: Any, pilot: Pilot) -> None:
        end_s = time.monotonic() + LONGEST_S
        while not there():
            assert time.monotonic() < end_s, f"waited in vain\n{pilot.out}{pilot.err}"
            time.sleep(0.005)

    def stopped_after(self, since_s: float) -> float:
        """Return how long after a time the motors were off, minus the computer's delay; 0 if they were off before."""
        end_s, late_s = since_s + LONGEST_S, 0.0
        while any(self.motors):
            assert time.monotonic() < end_s, "the motors are still on"
            late_s += kept_waiting_s()
        return max(self.history[-1][0] - since_s - late_s, 0.0)

    def run(self) -> Run:
        """Return the only run there is."""
        (folder,) = (self.folder / RUNS_FOLDER).iterdir()
        return read_run(folder)

    def close(self) -> None:
        for pilot in self._pilots:
            pilot.kill()
            if pilot.process.stdin is not None:
                pilot.process.stdin.close()
        self.in_loop(self._served.close)


def bench_in(folder: Path, *, hung_on: str | None = None, **truth: Any) -> AbstractContextManager[Bench]:
    """Open a bench in a folder; `truth` contains tables of the truth file.

    With `hung_on`, its vehicle swings on that mount.
    """
    return in_a_loop(lambda loop: closing(Bench(folder, loop, hung_on=hung_on, **truth)))
