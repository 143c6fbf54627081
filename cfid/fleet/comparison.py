"""Compare each number of many campaigns: mean, scatter against what the uncertainties explain, outliers and drift."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import PurePath
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri, stdtr, stdtrit

from cfid.errors import CfidError
from cfid.estimate.propagation import Repeats, repeats
from cfid.findings import Finding, warning
from cfid.quantities.registry import find
from cfid.records import lab_book
from cfid.records.campaign import open_campaign
from cfid.records.parameters import Section
from cfid.records.run import Run, list_runs

Array = npt.NDArray[np.float64]

FEWEST = 5  # values, for one of them to be called an outlier
_FALSE = 0.01  # share of numbers without outliers of which one is named
_CERTAIN = 0.995  # confidence in a drift on one side: 99 % for both sides
_START_IN_NAME = "%Y-%m-%d_%H%M%S"  # the start of a run, in its name


class KnownValue(NamedTuple):
    """A number of a campaign, with its standard uncertainty if known, and the time of its last recording.

    `is_main` marks a number of a quantity that has an aim, such as the inertia.
    """

    name: str
    value: float
    std: float | None
    unit: str
    recorded: datetime
    accepted: bool
    is_main: bool


@dataclass(frozen=True, kw_only=True)
class Summary:
    """A campaign's numbers, and findings on its recordings; `recordings` are the hashes of those behind its numbers.

    `name` is the name of the folder, or its path if another folder of the fleet has the same name.
    """

    folder: str
    name: str
    vehicle: str
    complete_runs: int
    other_runs: int
    known: tuple[KnownValue, ...]
    lab_book: dict[str, dict[str, int]]
    findings: tuple[Finding, ...]
    recordings: frozenset[str]


@dataclass(frozen=True, kw_only=True)
class ComparedNumber:
    """One number in all campaigns: its value in each, None if missing, and how well the accepted values agree.

    `expected_scatter` is the standard deviation that the stated uncertainties alone would cause, None if unknown.
    `outliers` names the campaigns that lie apart from the others, `rejected` those whose number was rejected, and
    `without_std` those whose number has no uncertainty. Numbers without an uncertainty do not count if at least two
    others have one.
    """

    name: str
    unit: str
    is_main: bool
    values: tuple[KnownValue | None, ...]
    used: int
    repeats: Repeats | None
    expected_scatter: float | None
    outliers: tuple[str, ...]
    rejected: tuple[str, ...]
    without_std: tuple[str, ...]

    @property
    def drifts(self) -> bool:
        """Whether the drift is significant at 99 % confidence."""
        repeats = self.repeats
        if repeats is None or repeats.drift_per_day is None or not repeats.drift_std_per_day:
            return False
        limit = ndtri(_CERTAIN) if repeats.probability is not None else stdtrit(self.used - 2, _CERTAIN)
        return bool(abs(repeats.drift_per_day) > limit * repeats.drift_std_per_day)


def summarise(folder: str) -> Summary | CfidError:
    """Return a campaign's summary or its error, so that one faulty campaign does not hide the others."""
    try:
        campaign = open_campaign(folder)
        listed = list_runs(campaign.runs_folder)
        runs = [run for run in listed if isinstance(run, Run)]
        values = campaign.values(runs)
        by_fit = values.by_fit
    except CfidError as error:
        return error
    known = list[KnownValue]()
    findings = [warning("run-unreadable", f"{run} It does not count.") for run in listed if not isinstance(run, Run)]
    for fit, quantities in by_fit.items():
        recorded, axis = _recorded(fit.section), fit.name.partition(" ")[2]
        for quantity in quantities:
            for number in quantity.parameter.numbers(quantity.key):
                if number.value is None:
                    continue
                value, std = float(number.value), None if number.std is None else float(number.std)
                name = f"{number.name} ({axis})" if axis else number.name  # fits such as `swing x` share names
                row, unit = find(quantity.key), quantity.parameter.unit
                is_main = row is not None and row.aim is not None
                known.append(KnownValue(name, value, std, unit, recorded, quantity.accepted, is_main))
        findings += [warning("fit-outdated", f"{fit.stem}: {reason}") for reason in values.outdated(fit)]
    sources = sorted({source for fit in by_fit for source in fit.section.sources}, key=lambda source: source.path)
    missing = [source.path for source in sources if not (campaign.folder / source.path).exists()]
    findings += [warning("source-missing", f"{path} is missing.") for path in missing]
    complete = sum(run.header.state == "complete" for run in runs)
    return Summary(
        folder=folder,
        name=campaign.folder.name,
        vehicle=campaign.rig.vehicle.name,
        complete_runs=complete,
        other_runs=len(listed) - complete,
        known=tuple(known),
        lab_book=lab_book.summary(runs),
        findings=tuple(findings),
        recordings=frozenset(source.sha256 for source in sources),
    )


