"""Repeat kept fits through their commands, and refit campaigns from their recordings, each into a folder of its own."""

import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, Literal

import typer
from typer.main import get_command

from cfid.console.messages import clock, echo
from cfid.console.outcome import taking
from cfid.console.program import LABELS, OF_THE_PRINT, Program, running
from cfid.counted import counted
from cfid.errors import CfidError, ConfigError, DataError
from cfid.experiments import EXPERIMENTS, function_at
from cfid.fleet.campaigns import workers
from cfid.quantities.values import is_rows
from cfid.records.campaign import Campaign, open_campaign
from cfid.records.files import RIG_FILE, locked_folder, read_small
from cfid.records.fits import BY_HAND, Fit, keep_fit, list_fits
from cfid.records.parameters import Parameter, Section, runs_of
from cfid.records.result import Result
from cfid.records.run import read_run
from cfid.version import __version__

LOG = "refit.json"
NO_CHANGES: Mapping[str, str] = MappingProxyType({})
_INCOMPLETE = ".incomplete-"  # begins the name of a folder that a refit is working in
_LINES = 20  # printed about the progress
_FARTHEST = 1e9  # standard uncertainties: larger moves, as after an edit of a value or std, count as this

Method = Literal["default", "thesis"]
Outcome = Mapping[str, Any]  # the content of a refit.json


@dataclass(frozen=True, kw_only=True)
class Refit:
    """One repeated fit, or in `fault` a sentence on why it was not repeated.

    `moved` is the largest change of an accepted number, in standard uncertainties of the kept number, and `most` is the
    name of this number; they are None and "" where nothing can be compared.
    """

    name: str
    fault: str = ""
    moved: float | None = None
    most: str = ""
    notes: tuple[str, ...] = ()


def refit(folder: str, made: Path, changes: Mapping[str, str] = NO_CHANGES) -> Outcome:
    """Repeat the fits that a campaign's values come from, in their order, in the new folder `made`.

    `changes` replaces options of the fits. The folder gets the campaign's rig.toml, values set by hand, the new fits,
    and refit.json, whose content is returned: campaign, version, changes, and the outcome of each fit. The campaign
    itself is not changed. Raises CfidError when it cannot be read, OSError when the folder cannot be written.
    """
    campaign = open_campaign(folder)
    listed, values = list_fits(campaign.fits_folder), campaign.values()
    if not listed:
        raise DataError(f"{campaign.fits_folder}: holds no fit that could be repeated.")
    made.mkdir()
    (made / RIG_FILE).write_bytes((campaign.folder / RIG_FILE).read_bytes())
    target = open_campaign(made)
    fits = sorted({*values.by_fit, *values.in_force.values()}, key=lambda fit: fit.order)
    for fit in (fit for fit in fits if fit.name == BY_HAND):
        keep_fit(target.fits_folder, fit)
    outcomes = [Refit(name="", fault=str(fault)) for fault in listed if isinstance(fault, DataError)]
    for fit in (fit for fit in fits if fit.name != BY_HAND):
        try:
            outcomes.append(_repeat(fit, campaign, target, changes))
        except CfidError as error:
            outcomes.append(Refit(name=fit.name, fault=str(error)))
    content = {
        "campaign": folder,
        "cfid_version": __version__,
        "changes": dict(changes),
        "fits": [asdict(outcome) for outcome in outcomes],
    }
    (made / LOG).write_text(json.dumps(content, indent=1, allow_nan=False))
    return content


def refitted(folders: Sequence[str], out: Path, changes: Mapping[str, str]) -> Iterator[tuple[str, Path, Outcome]]:
    """Yield each campaign with its folder in `out` and the content of its refit.json, {} for one not refitted yet.

    Campaigns of one name have numbered folders, in the given order. Raises ConfigError for a folder that was refitted
    by another version or with other changes, and for one that no refit made.
    """
    taken = set[str]()
    for folder in folders:
        name, number = Path(folder).name, 1
        outcome: Outcome = {}
        while name in taken or ((out / name).exists() and (outcome := _log(out / name))["campaign"] != folder):
            number += 1
            name, outcome = f"{Path(folder).name}-{number}", {}
        taken.add(name)
        if outcome and (outcome["cfid_version"], outcome["changes"]) != (__version__, changes):
            options = ", ".join(f"{key} {value}" for key, value in outcome["changes"].items()) or "no changes"
            raise ConfigError(
                f"{out / name}: was refitted by cfid {outcome['cfid_version']} with {options}: name a new folder."
            )
        yield folder, out / name, outcome


