"""A simulated rig in a thread of the test, and a process that logs both of its devices into one run.

Run as a program, `python -m tests.rig.streaming_rig CAMPAIGN [SECONDS]`, this module is that process.
"""

import contextlib
import io
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from twisted.internet.threads import blockingCallFromThread

from cfid.recordings.angle import angle_record
from cfid.recordings.read import read_recording
from cfid.recordings.wrench import wrench_of
from cfid.records.campaign import find_campaign
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import load_rig, new_rig_text
from cfid.records.run import Label, Run, read_run
from cfid.rig.encoder import ready_encoder
from cfid.rig.hardware import Real
from cfid.rig.loadcell import ready_loadcell
from cfid.rig.lock import holder_of
from cfid.rig.loop import Loop
from cfid.rig.run import Plan, record_run
from cfid.rig.sim_file import devices_in, published
from cfid.sim.devices import SimulatedRig
from cfid.sim.service import Addresses, ServedRig, devices_at
from cfid.wire.rls import STEPS_PER_TURN, decode_words
from tests.places import ROOT
from tests.priority import run_devices

DEVICES = ("encoder", "loadcell")
PATIENCE_S = 30.0

_FASTEST_STEPS_PER_S = 21_000  # of the swing: 16 rad/s; the drawn releases come close to it (15.5)


@dataclass(frozen=True)
class CampaignRig:
    """A simulated rig that serves a campaign."""

    campaign: Path
    rig: SimulatedRig
    addresses: Addresses

    @property
    def streaming(self) -> bool:
        return self.rig.loadcell.streaming

    def holders(self) -> list[str]:
        """Return who holds the devices."""
        addresses = self.addresses
        places = (str(addresses.encoder_port), f"{addresses.address}:{addresses.rdt_port}")
        return [holder for place in places if (holder := holder_of(place))]


@contextlib.contextmanager
def served_rig(folder: Path, *, seed: int = 1) -> Iterator[CampaignRig]:
    """Serve a rig on real wires, with a campaign folder whose rig.sim.toml names its addresses."""
    folder.mkdir(exist_ok=True)
    (folder / RIG_FILE).write_text(new_rig_text())
    rig = load_rig(folder / RIG_FILE)
    loop = Loop()
    thread = threading.Thread(target=run_devices, args=(loop,))
    thread.start()
    try:
        simulated = _in_loop(
            loop,
            lambda: SimulatedRig(rig, seconds=loop.seconds, seed=seed, axis="x", commands=(28000, 0, 28000, 0)),
        )
        served = ServedRig(simulated, reactor=loop, folder=folder)
        addresses = _in_loop(loop, served.open)
        with published(folder, devices_at(addresses, rig.devices), seed=seed):
            yield CampaignRig(folder, simulated, addresses)
        _in_loop(loop, served.close)
    finally:
        loop.callFromThread(loop.stop)
        thread.join(5)
        loop.close()


def _in_loop(loop: Loop, act: Callable[[], Any]) -> Any:
    return blockingCallFromThread(loop, act)


@dataclass
class Logger:
    """A process that records a run into `folder`."""

    process: "subprocess.Popen[str]"
    folder: Path

    def wait_for_rows(self) -> None:
        """Wait until the files of both devices have enough rows for a recording."""
        end_s = time.monotonic() + PATIENCE_S
        while any((self.folder / f"{name}.csv").stat().st_size < 2000 for name in DEVICES):
            assert time.monotonic() < end_s, "no rows"
            assert self.process.poll() is None, self.process.communicate()
            time.sleep(0.002)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def end(self, *signals: signal.Signals) -> str:
        """Send signals and wait for the end; return exit code and output after a failure or an error message, or ""."""
        for number in signals:
            self.process.send_signal(number)
        out, err = self.process.communicate(timeout=PATIENCE_S)
        return f"exit code {self.process.returncode}: {out}{err}" if self.process.returncode or err else ""


@contextlib.contextmanager
def logger(rig: CampaignRig, *words: str) -> Iterator[Logger]:
    """Start a process that logs both devices of a rig, and kill it when the block ends."""
    command = [sys.executable, "-W", "error", "-m", "tests.rig.streaming_rig", str(rig.campaign), *words]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            folder = process.stdout.readline().strip()
            assert folder, process.communicate()
            yield Logger(process, Path(folder))
        finally:
            process.kill()


