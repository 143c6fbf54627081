"""What a command found, and how it leaves the program: kept in the campaign, drawn, printed, exit code."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from cfid import __version__
from cfid.console.options import Delivery
from cfid.errors import ConfigError, FitError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cfid.records.campaign import Campaign
    from cfid.records.covariances import Covariance
    from cfid.records.parameters import Parameter, Source


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One fit's result as the contract of --json has it, and in words for a person.

    `drawings` draws its figures when they are wanted, by file name; `beside` is where they go by default.
    `covariances`, `common` and `rejected` are what `Section` keeps; what is rejected is given by --force alone.
    """

    command: str
    section: str = ""
    method: str
    parameters: "Mapping[str, Parameter]"
    quality: Mapping[str, Any]
    warnings: tuple[str, ...]
    sources: "tuple[Source, ...]"
    covariances: "tuple[Covariance, ...]" = ()
    common: "Mapping[str, Mapping[str, list[float]]]" = field(default_factory=dict)
    rejected: Mapping[str, str] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()
    drawings: "Callable[[], Mapping[str, Figure]] | None" = None
    beside: Path = field(default_factory=Path)


def deliver(outcome: Outcome, delivery: Delivery, campaign: "Campaign | None") -> None:
    """Draw, keep and print an outcome.

    Raises FitError when it is not believed and --force does not ask for the numbers all the same.
    """
    given = not outcome.doubts or delivery.force
    if not delivery.force:
        outcome = without_rejected(outcome)
    drawn = _draw(outcome, delivery)
    if given and campaign is not None and outcome.parameters:
        _keep(outcome, campaign, drawn)
    if delivery.json:
        typer.echo(_as_json(outcome, given))
    else:
        _print(outcome, given, drawn)
    if not given:
        kept = " parameters.toml keeps what it had." if campaign is not None else ""
        raise FitError(f"not believed: {' '.join(outcome.doubts)}{kept} --force gives the numbers all the same.")


def without_rejected(outcome: Outcome) -> Outcome:
    """Take away the parameters that were rejected, and the covariances with them; why they were stays."""
    gone = outcome.rejected
    kept = {key: parameter for key, parameter in outcome.parameters.items() if key not in gone}
    common = {
        cause: {key: effect for key, effect in effects.items() if key not in gone}
        for cause, effects in outcome.common.items()
    }
    return replace(
        outcome,
        parameters=kept,
        covariances=tuple(one for one in outcome.covariances if not gone.keys() & set(one.of)),
        common={cause: effects for cause, effects in common.items() if effects},
    )


def _as_json(outcome: Outcome, given: bool) -> str:
    import json
    from dataclasses import asdict

    from cfid.records.parameters import plain

    content = {
        "command": outcome.command,
        "parameters": {name: p.as_json() for name, p in outcome.parameters.items()} if given else {},
        "quality": {
            "believed": not outcome.doubts,
            "doubts": outcome.doubts,
            "rejected": outcome.rejected,
            **outcome.quality,
        },
        "warnings": (*outcome.warnings, *outcome.rejected.values()),
        "sources": [asdict(source) for source in outcome.sources],
        "version": __version__,
    }
    return json.dumps(plain(content), indent=2, allow_nan=False)


def _keep(outcome: Outcome, campaign: "Campaign", drawn: Sequence[Path]) -> None:
    from datetime import UTC, datetime

    from cfid.records.fits import Fit, keep_fit
    from cfid.records.parameters import Section, Source, plain, store_section

    section = Section(
        method=outcome.method,
        found=datetime.now(UTC).replace(microsecond=0),
        cfid_version=__version__,
        believed=not outcome.doubts,
        sources=tuple(Source(_path_in(campaign, source.path), source.sha256) for source in outcome.sources),
        parameters=outcome.parameters,
        covariance=outcome.covariances,
        common=outcome.common,
        rejected=outcome.rejected,
    )
    name = outcome.section or outcome.command.removeprefix("fit ")
    fit = Fit(
        name=name,
        command=outcome.command,
        section=section,
        quality=plain(outcome.quality),
        warnings=outcome.warnings,
        doubts=outcome.doubts,
        lines=outcome.lines,
        figures=tuple(_path_in(campaign, str(path)) for path in drawn),
    )
    store_section(campaign.parameters_file, name, section)
    keep_fit(campaign.fits_folder, fit)


def _path_in(campaign: "Campaign", path: str) -> str:
    """Return a path that holds wherever one stands: from the campaign's folder on if it lies there."""
    here, folder = Path(path).resolve(), campaign.folder.resolve()
    return str(here.relative_to(folder) if here.is_relative_to(folder) else here)


def _draw(outcome: Outcome, delivery: Delivery) -> Sequence[Path]:
    wanted = delivery.figures and (delivery.out is not None or not delivery.json)
    if not wanted or outcome.drawings is None:
        return ()
    from cfid.drawing.save import save_figure

    folder = delivery.out or outcome.beside
    try:
        folder.mkdir(parents=True, exist_ok=True)
        drawings = outcome.drawings()
        saved = [save_figure(figure, folder / name, force=delivery.force) for name, figure in drawings.items()]
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigError(f"{folder}: no figure can be written: {reason}. Say --out DIR or --no-figures.") from None
    return [path for paths in saved for path in paths]


def _print(outcome: Outcome, given: bool, drawn: Sequence[Path]) -> None:
    from cfid.console.messages import note
    from cfid.console.tables import print_parameters

    if given:
        print_parameters(outcome.parameters, title=f"cfid {outcome.command}")
    for line in outcome.lines:
        typer.echo(line)
    for warning in (*outcome.warnings, *outcome.rejected.values(), *(outcome.doubts if given else ())):
        note(warning)
    for path in drawn:
        if path.suffix == ".png":
            typer.echo(f"figure: {path} (and .svg)", err=True)
