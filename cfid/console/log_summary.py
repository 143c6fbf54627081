"""The summary at the end of a `cfid log` command: rows, losses, files and verdict, as lines or as one JSON object."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.console.messages import echo, fitted, printable
from cfid.console.verdicts import verdict_line
from cfid.counted import counted
from cfid.errors import CfidError
from cfid.findings import rejection
from cfid.version import __version__

if TYPE_CHECKING:
    from cfid.records.run import Run

_SINGULAR = {  # the singular of each kind that run.toml names in the plural
    "duplicates": "duplicate",
    "malformed datagrams": "malformed datagram",
    "foreign datagrams": "foreign datagram",
    "datagrams dropped by this computer": "datagram dropped by this computer",
    "garbled replies": "garbled reply",
    "late replies": "late reply",
    "device errors": "device error",
    "polls without position": "poll without position",
    "lines that do not match": "line that does not match",
}


def print_summary(run: "Run", lines: Sequence[str] = (), failure: CfidError | None = None) -> None:
    """Print a run's rows, losses and files; the failure that ended the run is printed later, when the command ends."""
    for name, device in devices_of(run).items():
        skipped = f", {device['skipped']} skipped: {device['achieved']}" if device["achieved"] else ""
        lost = "losses unknown" if device["lost"] is None else f"{device['lost']} lost"
        counts = f"{counted(device['rows'], 'row')}, {lost}{_counts_of(device)}{skipped}"
        echo(fitted(f"{name}: {counts} -> {device['file']}", indent=2))
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
    known = [(record.model_extra or {}).get("stopped_in_s") for record in run.header.devices.values()]
    return next((seconds for seconds in known if seconds is not None), None)


def print_json(content: Mapping[str, Any]) -> None:
    """Print the JSON object of --json."""
    echo(json.dumps(content, indent=2))


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
        "findings": _findings(failure),
        "quality": {},
        "verdict": None if run.header.verdict is None else run.header.verdict.model_dump(),
        "devices": devices,
        "stopped_in_s": _stopped_in_s(run),
        "sources": [{"path": device["file"], "sha256": sha256_of(Path(device["file"]))} for device in devices.values()],
        "version": __version__,
    }


def _findings(failure: CfidError | None) -> list[dict[str, Any]]:
    return [] if failure is None else [rejection("run-failed", str(failure)).as_json()]


def devices_of(run: "Run") -> dict[str, dict[str, Any]]:
    """Return what each device of a run recorded and lost, in the form of the summary."""
    devices: dict[str, dict[str, Any]] = {}
    for name, record in run.header.devices.items():
        extra = record.model_extra or {}
        kinds = {**extra.get("arrivals", {}), **extra.get("losses", {})}
        kinds.pop("lost", None)  # printed separately, before the kinds
        file = run.device_file(name)
        gaps = sum(one.get("lost") != 0 for one in extra.get("gaps", ()))  # the rows of other gaps were only late
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


def _counts_of(device: Mapping[str, Any]) -> str:
    """Return the counts of a device's losses in parentheses, or "" where nothing is lost."""
    kinds = ((count, kind.replace("_", " ")) for kind, count in device["kinds"].items() if count)
    counts = [counted(count, _SINGULAR.get(kind, kind), kind) for count, kind in kinds]
    if device["gaps"]:
        counts.append(counted(device["gaps"], "gap"))
    return f" ({', '.join(counts)})" if counts else ""
