"""`cfid fit swing`: one swing to its natural frequency, and with mass and distance to an axis inertia."""

from typing import Annotated

import typer

from cfid.console.inputs import open_workplace, read_recording
from cfid.console.options import (
    CutOptions,
    Delivery,
    GravityMps2,
    MassKg,
    Method,
    ReadingOptions,
    RigOptions,
    WindowOptions,
    flat,
)
from cfid.console.outcome import deliver


@flat
def swing(
    *,
    run: Annotated[str, typer.Argument(metavar="RUN", help="A run folder, a run's name, or a CSV file.")],
    window: WindowOptions,
    cut: CutOptions,
    rig: RigOptions,
    reading: ReadingOptions,
    delivery: Delivery,
    axis: Annotated[str | None, typer.Option(help="Mount it swung about; default: the run's label.")] = None,
    distance_m: Annotated[float | None, typer.Option(help="From the axis to the centre of mass.")] = None,
    mass_kg: MassKg = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
) -> None:
    """Fit one swing: a pendulum with its sine kept and the damping that the data supports.

    Without mass and distance (by hand, or a mount of rig.toml) it gives the natural frequency only.

    Example: [bold]cfid fit swing x.csv --time-unit us --mass-kg 0.028 --distance-m 0.022855[/bold]
    """
    from cfid.swing.geometry import body_of_swing, surroundings
    from cfid.swing.result import analyse, swing_outcome
    from cfid.swing.window import check_peaks, find

    workplace = open_workplace(rig, gravity_mps2=gravity_mps2)
    record = read_recording(run, reading.reading(), workplace)
    axis = axis or record.label.axis
    body = body_of_swing(workplace, axis=axis, body=record.label.body, mass_kg=mass_kg, distance_m=distance_m)
    check_peaks(window.peaks, [axis] if axis else [])
    found = find(record, window, axis=axis, cut=cut)
    analysed = analyse(record, found, method)
    outcome = swing_outcome(record, found, analysed, axis=axis, body=body, around=surroundings(workplace))
    deliver(outcome, delivery, workplace.campaign)
