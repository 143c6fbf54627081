"""`cfid export`: export a campaign's parameters to the files of firmware and simulators."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from cfid.console.campaign import here
from cfid.console.messages import echo, headline, in_options, note

if TYPE_CHECKING:
    from cfid.export.target import Target
    from cfid.export.vehicle import ExportVehicle
    from cfid.records.campaign import Campaign
    from cfid.records.values import Values

LIST, SAMPLES = "list", "samples"
FOLDER = "exports"  # in a campaign's folder


def export(
    target: Annotated[
        str,
        typer.Argument(
            metavar="TARGET|list|samples",
            help="Target to write; list shows all targets; samples draws vehicles from the uncertainties.",
        ),
    ],
    *,
    out: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|-", help="File to write; - is stdout; default: a file in the campaign's exports folder."
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option("--samples", "--n", min=1, help="Number of vehicles to draw, with samples; default: 1000."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of the random numbers, with samples; default: 1.")
    ] = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Overwrite a file; export rejected, outdated or implausible quantities, marked as such, but never a "
            "firmware header whose thrust over voltage would stop the motors.",
        ),
    ] = False,
    campaign: Annotated[
        Path | None, typer.Option(help="Campaign folder; default: the current folder or a parent.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the list as one JSON object.")] = False,
) -> None:
    """Export the measured parameters to a file for firmware or a simulator, in its frame and units, with their origins.

    A quantity that was not measured is left out or marked, never guessed; a target that needs it is refused. Rejected,
    outdated or implausible quantities are refused too, unless --force is given; the file then marks them.

    Example: [bold]cfid export crazyflow[/bold]
    """
    from cfid.errors import ConfigError
    from cfid.export.catalogue import target_named
    from cfid.export.target import text_of

    found = here(campaign)
    known = _known(found)
    if target == LIST:
        _print_list(known.vehicle, json=json)
        return
    if json:
        raise ConfigError("--json goes with `cfid export list`: an export has its target's own format.")
    if target == SAMPLES:
        from cfid.export.samples_command import write_samples

        if out == "-":
            raise ConfigError("samples are several files: --out must name a folder, not -.")
        folder = Path(out) if out else found.folder / FOLDER
        write_samples(known, folder, count=count or 1000, seed=1 if seed is None else seed, force=force)
        return
    if count is not None or seed is not None:
        raise ConfigError("--samples and --seed go with `cfid export samples`: a file has the measured numbers.")
    wanted, vehicle = target_named(target), known.vehicle
    text = text_of(wanted, vehicle)  # raises first, since --force does not lift its refusals
    refuse(wanted, known, force=force)
    _write(text, out or str(found.folder / FOLDER / wanted.file_name), force=force)
    _warn(wanted, vehicle)


class ExportInput(NamedTuple):
    """A campaign's values, and the vehicle to export."""

    values: "Values"
    vehicle: "ExportVehicle"


def refuse(target: "Target", known: ExportInput, *, force: bool) -> None:
    """Raise DataError for quantities that should not be exported; with `force`, these are exported and marked."""
    from cfid.errors import DataError
    from cfid.export.refusals import objections, refuse_rejected

    refuse_rejected(target, known.vehicle, known.values)
    against = objections(target, known.vehicle)
    if against and not force:
        raise DataError(
            f"{target.name}: nothing was written. {' '.join(against)} Use --force to write it anyway, marked."
        )


def _known(campaign: "Campaign") -> ExportInput:
    from cfid.console.campaign import note_earlier_parameters, note_unreadable_fits
    from cfid.errors import DataError
    from cfid.export.refusals import marked
    from cfid.export.vehicle import collect

    note_earlier_parameters(campaign)
    if note_unreadable_fits(campaign):
        raise DataError("an export needs all kept fits: restore those that cannot be read, or move them out of fits/.")
    simulated = {run.folder.name for run in campaign.runs(complete=False) if run.header.simulated}
    values = campaign.values()
    return ExportInput(values, marked(collect(campaign.rig, values, simulated=simulated)))


def _write(text: str, out: str, *, force: bool) -> None:
    from cfid.errors import ConfigError
    from cfid.records.files import refuse_kept, write_whole

    if out == "-":
        echo(text, nl=False)
        return
    path = Path(out)
    try:
        if (path.exists() or path.is_symlink()) and not force:
            raise ConfigError(
                f"{path} exists already: nothing was changed. --force overwrites it, --out names another."
            )
        refuse_kept(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text.encode())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}.") from None
    echo(str(path))


def _warn(target: "Target", vehicle: "ExportVehicle") -> None:
    from cfid.export.target import caveats, left_out, need_text, simulated, unaccepted

    if keys := simulated(target, vehicle):
        note(f"SIMULATED, no vehicle was measured: {', '.join(keys)}. The file marks them.")
    for sentence in caveats(target, vehicle):
        note(sentence)
    for key in unaccepted(target, vehicle):
        note(f"{key} is rejected by its fit: the file marks it.")
    for use in left_out(target, vehicle):
        note(f"not measured, and left out or marked: {need_text(use)}.")


def _print_list(vehicle: "ExportVehicle", *, json: bool) -> None:
    from cfid.export.catalogue import TARGETS
    from cfid.version import __version__

    rows = [_row(target, vehicle) for target in TARGETS.values()]
    if json:
        import json as encoder

        content = {"command": "export list", "targets": rows, "version": __version__}
        echo(encoder.dumps(content, indent=2))
        return
    for row in rows:
        headline(f"{row['target']}: {row['about']}")
        _print_keys("has", ["; ".join(need["keys"] for need in row["needs"] + row["uses"] if need["known"])])
        _print_keys("MISSING", [f"{n['keys']}: {n['given_by']}" for n in row["needs"] if not n["known"]])
        _print_keys("could also use", [f"{n['keys']}: {n['given_by']}" for n in row["uses"] if not n["known"]])
        _print_keys("rejected", row["rejected"])


def _print_keys(title: str, words: list[str]) -> None:
    for word in words:
        echo(f"  {title}: {in_options(word)}")


def _row(target: "Target", vehicle: "ExportVehicle") -> dict[str, Any]:
    from cfid.export.target import given_by, has, keys_of, missing, unaccepted

    def row_of(need: str) -> dict[str, Any]:
        return {"keys": keys_of(need), "known": has(vehicle, need), "given_by": given_by(need)}

    return {
        "target": target.name,
        "file": target.file_name,
        "about": target.about,
        "ready": not missing(target, vehicle),
        "needs": [row_of(need) for need in target.needs],
        "uses": [row_of(use) for use in target.uses],
        "rejected": list(unaccepted(target, vehicle)),
    }
