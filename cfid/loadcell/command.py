"""`cfid fit loadcell`: gain, cross-talk and linearity of the load cell, from known weights hung on it."""

from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.inputs import find_recording, open_workplace
from cfid.console.lists import measured
from cfid.console.messages import note
from cfid.console.options import Figures, Force, Geometry, GravityMps2, Out
from cfid.console.outcome import Delivery, deliver
from cfid.console.selection import chosen

if TYPE_CHECKING:
    from cfid.records.campaign import Campaign
    from cfid.records.result import Result


def loadcell(
    runs: Annotated[
        list[str] | None,
        typer.Argument(metavar="RUN ...", help="Runs with a known load; default: the campaign's runs with --pull."),
    ] = None,
    *,
    store: Annotated[bool, typer.Option("--store", help="Write the calibration to rig.toml for later runs.")] = False,
    geometry: Geometry = None,
    gravity_mps2: GravityMps2 = None,
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Fit gain, cross-talk and linearity of the load cell to weights hung at known places.

    Record each load with `cfid log loadcell --pull -z --weight 50 --at-mm 46,0,0`, and the empty cell without a weight.

    Example: cfid fit loadcell --store
    """
    from cfid.errors import ConfigError
    from cfid.loadcell import fit

    gravity = measured(gravity_mps2, "--gravity-mps2")
    workplace = open_workplace(geometry, gravity=gravity)
    if store and workplace.campaign is None:
        raise ConfigError("--store: there is no campaign here whose rig.toml could be changed: give --campaign.")
    words = chosen(
        runs,
        workplace.campaign,
        suits=lambda run: run.header.kind == "loadcell" and run.header.label.pull is not None,
        wanted="loads on the load cell",
    )
    result = fit(
        [find_recording(word, workplace) for word in words],
        gravity_mps2=workplace.rig.site.gravity_mps2,
        gravity_std_mps2=workplace.rig.site.gravity_std_mps2,
    )
    deliver(result, Delivery(force, figures, out), workplace)
    if store and workplace.campaign is not None:
        _store(result, workplace.campaign)


def _store(result: "Result", campaign: "Campaign") -> None:
    from cfid.loadcell.result import rig_keys
    from cfid.records.rig_file import change_rig

    cell = campaign.rig.loadcell
    keys = rig_keys(result, gain=cell.gain, gain_std=cell.gain_std)
    path = change_rig(campaign.folder, "loadcell", keys)
    note(f"{path}: {', '.join(f'loadcell.{key} = {value}' for key, value in keys.items())}. It holds for later runs.")
