"""`cfid log loadcell` over the simulated wire, against a logger like that of the thesis.

The latter makes a tuple of each packet, and a table of all packets at the end. The box sends each record separately, as
a real one does, so that every datagram can wake up its receiver. Processor time and resident memory are those of the
logger's process from second 10 to the end. Afterwards, losses are measured when the logger is stopped for half of every
second, and at ten times the rate of the box.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cfid.records.rig_file import Devices, load_rig, new_rig_text
from cfid.rig.loop import Ending, Loop, run_until_done
from cfid.rig.sim_file import SIM_FILE, published
from cfid.sim.faults import SOUND_LOADCELL, FaultyNetFT
from cfid.sim.loadcell import LoadCellTruth, SimulatedLoadCell
from cfid.sim.netft import NetFTBox
from cfid.sim.service import NetFTServer

SECONDS = float(os.environ.get("BENCH_SECONDS", "60"))
WARM_S = min(10.0, SECONDS / 3)
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
CFID = (sys.executable, "-m", "cfid.cli.main")
FAST_HZ = 70_000


class Cost(NamedTuple):
    """What a logger's process used: share of a core in percent, and resident memory at start and end in MB."""

    core_percent: float
    memory_from_mb: float
    memory_to_mb: float

    @property
    def grown_mb(self) -> float:
        return self.memory_to_mb - self.memory_from_mb


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rig.toml").write_text(new_rig_text())
        with serving(folder, internal_hz=7000):
            peer = measured(folder, sys.executable, "-c", PEER, str(rdt_port(folder)), str(folder / "peer.csv"))
            told("thesis-style logger, 7 kHz real-time", peer)
            cost = measured(folder, *CFID, "log", "loadcell", "--for", f"{SECONDS:g}")
            told("cfid log loadcell, 7 kHz", cost)
            print(f"  {lost(folder)}")
            print(f"core: {cost.core_percent:.1f} %  (goal: at most 2 %)")
            print(f"memory grown by {cost.grown_mb:.1f} MB  (goal: at most 5 MB)")
            print(f"ratio to the peer, core: {cost.core_percent / peer.core_percent:.2f}")
            stall(folder)
        with serving(folder, internal_hz=FAST_HZ):
            cost = measured(folder, *CFID, "log", "loadcell", "--for", f"{SECONDS:g}", "--rate-hz", str(FAST_HZ))
            told("cfid log loadcell, 70 kHz buffered", cost)
            print(f"  {lost(folder)}; goal none")


def stall(folder: Path) -> None:
    """Stop the logger's process for half of every second."""
    words = (*CFID, "log", "loadcell", "--for", f"{SECONDS:g}")
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as logger:
        time.sleep(2)
        end_s = time.monotonic() + SECONDS - 3
        while time.monotonic() < end_s:
            logger.send_signal(signal.SIGSTOP)
            time.sleep(0.5)
            logger.send_signal(signal.SIGCONT)
            time.sleep(0.5)
    print(f"cfid log loadcell, 7 kHz real-time, stopped for 500 ms once a second\n  {lost(folder)}; goal none")


@contextmanager
def serving(folder: Path, *, internal_hz: int) -> Iterator[None]:
    words = (sys.executable, __file__, "serve", str(folder), str(internal_hz))
    with subprocess.Popen(words, cwd=folder) as server:
        try:
            while not (folder / SIM_FILE).exists():
                time.sleep(0.1)
            yield
        finally:
            server.send_signal(signal.SIGINT)


def measured(folder: Path, *words: str) -> Cost:
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as logger:
        time.sleep(WARM_S)
        ticks, memory = ticks_of(logger.pid), memory_mb(logger.pid)
        spent_s = SECONDS - WARM_S - 1
        time.sleep(spent_s)
        cost = Cost(100 * (ticks_of(logger.pid) - ticks) / TICKS_PER_S / spent_s, memory, memory_mb(logger.pid))
        if PEER in words:
            logger.send_signal(signal.SIGINT)
    return cost


def ticks_of(process: int) -> int:
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12])


def memory_mb(process: int) -> float:
    line = next(line for line in Path(f"/proc/{process}/status").read_text().splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


def rdt_port(folder: Path) -> int:
    return int(tomllib.loads((folder / SIM_FILE).read_text())["devices"]["loadcell"]["rdt_port"])


def lost(folder: Path) -> str:
    run = max((folder / "runs").iterdir())
    device = tomllib.loads((run / "run.toml").read_text())["devices"]["loadcell"]
    return f"{device['rows']} rows, {device['lost']} lost"


def told(what: str, cost: Cost) -> None:
    print(f"{what}\n  {cost.core_percent:.1f} % of a core, {cost.memory_to_mb:.0f} MB, grown by {cost.grown_mb:.1f} MB")


PEER = """
import struct, sys, time
import pandas as pd
from twisted.internet import reactor
from twisted.internet.protocol import DatagramProtocol

rows = []

class Logger(DatagramProtocol):
    def startProtocol(self):
        self.transport.connect("127.0.0.1", int(sys.argv[1]))
        self.transport.write(struct.pack(">HHI", 0x1234, 2, 0))

    def datagramReceived(self, datagram, source):
        now = time.time()
        _, _, _, *counts = struct.unpack(">IIIiiiiii", datagram)
        rows.append((now, *counts))

reactor.listenUDP(0, Logger())
reactor.run()
pd.DataFrame(rows, columns=["t", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]).to_csv(sys.argv[2], index=False)
print(len(rows))
"""


def serve(folder: Path, internal_hz: int) -> None:
    """Serve a box that sends each sample as it is taken; a real box samples at 7 kHz."""

    async def served(loop: Loop, ending: Ending) -> None:
        box = NetFTBox(
            load_cell=SimulatedLoadCell(LoadCellTruth(), np.random.default_rng(1)),
            plant=lambda time_s: np.zeros((len(time_s), 6)),
            powered_s=loop.seconds(),
            internal_hz=internal_hz,
            rate_hz=internal_hz,
        )
        faulty = FaultyNetFT(box, SOUND_LOADCELL, opened_s=loop.seconds(), rng=np.random.default_rng(1))
        ports = NetFTServer(faulty, reactor=loop, sending_every_s=1 / 7000).open()
        setting = load_rig(folder / "rig.toml").devices.loadcell.model_copy(
            update={"address": "127.0.0.1", "rdt_port": ports.rdt, "http_port": ports.http, "tcp_port": ports.tcp}
        )
        with published(folder, Devices(loadcell=setting), seed=1):
            await ending.within(None)

    run_until_done(served)


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        serve(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        main()
