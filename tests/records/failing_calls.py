"""Make each system call of a job that opens or changes files fail in turn, and check the campaign after each failure.

    LD_PRELOAD=failing_calls.so python -m tests.records.failing_calls FOLDER KIND ...

Prints a JSON object: how often each job was tried, and what was wrong after which call.
"""

import ctypes
import errno
import json
import os
import shutil
import sys
import traceback
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cfid.console.campaign import make_campaign
from cfid.errors import CfidError
from cfid.records.campaign import Campaign, open_campaign
from cfid.records.files import write_files
from cfid.records.fits import Fit, list_fits
from cfid.records.parameters import Parameter, Section, Source
from cfid.records.parameters_file import is_as_written
from cfid.records.result import Result
from cfid.records.run import DeviceRecord, Label, Run, amend_run, list_runs, read_run
from cfid.records.run_writer import create_run
from cfid.report.sealed import MARK, write_report
from tests.lab import keep, sections_at

NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)
Job = Callable[[Campaign], None]
ROWS, BLOCKS = 400, 3
OLD, NEW = f"<!-- {MARK} -->\nold\n", f"<!-- {MARK} -->\n{'new ' * 5000}\n"
# Error number, whether half of a write succeeds, whether all later calls fail too: a single error, a partial write, a
# disk that is full from then on, or a disk that an error made read-only, which no longer flushes anything.
KINDS = {
    "ENOSPC": (errno.ENOSPC, 0, 0), "EIO": (errno.EIO, 0, 0), "EMFILE": (errno.EMFILE, 0, 0),
    "EROFS": (errno.EROFS, 0, 1),
    "short": (errno.ENOSPC, 1, 0), "full": (errno.ENOSPC, 0, 1), "short and full": (errno.ENOSPC, 1, 1),
}  # fmt: skip
MATRIX = {"inertia.matrix_kg_m2": Parameter(value=2e-5 * np.eye(3), std=1e-8 * np.ones((3, 3)), unit="kg m^2")}


def record(campaign: Campaign) -> None:
    devices = {name: DeviceRecord(file=f"{name}.csv", columns=("t", "phi")) for name in ("encoder", "other")}
    with create_run(
        campaign.runs_folder, kind="swing", label=Label(axis="y"), devices=devices, started=NOON, cfid_version="0"
    ) as run:
        for block in range(BLOCKS):
            index = np.arange(ROWS) + block * ROWS
            for name in devices:
                run.append(name, (1e-3 * index, index))


def fit(campaign: Campaign) -> None:
    campaign.keep(Result(command="fit inertia", method="default", quantities=MATRIX))


def by_hand(campaign: Campaign) -> None:
    campaign.keep_by_hand("arm_m", Parameter(value=0.046, unit="m"))


def note(campaign: Campaign) -> None:
    amend_run(read_run(campaign.runs_folder / "2026-11-21_120000_swing_x"), note="new")


def report(campaign: Campaign) -> None:
    write_report(campaign.folder / "report.md", NEW)


def export(campaign: Campaign) -> None:
    write_files({campaign.folder / "exports" / "vehicle.json": NEW.encode()}, force=True)


JOBS = (record, fit, by_hand, note, report, export)
# Files that each job may replace; a job may add other files, but changes no others.
REPLACED: dict[Job, set[str]] = {
    fit: {"parameters.toml"}, by_hand: {"parameters.toml"}, note: {"runs/2026-11-21_120000_swing_x/run.toml"},
    report: {"report.md"}, export: {"exports/vehicle.json"},
}  # fmt: skip


class Ended(NamedTuple):
    """How a job ended: the message of its error, "" after success, and the traceback of an unexpected failure."""

    message: str
    trace: str
    calls: int


def _section() -> Section:
    source = Source("runs/a/encoder.csv", "0" * 64)
    return Section(
        method="default", found=NOON, cfid_version="0", accepted=True, sources=(source,),
        parameters={"swing.axis_inertia_kg_m2": Parameter(value=1e-5, std=1e-8, unit="kg m^2")},
    )  # fmt: skip