def refits(
    waiting: Mapping[Path, str], out: Path, changes: Mapping[str, str], *, jobs: int, scheduler: str | None = None
) -> Iterator[tuple[Path, Outcome | CfidError]]:
    """Refit the campaigns, by the folders to make; yield each with its outcome or why there is none, in any order.

    A folder gets its name when it is complete, so that an interruption leaves no incomplete one; what a killed command
    left is removed first. Raises ConfigError where nothing can be written.
    """
    if not waiting:
        return
    began_s = time.monotonic()
    try:
        out.mkdir(parents=True, exist_ok=True)
        with (
            locked_folder(out),  # another command that works there is waited for
            _workplace(out) as half,
            workers(jobs, scheduler, most=len(waiting)) as pool,
        ):
            futures = {pool.submit(refit, folder, half / made.name, changes): made for made, folder in waiting.items()}
            for count, future in enumerate(as_completed(futures), 1):
                made = futures[future]
                outcome = _outcome_of(future, waiting[made])
                if not isinstance(outcome, CfidError):
                    (half / made.name).rename(made)
                yield made, outcome
                if count == len(futures) or count % -(-len(futures) // _LINES) == 0:
                    spent_s = time.monotonic() - began_s
                    rest = f", {clock(spent_s / count * (len(futures) - count))} to go" if count < len(futures) else ""
                    echo(f"{count} of {counted(len(futures), 'campaign')} in {clock(spent_s)}{rest}", err=True)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror or error}.") from None


@contextmanager
def _workplace(out: Path) -> Iterator[Path]:
    """Make a folder for incomplete results, and remove those of commands that were killed."""
    for left in out.glob(f"{_INCOMPLETE}*"):
        shutil.rmtree(left, ignore_errors=True)
    with TemporaryDirectory(dir=out, prefix=_INCOMPLETE) as folder:
        yield Path(folder)


def _outcome_of(future: "Future[Outcome]", folder: str) -> Outcome | CfidError:
    try:
        return future.result()
    except CfidError as error:
        return error
    except BrokenProcessPool:
        return DataError(
            f"{folder}: a process died, perhaps for lack of memory, and ended the others. The same command continues; "
            "fewer `jobs` take less memory."
        )
    except Exception as error:  # a bug must not stop the other campaigns
        return DataError(f"{folder}: {type(error).__name__}: {error}".splitlines()[0])


def _log(folder: Path) -> Outcome:
    try:
        content = json.loads(read_small(folder / LOG))
        return {key: content[key] for key in ("campaign", "cfid_version", "changes", "fits")}
    except (OSError, ValueError, TypeError, KeyError):
        raise ConfigError(f"{folder}: exists, and no refit made it: name a new folder.") from None


def _repeat(fit: Fit, campaign: Campaign, target: Campaign, changes: Mapping[str, str]) -> Refit:
    elsewhere = [source.path for source in fit.section.sources if not source.run]
    if elsewhere or not fit.section.sources:
        raise DataError(
            f"was made from {(elsewhere or ['no file'])[0]}, which is no run of the campaign: fit it by hand."
        )
    runs = [read_run(campaign.runs_folder / name) for name in runs_of(fit.section.sources)]
    excluded = [run.folder.name for run in runs if run.header.excluded]
    if len(excluded) == len(runs):
        raise DataError(f"all its runs are excluded now: {', '.join(excluded)}.")
    options = options_of(fit, changes)
    if scales := options.get("verify"):  # names of runs, which the new campaign does not have
        options["verify"] = [path if Path(path).exists() else campaign.runs_folder / path for path in scales]
    used = [run.folder for run in runs if not run.header.excluded]
    result = again(fit, used, campaign=target.folder, options=options)
    changed = [Path(source.path).name for source in result.sources if source.sha256 not in fit.hashes]
    target.keep(result, force=options.get("force", False), options=options)
    moves = moves_of(fit.section, target.fits()[-1].section.parameters)
    notes = {
        "left out, since excluded": excluded,
        "changed since it was fitted": [] if excluded else changed,
    }
    moved, most = max(moves, default=(None, ""))
    texts = tuple(f"{text}: {', '.join(names)}." for text, names in notes.items() if names)
    return Refit(name=fit.name, moved=moved, most=most, notes=texts)


