"""Refit one campaign from its recordings: the task of one process, or of one worker of a cluster."""

import re
import tempfile
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath

from cfid.errors import CfidError, DataError
from cfid.fleet.places import Place, at_hand
from cfid.fleet.recipes import NO_CHANGES, again, options_of
from cfid.recordings.resumed import resumed_by
from cfid.records.campaign import Campaign, open_campaign
from cfid.records.files import RIG_FILE, RUNS_FOLDER
from cfid.records.fits import BY_HAND, Fit, keep_fit, list_fits
from cfid.records.parameters import Parameter, Section
from cfid.records.run import Run, read_run
from cfid.version import __version__

_FARTHEST = 1e9  # standard uncertainties: larger moves, as after an edit of a value or std, count as this
_RUN_NAME = re.compile(r"[A-Za-z0-9_+-][A-Za-z0-9_.+-]*")


@dataclass(frozen=True, kw_only=True)
class Refit:
    """One repeated fit, or a sentence on why it was not repeated.

    `moved` is the largest change of an accepted number, in standard uncertainties of the kept number, and `most` is the
    name of this number; they are None and "" where nothing can be compared.
    """

    name: str
    fault: str = ""
    moved: float | None = None
    most: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Refitted:
    """A refitted campaign: its files by name, and the outcome of each fit, or the `fault` if it cannot be read.

    `cfid_version` is kept because a cluster's worker may have another version of cfid.
    """

    files: Mapping[str, bytes]
    fits: tuple[Refit, ...]
    processor_s: float
    fault: str = ""
    cfid_version: str = __version__


def refit(campaign: str, changes: Mapping[str, str] = NO_CHANGES) -> Refitted:
    """Repeat the fits that a campaign's values come from, in the original order, without changing the campaign.

    `changes` replaces options of the fits. Raises no CfidError, since one faulty campaign must not stop the others.
    """
    began_s = time.process_time()
    try:
        with at_hand(campaign) as place, tempfile.TemporaryDirectory(prefix="cfid-fleet-") as made:
            fits = tuple(_repeat_all(place, Path(made), changes))
            files = {
                path.relative_to(made).as_posix(): path.read_bytes() for path in Path(made).rglob("*") if path.is_file()
            }
    except CfidError as error:
        return Refitted(files={}, fits=(), processor_s=time.process_time() - began_s, fault=str(error))
    return Refitted(files=files, fits=fits, processor_s=time.process_time() - began_s)


def _repeat_all(place: Place, folder: Path, changes: Mapping[str, str]) -> Iterable[Refit]:
    """Make a campaign in a folder with the rig of the original campaign, and repeat the original fits in it."""
    own = open_campaign(place.folder)
    (folder / RIG_FILE).write_bytes((place.folder / RIG_FILE).read_bytes())
    made = open_campaign(folder)
    listed, values = list_fits(own.fits_folder), own.values()
    unreadable = [fit for fit in listed if not isinstance(fit, Fit)]
    fits = sorted({*values.by_fit, *values.in_force.values()}, key=lambda fit: fit.order)
    for fit in (fit for fit in fits if fit.name == BY_HAND):
        keep_fit(made.fits_folder, fit)
    if not listed:
        raise DataError(f"{place.named(str(own.fits_folder))}: holds no fit that could be repeated.")
    for fault in unreadable:
        yield Refit(name="", fault=place.named(str(fault)))
    for fit in (fit for fit in fits if fit.name != BY_HAND):
        try:
            yield _repeat(fit, own, made, place, changes)
        except CfidError as error:
            yield Refit(name=fit.name, fault=place.named(str(error)))


def _repeat(fit: Fit, own: Campaign, made: Campaign, place: Place, changes: Mapping[str, str]) -> Refit:
    runs, notes = _runs_of(fit, own, place)
    options = options_of(fit, changes)
    scales = [_scales(one, own, place) for one in options.get("verify") or ()]
    brought = options | ({"verify": scales} if scales else {})
    result = again(fit, [run.folder for run in runs], campaign=made.folder, options=brought)
    before = {source.sha256 for source in fit.section.sources}
    changed = [PurePath(source.path).name for source in result.sources if source.sha256 not in before]
    if changed and not any("left out" in note for note in notes):
        notes += (f"changed since it was fitted: {', '.join(changed)}.",)
    sources = tuple(replace(source, path=place.named(source.path)) for source in result.sources)
    made.keep(replace(result, sources=sources), force=options.get("force", False), options=options)
    moves = moves_of(fit.section, made.fits()[-1].section.parameters)
    if beyond := [name for move, name in moves if move == _FARTHEST]:
        notes += (f"moved by {_FARTHEST:g} of the kept std or more: {', '.join(beyond)}.",)
    moved, most = max(moves, default=(None, ""))
    return Refit(name=fit.name, moved=moved, most=most, notes=notes)


def _runs_of(fit: Fit, own: Campaign, place: Place) -> tuple[list[Run], tuple[str, ...]]:
    """Return a fit's runs, except those excluded since, and notes. Raises DataError for a fit of other files."""
    paths = [PurePath(source.path) for source in fit.section.sources]
    elsewhere = [
        str(path)
        for path in paths
        if path.parts[:1] != (RUNS_FOLDER,) or len(path.parts) != 3 or not _RUN_NAME.fullmatch(path.parts[1])
    ]
    if elsewhere or not paths:
        where = elsewhere[0] if elsewhere else "no file"
        raise DataError(f"was made from {where}, which is no run of the campaign: fit it by hand.")
    runs = []
    for name in dict.fromkeys(path.parts[1] for path in paths):
        place.bring_run(name)
        runs.append(read_run(own.runs_folder / name))
    left = [run.folder.name for run in runs if run.header.excluded]
    if len(left) == len(runs):
        raise DataError(f"all its runs are excluded now: {', '.join(left)}.")
    notes = (f"left out, since excluded: {', '.join(left)}.",) if left else ()
    return [run for run in runs if not run.header.excluded], notes


def _scales(named: Path, own: Campaign, place: Place) -> Path:
    """Return the path of the recording of scales that verified a fit: a file, or the folder of a named run.

    The runs that this run completes are fetched too.
    """
    if named.exists() or not _RUN_NAME.fullmatch(str(named)):
        return named
    names = [str(named)]
    while _RUN_NAME.fullmatch(names[-1]) and names[-1] not in names[:-1]:
        place.bring_run(names[-1])
        names.append(resumed_by(read_run(own.runs_folder / names[-1])))
    return own.runs_folder / named


def moves_of(kept: Section, made: Mapping[str, Parameter]) -> list[tuple[float, str]]:
    """Return the change of each number, in standard uncertainties of the kept number up to a limit, and its name."""
    new = {one.name: one.value for key, found in made.items() for one in found.numbers(key)}
    return [
        (min(abs(value - one.value) / one.std, _FARTHEST), one.name)
        for key, found in kept.parameters.items()
        if key not in kept.rejected
        for one in found.numbers(key)
        if one.std and one.value is not None and (value := new.get(one.name)) is not None
    ]
