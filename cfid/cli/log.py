"""`cfid log encoder`, `cfid log gyro` and `cfid log loadcell`: record one device into a new run."""

from contextlib import ExitStack
from typing import Annotated

import typer

from cfid.console.flat import flat
from cfid.console.labels import LabelOptions, LoadOptions
from cfid.console.live import LiveLine
from cfid.console.options import positive
from cfid.console.recording import KeepOptions, Lasting, record, refuse_mixture, rehearse, rig_of
from cfid.console.vehicle import LinkOptions, reach
from cfid.experiments import judge_of

_CABLE_MS, _RADIO_MS = 1, 10  # between rows of gyro and accelerometer


@flat
def encoder(
    *,
    label: LabelOptions,
    lasting: Lasting,
    keep: KeepOptions,
    port: Annotated[str | None, typer.Option(help="Serial port; default: rig.toml's, else search for it.")] = None,
    rate_hz: Annotated[float | None, typer.Option(help="Polls per second; default: rig.toml's.")] = None,
) -> None:
    """Record the encoder until Ctrl-C.

    Example: [bold]cfid log encoder --axis x --for 20[/bold]
    """
    from cfid.records.rig_file import RigFacts
    from cfid.rig.encoder import ready_encoder
    from cfid.rig.run import Plan

    rig = rig_of(keep.campaign)
    campaign, devices, simulated = rig.campaign, rig.devices, rig.simulated
    kept = label.label(campaign)
    setting, counts_per_turn = devices.encoder, campaign.rig.encoder.counts_per_turn
    if port is not None:
        refuse_mixture("--port", simulated)
        setting = setting.model_copy(update={"port": port})
    if rate_hz is not None:
        setting = setting.sampled_at(positive(rate_hz, "--rate-hz"))
    plan = Plan(
        runs_folder=campaign.runs_folder,
        kind=label.kind_of_angles,
        label=kept,
        for_s=lasting.seconds,
        facts=RigFacts(lab_book=campaign.rig.lab_book),
        simulated=simulated,
    )
    if lasting.dry_run:
        rehearse("the encoder", campaign.runs_folder, lasting.seconds)
        return
    live = LiveLine(quiet=keep.quiet)
    with ExitStack() as held:
        device = ready_encoder(setting, rig.hardware, held, counts_per_turn=counts_per_turn, say=live.say)
        record("log encoder", plan, [device], live, keep, hardware=rig.hardware, judge=judge_of(plan.kind))


@flat
def gyro(
    *,
    label: LabelOptions,
    lasting: Lasting,
    vehicle: LinkOptions,
    log_ms: Annotated[
        int | None,
        typer.Option(
            min=1, max=10, help="Milliseconds between rows; default: 1, by radio 10, which any link sustains."
        ),
    ] = None,
    keep: KeepOptions,
) -> None:
    """Record the vehicle's gyro and accelerometer until Ctrl-C, in place of an encoder. No motor turns.

    Example: [bold]cfid log gyro --axis x --for 20[/bold]
    """
    from cfid.rig.run import Plan

    rig = rig_of(keep.campaign)
    campaign, simulated = rig.campaign, rig.simulated
    kind = label.kind_of_angles
    plan = Plan(
        runs_folder=campaign.runs_folder,
        kind="gyro" if kind == "encoder" else kind,
        label=label.label(campaign),
        for_s=lasting.seconds,
        simulated=simulated,
    )
    if lasting.dry_run:
        rehearse("gyro and accelerometer", campaign.runs_folder, lasting.seconds)
        return
    live = LiveLine(quiet=keep.quiet)
    with ExitStack() as held:
        ready = reach(vehicle, rig, held)
        ready.refuse_driven()
        device = ready.inertial_log(log_ms or (_RADIO_MS if ready.uri.startswith("radio:") else _CABLE_MS))
        record("log gyro", plan, [device], live, keep, hardware=rig.hardware, judge=judge_of(plan.kind))


@flat
def loadcell(
    *,
    label: LabelOptions,
    load: LoadOptions,
    lasting: Lasting,
    keep: KeepOptions,
    address: Annotated[str | None, typer.Option(help="Address of the load cell's box; default: rig.toml's.")] = None,
    rate_hz: Annotated[
        int | None, typer.Option(min=1, help="Samples per second, 7000 divided by a whole number; default: rig.toml's.")
    ] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="Receive one sample per datagram: less delay, more processing.")
    ] = False,
    bias: Annotated[bool, typer.Option("--bias", help="Zero the load cell at the present load first.")] = False,
) -> None:
    """Record the load cell until Ctrl-C.

    Example: [bold]cfid log loadcell --for 30 --note "empty mount"[/bold]
    """
    from cfid.rig.loadcell import ready_loadcell
    from cfid.rig.run import Plan

    rig = rig_of(keep.campaign)
    campaign, devices, simulated = rig.campaign, rig.devices, rig.simulated
    setting = devices.loadcell
    if address is not None:
        refuse_mixture("--address", simulated)
        setting = setting.model_copy(update={"address": address})
    setting = setting.sampled_at(rate_hz)
    kept = load.on(label.label(campaign))
    plan = Plan(
        runs_folder=campaign.runs_folder,
        kind="loadcell",
        label=kept,
        for_s=lasting.seconds,
        simulated=simulated,
        facts=campaign.rig.facts,
    )
    if lasting.dry_run:
        rehearse("the load cell", campaign.runs_folder, lasting.seconds)
        return
    live = LiveLine(quiet=keep.quiet)
    with ExitStack() as held:
        device = ready_loadcell(setting, rig.hardware, held, buffered=not real_time, bias=bias, say=live.say)
        record("log loadcell", plan, [device], live, keep, hardware=rig.hardware, judge=judge_of("loadcell"))
