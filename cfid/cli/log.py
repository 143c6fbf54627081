"""`cfid log encoder`, `cfid log gyro` and `cfid log loadcell`: record one device into a new run."""

from contextlib import ExitStack
from typing import Annotated

import typer

from cfid.console.labels import AtMm, Axis, Body, Note, Pull, Weight, kind_of_angles, label_of, with_load
from cfid.console.live import LiveLine
from cfid.console.options import positive
from cfid.console.recording import DryRun, ForS, record, rehearse_devices, rig_of
from cfid.console.vehicle import Uri, reach
from cfid.experiments import judge_of

_CABLE_MS, _RADIO_MS = 1, 10  # between rows of gyro and accelerometer; any radio link sustains the latter


def encoder(
    *,
    axis: Axis = None,
    weight: Weight = None,
    body: Body = None,
    for_s: ForS = None,
    rate_hz: Annotated[float | None, typer.Option(metavar="HZ", help="Polls per second; default: rig.toml's.")] = None,
    dry_run: DryRun = False,
    note: Note = None,
) -> None:
    """Record the encoder until Ctrl-C.

    Example: cfid log encoder --axis x --for 20
    """
    from cfid.records.rig_file import RigFacts
    from cfid.rig.encoder import ready_encoder
    from cfid.rig.run import Plan

    rig = rig_of()
    setting, stated = rig.devices.encoder, rig.campaign.rig
    if rate_hz is not None:
        setting = setting.sampled_at(positive(rate_hz, "--rate-hz"))
    plan = Plan(
        runs_folder=rig.campaign.runs_folder,
        kind=kind_of_angles(axis, weight),
        label=label_of(axis, weight, body, note, rig.campaign),
        for_s=None if for_s is None else positive(for_s, "--for"),
        facts=RigFacts(lab_book=stated.lab_book),
        simulated=rig.simulated,
    )
    if dry_run:
        rehearse_devices("log encoder", "the encoder", plan.runs_folder, plan.for_s)
        return
    live = LiveLine()
    with ExitStack() as held:
        device = ready_encoder(
            setting, rig.hardware, held, counts_per_turn=stated.encoder.counts_per_turn, say=live.say
        )
        record("log encoder", plan, [device], live, hardware=rig.hardware, judge=judge_of(plan.kind))


def gyro(
    *,
    axis: Axis = None,
    weight: Weight = None,
    body: Body = None,
    for_s: ForS = None,
    uri: Uri = None,
    dry_run: DryRun = False,
    note: Note = None,
) -> None:
    """Record the vehicle's gyro and accelerometer until Ctrl-C, in place of an encoder. No motor turns.

    A row is taken each millisecond, by radio every ten.

    Example: cfid log gyro --axis x --for 20
    """
    from cfid.rig.run import Plan

    rig = rig_of()
    kind = kind_of_angles(axis, weight)
    plan = Plan(
        runs_folder=rig.campaign.runs_folder,
        kind="gyro" if kind == "encoder" else kind,
        label=label_of(axis, weight, body, note, rig.campaign),
        for_s=None if for_s is None else positive(for_s, "--for"),
        simulated=rig.simulated,
    )
    if dry_run:
        rehearse_devices("log gyro", "gyro and accelerometer", plan.runs_folder, plan.for_s)
        return
    live = LiveLine()
    with ExitStack() as held:
        vehicle = reach(uri, rig, held)
        vehicle.refuse_driven()
        device = vehicle.inertial_log(_RADIO_MS if vehicle.uri.startswith("radio:") else _CABLE_MS)
        record("log gyro", plan, [device], live, hardware=rig.hardware, judge=judge_of(plan.kind))


def loadcell(
    *,
    pull: Pull = None,
    weight: Weight = None,
    at_mm: AtMm = None,
    axis: Axis = None,
    body: Body = None,
    for_s: ForS = None,
    rate_hz: Annotated[
        int | None, typer.Option(metavar="HZ", min=1, help="7000 divided by a whole number; default: rig.toml's.")
    ] = None,
    bias: Annotated[bool, typer.Option("--bias", help="Zero the load cell at the present load first.")] = False,
    dry_run: DryRun = False,
    note: Note = None,
) -> None:
    """Record the load cell until Ctrl-C.

    Example: cfid log loadcell --for 30 --note "empty mount"
    """
    from cfid.rig.loadcell import ready_loadcell
    from cfid.rig.run import Plan

    rig = rig_of()
    setting = rig.devices.loadcell.sampled_at(rate_hz)
    plan = Plan(
        runs_folder=rig.campaign.runs_folder,
        kind="loadcell",
        label=with_load(label_of(axis, weight, body, note, rig.campaign), pull, at_mm),
        for_s=None if for_s is None else positive(for_s, "--for"),
        simulated=rig.simulated,
        facts=rig.campaign.rig.facts.of("loadcell", "scales"),
    )
    if dry_run:
        rehearse_devices("log loadcell", "the load cell", plan.runs_folder, plan.for_s)
        return
    live = LiveLine()
    with ExitStack() as held:
        device = ready_loadcell(setting, rig.hardware, held, bias=bias, say=live.say)
        record("log loadcell", plan, [device], live, hardware=rig.hardware, judge=judge_of("loadcell"))
