"""Build a report: one dictionary of plain values, which `--format json` prints and every template reads."""

from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from typing import Any

from cfid.comparison.claims import comparisons_with, rows_of
from cfid.counted import counted
from cfid.errors import DataError
from cfid.findings import CODES
from cfid.guide.certainty import percent
from cfid.guide.status import Status, TaskStatus, status_of
from cfid.quantities.registry import find
from cfid.recordings.resumed import completing
from cfid.records.campaign import Campaign
from cfid.records.fits import BY_HAND, Fit, list_fits
from cfid.records.lab_book import lines, summary
from cfid.records.parameters import plain
from cfid.records.rig_file import CampaignKind
from cfid.records.run import Run, list_runs
from cfid.records.values import Values
from cfid.report.checks import agreements_of
from cfid.report.experiments import experiments_of, title_of
from cfid.report.repeats import measurements_of, repeats_of
from cfid.report.sheet import main_numbers, sheet_of
from cfid.version import __version__

Content = dict[str, Any]

FORMAT = 2  # version of the JSON object
_MOST_FINDINGS = 5
_RECORDINGS = frozenset({"recording", *CODES})  # codes of findings about runs
_LOSSES = ("samples-lost", "samples-not-taken")


def build(campaign: Campaign, *, now: datetime, kind: CampaignKind | None = None) -> Content:
    """Read a campaign's fits and runs, and return the report; docs/reference/report.md lists its keys.

    Unknown values are None, and dates are texts in ISO format. `kind` replaces the kind of campaign in rig.toml, which
    determines what the campaign should find; other missing quantities are not named. Unreadable fits and runs are
    named under `unreadable`.
    """
    listed = list_runs(campaign.runs_folder)
    runs = [run for run in listed if isinstance(run, Run)]
    broken = [each for each in (*listed, *list_fits(campaign.fits_folder)) if isinstance(each, DataError)]
    values, status = campaign.values(), status_of(campaign, kind=kind)
    fits = [fit for fit in values.fits if fit.section.parameters and fit.name != BY_HAND]
    measurements = measurements_of(fits, values.in_force)
    experiments = experiments_of(measurements, values, campaign.folder)
    repeats = [repeats_of(name, list(several)) for name, several in measurements.items() if len(several) > 1]
    content: Any = plain(
        {
            "format": FORMAT,
            "about": _about(campaign, runs, fits, now),
            "summary": summary_of(values, experiments, status),
            "sheet": sheet_of(values, wanted=[each.task.section for each in status.tasks]),
            "experiments": experiments,
            "repeats": [{"title": title_of(repeat["name"]), **repeat} for repeat in repeats if repeat is not None],
            "agreements": agreements_of(values),
            "published": rows_of(comparisons_with(campaign, values)),
            "runs": [_run(run) for run in runs],
            "unreadable": [str(error) for error in broken],
        }
    )
    return dict(content)


def _about(campaign: Campaign, runs: Sequence[Run], fits: Sequence[Fit], now: datetime) -> Content:
    started = [run.header.started for run in runs]
    frame = campaign.rig.vehicle.body_frame
    return {
        "vehicle": campaign.rig.vehicle.name,
        "campaign": campaign.folder.resolve().name,
        "body_frame": f"forward {frame.forward}, left {frame.left}, up {frame.up}",
        "recorded": [min(started).isoformat(), max(started).isoformat()] if started else None,
        "written": now.isoformat(),
        "cfid_version": __version__,
        "fitted_with": sorted({fit.section.cfid_version for fit in fits}),
        "runs": len(runs),
        "simulated_runs": sum(run.header.simulated for run in runs),
        "simulated": any(fit.section.simulated for fit in fits),
        "unused_runs": sum(_is_unused(run, runs) for run in runs),
        "growing_runs": sum(run.grows for run in runs),
        "lab_book": lines(summary(runs)),
    }


def _is_unused(run: Run, runs: Sequence[Run]) -> bool:
    """Return whether a run is not being recorded, and no fit uses it alone or with a run that completes it."""
    if run.usable or run.grows:
        return False
    included = [other for other in runs if not other.header.excluded]
    return bool(run.header.excluded) or not any(other.usable for other in completing(run, included))


