"""`cfid export`: what a campaign found, as the files that firmware and simulators take."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from cfid.console.campaign import here
from cfid.console.messages import note
from cfid.errors import ConfigError

if TYPE_CHECKING:
    from cfid.export.target import Target
    from cfid.export.vehicle import Stale, Vehicle
    from cfid.records.campaign import Campaign
    from cfid.records.parameters import Section

LIST, SAMPLES = "list", "samples"
FOLDER = "exports"  # of a campaign


def export(
    target: Annotated[
        str,
        typer.Argument(
            metavar="TARGET|list|samples",
            help="Whose file to write; list says which there are; samples draws vehicles from the uncertainties.",
        ),
    ],
    *,
    out: Annotated[
        str | None,
        typer.Option(metavar="FILE|-", help="Where to; - is stdout. Default: the campaign's folder exports."),
    ] = None,
    count: Annotated[int | None, typer.Option("--n", min=1, help="How many vehicles (samples). Default: 1000.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the random numbers (samples). Default: 1.")] = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Overwrite a file; export what is rejected, doubtful or implausible, marked so. A firmware header "
            "whose thrust over voltage would stop the motors is refused all the same.",
        ),
    ] = False,
    campaign: Annotated[Path | None, typer.Option(help="Campaign folder; default: this one or a parent.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object (list).")] = False,
) -> None:
    """Write what was measured as a file for firmware or a simulator: turned to its frame, in its units, with origins.

    What was not measured is left out or marked, never guessed; a target that cannot do without is refused. So is what
    is rejected, doubtful or implausible, unless --force asks for it: the file then says so.

    Example: [bold]cfid export crazyflow[/bold]
    """
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
            raise ConfigError("samples are several files: --out names a folder, and - is none.")
        folder = Path(out) if out else found.folder / FOLDER
        write_samples(known, folder, count=count or 1000, seed=1 if seed is None else seed, force=force)
        return
    if count is not None or seed is not None:
        raise ConfigError("--n and --seed go with `cfid export samples`: a file has the measured numbers.")
    wanted, vehicle = target_named(target), known.vehicle
    text = text_of(wanted, vehicle)  # what no --force writes is refused first
    refuse(wanted, known, force=force)
    _write(text, out or str(found.folder / FOLDER / wanted.file_name), force=force)
    _warn(wanted, vehicle)


class Known(NamedTuple):
    """What a campaign knows: the sections of its parameters.toml, when they are stale, and what exports take of it."""

    sections: "dict[str, Section]"
    stale: "Stale"
    vehicle: "Vehicle"


def refuse(target: "Target", known: Known, *, force: bool) -> None:
    """Raise DataError for what should not be exported; `force` lets through what is there, marked."""
    from cfid.errors import DataError
    from cfid.export.refusals import objections, refuse_rejected

    refuse_rejected(target, known.vehicle, known.sections)
    said = objections(target, known.vehicle, known.sections, stale=known.stale)
    if said and not force:
        raise DataError(
            f"{target.name}: nothing was written. {' '.join(said)} --force writes it all the same, and marks it."
        )


def _known(campaign: "Campaign") -> Known:
    from cfid.errors import DataError
    from cfid.export.exchange import covariance_blocks
    from cfid.export.refusals import marked
    from cfid.export.vehicle import collect
    from cfid.records.campaign import RIG_FILE
    from cfid.records.files import read_toml
    from cfid.records.parameters import load_sections
    from cfid.records.run import Run, list_runs
    from cfid.records.stale import stale_in

    runs = [run for run in list_runs(campaign.runs_folder) if isinstance(run, Run)]
    simulated = {run.folder.name for run in runs if run.header.simulated}
    sections, stale = load_sections(campaign.parameters_file), stale_in(campaign.folder, runs)
    content = read_toml(campaign.parameters_file, DataError) if sections else {}
    vehicle = collect(
        campaign.rig,
        sections,
        rig_file=RIG_FILE,
        simulated=simulated,
        stale=stale,
        covariance=covariance_blocks(content),
    )
    return Known(sections, stale, marked(vehicle, sections))


def _write(text: str, out: str, *, force: bool) -> None:
    from cfid.records.files import write_whole

    if out == "-":
        typer.echo(text, nl=False)
        return
    path = Path(out)
    if path.exists() and not force:
        raise ConfigError(f"{path} is there already: nothing was changed. --force overwrites it, --out names another.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text.encode())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}.") from None
    typer.echo(str(path))


def _warn(target: "Target", vehicle: "Vehicle") -> None:
    from cfid.export.target import asked_for, caveats, left_out, simulated, unaccepted

    if keys := simulated(target, vehicle):
        note(f"SIMULATED, no vehicle was measured: {', '.join(keys)}. The file says so.")
    for sentence in caveats(target, vehicle):
        note(sentence)
    for key in unaccepted(target, vehicle):
        note(f"{key} is rejected by its fit: the file says so.")
    for use in left_out(target, vehicle):
        note(f"not measured, and left out or marked: {asked_for(use)}.")


def _print_list(vehicle: "Vehicle", *, json: bool) -> None:
    from cfid import __version__
    from cfid.export.catalogue import TARGETS

    rows = [_row(target, vehicle) for target in TARGETS.values()]
    if json:
        import json as encoder

        content = {"command": "export list", "targets": rows, "version": __version__}
        typer.echo(encoder.dumps(content, indent=2))
        return
    for row in rows:
        typer.secho(f"{row['target']}: {row['about']}", bold=True)
        _print_keys("has", ["; ".join(need["keys"] for need in row["needs"] + row["uses"] if need["known"])])
        _print_keys("MISSING", [f"{n['keys']}: {n['given_by']}" for n in row["needs"] if not n["known"]])
        _print_keys("could also use", [f"{n['keys']}: {n['given_by']}" for n in row["uses"] if not n["known"]])
        _print_keys("rejected", row["rejected"])


def _print_keys(title: str, words: list[str]) -> None:
    for word in words:
        typer.echo(f"  {title}: {word}")


def _row(target: "Target", vehicle: "Vehicle") -> dict[str, Any]:
    from cfid.export.target import given_by, has, keys_of, missing, unaccepted

    def told(need: str) -> dict[str, Any]:
        return {"keys": keys_of(need), "known": has(vehicle, need), "given_by": given_by(need)}

    return {
        "target": target.name,
        "file": target.file_name,
        "about": target.about,
        "ready": not missing(target, vehicle),
        "needs": [told(need) for need in target.needs],
        "uses": [told(use) for use in target.uses],
        "rejected": list(unaccepted(target, vehicle)),
    }