def whole_rows(path: Path) -> pd.DataFrame:
    """Read the rows that end with a newline; each has all columns and only numbers."""
    text = path.read_bytes()
    rows = pd.read_csv(io.BytesIO(text[: text.rfind(b"\n") + 1]), dtype=np.float64)
    assert not rows.isna().to_numpy().any()
    assert not isinstance(rows.index, pd.MultiIndex)
    return rows


def check_loadcell(rows: pd.DataFrame) -> None:
    """Check that no record is missing, doubled or wrong, and that the times are those of a steady clock."""
    assert rows["rdt_sequence"].iloc[0] == 1
    assert np.all(np.diff(rows["rdt_sequence"]) == 1)
    assert np.all(np.diff(rows["ft_sequence"]) == 1)
    assert np.all(rows["status"] == 0)
    assert np.abs(np.diff(rows["t"]) - 1 / 7000).max() < 1e-4
    assert np.abs(rows[["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]]).to_numpy().max() < 1e7  # 10 N


def check_encoder(rows: pd.DataFrame) -> None:
    """Check that every word is valid and that the axis never moves faster, by the device's own clock, than it can."""
    words = decode_words(rows["phi"].to_numpy(dtype=np.int64))
    assert words.valid.all()
    half = STEPS_PER_TURN // 2
    moved = (np.diff(words.position) + half) % STEPS_PER_TURN - half
    passed_s = 1e-6 * np.diff(rows["device_us"])
    assert np.all(np.diff(rows["t"]) > 0)
    assert np.all(passed_s > 0)
    assert np.all(np.abs(moved) <= 1 + _FASTEST_STEPS_PER_S * passed_s)


def check_rows(folder: Path) -> dict[str, pd.DataFrame]:
    """Return the rows of both devices after a check that they are right."""
    rows = {name: whole_rows(folder / f"{name}.csv") for name in DEVICES}
    check_loadcell(rows["loadcell"])
    check_encoder(rows["encoder"])
    return rows


def check_cut_run(folder: Path) -> dict[str, pd.DataFrame]:
    """Return the rows of a run that was cut, after a check that it opens, is reported as cut, and has no wrong row."""
    run = read_run(folder)
    assert run.cut
    rows = check_rows(folder)
    for record in (angle_record(folder), wrench_of(read_recording(folder))):
        assert any("the run was cut" in note for note in record.notes)
        assert len(record.time_s) > 0
    return rows


def check_complete_run(folder: Path) -> Run:
    """Return a run after a check that it is complete: every row is there and right, and run.toml counts them."""
    run = read_run(folder)
    assert run.header.state == "complete", run.header.reason
    rows = check_rows(folder)
    assert {name: len(rows[name]) for name in DEVICES} == {name: run.header.devices[name].rows for name in DEVICES}
    assert run.header.devices["loadcell"].lost == 0
    facts = run.header.devices["encoder"].model_extra or {}
    assert len(rows["encoder"]) + facts["losses"]["polls_without_position"] == facts["polls"]
    assert not list(folder.glob(".*"))
    return run


def _record(campaign_folder: Path, for_s: float | None) -> None:
    campaign = find_campaign(campaign_folder, start=campaign_folder)
    assert campaign is not None
    devices, simulated = devices_in(campaign.folder, campaign.rig)
    plan = Plan(runs_folder=campaign.runs_folder, kind="both", label=Label(), for_s=for_s, simulated=simulated)
    hardware = Real()
    with ExitStack() as held:
        ready = [
            ready_encoder(
                devices.encoder, hardware, held, counts_per_turn=campaign.rig.encoder.counts_per_turn, say=_say
            ),
            ready_loadcell(devices.loadcell, hardware, held, say=_say),
        ]
        record_run(plan, ready, hardware, show=lambda _: None, begun=lambda folder: print(folder, flush=True))


def _say(sentence: str) -> None:
    if "receive buffer" not in sentence:  # the size of the buffer depends on this computer
        print(sentence, file=sys.stderr)


if __name__ == "__main__":
    _record(Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else None)
    sys.stdout.flush()
    sys.exit(os.EX_OK)
