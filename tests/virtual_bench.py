"""A campaign whose vehicle and load cell are simulated in virtual time, and on which `cfid` runs.

The test sees what the motors do, on the clock of the simulated hardware.
"""

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cfid.records.files import RIG_FILE, RUNS_FOLDER
from cfid.records.rig_file import load_rig, new_rig_text
from cfid.records.run import Run, read_run
from cfid.sim.devices import SimulatedRig
from cfid.sim.faults import CrazyflieFaults, LoadCellFaults
from cfid.sim.propulsion import STILL, Four
from cfid.sim.truth import SimTruth
from cfid.sim.virtual import Virtual
from tests.virtual_command import Command, PausingClock

LOADCELL_HZ = 700
UNIX_S = 1_763_712_345.0


class Pilot(Command):
    """A command that may drive motors."""

    def __init__(self, bench: "Bench", words: tuple[object, ...], **options: Any) -> None:
        super().__init__(bench.hardware, bench.folder, words, **options)
        self._bench = bench

    def wait_until_motors_run(self, for_s: float = 0.2) -> None:
        """Wait until motors have run for `for_s` seconds."""
        self.wait_until(lambda: any(self._bench.motors), "motors")
        self.go_on_for(for_s)

    def end(self) -> int:
        """Wait for its end, and return its exit code."""
        return self.run_to_end()


class Bench:
    """The campaign's folder, and its simulated rig; `truth` contains tables of the truth file."""

    def __init__(self, folder: Path, *, hung_on: str | None = None, **truth: Any) -> None:
        self.folder = folder
        content = re.sub(r"(?ms)^\[devices\.\w+\].*?(?=^\[|^# The axis)", "", new_rig_text())
        (folder / RIG_FILE).write_text(
            f"{content}\n[devices.loadcell]\nrate_hz = {LOADCELL_HZ}\n[devices.crazyflie]\nstop_below_v = 3.1\n"
        )
        self.history: list[tuple[float, Four]] = [(0.0, STILL)]
        self._truth, self._hung_on = truth, hung_on
        self.hardware = Virtual(self._rig, unix_s=UNIX_S, time=PausingClock())
        self.rig = self.hardware.rig
        self.uri = self.hardware.find_vehicle()

    def _rig(self, seconds: Callable[[], float]) -> SimulatedRig:
        rig = load_rig(self.folder / RIG_FILE)
        return SimulatedRig(
            rig if self._hung_on else rig.model_copy(update={"mounts": {}}),  # without mounts, no encoder swings
            axis=self._hung_on,
            seconds=seconds,
            seed=5,
            truth=SimTruth.model_validate(self._truth),
            on_motors=lambda time_s, motors: self.history.append((time_s, motors)),
        )

    @property
    def motors(self) -> Four:
        """The present state of the motors."""
        return self.history[-1][1]

    def start(self, *words: object, **options: Any) -> Pilot:
        return Pilot(self, words, **options)

    def vehicle_suffers(self, **faults: Any) -> None:
        """Set faults of the vehicle from now on; timed faults start at once."""
        self.rig.crazyflie.faults = CrazyflieFaults(**faults)

    def loadcell_suffers(self, **faults: Any) -> None:
        self.rig.loadcell.faults = LoadCellFaults(**faults)

    def stopped_after(self, since_s: float) -> float:
        """Return how long after a time the motors were off; 0 if they were off before."""
        assert not any(self.motors)
        return max(self.history[-1][0] - since_s, 0.0)

    def run(self) -> Run:
        """Return the only run there is."""
        (folder,) = (self.folder / RUNS_FOLDER).iterdir()
        return read_run(folder)


@contextmanager
def bench_in(folder: Path, *, hung_on: str | None = None, **truth: Any) -> Iterator[Bench]:
    """Open a bench in a folder; with `hung_on`, its vehicle swings on that mount."""
    os.environ.setdefault("XDG_CACHE_HOME", str(folder / "cache"))
    yield Bench(folder, hung_on=hung_on, **truth)
