"""`cfid fits`: list a campaign's kept fits, withdraw them, and repeat them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Column, Table

from cfid.console.campaign import here, write_parameters
from cfid.console.messages import echo, note, print_json, printable
from cfid.console.program import program
from cfid.errors import ConfigError, DataError, FitError
from cfid.fleet.refit import again, moves_of, options_of
from cfid.records.fits import is_withdrawn, list_fits, withdraw
from cfid.records.parameters import runs_of

if TYPE_CHECKING:
    from cfid.records.campaign import Campaign
    from cfid.records.fits import Fit
    from cfid.records.parameters import Parameter
    from cfid.records.values import Values

_DIFFERENT = 1e-6  # of a standard uncertainty: below it, numbers differ by rounding


def show_fits(context: typer.Context) -> None:
    """List the kept fits: which count, and why the others do not.

    cfid parameters --why KEY compares the fits that have one parameter.

    Example: cfid fits
    """
    if context.invoked_subcommand is not None:
        return

    campaign = here()
    values, listed = campaign.values(), list_fits(campaign.fits_folder)
    counts = {fit.stem: len(quantities) for fit, quantities in values.by_fit.items()}
    rows = [
        (fit, counts.get(fit.stem, 0), _state(fit, values, withdrawn=is_withdrawn(campaign.fits_folder, fit)))
        for fit in listed
        if not isinstance(fit, DataError)
    ]
    for fault in (fault for fault in listed if isinstance(fault, DataError)):
        note(f"{fault} The fit does not count.")
    if program().json:
        content = [
            {
                "fit": fit.stem, "command": fit.command, "options": fit.options, "method": fit.section.method,
                "revision": fit.revision, "found": fit.section.found.isoformat(), "accepted": fit.section.accepted,
                "recordings": sorted(fit.recordings), "parameters_taken": count, "state": state,
            }
            for fit, count, state in rows
        ]  # fmt: skip
        print_json({"command": "fits", "fits": content})
        return

    table = Table(Column("fit", overflow="fold"), "when", "recordings", "taken", "state", box=SIMPLE, pad_edge=False)
    for fit, count, state in rows:
        cells = (fit.stem, f"{fit.section.found:%Y-%m-%d %H:%M}", str(len(fit.recordings)), str(count), state)
        table.add_row(*map(printable, cells))
    if rows:
        Console().print(table)
    else:
        echo("no fits yet: `cfid fit --help` lists them.")


def drop(words: Annotated[list[str], typer.Argument(metavar="FIT ...", help="Names or numbers of fits.")]) -> None:
    """Withdraw fits, so that the next best count. Nothing is deleted.

    Example: cfid fits drop 0007_thrust
    """
    campaign = here()
    for fit in [_fit_named(word, campaign) for word in words]:
        before = {quantity.key for quantity in campaign.values() if quantity.fit.stem == fit.stem}
        withdraw(campaign.fits_folder, fit)
        now = {quantity.key: quantity.fit.stem for quantity in campaign.values()}
        others = dict.fromkeys(now[key] for key in sorted(before) if key in now)
        lost = sorted(before - now.keys())
        echo(f"{fit.stem}: withdrawn." + (f" Its parameters now come from {', '.join(others)}." if others else ""))
        if lost:
            note(f"no other fit has {', '.join(lost)}.")
    write_parameters(campaign)


def repeat(
    word: Annotated[str, typer.Argument(metavar="FIT", help="A fit's name as `cfid fits` lists it, or its number.")],
) -> None:
    """Repeat a kept fit, and state whether the numbers are the same.

    Nothing is kept.

    Example: cfid fits repeat 0007_thrust
    """
    campaign = here()
    fit = _fit_named(word, campaign)
    elsewhere = [source.path for source in fit.section.sources if not source.run]
    if elsewhere or not fit.section.sources:
        raise DataError(
            f"{fit.stem}: was made from {elsewhere[0] if elsewhere else 'no file'}, not from runs: fit it by hand."
        )
    for reason in campaign.values().outdated(fit):
        note(f"{fit.stem}: {reason}")
    runs = [campaign.runs_folder / name for name in runs_of(fit.section.sources)]
    result = again(fit, runs, campaign=campaign.folder, options=options_of(fit))
    if not (fit.options and fit.options.get("force")):  # a rejected fit is kept without numbers
        result = result.without_rejected() if result.accepted else replace(result, quantities={})
    before, now = _numbers(fit.section.parameters), _numbers(result.quantities)
    moves = {name: move for move, name in sorted(moves_of(fit.section, result.quantities), reverse=True)}
    gone, new = sorted(before.keys() - now.keys()), sorted(now.keys() - before.keys())
    same = now == before or not (gone or new or any(move >= _DIFFERENT for move in moves.values()))
    if program().json:
        moved = [
            {"name": name, "before": before[name], "now": now[name], "move_over_std": move}
            for name, move in moves.items()
            if move >= _DIFFERENT
        ]
        head = {"command": "fits repeat", "fit": fit.stem, "same": same}
        print_json({**head, "moved": moved, "gone": gone, "new": new})
    elif same:
        rounding = "" if now == before else " but for rounding"
        echo(f"{fit.stem}: {f'the same {len(before)} numbers{rounding}' if before else 'rejected, as before'}.")
    else:
        for name, move in moves.items():
            if move >= _DIFFERENT:
                echo(f"  {name}: {before[name]:g}, now {now[name]:g}: moved by {move:.2g} standard uncertainties.")
        for name in (*gone, *new):
            echo(f"  {name}: is {'gone' if name in before else 'new'}.")
    if not same:
        raise FitError(f"{fit.stem}: has other numbers than those kept.")


def _numbers(parameters: "Mapping[str, Parameter]") -> dict[str, Any]:
    """Return the value of each number of some parameters by the number's name."""
    return {number.name: number.value for key, parameter in parameters.items() for number in parameter.numbers(key)}


def _fit_named(word: str, campaign: "Campaign") -> "Fit":
    """Return the kept fit of a name or number. Raises ConfigError where there is none."""
    stem = word.removesuffix(".json")
    fits = [fit for fit in campaign.fits() if fit.stem == stem or (word.isdecimal() and fit.number == int(word))]
    if len(fits) != 1:
        raise ConfigError(f"{word}: no kept fit has this name or number; `cfid fits` lists them.")
    return fits[0]


def _state(fit: "Fit", values: "Values", *, withdrawn: bool) -> str:
    """Return in a few words whether a fit's parameters count, and why not."""
    if withdrawn:
        return "withdrawn"
    taken = values.by_fit.get(next((other for other in values.fits if other.stem == fit.stem), fit), [])
    keys = [
        key
        for key in (*fit.section.parameters, *fit.section.rejected)
        if key not in {quantity.key for quantity in taken}
    ]
    if not keys:
        return "counts"
    why = next(
        (candidate.why for candidate in values.candidates(keys[0]) if candidate.fit.stem == fit.stem), "rejected"
    )
    return f"counts, except {keys[0]}{' and others' if len(keys) > 1 else ''}: {why}" if taken else why