def distinct(summaries: Sequence[Summary]) -> list[Summary]:
    """Return summaries with distinct names, and a finding on each that shares recordings with an earlier one."""
    names = Counter(summary.name for summary in summaries)
    first, result = dict[str, str](), []
    for summary in summaries:
        name = summary.name if names[summary.name] == 1 else summary.folder
        shared = [first[digest] for digest in sorted(summary.recordings) if digest in first]
        first |= dict.fromkeys(summary.recordings - first.keys(), name)
        text = f"rests on recordings of {shared[0]}, and both count: name one of them alone." if shared else ""
        findings = (*summary.findings, *([warning("recordings-shared", text)] if text else []))
        result.append(replace(summary, name=name, findings=findings))
    return result


def compare(summaries: Sequence[Summary]) -> list[ComparedNumber]:
    """Compare the numbers of campaigns; numbers of the same name in different units are different numbers."""
    names = [summary.name for summary in summaries]
    tables = [{(known.name, known.unit): known for known in summary.known} for summary in summaries]
    keys = dict.fromkeys(key for table in tables for key in table)
    units = Counter(name for name, _ in keys)
    return [
        _compared(name if units[name] == 1 else f"{name}, {unit}", [table.get((name, unit)) for table in tables], names)
        for name, unit in keys
    ]


def _compared(name: str, values: Sequence[KnownValue | None], campaigns: Sequence[str]) -> ComparedNumber:
    known = [(place, value) for place, value in zip(campaigns, values, strict=True) if value is not None]
    accepted = [(place, value) for place, value in known if value.accepted]
    stated = [(place, value) for place, value in accepted if value.std]
    counting = stated if len(stated) > 1 else accepted
    value = np.array([value.value for _, value in counting])
    std = np.array([value.std or np.nan for _, value in counting])
    time_s = np.array([value.recorded.timestamp() for _, value in counting])
    is_stated = len(stated) > 1
    return ComparedNumber(
        name=name,
        unit=known[0][1].unit,
        is_main=known[0][1].is_main,
        values=tuple(values),
        used=len(counting),
        repeats=repeats(time_s=time_s, value=value, std=std) if len(counting) > 1 else None,
        expected_scatter=float(np.sqrt(np.mean(std**2))) if is_stated else None,
        outliers=tuple(counting[place][0] for place in outliers(value, std)) if is_stated else (),
        rejected=tuple(place for place, value in known if not value.accepted),
        without_std=tuple(place for place, value in accepted if not value.std),
    )


def outliers(value: Array, std: Array) -> list[int]:
    """Return the indices of outliers among values (n,) with standard uncertainties (n,), the farthest first.

    Each value is predicted from the others: their mean, with its own standard uncertainty and the scatter between the
    others that their uncertainties leave (R. DerSimonian, N. Laird, Meta-analysis in clinical trials, Controlled
    Clinical Trials 7, 1986). It is an outlier if its distance is improbable both for the normal distribution of what
    is stated and for Student's t of the scatter that the others show, at a level that names an outlier in one of a
    hundred numbers without any. The farthest is removed before the others are tested again. Among fewer than five
    values, none is an outlier.
    """
    places, named = np.arange(len(value)), []
    while len(places) >= FEWEST:
        chances = [_chance_of_distance(value[places], std[places], place) for place in range(len(places))]
        farthest = int(np.argmin(chances))
        if chances[farthest] * len(places) > _FALSE:
            break
        named.append(int(places[farthest]))
        places = np.delete(places, farthest)
    return named


def _chance_of_distance(value: Array, std: Array, place: int) -> float:
    """Return the probability that a value lies as far from the mean of the others as it does."""
    others, freedom = np.arange(len(value)) != place, len(value) - 2
    weight = 1 / std[others] ** 2
    spread = weight @ (value[others] - np.average(value[others], weights=weight)) ** 2
    between = max(0.0, (spread - freedom) / (weight.sum() - weight @ weight / weight.sum()))
    weight = 1 / (std[others] ** 2 + between)
    mean = np.average(value[others], weights=weight)
    ratio = weight @ (value[others] - mean) ** 2 / freedom
    distance = abs(value[place] - mean) / np.sqrt(std[place] ** 2 + between + 1 / weight.sum())
    by_scatter = stdtr(freedom, -distance / np.sqrt(ratio)) if ratio > 0 else 0.0
    return 2 * float(max(ndtr(-distance), by_scatter))


def _recorded(section: Section) -> datetime:
    """Return the start of a section's last run, which its name states, or the time of the fit if it has no runs."""
    times = []
    for source in section.sources:
        with suppress(ValueError):
            name = PurePath(source.path).parent.name[: len("2026-11-21_083012")]
            times.append(datetime.strptime(name, _START_IN_NAME).replace(tzinfo=UTC))
    return max(times, default=section.found)
