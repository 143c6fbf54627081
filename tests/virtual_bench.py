"""A campaign whose vehicle and load cell are simulated in virtual time, and on which `cfid` runs.

The test sees what the motors do, on the clock of the simulated hardware.
"""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cfid.errors import DeviceError
from cfid.records.files import RIG_FILE, RUNS_FOLDER
from cfid.records.rig_file import load_rig, new_rig_text
from cfid.records.run import Run, read_run
from cfid.rig.link import Link
from cfid.sim.devices import SimulatedRig
from cfid.sim.faults import CrazyflieFaults, LoadCellFaults
from cfid.sim.netft import Address
from cfid.sim.propulsion import STILL, Four
from cfid.sim.truth import SimTruth
from cfid.sim.virtual import Virtual
from cfid.wire.crtp import Packet, decode_packet, encode_packet
from tests.virtual_command import Command, Keyboard, PausingClock

LOADCELL_HZ = 700
UNIX_S = 1_763_712_345.0


class Pilot(Command):
    """A command that may drive motors."""

    def __init__(self, bench: "Bench", words: tuple[object, ...], keyboard: Keyboard | None, **options: Any) -> None:
        if keyboard is not None:
            options["stdin"] = keyboard.stdin
        if options.get("screen"):
            options["screen"] = keyboard
        super().__init__(bench.hardware, bench.folder, words, **options)
        self._bench = bench
        self.keyboard = keyboard

    def type(self, text: str) -> None:
        """Type text into the command."""
        assert self.keyboard is not None
        self.keyboard.type(text)

    def wait_until_motors_run(self, for_s: float = 0.2) -> None:
        """Wait until motors have run for `for_s` seconds."""
        self.wait_until(lambda: any(self._bench.motors), "motors")
        self.go_on_for(for_s)

    def end(self) -> int:
        """Wait for its end, and return its exit code."""
        return self.run_to_end()


class BenchHardware(Virtual):
    """A simulated rig whose vehicle refuses the next few links, as a radio that another program uses does."""

    links_refused = 0

    def link(self, uri: str) -> Link:
        """Open a link. Raises DeviceError for one that is refused."""
        if self.links_refused:
            self.links_refused -= 1
            raise DeviceError(f"{uri}: [Errno 16] Resource busy.")
        return super().link(uri)


class Bench:
    """The campaign's folder, and its simulated rig; `truth` contains tables of the truth file."""

    def __init__(self, folder: Path, *, hung_on: str | None = None, **truth: Any) -> None:
        self.folder = folder
        os.environ.setdefault("XDG_CACHE_HOME", str(folder / "cache"))
        content = re.sub(r"(?ms)^\[devices\.\w+\].*?(?=^\[|^# The axis)", "", new_rig_text())
        (folder / RIG_FILE).write_text(
            f"{content}\n[devices.loadcell]\nrate_hz = {LOADCELL_HZ}\n[devices.crazyflie]\nstop_below_v = 3.1\n"
        )
        self.history: list[tuple[float, Four]] = [(0.0, STILL)]
        self._pilots: list[Pilot] = []
        self._keyboards: list[Keyboard] = []
        self._truth, self._hung_on = truth, hung_on
        self.hardware = BenchHardware(self._rig, unix_s=UNIX_S, time=PausingClock())
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

    def start(
        self, *words: object, typed: str | None = None, terminal: bool = False, script: bool = False, **options: Any
    ) -> Pilot:
        """Start a command. `typed` is all its input; a terminal or a script types while it runs.

        With `screen`, the terminal is also where it prints.
        """
        keyboard = Keyboard(terminal=terminal) if terminal or script or typed is not None else None
        if keyboard is not None:
            self._keyboards.append(keyboard)
        if keyboard is not None and typed is not None:
            keyboard.type(typed)
            keyboard.hang_up()
        self._pilots.append(Pilot(self, words, keyboard, **options))
        return self._pilots[-1]

    def send(self, packet: Packet) -> None:
        """Send a packet to the vehicle as another program does, which gets no answer."""
        self.rig.crazyflie.vehicle.receive(encode_packet(packet), self.hardware.seconds())
        self.hardware.attend_vehicle()

    def send_often(self, every_s: float, *packets: Packet) -> None:
        """Send packets as another program does, from now on."""
        for packet in packets:
            self.send(packet)
        self.hardware.at(every_s, self.send_often, every_s, *packets)

    def disturb(
        self,
        arriving: Callable[[Packet], Sequence[Packet]] = lambda packet: [packet],
        leaving: Callable[[Packet], bool] = lambda packet: True,
    ) -> None:
        """Disturb the link: `arriving` returns what arrives of a packet from the vehicle.

        Of the packets to the vehicle those pass for which `leaving` is true.
        """
        vehicle = self.rig.crazyflie
        received, arrivals = vehicle.received, vehicle.arrivals

        def disturbed(now_s: float) -> list[tuple[bytes, Address, float]]:
            return [
                (encode_packet(sent), client, arrived_s)
                for datagram, client, arrived_s in arrivals(now_s)
                if (packet := decode_packet(datagram))
                for sent in arriving(packet)
            ]

        def filtered(datagram: bytes, client: Address, now_s: float) -> None:
            packet = decode_packet(datagram)
            if packet is not None and leaving(packet):
                received(datagram, client, now_s)

        vehicle.arrivals, vehicle.received = disturbed, filtered  # type: ignore[method-assign]

    def packets(self) -> list[Packet]:
        """Return a list that takes the packets to the vehicle from now on."""
        sent: list[Packet] = []

        def note(packet: Packet) -> bool:
            sent.append(packet)
            return True

        self.disturb(leaving=note)
        return sent

    def close(self) -> None:
        for pilot in self._pilots:
            pilot.abandon()
        for keyboard in self._keyboards:
            keyboard.close()

    def vehicle_suffers(self, **faults: Any) -> None:
        """Set faults of the vehicle from now on; timed faults start at once."""
        self.rig.crazyflie.faults = CrazyflieFaults(**faults)
        self.hardware.attend_vehicle()

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
    bench = Bench(folder, hung_on=hung_on, **truth)
    try:
        yield bench
    finally:
        bench.close()
