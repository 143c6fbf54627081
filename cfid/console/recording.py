"""The shared part of all `cfid log` commands: where to record, and the run itself."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from cfid.console.campaign import here
from cfid.console.live import LiveLine
from cfid.console.messages import clock, echo, fitted, note, print_json
from cfid.console.program import program
from cfid.console.run_summary import Judge, judged, print_summary, stop_line, summary
from cfid.errors import CfidError, ConfigError, DataError
from cfid.records.choose import LAST
from cfid.records.files import RUN_FILE
from cfid.records.run import read_run
from cfid.version import __version__

if TYPE_CHECKING:
    from cfid.records.campaign import Campaign
    from cfid.records.rig_file import Devices
    from cfid.records.run import Run
    from cfid.rig.hardware import Hardware
    from cfid.rig.instrument import Instrument
    from cfid.rig.run import Plan

_BYTES_A_ROW = 75  # a row of a load cell, the longest

Found = Callable[["Run"], tuple[Mapping[str, Any], Sequence[str]]]  # parameters as in --json, and lines to print


class Rig(NamedTuple):
    """A campaign, the addresses of its devices, whether they are simulated, and what opens them."""

    campaign: "Campaign"
    devices: "Devices"
    simulated: bool
    hardware: "Hardware"


DryRun = Annotated[bool, typer.Option("--dry-run", help="Print what would be done, and how long it takes.")]


ForS = Annotated[float | None, typer.Option("--for", metavar="S", help="Seconds to record; default: until Ctrl-C.")]
Resume = Annotated[bool, typer.Option("--resume", help="Record what an interrupted RUN lacks, else the last.")]
ResumedRun = Annotated[
    Path | None, typer.Argument(metavar="RUN", help="Run to resume, after --resume: its name or folder, or last.")
]


def run_to_resume(run: Path | None, *, resume: bool) -> Path | None:
    """Return the run to resume: `last` where no run is named, None without `resume`. Raises ConfigError."""
    if run is not None and not resume:
        raise ConfigError(f"{run}: a run is named to resume it: write --resume {run}.")
    return (run or Path(LAST)) if resume else None


def rig_of(*, or_real: bool = False) -> Rig:
    """Return the campaign, its devices and whether they are simulated; print a note if they are.

    Raises ConfigError where the simulated rig was killed, so that a command meant for it starts no real motor. With
    `or_real`, the devices are then those of rig.toml, and a note is printed.
    """
    from cfid.rig.hardware import present
    from cfid.rig.sim_file import SIM_FILE, is_left_behind

    campaign, hardware = here(), present()
    devices, simulated = hardware.devices(campaign.folder, campaign.rig)
    if simulated:
        file = campaign.folder / SIM_FILE
        note(f"the rig is simulated{f': {file} points at it' if file.exists() else ''}.")
    elif is_left_behind(campaign.folder):
        gone = f"{campaign.folder / SIM_FILE}: no simulated rig holds it, as after a kill, or in a copy of a folder"
        if not or_real:
            raise ConfigError(f"{gone}. Start `cfid rig sim` here, or delete this file for the devices of rig.toml.")
        note(f"{gone}: the devices are the real ones of rig.toml.")
    return Rig(campaign, devices, simulated, hardware)


def effort_of(seconds: float, runs_folder: Path, *, rate_hz: float) -> str:
    """Return how long a recording lasts and how much disk space it takes, for the question before the recording.

    `rate_hz` is the number of rows per second of all devices. Raises ConfigError where the disk has too little space.
    """
    needed = seconds * rate_hz * _BYTES_A_ROW
    place = next(folder for folder in (runs_folder, *runs_folder.resolve().parents) if folder.is_dir())
    free = shutil.disk_usage(place).free
    if needed > free:
        raise ConfigError(
            f"{runs_folder}: the recording takes about {needed / 1e6:.0f} MB, and the disk has {free / 1e6:.0f} MB: "
            "make room, or record less."
        )
    return f", for {clock(seconds)} min (about {max(needed / 1e6, 1):.0f} MB; {free / 1e9:.1f} GB are free)"


def rehearse(command: str, lines: Sequence[str], **facts: Any) -> None:
    """Print what a command would record, without opening a device: lines, or the `facts` as the object of --json."""
    if program().json:
        print_json({"command": command, "dry_run": True, **facts, "version": __version__})
    else:
        echo(fitted("\n".join(lines)))


def rehearse_devices(command: str, what: str, runs_folder: Path, for_s: float | None) -> None:
    """Print which devices would be recorded, where, and for how many seconds; None is until Ctrl-C."""
    lasts = "until Ctrl-C" if for_s is None else f"{for_s:g} s"
    line = f"would record {what} into {runs_folder}: {lasts}. Nothing was opened."
    rehearse(command, [line], records=what, runs_folder=str(runs_folder), lasts_s=for_s)


def record(
    command: str,
    plan: "Plan",
    instruments: "Sequence[Instrument]",
    live: LiveLine,
    *,
    hardware: "Hardware",
    judge: Judge | None,
    found: Found | None = None,
) -> None:
    """Record a run and print its summary, even if the run failed. Raises the error that ended the run.

    `judge` returns what a complete run is good for; it is None where no fit uses the run. `found` evaluates a run that
    did not fail.
    """
    run, failure = attempt(plan, instruments, hardware, live)
    if run is not None:
        run = judged(run, judge)
        parameters, lines = found(run) if found is not None and failure is None else ({}, ())
        if program().json:
            print_json(summary(command, run, failure, parameters))
        else:
            print_summary(run, lines, failure)
    if failure is not None:
        raise failure


def attempt(
    plan: "Plan", instruments: "Sequence[Instrument]", hardware: "Hardware", live: LiveLine
) -> "tuple[Run | None, CfidError | None]":
    """Record a run; return the run, or None where run.toml does not state how it ended, and the error that ended it."""
    from cfid.rig.run import record_run

    folders: list[Path] = []
    stops_s: list[float] = []

    def begun(folder: Path) -> None:
        folders.append(folder)
        live.tell(f"recording into {folder} ({_until(plan)})")

    try:
        recorded = record_run(
            plan, instruments, hardware, show=live.show, begun=begun, say=live.say, stopped=stops_s.append
        )
        return recorded, None
    except CfidError as error:
        run = _closed(folders[0]) if folders else None
        if run is None and stops_s:
            live.say(stop_line(stops_s[0]))
        if run is None and folders and str(folders[0]) not in str(error):
            live.say(f"{folders[0] / RUN_FILE} cannot be written either. The run counts as cut. Its rows are kept.")
        return run, error
    finally:
        live.end()


def _closed(folder: Path) -> "Run | None":
    """Return a run that was closed, or None where its run.toml could not be written or is missing."""
    try:
        run = read_run(folder)
    except DataError:
        return None
    return None if run.header.state == "recording" else run


def _until(plan: "Plan") -> str:
    if plan.procedure is not None:
        return "Ctrl-C stops the motors and ends it" if {"motor", "motors"} & set(plan.requested) else "Ctrl-C ends it"
    return "Ctrl-C ends it" if plan.for_s is None else f"{plan.for_s:g} s; Ctrl-C ends it before"
