"""Deliver a result: keep it in the campaign, draw it, print it, set the exit code."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.console.campaign import write_parameters
from cfid.console.messages import echo, fitted, in_options, note, print_json, printable
from cfid.console.program import given_options, program
from cfid.console.tables import print_parameters
from cfid.counted import counted
from cfid.errors import ConfigError, RejectedError
from cfid.findings import CODES, Finding, texts
from cfid.quantities.registry import is_of_the_run
from cfid.records.result import Result
from cfid.version import __version__

if TYPE_CHECKING:
    from cfid.console.inputs import Workplace
    from cfid.records.campaign import Campaign

_SHOWN = 2  # warnings
_SIMULATED = "recording-simulated"


_taken: ContextVar[list[Result] | None] = ContextVar("taken", default=None)


@dataclass(frozen=True)
class Delivery:
    """How a result is printed, drawn and kept: the options at the end of each fit's list."""

    force: bool = False
    figures: bool | None = None
    out: Path | None = None


@contextmanager
def taking() -> Iterator[list[Result]]:
    """Collect the results that commands deliver, which are then neither printed, drawn nor kept."""
    results: list[Result] = []
    token = _taken.set(results)
    try:
        yield results
    finally:
        _taken.reset(token)


def deliver(result: Result, delivery: Delivery, workplace: "Workplace", *, keep: bool = True) -> None:
    """Draw, keep and print a result; with --force also rejected quantities and those impossible for the rig.

    Raises RejectedError when a quantity that the command determines was rejected and --force is not set; the fit is
    then kept without numbers. Raises ConfigError where no figure can be written; the result is then printed, but not
    kept.
    """
    from cfid.records.plausibility import judged

    result = judged(result, None if workplace.borrowed else workplace.rig)
    if (results := _taken.get()) is not None:
        results.append(result)
        return
    if result.folder is None and workplace.campaign is not None:
        result = replace(result, folder=workplace.campaign.folder / "figures")
    campaign = workplace.campaign if keep else None
    if campaign is not None:
        result = _with_names(result, campaign.runs_folder)
    given = result if delivery.force else result.without_rejected()
    try:
        drawn, undrawn = _draw(given, delivery), None
    except ConfigError as error:  # a full disk must not lose the computed numbers
        drawn, undrawn = (), error
    kept = result.accepted or delivery.force
    in_force, remark, stem = False, "", ""
    if campaign is not None and undrawn is None and (given.quantities or not kept):
        write_parameters(campaign)
        with suppress(RejectedError):  # of a rejected fit, which is kept without numbers
            path = campaign.keep(result, figures=drawn, force=delivery.force, options=given_options())
            stem = path.stem
            in_force, remark = _standing(campaign, stem)
    if program().json:
        print_json(_content(given, accepted=result.accepted, in_force=in_force))
    else:
        _print(given, drawn)
        rejections = texts(result.findings, "rejection") if kept else ()  # otherwise the error states them
        for word, text in _notes(result.findings, rejections, verbose=program().verbose):
            note(printable(text), word=word)
        if stem:
            echo(f"{'accepted' if result.accepted else 'rejected'}, kept as {stem}. Next: cfid status")
    if not kept:
        raise _refusal(result, campaign)
    if remark:
        note(remark)
    if undrawn is not None:
        raise ConfigError(f"{undrawn} Nothing is kept of this fit.") if campaign is not None else undrawn


def _notes(findings: Sequence[Finding], rejections: Sequence[str], *, verbose: bool) -> list[tuple[str, str]]:
    """Return the sentences to print, each with the word before it; without `verbose` two, and no notes.

    What a fit warns of comes before what readers of files do. That a recording is simulated stands in the title.
    """
    of_fits_first = sorted(findings, key=lambda finding: finding.code in CODES)
    told = [one for one in of_fits_first if verbose or one.code != _SIMULATED]
    warnings = [
        *(("rejected", text) for text in rejections),
        *(("warning", text) for text in texts(told, "warning")),
    ]
    if verbose:
        return [*warnings, *(("note", text) for text in texts(findings, "note"))]
    more = len(warnings[_SHOWN:])
    rest = [("note", f"{counted(more, 'more warning')}: `verbose` shows all.")] if more else []
    return [*warnings[:_SHOWN], *rest]


