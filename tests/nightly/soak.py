"""A long recording of encoder and load cell: in virtual time, or of both at once in real time from a simulated rig.

    python -m tests.nightly.soak --virtual 3600 --real 600

It prints rows, losses and gaps, and for real time the growth of the recorder's process in memory and open files.
"""

import argparse
import os
import subprocess
import sys
import time
import tomllib
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cfid.console.campaign import make_campaign
from cfid.records.files import RIG_FILE, RUNS_FOLDER
from cfid.records.rig_file import load_rig
from cfid.records.run import Label, Run, read_run
from cfid.rig.encoder import ready_encoder
from cfid.rig.instrument import Instrument
from cfid.rig.loadcell import ready_loadcell
from cfid.rig.run import Plan, record_run
from cfid.rig.sim_file import SIM_FILE
from cfid.sim.devices import SimulatedRig
from cfid.sim.virtual import Virtual
from tests.lab import known
from tests.priority import ahead_of_others

CFID = (sys.executable, "-m", "cfid.cli.main")
WARM_SHARE = 0.2
STARTS_WITHIN_S = 60.0


def virtual(for_s: float, folder: Path) -> None:
    """Record each instrument for `for_s` seconds on a virtual clock, and print what is missing."""
    make_campaign(folder, kind="simulated")
    rig = load_rig(folder / RIG_FILE)
    for name in ("encoder", "loadcell"):
        hardware = Virtual(lambda seconds: SimulatedRig(rig, seconds=seconds, seed=1), unix_s=time.time())
        devices, _ = hardware.devices(folder, rig)
        plan = Plan(runs_folder=folder / RUNS_FOLDER, kind=name, label=Label(), for_s=for_s, simulated=True)
        with ExitStack() as held:
            turn = rig.encoder.counts_per_turn
            instrument: Instrument = (
                ready_encoder(devices.encoder, hardware, held, counts_per_turn=turn, say=print)
                if name == "encoder"
                else ready_loadcell(devices.loadcell, hardware, held, say=print)
            )
            run = record_run(plan, [instrument], hardware, show=lambda _: None, begun=lambda _: None)
        _print(f"{name}, {for_s:g} s of virtual time", run, name)


def real(for_s: float, folder: Path) -> None:
    """Record both at once over their wires from a simulated rig; print what is missing, and how the process grew."""
    make_campaign(folder, kind="simulated")
    with subprocess.Popen((*CFID, "rig", "sim", "--axis", "x"), cwd=folder, stderr=subprocess.DEVNULL) as rig:
        try:
            _wait_for(folder / SIM_FILE)
            loggers = {
                name: subprocess.Popen(
                    (*CFID, "log", name, "--for", f"{for_s:g}"), cwd=folder,
                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )
                for name in ("encoder", "loadcell")
            }  # fmt: skip
            time.sleep(WARM_SHARE * for_s)
            before = {name: _used(logger.pid) for name, logger in loggers.items()}
            time.sleep(0.9 * for_s - WARM_SHARE * for_s)
            after = {name: _used(logger.pid) for name, logger in loggers.items()}
            codes = {name: logger.wait(for_s + STARTS_WITHIN_S) for name, logger in loggers.items()}
        finally:
            rig.terminate()  # a rig started in the background ignores Ctrl-C
    for name, code in codes.items():
        (run,) = (one for one in map(read_run, sorted((folder / "runs").iterdir())) if name in one.header.devices)
        what = f"{name}, {for_s:g} s of real time"
        _print(what, run, name)
        memory, files = (last - first for first, last in zip(before[name], after[name], strict=True))
        print(f"{what}, exit code {code}  (goal: 0)")
        print(f"{what}, memory grown by {memory:.1f} MB  (goal: at most 5)")
        print(f"{what}, open files grown by {files:.0f}  (goal: 0)")


def _print(what: str, run: Run, device: str) -> None:
    record = run.header.devices[device]
    print(f"{what}, rows {record.rows}")
    print(f"{what}, lost {record.lost}  (goal: 0)")
    asked = (record.rows or 0) + known(record.lost) + (record.skipped or 0)
    print(f"{what}, skipped {1e4 * (record.skipped or 0) / asked:.2f} in 10 000  (goal: at most 1)")
    for gap in (record.model_extra or {}).get("gaps", ()):
        print(f"{what}, a gap of {gap['to_s'] - gap['from_s']:.2f} s after {gap['from_s']:.0f}: {gap['reason']}")


def _used(process: int) -> tuple[float, float]:
    """Return a process' resident memory in MB and the number of its open files."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6, float(len(list(Path(f"/proc/{process}/fd").iterdir())))


def _wait_for(file: Path) -> None:
    end_s = time.monotonic() + STARTS_WITHIN_S
    while not (file.exists() and "devices" in _content(file)):
        if time.monotonic() > end_s:
            sys.exit("the simulated rig did not start.")
        time.sleep(0.1)


def _content(file: Path) -> dict[str, Any]:
    return tomllib.loads(file.read_text(encoding="utf-8"))


def main() -> None:
    """Record for the given times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--virtual", type=float, default=3600.0, help="seconds; 0 leaves it out")
    parser.add_argument("--real", type=float, default=600.0, help="seconds; 0 leaves it out")
    arguments = parser.parse_args()
    with TemporaryDirectory(prefix="cfid-soak-") as name, ahead_of_others():
        if arguments.virtual:
            virtual(arguments.virtual, Path(name) / "virtual")
        if arguments.real:
            real(arguments.real, Path(name) / "lab")


if __name__ == "__main__":
    main()
