"""Gather the content of a report from a campaign's files; `formats` renders it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, TypeVar

from cfid.counted import counted
from cfid.errors import DataError
from cfid.guide.status import status_of
from cfid.recordings.resumed import completing
from cfid.records.campaign import Campaign
from cfid.records.fits import BY_HAND, Fit, list_fits
from cfid.records.lab_book import lines, summary
from cfid.records.parameters import plain
from cfid.records.rig_file import CampaignKind
from cfid.records.run import Run, list_runs
from cfid.report.agreement import Agreement, agreements_of
from cfid.report.comparison import PublishedComparison, comparisons, frame_text
from cfid.report.experiments import Experiment, experiments_of
from cfid.report.flown import flown_agreements
from cfid.report.measurements import measurements_of
from cfid.report.repeats import RepeatedFit, repeated_fits
from cfid.report.sheet import SheetGroup, sheet_of
from cfid.report.summary import FirstScreen, summary_of
from cfid.version import __version__

FORMAT = 1  # version of the JSON object

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class About:
    """The vehicle, the dates and the cfid versions; `recorded` contains the start times of the first and last run."""

    vehicle: str
    campaign: str
    body_frame: str
    recorded: tuple[datetime, datetime] | None
    written: datetime
    cfid_version: str
    fitted_with: tuple[str, ...]
    runs: int
    simulated_runs: int
    unused_runs: int = 0
    growing_runs: int = 0
    lab_book: tuple[str, ...] = ()

    @property
    def days(self) -> str:
        """The day of the runs, or their first and last day, or "" without runs."""
        return " to ".join(dict.fromkeys(f"{start:%Y-%m-%d}" for start in self.recorded or ()))

    @property
    def recorded_in(self) -> str:
        """The number of runs, and how many of them are being recorded, or are selected by no fit.

        No fit selects runs that failed, were excluded or were judged as not usable.
        """
        parts = {"being recorded": self.growing_runs, "not usable or excluded": self.unused_runs}
        named = " and ".join(f"{count} of them {state}" for state, count in parts.items() if count)
        return ", ".join(filter(None, [counted(self.runs, "run"), named]))


@dataclass(frozen=True)
class RunLine:
    """One recording: its name, the operator's label, its state and its losses."""

    name: str
    what: str
    state: str
    rows: int | None
    lost: int | None
    simulated: bool
    excluded: str
    note: str


@dataclass(frozen=True)
class Report:
    """The content of a report, in the order of the report."""

    about: About
    summary: FirstScreen
    sheet: tuple[SheetGroup, ...]
    experiments: tuple[Experiment, ...]
    repeats: tuple[RepeatedFit, ...]
    agreements: tuple[Agreement, ...]
    comparisons: tuple[PublishedComparison, ...]
    runs: tuple[RunLine, ...]
    unreadable: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the content as plain lists and numbers, with dates in ISO format and None for unknown values."""
        content: dict[str, Any] = _dates_as_text(plain({"format": FORMAT, **asdict(self)}))
        return content


def gather(campaign: Campaign, *, now: datetime, kind: CampaignKind | None = None) -> Report:
    """Read a campaign's parameters, fits and runs, and return the report.

    `kind` replaces the kind of campaign in rig.toml, which determines what the campaign should find; other missing
    quantities are not named. The report names unreadable fits and runs.
    """
    runs, broken_runs = _readable(list_runs(campaign.runs_folder))
    _, broken_fits = _readable(list_fits(campaign.fits_folder))
    known, status = campaign.values(), status_of(campaign, kind=kind)
    fits = [fit for fit in known.fits if fit.section.parameters and fit.name != BY_HAND]
    held = known.in_force
    measured = measurements_of(fits, held)
    experiments = experiments_of(measured, fits, known, campaign.folder)
    return Report(
        about=_about(campaign, runs, fits, now),
        summary=summary_of(known, experiments, status.tasks, status.next, status.remarks),
        sheet=sheet_of(known, wanted=[one.task.section for one in status.tasks]),
        experiments=experiments,
        repeats=repeated_fits(measured),
        agreements=(*agreements_of(known, held), *flown_agreements(known)),
        comparisons=comparisons(known),
        runs=tuple(_line(run) for run in runs),
        unreadable=(*broken_runs, *broken_fits),
    )


def _readable(found: Sequence[Kind | DataError]) -> tuple[list[Kind], list[str]]:
    return (
        [one for one in found if not isinstance(one, DataError)],
        [str(one) for one in found if isinstance(one, DataError)],
    )


def _about(campaign: Campaign, runs: Sequence[Run], fits: Sequence[Fit], now: datetime) -> About:
    started = [run.header.started for run in runs]
    return About(
        vehicle=campaign.rig.vehicle.name,
        campaign=campaign.folder.resolve().name,
        body_frame=frame_text(campaign.rig.vehicle.body_frame),
        recorded=(min(started), max(started)) if started else None,
        written=now,
        cfid_version=__version__,
        fitted_with=tuple(sorted({fit.section.cfid_version for fit in fits})),
        runs=len(runs),
        simulated_runs=sum(run.header.simulated for run in runs),
        unused_runs=sum(_is_unused(run, runs) for run in runs),
        growing_runs=sum(run.grows for run in runs),
        lab_book=tuple(lines(summary(runs))),
    )


def _is_unused(run: Run, runs: Sequence[Run]) -> bool:
    """Return whether a run is not being recorded, and no fit uses it alone or with a run that completes it."""
    if run.usable or run.grows:
        return False
    included = [one for one in runs if not one.header.excluded]
    return bool(run.header.excluded) or not any(one.usable for one in completing(run, included))


def _line(run: Run) -> RunLine:
    header, devices = run.header, run.header.devices.values()
    label = header.label
    weight = None if label.weight_g is None else f"{label.weight_g:g} g"
    rows = [device.rows for device in devices if device.rows is not None]
    return RunLine(
        name=run.folder.name,
        what=" ".join(filter(None, [header.kind, label.body, label.axis, weight])),
        state=run.outcome,
        rows=sum(rows) if rows else None,
        lost=header.lost,
        simulated=header.simulated,
        excluded=getattr(header, "excluded", ""),
        note="; ".join(filter(None, [*(device.achieved for device in devices), label.note, header.reason])),
    )


def _dates_as_text(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _dates_as_text(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_dates_as_text(item) for item in value]
    return value.isoformat() if isinstance(value, datetime) else value
