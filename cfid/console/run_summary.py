"""The end of a recording: its verdict, which its run.toml keeps, and the summary of rows, losses and files."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.console.messages import echo, fitted, note, printable
from cfid.counted import counted
from cfid.errors import CfidError, ConfigError, DataError
from cfid.findings import rejection
from cfid.version import __version__

if TYPE_CHECKING:
    from cfid.records.run import Run

_FEW_LOST = 0.01  # of a device's samples
_MANY_SKIPPED = 0.1  # of the samples that were due: fewer do not affect a fit

Judge = Callable[["Run"], str]  # returns what a run is good for, or raises a CfidError that states why it is not usable


def judged(run: "Run", judge: Judge | None) -> "Run":
    """Return a run with its verdict, which is stored in run.toml; return a run that was ended early unchanged.

    If a fault ended the run, the fault is its verdict.
    """
    if run.header.state == "failed":
        return _with_verdict(run, run.header.reason, usable=False)
    if judge is None or run.header.state != "complete":
        return run
    try:
        usable, text = True, f"{judge(run)}{_losses(run)}"
    except ConfigError as error:  # a fault of rig.toml, which may be mended, is none of the recording
        note(f"not judged: {error}")
        return run
    except CfidError as error:
        usable, text = False, f"{error}{_losses(run)}"  # losses may be the cause
    except KeyboardInterrupt:  # the run is complete, and the report of the motors' stop is yet to be printed
        note("not judged: interrupted.")
        return run
    return _with_verdict(run, text, usable=usable)


def _with_verdict(run: "Run", text: str, *, usable: bool) -> "Run":
    from cfid.records.run import Verdict, amend_run, by_name

    try:
        return amend_run(run, verdict=Verdict(usable=usable, text=by_name(text, run.folder.parent)))
    except DataError as error:
        note(f"the verdict was not kept: {error}")
        return run


def _losses(run: "Run") -> str:
    """Return a sentence for each device that lost more than 1 % of its samples, or skipped more than 10 %."""
    sentences = []
    for name, record in run.header.devices.items():
        lost, skipped = record.lost or 0, record.skipped or 0
        taken = lost + (record.rows or 0)
        stood_s = sum(gap.get("stood_s", 0.0) for gap in (record.model_extra or {}).get("gaps", ()))
        if stood_s * (record.rate_hz or 0) > (lost + skipped) / 2:
            sentences.append(f" cfid itself stood still for {stood_s:.1f} s: {name} has no rows of them.")
        elif lost > _FEW_LOST * taken:
            sentences.append(f" {lost} of {taken} samples of {name} are lost: see to its cable, and to other programs.")
        elif skipped > _MANY_SKIPPED * (taken + skipped):
            sentences.append(f" {name} was read at {record.achieved}: end other programs.")
    return "".join(sentences)


def verdict_line(run: "Run") -> str:
    """Return what a recording is good for, or "" where nothing judges it.

    The fault that ended a run is not repeated, since it is also the error that ends the command.
    """
    verdict = run.header.verdict
    if run.header.state == "failed":
        return f"NOT USABLE: the fault below ended it. {_completing(run) or _again(run)}"
    if verdict is None and run.header.state == "interrupted":
        again = _completing(run) or f"Record it again, or name it to a fit: {run.folder.name}."
        return f"not judged, since it was ended early: fits leave it out. {again}"
    if verdict is None:
        return ""
    good = "usable, but with losses" if _losses(run) else "good"
    return f"{good}: {verdict.text}" if verdict.usable else f"NOT USABLE: {verdict.text} {_again(run)}"


def _again(run: "Run") -> str:
    """Return what to do about an unusable run; if the run completes others, the fault may be in those."""
    from cfid.recordings.resumed import resumed_by

    if not (before := resumed_by(run)):
        return "Record it again."
    rest = f"`cfid log {run.header.kind} --resume {before}` records the rest again"
    return f"If {before} is right, {rest}; else record it all again, without --resume."


def _completing(run: "Run") -> str:
    """Return a sentence on the command that records what a staircase or series lacks, or "" for another run."""
    if "planned" in run.header.requested:
        return f"`cfid log {run.header.family} --resume {run.folder.name}` records what the series lacks."
    if "steps" not in run.header.requested:
        return ""
    from cfid.recordings.resumed import steps_left

    with contextlib.suppress(CfidError):  # unreadable rows are reported elsewhere
        if not any(steps_left(run)):  # --resume would refuse such a run
            return ""
    return f"`cfid log {run.header.kind} --resume {run.folder.name}` records what it lacks."


def print_summary(run: "Run", lines: Sequence[str] = (), failure: CfidError | None = None) -> None:
    """Print a run's rows, losses and files; the failure that ended the run is printed later, when the command ends."""
    for name, device in devices_of(run).items():
        skipped = f", {device['skipped']} skipped: {device['achieved']}" if device["achieved"] else ""
        lost = "losses unknown" if device["lost"] is None else f"{device['lost']} lost"
        kinds = {**device["kinds"], "gaps": device["gaps"]}
        counts = ", ".join(f"{kind.replace('_', ' ')}: {count}" for kind, count in kinds.items() if count)
        losses = f"{lost} ({counts})" if counts else lost
        echo(fitted(f"{name}: {counted(device['rows'], 'row')}, {losses}{skipped} -> {device['file']}", indent=2))
    for line in (*lines, verdict_line(run)):
        if line:
            echo(fitted(printable(line)))
    if (stopped_in_s := _stopped_in_s(run)) is not None:
        echo(stop_line(stopped_in_s))
    if failure is not None and run.header.state == "complete":
        echo("All that was asked for was recorded before the fault below: the run is complete.")
    elif run.header.reason and run.header.state != "failed":
        echo(fitted(printable(run.header.reason)))


