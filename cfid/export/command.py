"""`cfid export`: export a campaign's parameters to the files of firmware and simulators."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from cfid.console.campaign import here, write_parameters
from cfid.console.messages import echo, headline, in_options, note, print_json
from cfid.console.program import program
from cfid.errors import ConfigError, DataError
from cfid.export.render import rendered
from cfid.export.samples import EVERYTHING, LISTS, counts_text, draw
from cfid.export.target import (
    FOLDER,
    TORQUE,
    Target,
    given_by,
    need_keys,
    need_text,
    refuse,
    target_named,
    targets,
    warnings,
)
from cfid.export.vehicle import ExportVehicle, collect, collect_published, with_published
from cfid.published import published_set, published_sets
from cfid.quantities.registry import Platform
from cfid.records.campaign import Campaign
from cfid.records.files import write_files
from cfid.records.values import Values
from cfid.version import __version__

LIST, SAMPLES = "list", "samples"


def export(
    target: Annotated[
        str,
        typer.Argument(
            metavar="TARGET|list|samples",
            help="Target to write; list shows all targets; samples draws vehicles from the uncertainties.",
        ),
    ],
    *,
    source: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="NAME|FILE.toml",
            help="Published parameter set to export instead of a campaign, such as thesis; writes to this folder.",
        ),
    ] = None,
    published: Annotated[
        list[str] | None,
        typer.Option(
            metavar="torque|KEY[=SET]",
            help="Quantity that was not measured to take from a published set, marked; default set: the first of the "
            "vehicle's platform; cfid compare shows all.",
        ),
    ] = None,
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
) -> None:
    """Export the parameters to a file for firmware or a simulator.

    The file has the frame and units of its reader, and the origin of each number.

    A quantity that was not measured is left out or marked, never guessed; a target that needs it is refused. Rejected,
    outdated or implausible quantities are refused too, unless --force is given; the file then marks them.

    With --from, the file has what others published, and no campaign is needed.

    Example: cfid export crazyflow
    """
    values = None
    if source is None:
        opened = here()
        place, exports = opened.folder, opened.folder / FOLDER
        vehicle, values = _collected(opened)
        vehicle = _completed(vehicle, published or [], opened.rig.vehicle.platform)
    elif published:
        raise ConfigError("--published completes a campaign's values, and --from takes none: give one of both.")
    else:
        place, exports = Path(), Path()
        vehicle = collect_published(published_set(source))
    if target == LIST:
        _print_list(place, vehicle)
        return
    if target == SAMPLES:
        if values is None:
            raise ConfigError("samples are drawn from the uncertainties of a campaign: leave --from out.")
        if out == "-":
            raise ConfigError("samples are several files: --out must name a folder, not -.")
        folder = Path(out) if out else exports
        _write_samples(vehicle, values, folder, count=count or 1000, seed=1 if seed is None else seed, force=force)
        return
    if count is not None or seed is not None:
        raise ConfigError("--samples and --seed go with `cfid export samples`: a file has the measured numbers.")
    wanted = target_named(target, place)
    text = rendered(wanted, vehicle)  # raises first, since --force does not lift its refusals
    refuse(wanted, vehicle, values, force=force)
    notes = warnings(wanted, vehicle)
    lacking = "not measured" if source is None else "not stated"
    notes += [f"{lacking}, and left out or marked: {need_text(use, vehicle)}." for use in wanted.not_measured(vehicle)]
    if out != "-":
        path = Path(out) if out else exports / wanted.file_name
        write_files({path: text.encode()}, force=force)
        _print_written(target, [path], notes)
    elif program().json:
        raise ConfigError("stdout has either the file or a JSON object: `out` names a file, or leave `json` out.")
    else:
        echo(text, nl=False)
        for sentence in notes:
            note(sentence)


def _completed(vehicle: ExportVehicle, words: Sequence[str], platform: Platform) -> ExportVehicle:
    """Return a vehicle with quantities KEY or KEY=SET of sets; without one, of the platform's first that states it."""
    for word in words:
        key, _, name = word.partition("=")
        key = TORQUE if key == "torque" else key
        sets = [each for each in published_sets().values() if each.platform == platform and each.find(key)]
        if not name and not sets:
            raise ConfigError(f"--published {word}: no set for {platform} states it: name one, as in {word}=thesis.")
        vehicle = with_published(vehicle, key, published_set(name) if name else sets[0])
    return vehicle


