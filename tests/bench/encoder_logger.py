"""`cfid log encoder` at 1 kHz over a pseudo terminal, against a logger like that of the thesis.

The latter polls again as soon as an answer has arrived, and keeps a list until the end. The processor times per sample
are compared. cfid's log is judged on the time grid of the rate: a grid point without its own row was missed, whether
the poll was skipped or got no answer.
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

import numpy as np
import pandas as pd

from cfid.records.rig_file import new_rig_text
from cfid.rig.sim_file import SIM_FILE
from cfid.wire.rls import decode_words

SECONDS = float(os.environ.get("BENCH_SECONDS", "60"))
BUSY = int(os.environ.get("BENCH_BUSY", "4"))
CFID = (sys.executable, "-m", "cfid.cli.main")

PEER = """
import sys, time
import pandas as pd
from twisted.internet import reactor
from twisted.internet.serialport import SerialPort
from twisted.protocols.basic import LineReceiver

rows = []

class Logger(LineReceiver):
    delimiter = b"\\r"

    def connectionMade(self):
        self.transport.write(b"!")

    def lineReceived(self, line):
        rows.append((time.time(), line.split(b":")[0].decode()))
        self.transport.write(b"!")

SerialPort(Logger(), sys.argv[1], reactor, baudrate=115200)
reactor.run()
pd.DataFrame(rows, columns=["t", "phi"]).to_csv(sys.argv[2], index=False, float_format="%.6f")
"""


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rig.toml").write_text(new_rig_text())
        with serving(folder), busy():
            port = tomllib.loads((folder / SIM_FILE).read_text())["devices"]["encoder"]["port"]
            theirs_s = processor_s(folder, sys.executable, "-c", PEER, port, str(folder / "peer.csv"))
            ours_s = processor_s(folder, *CFID, "log", "encoder")
        told_peer(folder / "peer.csv", theirs_s)
        told(max((folder / "runs").iterdir()), ours_s, theirs_s / len(pd.read_csv(folder / "peer.csv")))


def told_peer(path: Path, spent_s: float) -> None:
    rows = pd.read_csv(path)
    print(f"thesis-style logger: {len(rows)} rows, {1e6 * spent_s / len(rows):.0f} us of processor time a sample")


def told(run: Path, spent_s: float, peer_s: float) -> None:
    device = tomllib.loads((run / "run.toml").read_text())["devices"]["encoder"]
    rows = pd.read_csv(run / "encoder.csv")
    steps_s = np.diff(rows["t"])
    wrong = int((~decode_words(rows["phi"].to_numpy()).valid).sum())
    each_s = spent_s / len(rows)
    places = round(np.ptp(rows["t"]) * device["rate_hz"]) + 1
    print(f"cfid log encoder:    {len(rows)} rows, {1e6 * each_s:.0f} us of processor time a sample")
    missed = 1e4 * (1 - len(rows) / places)
    print(f"of {places} places missed beside {BUSY} busy programs: {missed:.2f} in 10 000  (goal: at most 1)")
    print(f"    {device['skipped']} skipped, {device['lost']} lost; {wrong} words wrong (goal: none)")
    slow = int(np.sum(steps_s > 2e-3))
    print(f"rate achieved: {1 / steps_s.mean():.2f}  (goal: {device['rate_hz']:g} Hz)")
    print(f"  {slow} steps above 2 ms, {1e3 * steps_s.max():.1f} ms at most")
    print(f"ratio to the peer, processor time a sample: {each_s / peer_s:.2f}")


@contextmanager
def busy() -> Iterator[None]:
    """Keep the processors busy with other programs."""
    words = (sys.executable, "-c", "while True: pass")
    others = [subprocess.Popen(words) for _ in range(BUSY)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


@contextmanager
def serving(folder: Path) -> Iterator[None]:
    with subprocess.Popen((*CFID, "rig", "sim", "--axis", "x"), cwd=folder, stderr=subprocess.DEVNULL) as server:
        try:
            while not (folder / SIM_FILE).exists():
                time.sleep(0.1)
            yield
        finally:
            server.send_signal(signal.SIGINT)


def processor_s(folder: Path, *words: str) -> float:
    """Run a logger for SECONDS, end it with Ctrl-C, and return the processor time that it took."""
    before = os.times()
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as logger:
        time.sleep(SECONDS)
        logger.send_signal(signal.SIGINT)
    after = os.times()
    return after.children_user - before.children_user + after.children_system - before.children_system


if __name__ == "__main__":
    main()
