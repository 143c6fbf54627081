"""Judge a recording as soon as it ends, and store the verdict in its run.toml."""

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING

from cfid.console.messages import note
from cfid.errors import CfidError, ConfigError, DataError

if TYPE_CHECKING:
    from cfid.records.run import Run

_LARGEST_BYTES = 400_000_000  # of a run: 13 minutes of a load cell at 7 kHz, read in half a minute within 1.5 GB
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
    size = sum(run.device_file(name).stat().st_size for name in run.header.devices)
    if size > _LARGEST_BYTES:
        note(f"not judged: {size / 1e6:.0f} MB take long to read, and much memory; the fit will judge it.")
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