def _collected(campaign: Campaign) -> tuple[ExportVehicle, Values]:
    """Return a campaign's vehicle and values. Raises DataError if a kept fit cannot be read."""
    if write_parameters(campaign):
        raise DataError("an export needs all kept fits: restore those that cannot be read, or move them out of fits/.")
    values = campaign.values()
    return collect(campaign.rig, values, campaign=campaign.folder.resolve().name), values


def _print_written(target: str, paths: Sequence[Path], notes: Sequence[str], **facts: Any) -> None:
    """Print the paths of written files, and notes on what is in them."""
    if program().json:
        content = {"command": f"export {target}", "files": list(map(str, paths)), **facts, "notes": list(notes)}
        print_json({**content, "version": __version__})
        return
    for path in paths:
        echo(path)
    for sentence in notes:
        note(sentence)


def _write_samples(vehicle: ExportVehicle, values: Values, folder: Path, *, count: int, seed: int, force: bool) -> None:
    refuse(EVERYTHING, vehicle, values, force=force)
    samples = draw(vehicle, values, count=count, seed=seed)
    marks = warnings(EVERYTHING, vehicle)
    files = {folder / name: content for name, content in samples.files(vehicle, seed, marks).items()}
    write_files(files, force=force)
    reasons = f": {counts_text(samples.reasons)}" if samples.reasons else ""
    notes = [f"{100 * samples.rejected_share:.1f} % of {samples.draws} draws rejected{reasons}."]
    if samples.joint.exact:
        notes.append(f"no uncertainty is known of {', '.join(samples.joint.exact)}: the same in every vehicle.")
    if samples.joint.independent:
        notes.append(
            f"no covariance is kept of {', '.join(samples.joint.independent)}: their numbers are drawn independently. "
            "Fit again to have it."
        )
    notes += marks
    for name in LISTS:
        if missing := target_named(name, folder).missing(vehicle):
            needs = "; ".join(need_text(need, vehicle) for need in missing)
            notes.append(f"no list for {name}, which needs what is not measured yet: {needs}.")
    _print_written(SAMPLES, list(files), notes, draws=samples.draws, rejected=dict(samples.reasons))


def _print_list(folder: Path, vehicle: ExportVehicle) -> None:
    listed, faults = targets(folder)
    for fault in faults:
        note(str(fault))
    rows = [_row(target, vehicle) for target in listed.values()]
    if program().json:
        print_json({"command": "export list", "targets": rows, "version": __version__})
        return
    for row in rows:
        headline(f"{row['target']}: {row['about']}")
        _print_keys("has", ["; ".join(need["keys"] for need in row["needs"] + row["uses"] if need["known"])])
        _print_keys("MISSING", [_lacking(n) for n in row["needs"] if not n["known"]])
        _print_keys("could also use", [_lacking(n) for n in row["uses"] if not n["known"]])
        _print_keys("rejected", row["rejected"])


def _print_keys(title: str, words: list[str]) -> None:
    for word in words:
        echo(f"  {title}: {in_options(word)}")


def _lacking(need: dict[str, Any]) -> str:
    return ": ".join(filter(None, [need["keys"], need["given_by"]]))


def _row(target: Target, vehicle: ExportVehicle) -> dict[str, Any]:

    def row_of(need: str) -> dict[str, Any]:
        by = "" if vehicle.published else given_by(need)
        return {"keys": need_keys(need), "known": bool(vehicle.met(need)), "given_by": by}

    return {
        "target": target.name,
        "file": target.file_name,
        "about": target.about,
        "ready": not target.missing(vehicle),
        "needs": [row_of(need) for need in target.needs],
        "uses": [row_of(use) for use in target.uses],
        "rejected": [quantity.key for quantity in target.taken(vehicle) if quantity.is_marked("REJECTED")],
    }
