"""`cfid log encoder` and `cfid log loadcell`: a device recorded into a new run."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cfid.cli.live import LiveLine
from cfid.cli.options import flat, positive
from cfid.cli.speech import note
from cfid.errors import ConfigError, DataError

if TYPE_CHECKING:
    from cfid.campaign import Campaign, Devices
    from cfid.rig.log import Device, Plan
    from cfid.run import Label, Run

_LABEL = "What is recorded"
_OUTPUT = "Output"


@dataclass(frozen=True, kw_only=True)
class LabelOptions:
    """What the operator says the run is."""

    axis: Annotated[
        str | None, typer.Option(metavar="MOUNT", help="Mount of a swing, as in rig.toml.", rich_help_panel=_LABEL)
    ] = None
    weight: Annotated[
        float | None, typer.Option(metavar="GRAMS", help="A dropping weight.", rich_help_panel=_LABEL)
    ] = None
    body: Annotated[
        Literal["crazyflie", "testbody", "fixture"] | None,
        typer.Option(help="What swings; default with --axis: crazyflie.", rich_help_panel=_LABEL),
    ] = None
    note: Annotated[str | None, typer.Option(help="A note, kept with the run.", rich_help_panel=_LABEL)] = None


@dataclass(frozen=True, kw_only=True)
class LogOptions:
    """How long, where to, and what to do with it."""

    for_s: Annotated[
        float | None, typer.Option("--for", metavar="S", help="Seconds to record; default: until Ctrl-C.")
    ] = None
    campaign: Annotated[Path | None, typer.Option(help="Campaign folder; default: this one or a parent.")] = None
    plot: Annotated[bool, typer.Option("--plot", help="Write the figure too.", rich_help_panel=_OUTPUT)] = False
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.", rich_help_panel=_OUTPUT)] = False


@flat
def encoder(
    *,
    label: LabelOptions,
    log: LogOptions,
    port: Annotated[str | None, typer.Option(help="Serial port; default: rig.toml's, else looked for.")] = None,
    rate_hz: Annotated[float | None, typer.Option(help="Polls per second; default: rig.toml's.")] = None,
    continuous: Annotated[
        bool, typer.Option("--continuous", help="Let the interface send by itself instead of polling it.")
    ] = False,
) -> None:
    """Record the encoder until Ctrl-C.

    Example: [bold]cfid log encoder --axis x --for 20[/bold]
    """
    from cfid.rig.log import ready_encoder

    campaign, devices, simulated = _rig(log.campaign)
    kept = _label(label, campaign)
    setting = devices.encoder
    if port is not None:
        setting = setting.model_copy(update={"port": port})
    if rate_hz is not None:
        setting = setting.model_copy(update={"rate_hz": positive(rate_hz, "--rate-hz")})
    kind = "swing" if label.axis else "drop" if label.weight else "encoder"
    plan = _plan(campaign, kind, kept, log, simulated=simulated)
    live = LiveLine()
    with ExitStack() as held:
        device = ready_encoder(
            setting,
            held,
            counts_per_turn=campaign.rig.encoder.counts_per_turn,
            continuous=continuous,
            say=live.say,
        )
        run = _record(plan, device, live)
    _summarise(run, log)


@flat
def loadcell(
    *,
    label: LabelOptions,
    log: LogOptions,
    address: Annotated[str | None, typer.Option(help="Address of the box; default: rig.toml's.")] = None,
    rate_hz: Annotated[int | None, typer.Option(min=1, help="Samples per second, 7000/n; default: rig.toml's.")] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="One sample a datagram: less delay, five times the work.")
    ] = False,
    bias: Annotated[bool, typer.Option("--bias", help="Let the box take the present load as zero first.")] = False,
) -> None:
    """Record the load cell until Ctrl-C.

    Example: [bold]cfid log loadcell --for 30 --note "empty mount"[/bold]
    """
    from cfid.rig.log import ready_loadcell

    campaign, devices, simulated = _rig(log.campaign)
    setting = devices.loadcell
    if address is not None:
        setting = setting.model_copy(update={"address": address})
    if rate_hz is not None:
        setting = setting.model_copy(update={"rate_hz": rate_hz})
    plan = _plan(campaign, "loadcell", _label(label, campaign), log, simulated=simulated)
    live = LiveLine()
    with ExitStack() as held:
        device = ready_loadcell(setting, held, buffered=not real_time, bias=bias, say=live.say)
        run = _record(plan, device, live)
    _summarise(run, log)


def _rig(folder: Path | None) -> "tuple[Campaign, Devices, bool]":
    """Return the campaign and where its devices are, and say so when they are simulated."""
    from cfid.cli.campaign import here
    from cfid.rig.sim_file import SIM_FILE, devices_in

    campaign = here(folder)
    devices, simulated = devices_in(campaign.folder, campaign.rig)
    if simulated:
        note(f"the rig is simulated: {campaign.folder / SIM_FILE} points at it.")
    return campaign, devices, simulated


def _label(options: LabelOptions, campaign: "Campaign") -> "Label":
    """Check the label against rig.toml, where a misspelt mount would only be found by the fit."""
    from cfid.run import Label

    body = options.body or ("crazyflie" if options.axis else None)
    if options.axis and options.weight:
        raise ConfigError("--axis is a swing's and --weight a dropping weight's: give one of them.")
    if options.weight is not None:
        positive(options.weight, "--weight")
    rig = campaign.rig
    mounts = rig.testbody.mounts if body == "testbody" and rig.testbody is not None else rig.mounts
    if options.axis and body != "fixture" and options.axis not in mounts:
        known = ", ".join(mounts) or "none"
        raise ConfigError(f"--axis {options.axis}: rig.toml has no such mount of the {body}; it has {known}.")
    return Label(axis=options.axis, weight_g=options.weight, body=body, note=options.note)


def _plan(campaign: "Campaign", kind: str, label: "Label", log: LogOptions, *, simulated: bool) -> "Plan":
    from cfid.rig.log import Plan

    if log.for_s is not None:
        positive(log.for_s, "--for")
    return Plan(runs_folder=campaign.runs_folder, kind=kind, label=label, for_s=log.for_s, simulated=simulated)


def _record(plan: "Plan", device: "Device", live: LiveLine) -> "Run":
    from cfid.rig.log import log

    def begun(folder: Path) -> None:
        until = "Ctrl-C ends it" if plan.for_s is None else f"{plan.for_s:g} s; Ctrl-C ends it before"
        typer.echo(f"recording into {folder} ({until})", err=True)

    try:
        return log(plan, [device], show=live.show, begun=begun)
    finally:
        live.end()


def _summarise(run: "Run", options: LogOptions) -> None:
    figures = _draw(run) if options.plot else []
    content = _summary(run)
    if options.json:
        import json

        typer.echo(json.dumps({**content, "figures": [str(path) for path in figures]}, indent=2))
        return
    for name, device in content["devices"].items():
        typer.echo(f"{name}: {device['rows']} rows, {device['lost']} lost{device['kinds']} -> {device['file']}")
    if run.header.reason:
        typer.echo(run.header.reason)
    for path in figures:
        if path.suffix == ".png":
            typer.echo(f"figure: {path} (and .svg)", err=True)


def _summary(run: "Run") -> dict[str, Any]:
    devices = {}
    for name, record in run.header.devices.items():
        extra = record.model_extra or {}
        kinds = {**extra.get("arrivals", {}), **extra.get("losses", {})}
        kinds.pop("lost", None)  # stands before them
        told = ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in kinds.items() if count)
        devices[name] = {
            "rows": record.rows,
            "lost": record.lost,
            "kinds": f" ({told})" if told else "",
            "gaps": len(extra.get("gaps", ())),
            "file": str(run.device_file(name)),
        }
    return {"command": "log", "run": str(run.folder), "state": run.header.state, "devices": devices}


def _draw(run: "Run") -> list[Path]:
    """Draw what `cfid show` draws, beside the run's files; too few rows for a figure are said, not an error."""
    from cfid.cli.inputs import open_workplace
    from cfid.cli.options import LoadCellOptions, ReadingOptions, RigOptions
    from cfid.cli.views import views_of
    from cfid.report.save import save_figure

    try:
        workplace = open_workplace(RigOptions(campaign=run.folder.parent.parent))
        views, _ = views_of(str(run.folder), workplace, ReadingOptions(), LoadCellOptions())
    except DataError as error:
        note(f"no figure: {error}")
        return []
    return [path for view in views for path in save_figure(view.draw(), run.folder / f"{view.device}_recording")]