def _standing(campaign: "Campaign", stem: str) -> tuple[bool, str]:
    """Return whether any value of the campaign comes from a kept fit, and a sentence if some of its values do not."""
    values = campaign.values()
    fit = next(fit for fit in values.fits if fit.stem == stem)
    taken = {quantity.key for quantity in values if quantity.fit is fit}
    others = [key for key in fit.section.parameters if key not in taken and not is_of_the_run(key)]
    if not others:
        return bool(taken), ""
    reason = next((candidate.why for candidate in values.candidates(others[0]) if candidate.fit is fit), "")
    what = others[0] if len(others) == 1 else f"{others[0]} and {len(others) - 1} more"
    return bool(taken), f"{what} of the campaign stays as it was: {reason}. `cfid fits` lists all fits."


def _refusal(result: Result, campaign: "Campaign | None") -> RejectedError:
    """Print all rejections of a result but the first, each on a line of its own, and return that one as an error."""
    reason, *others = texts(result.findings, "rejection")
    for text in others:
        note(text, word="rejected")
    still = " The campaign's values are unchanged." if campaign is not None else ""
    return RejectedError(f"rejected: {reason}{still} Use --force to get the numbers anyway.")


def _with_names(result: Result, runs_folder: Path) -> Result:
    """Return a result whose findings name runs of the campaign by their names instead of their paths."""
    from cfid.records.run import by_name

    named = [
        replace(
            finding,
            sentence=by_name(finding.sentence, runs_folder),
            where=tuple(by_name(at, runs_folder) for at in finding.where),
        )
        for finding in result.findings
    ]
    return replace(result, findings=tuple(named))


def _content(result: Result, *, accepted: bool, in_force: bool) -> dict[str, Any]:
    return {
        "command": result.command,
        "parameters": {name: p.as_json() for name, p in result.quantities.items()},
        "accepted": accepted,
        "in_force": in_force,
        "findings": [finding.as_json() | {"text": in_options(finding.text)} for finding in result.findings],
        "quality": result.quality,
        "sources": [asdict(source) for source in result.sources],
        "version": __version__,
    }


def _draw(result: Result, delivery: Delivery) -> Sequence[Path]:
    placed = delivery.out is not None or result.folder is not None
    wanted = placed if delivery.figures is None else delivery.figures
    if program().json and delivery.out is None:
        wanted = False
    if not wanted or result.drawings is None:
        return ()
    from cfid.drawing.save import save_figure

    folder = delivery.out or result.folder or Path()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        drawings = result.figures()
        saved = [save_figure(figure, folder / name, force=delivery.force) for name, figure in drawings.items()]
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigError(f"{folder}: no figure can be written: {reason}. Use --out DIR or --no-figures.") from None
    return [path for paths in saved for path in paths]


def _print(result: Result, drawn: Sequence[Path]) -> None:
    from cfid.records.campaign import are_simulated

    hidden = () if program().verbose else result.beside
    shown = {
        key: quantity
        for key, quantity in result.quantities.items()
        if not any(fnmatchcase(key, pattern) for pattern in hidden)
    }
    if shown:
        print_parameters(shown, title=f"cfid {result.command}{', simulated' * are_simulated(result.sources)}")
    for line in result.summary() if result.prints_lines or program().verbose else ():
        echo(fitted(in_options(printable(line))))
    if pictures := [path for path in drawn if path.suffix == ".png"]:
        names = ", ".join(path.name for path in pictures)
        echo(fitted(f"figures in {pictures[0].parent}: {names} (and .svg)", indent=2, err=True), err=True)