def make(folder: Path) -> None:
    """Make a campaign with a run, two fits, a report and an export."""
    make_campaign(folder, kind="simulated")
    campaign = open_campaign(folder)
    devices = {"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))}
    with create_run(
        campaign.runs_folder, kind="swing", label=Label(axis="x"), devices=devices, started=NOON, cfid_version="0"
    ) as run:
        run.append("encoder", ([0.0, 1.0], [0, 1]))
    keep(campaign.folder, "swing x", _section())
    campaign.keep(Result(command="fit friction", method="default", quantities=MATRIX))
    write_report(folder / "report.md", OLD)
    write_files({folder / "exports" / "vehicle.json": OLD.encode()}, force=False)


def attempt(job: Job, campaign: Campaign, which: int, kind: str) -> Ended:
    """Do a job in a separate process, in which call number `which` fails, or no call if `which` is 0."""
    calls, (reader, writer) = ctypes.CDLL(None), os.pipe()
    child = os.fork()
    if not child:
        message = trace = ""
        calls.arm(os.fsencode(campaign.folder), ctypes.c_long(which), *KINDS[kind])
        try:
            job(campaign)
        except CfidError as error:
            message = str(error) or "no message"
        except BaseException:
            trace = traceback.format_exc()
        count = calls.counted()
        calls.arm(b"", 0, 0, 0, 0)
        os.write(writer, json.dumps([message, trace, count]).encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as file:
        content = file.read()
    os.waitpid(child, 0)
    return Ended(*json.loads(content))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def faults(
    job: Job, ended: Ended, before: dict[str, bytes], done: dict[str, bytes], campaign: Campaign
) -> Iterator[str]:
    """Yield what is wrong after an attempt; `done` contains the files after the same job without a failure."""
    after = contents(campaign.folder)
    if ended.trace:
        yield ended.trace.strip().splitlines()[-1]
    for name, content in before.items():
        allowed = {content, done[name]} if name in REPLACED.get(job, set()) else {content}
        if job in (fit, by_hand) and name == "parameters.toml" and is_as_written(after.get(name, b"").decode()):
            continue  # the time of the fit differs, so the file only has to be whole
        if after.get(name) not in allowed:
            yield f"{name} is gone or half written"
        if ended.message and "is unchanged" in ended.message and name in ended.message and after.get(name) != content:
            yield f"{name} was changed, and the message denies it: {ended.message}"
    yield from (f"{name} was left behind" for name in after if name.endswith(".tmp"))
    try:
        found = [
            *list_fits(campaign.fits_folder),
            *list_runs(campaign.runs_folder),
            *sections_at(campaign.folder),
        ]
    except CfidError as error:
        yield f"unreadable: {error}"
        return
    yield from (f"unreadable: {each}" for each in found if isinstance(each, CfidError))
    runs = [each for each in found if isinstance(each, Run) and each.header.label.axis == "y"]
    yield from (fault for run in runs for fault in _faults_of_run(run, ended))
    if not ended.message and not ended.trace:
        new = len([each for each in found if isinstance(each, Fit)])
        if (job is record and not runs) or (job in (fit, by_hand) and new != 3):
            yield "succeeded, and nothing was kept"
        if job in (note, report, export) and any(after[name] != done[name] for name in REPLACED[job]):
            yield "succeeded, and the file is the old one"
    if (again := attempt(job, campaign, 0, "EIO")).message or again.trace:
        yield f"the job cannot be repeated: {again.message}{again.trace}"


def _faults_of_run(run: Run, ended: Ended) -> Iterator[str]:
    for name, device in run.header.devices.items():
        path = run.device_file(name)
        rows = path.read_bytes().count(b"\n") - 1 if path.exists() else 0
        if device.rows is not None and device.rows > rows:
            yield f"{name} holds {rows} rows, run.toml states {device.rows}"
        if run.header.state == "complete" and rows != ROWS * BLOCKS:
            yield f"a complete run holds {rows} rows of {name}"
    if run.header.state == "complete" and ended.message:
        yield f"a complete run, and the message {ended.message}"
    if run.header.state == "failed" and not run.header.reason:
        yield "a failed run without its reason"


def main() -> None:
    """Make each call of each job fail, in each kind of failure."""
    folder, kinds = Path(sys.argv[1]).resolve(), sys.argv[2:]
    tries: dict[str, int] = {}
    wrong: list[str] = []
    make(folder / "template")
    for job in JOBS:
        place = folder / "lab"

        def anew(place: Path = place) -> Campaign:
            shutil.rmtree(place, ignore_errors=True)
            shutil.copytree(folder / "template", place)
            return open_campaign(place)

        campaign = anew()
        before = contents(place)
        ended = attempt(job, campaign, 0, "EIO")
        assert (ended.message, ended.trace) == ("", "")
        done = contents(place)
        for kind in kinds:
            which = 0
            while True:
                which += 1
                ended = attempt(job, anew(), which, kind)
                if ended.calls < which:
                    break
                tries[job.__name__] = tries.get(job.__name__, 0) + 1
                if kind == "EROFS" and "which are kept" in ended.message:
                    wrong.append(f"{job.__name__}, call {which}, {kind}: no flush succeeded, and {ended.message}")
                wrong += [
                    f"{job.__name__}, call {which}, {kind}: {fault}"
                    for fault in faults(job, ended, before, done, campaign)
                ]
    print(json.dumps({"tries": tries, "wrong": wrong}))


if __name__ == "__main__":
    main()