def moves_of(kept: Section, made: Mapping[str, Parameter]) -> list[tuple[float, str]]:
    """Return the change of each number, in standard uncertainties of the kept number up to a limit, and its name."""
    new = {number.name: number.value for key, parameter in made.items() for number in parameter.numbers(key)}
    return [
        (min(abs(value - number.value) / number.std, _FARTHEST), number.name)
        for key, parameter in kept.parameters.items()
        if key not in kept.rejected
        for number in parameter.numbers(key)
        if number.std and number.value is not None and (value := new.get(number.name)) is not None
    ]


def changes_of(words: Sequence[str], method: Method | None) -> dict[str, str]:
    """Return options that replace those of fits, from words such as "peaks=12" and from a method.

    Raises ConfigError for a word without a value, and for an option that no fit has.
    """
    changes = {} if method is None else {"method": str(method)}
    known = {str(option.name) for row in EXPERIMENTS.values() for option in _command(row.function).params} - {"force"}
    for word in words:
        name, sign, value = word.partition("=")
        key = name.strip().lstrip("-").replace("-", "_")
        if not (sign and value):
            raise ConfigError(f"`set` {word}: expected NAME=VALUE, as in peaks=12.")
        if key not in known:
            raise ConfigError(f"`set` {word}: no fit has an option {key}. A file in fits/ lists those of its fit.")
        changes[key] = value.strip()
    return changes


def options_of(kept: Fit, changes: Mapping[str, str] = NO_CHANGES) -> dict[str, Any]:
    """Return the options of a kept fit, with those of `changes` that its command has in place of its own.

    Raises DataError for a fit that cannot be repeated, and for an option that its command does not have.
    """
    swings = kept.quality.get("swings", ())
    known = [str(row.get("axis")) for row in swings if "known_kg_m2" in row] if is_rows(swings) else []
    if known:
        raise DataError(f"axis inertias of {', '.join(known)} were given as numbers: fit it by hand.")
    if kept.options is None:
        raise DataError("was made in Python, and its options are not kept: fit it by hand.")
    names = {option.name for option in _command_of(kept).params if option.param_type_name == "option"} - OF_THE_PRINT
    options = dict(kept.options) | {name: value for name, value in changes.items() if name in names}
    for name in options.keys() - names - {LABELS}:
        raise DataError(f"its option {name} = {options[name]!r} is none that this command takes: fit it by hand.")
    return options


def again(kept: Fit, runs: Sequence[Path], *, campaign: Path, options: Mapping[str, Any]) -> Result:
    """Fit the runs in these folders like a kept fit, with the rig.toml and the earlier fits of a campaign.

    Raises DataError for options that its command does not take.
    """
    command = _command_of(kept)
    words = _with_labels(runs, options.get(LABELS, ()))
    if command.params[0].nargs == 1:
        words = words[:1]
    given = {name: value for name, value in options.items() if name not in (LABELS, "force")}
    with running(Program(campaign=campaign)), taking() as results:
        try:
            with command.make_context(kept.command, words, default_map=given) as context:
                command.invoke(context)
        except typer.BadParameter as error:
            raise DataError(f"its options are none that this command takes: {error.format_message()}") from None
    return results[0]


def _with_labels(runs: Sequence[Path], typed: Sequence[str]) -> list[str]:
    """Return runs as words, with the labels typed for them. Raises DataError for a label of any other run."""
    names = {run.name for run in runs}
    labelled = [word.partition("=") for word in map(str, typed) if PurePath(word).name not in names]
    labels = {PurePath(run).name: label for label, _, run in labelled}
    if lost := labels.keys() - names:
        raise DataError(f"{labels[min(lost)]}={min(lost)} was typed, which is none of its runs: fit it by hand.")
    return [f"{labels[run.name]}={run}" if run.name in labels else str(run) for run in runs]


def _command_of(kept: Fit) -> Any:
    place = next((row.function for row in EXPERIMENTS.values() if row.fit == kept.command), None)
    if place is None:
        raise DataError(f"`cfid {kept.command}` is not repeated from its file: fit it by hand.")
    return _command(place)


def _command(place: str) -> Any:
    program = typer.Typer(add_completion=False)
    program.command()(function_at(place))
    return get_command(program)
