"""Summarise a campaign: its numbers, and whether its recordings are still those that its fits used.

A summary can be made in another process, or on another computer that can read the folder.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path, PurePath
from typing import NamedTuple

from cfid.errors import CfidError, ConfigError, DataError
from cfid.findings import Finding, warning
from cfid.fleet.places import is_address
from cfid.records import lab_book
from cfid.records.campaign import find_campaign
from cfid.records.files import RIG_FILE, sha256_of
from cfid.records.parameters import Section, Source
from cfid.records.run import Run, list_runs
from cfid.records.values import Quantity

_LARGEST = 1e60  # of numbers that can be compared; an edited file may contain any number
START_IN_NAME = "%Y-%m-%d_%H%M%S"  # the start of a run, in its name


class KnownValue(NamedTuple):
    """A number of a campaign, with its standard uncertainty if known, and the time of its last recording."""

    name: str
    value: float
    std: float | None
    unit: str
    recorded: datetime
    accepted: bool


@dataclass(frozen=True, kw_only=True)
class Summary:
    """A campaign; `findings` name unreadable runs, and recordings that are missing or have changed since their fit.

    `name` is the name of the folder, or its path if another folder of the fleet has the same name.
    """

    folder: Path
    name: str
    vehicle: str
    complete_runs: int
    other_runs: int
    known: tuple[KnownValue, ...]
    lab_book: dict[str, dict[str, int]]
    findings: tuple[Finding, ...]
    recordings: frozenset[str]  # hashes of the recordings behind its numbers


def summarise(place: str) -> Summary | CfidError:
    """Return a campaign's summary or its error, so that one faulty campaign does not hide the others."""
    folder = Path(place)
    try:
        campaign = find_campaign(folder, start=folder)
        if campaign is None:
            raise ConfigError(f"{folder}: not a campaign: it has no {RIG_FILE}.")
    except CfidError as error:
        return error
    listed = list_runs(campaign.runs_folder)
    runs = [run for run in listed if isinstance(run, Run)]
    unreadable = [
        warning("run-unreadable", f"{run} It does not count.") for run in listed if isinstance(run, DataError)
    ]
    complete = sum(run.header.state == "complete" for run in runs)
    values = campaign.values()
    sources = {source for fit in values.by_fit for source in fit.section.sources}
    known = [
        number
        for fit, quantities in values.by_fit.items()
        for quantity in quantities
        for number in _numbers(quantity, _recorded(fit.section, runs))
    ]
    return Summary(
        folder=folder,
        name=folder.name,
        vehicle=campaign.rig.vehicle.name,
        complete_runs=complete,
        other_runs=len(listed) - complete,
        known=tuple(one for one in known if _is_measured(one)),
        lab_book=lab_book.summary(runs),
        findings=(
            *unreadable,
            *(_not_compared(one) for one in known if not _is_measured(one)),
            *filter(None, (_source_finding(folder, source) for source in sorted(sources, key=lambda own: own.path))),
        ),
        recordings=frozenset(source.sha256 for source in sources),
    )


def with_shared(summaries: Sequence[Summary]) -> list[Summary]:
    """Return summaries with a finding on each that shares recordings with an earlier one, as a copy or a refit does."""
    first, found = dict[str, str](), []
    for one in summaries:
        known = [first[each] for each in sorted(one.recordings) if each in first]
        first |= dict.fromkeys(one.recordings - first.keys(), one.name)
        text = f"rests on recordings of {known[0]}, and both count: name one of them alone." if known else ""
        shared = (warning("recordings-shared", text),) if known else ()
        found.append(replace(one, findings=(*one.findings, *shared)))
    return found


def _recorded(section: Section, runs: Sequence[Run]) -> datetime:
    """Return the start time of a section's last run, or the time of the fit if it has no runs.

    The name of a run states its start, which is used for a run that is elsewhere, as after a refit.
    """
    started = {run.folder.name: run.header.started for run in runs}
    names = [PurePath(source.path).parent.name for source in section.sources]
    found = [when for name in names if (when := started.get(name) or _start_in(name)) is not None]
    return max(found, default=section.found)


def _start_in(name: str) -> datetime | None:
    try:
        return datetime.strptime(name[: len("2026-11-21_083012")], START_IN_NAME).replace(tzinfo=UTC)
    except ValueError:
        return None


def _numbers(quantity: Quantity, recorded: datetime) -> list[KnownValue]:
    """Return a quantity's numbers; of fits such as `swing x`, which share names, each name ends with (x)."""
    which = quantity.fit.name.partition(" ")[2]
    own, parameter = f" ({which})" if which else "", quantity.parameter
    return [
        KnownValue(one.name + own, float(one.value), _float(one.std), parameter.unit, recorded, quantity.accepted)
        for one in parameter.numbers(quantity.key)
        if one.value is not None
    ]


def _is_measured(one: KnownValue) -> bool:
    """Return whether a number can be compared, so that its square and its ratio to others do not overflow."""
    return abs(one.value) < _LARGEST and (not one.std or 1 / _LARGEST < one.std < _LARGEST)


def _not_compared(one: KnownValue) -> Finding:
    std = "" if one.std is None else f" +- {one.std:g}"
    return warning("number-not-compared", f"{one.name} is {one.value:g}{std}, which nobody measured: it is left out.")


def _float(std: float | None) -> float | None:
    return None if std is None else float(std)


def _source_finding(folder: Path, source: Source) -> Finding | None:
    if is_address(source.path):
        return None  # other computers are not contacted
    try:
        same = sha256_of(folder / source.path) == source.sha256
    except DataError:
        return warning("source-missing", f"{source.path} is missing.")
    return None if same else warning("source-changed", f"{source.path} has changed since it was fitted.")