def _run(run: Run) -> Content:
    """Return a recording: its name, the operator's label, its state and its losses."""
    header, devices = run.header, run.header.devices.values()
    return {
        "name": run.folder.name,
        "what": run.what,
        "state": run.outcome,
        "rows": run.rows,
        "lost": header.lost,
        "simulated": header.simulated,
        "excluded": header.excluded,
        "note": "; ".join(filter(None, [*(device.achieved for device in devices), header.label.note, header.reason])),
    }


def summary_of(values: Values, experiments: Sequence[Content], status: Status) -> Content:
    """Return the first screen: main numbers, the weakest number, main findings, and the guide's next step and remarks.

    `more_findings` counts the findings that are not shown.
    """
    step, command, why = status.next, status.next.command, status.next.why
    if step.words[0] == "report":  # the reader has the report already
        command, why = "cfid export", f"{why} Hand it to firmware and simulators."
    findings = list(_findings([each for each in experiments if not _is_replaced(each, experiments)]))
    return {
        "numbers": list(main_numbers(values)),
        "weakest": _weakest(status.tasks),
        "findings": findings[:_MOST_FINDINGS],
        "more_findings": len(findings[_MOST_FINDINGS:]),
        "next_command": command,
        "next_why": why,
        "remarks": status.remarks,
    }


def _weakest(statuses: Sequence[TaskStatus]) -> str:
    """Return a sentence on the number least certain for its purpose, with the main cause; "" if none can be judged."""
    certainties = [certainty for status in statuses for certainty in status.found if certainty.short_by]
    if not certainties:
        return ""
    worst = max(certainties, key=lambda certainty: certainty.short_by)
    quantity = find(worst.key)
    title = quantity.title[0].upper() + quantity.title[1:] if quantity else worst.key
    reason = f" (mostly by the {worst.mostly})" if worst.mostly else ""
    enough = "enough" if worst.short_by <= 1 else "not enough"
    aim = f"{worst.aim.purpose} ({percent(worst.aim.std)})"
    return f"{title} is known to {percent(worst.std)}{reason}, {enough} for {aim}."


def _is_replaced(experiment: Content, others: Iterable[Content]) -> bool:
    """Return whether a later fit of this kind replaces an experiment, as it used all its recordings and more.

    An experiment that is no longer current is replaced by any later accepted fit, which is what its findings request.
    """
    own = {source["sha256"] for source in experiment["sources"]}
    is_stale = any(finding["code"] == "stale" for finding in experiment["findings"])
    return any(
        (own and own < {source["sha256"] for source in other["sources"]}) or (is_stale and other["accepted"])
        for other in others
        if other["name"] == experiment["name"] and other["found"] > experiment["found"]
    )


def _findings(experiments: Sequence[Content]) -> Iterator[str]:
    """Yield rejections, then warnings on results, then on recordings, each sentence once with its experiments.

    Runs often lose samples, which must not hide the faults of a result, so all such losses of accepted fits are one
    sentence at the end. That runs are simulated is stated once, above the findings.
    """
    losses: dict[str, set[str]] = {}  # names of recordings that lost samples, by the accepted experiment
    for severity, of_recordings in (("rejection", False), ("rejection", True), ("warning", False), ("warning", True)):
        titles: dict[str, list[str]] = {}
        for experiment in experiments:
            for finding in experiment["findings"]:
                if finding["severity"] != severity or (finding["code"] in _RECORDINGS) is not of_recordings:
                    continue
                if experiment["accepted"] and finding["code"] in _LOSSES:
                    losses.setdefault(experiment["title"], set()).update(finding["where"])
                elif finding["code"] != "recording-simulated":
                    titles.setdefault(finding["sentence"], []).append(experiment["title"])
        yield from (f"{', '.join(dict.fromkeys(named))}: {sentence}" for sentence, named in titles.items())
    if losses:
        count = counted(len(set[str]().union(*losses.values())), "recording")
        yield f"{', '.join(losses)}: {count} lost samples or missed some; the fits are accepted nevertheless."