def stop_line(stopped_in_s: float) -> str:
    """Return the sentence at the end of every command that turned a motor."""
    return f"motors stopped, confirmed in {1000 * stopped_in_s:.0f} ms."


def _stopped_in_s(run: "Run") -> float | None:
    stops_s = [(record.model_extra or {}).get("stopped_in_s") for record in run.header.devices.values()]
    return next((seconds for seconds in stops_s if seconds is not None), None)


def summary(
    command: str, run: "Run", failure: CfidError | None, parameters: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the object of --json for a run. Raises DataError where a file of the run is missing."""
    from cfid.records.files import sha256_of

    devices = devices_of(run)
    return {
        "command": command,
        "run": str(run.folder),
        "state": run.header.state,
        "reason": run.header.reason,
        "parameters": dict(parameters or {}),
        "accepted": run.header.state == "complete" and failure is None,
        "findings": [] if failure is None else [rejection("run-failed", str(failure)).as_json()],
        "quality": {},
        "verdict": None if run.header.verdict is None else run.header.verdict.model_dump(),
        "devices": devices,
        "stopped_in_s": _stopped_in_s(run),
        "sources": [{"path": device["file"], "sha256": sha256_of(Path(device["file"]))} for device in devices.values()],
        "version": __version__,
    }


def devices_of(run: "Run") -> dict[str, dict[str, Any]]:
    """Return what each device of a run recorded and lost, in the form of the summary."""
    devices: dict[str, dict[str, Any]] = {}
    for name, record in run.header.devices.items():
        extra = record.model_extra or {}
        kinds = {**extra.get("arrivals", {}), **extra.get("losses", {})}
        kinds.pop("lost", None)  # printed separately, before the kinds
        file = run.device_file(name)
        gaps = sum(gap.get("lost") != 0 for gap in extra.get("gaps", ()))  # the rows of other gaps were only late
        devices[name] = {
            "rows": record.rows,
            "lost": record.lost,
            "skipped": record.skipped or 0,
            "achieved": record.achieved,
            "kinds": kinds,
            "gaps": gaps,
            "file": str(file),
        }
    return devices
