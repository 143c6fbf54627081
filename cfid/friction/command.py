"""`cfid fit friction`: dropping weights to Coulomb and viscous friction of the axis."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.console.inputs import Workplace, open_workplace
from cfid.console.options import CutOptions, Delivery, GravityMps2, Method, ReadingOptions, RigOptions, flat, positive
from cfid.console.outcome import deliver
from cfid.console.selection import chosen, labelled
from cfid.errors import ConfigError, DataError
from cfid.findings import note, warning
from cfid.friction.data import read_weights
from cfid.records.result import Result

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from cfid.friction.drops import Drop
    from cfid.friction.estimation import FrictionEstimate
    from cfid.records.parameters import Parameter
    from cfid.records.tables.angle import AngleRecord


@flat
def friction(
    *,
    runs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="GRAMS=FILE|RUN ...",
            help="Dropped weights; a run has its own label. Default: the campaign's complete drops.",
        ),
    ] = None,
    cut: CutOptions,
    rig: RigOptions,
    reading: ReadingOptions,
    delivery: Delivery,
    radius_mm: Annotated[float | None, typer.Option(help="Radius of the axis that the line is wound around.")] = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
) -> None:
    """Fit the friction of the swing's axis to weights dropped on a line wound around it.

    The steady speed's window is found; --from and --to set it by hand (for a single run, best).

    Example: [bold]cfid fit friction 20=drop_20g.csv 30=drop_30g.csv 40=drop_40g.csv --radius-mm 2[/bold]
    """
    from cfid.friction.estimation import fit_friction, thesis_friction

    workplace = open_workplace(rig, gravity_mps2=gravity_mps2)
    words = chosen(runs, workplace.campaign, suits=labelled("drop"), wanted="dropped weights")
    weights = read_weights(words, reading.reading(), workplace)
    radius_m, radius_std_m, notes = _radius_m(workplace, radius_mm)
    gravity = workplace.rig.site.gravity_mps2
    records = [record for _, record in weights]
    drops = [_drop(grams, record, cut, radius_m, gravity) for grams, record in weights]
    if method == "thesis":
        found = thesis_friction(drops)
    else:
        found = fit_friction(drops, radius_m=radius_m, radius_std_m=radius_std_m, gravity_mps2=gravity)
    outcome = _outcome(
        found=found, drops=drops, records=records, workplace=workplace, radius_m=radius_m, method=method, notes=notes
    )
    deliver(outcome, delivery, workplace.campaign)


def _radius_m(workplace: Workplace, radius_mm: float | None) -> tuple[float, float, tuple[str, ...]]:
    from cfid.records.campaign import MM

    if radius_mm is not None:
        return MM * positive(radius_mm, "--radius-mm"), 0.0, ()
    if workplace.rig.friction is None:
        raise ConfigError("the radius of the axis is not known: add [friction] to rig.toml, or say --radius-mm.")
    axis = workplace.rig.friction
    return MM * axis.radius_mm, MM * axis.radius_std_mm, workplace.notes


def _drop(grams: float, record: "AngleRecord", cut: CutOptions, radius_m: float, gravity: float) -> "Drop":
    from cfid.friction.drops import measure_drop

    try:
        return measure_drop(
            record.time_s,
            record.angle_rad,
            weight_kg=grams / 1000,
            radius_m=radius_m,
            gravity_mps2=gravity,
            from_s=cut.from_s,
            to_s=cut.to_s,
        )
    except DataError as error:
        raise DataError(f"{record.path}: {error}") from None


def _outcome(
    *,
    found: "FrictionEstimate",
    drops: "Sequence[Drop]",
    records: "Sequence[AngleRecord]",
    workplace: Workplace,
    radius_m: float,
    method: str,
    notes: tuple[str, ...],
) -> Result:
    def drawings() -> "dict[str, Figure]":
        from cfid.friction.figures import drops_figure, friction_figure

        labels = [f"{1000 * d.weight_kg:g} g, {r.name}" for d, r in zip(drops, records, strict=True)]
        gravity = workplace.rig.site.gravity_mps2
        figures = {"friction_runs": drops_figure(drops, labels=labels)}
        if any(drop.settled for drop in drops):
            figures["friction"] = friction_figure(drops, found, radius_m=radius_m, gravity_mps2=gravity)
        return figures

    unsettled = [record for record, drop in zip(records, drops, strict=True) if not drop.settled]
    return Result(
        command="fit friction",
        method=method,
        quantities=_parameters(found, drops),
        wanted=("friction.viscous_nms_per_rad", "friction.coulomb_nm"),
        quality={"settled": sum(drop.settled for drop in drops), "left_out": len(unsettled)},
        findings=(
            *(note("thesis-geometry", text) for text in notes),
            *(warning("recording", text) for record in records for text in record.notes),
            *found.findings,
            *(
                warning("friction-drop-left-out", f"{record.name}: the speed never settles; it is left out.")
                for record in unsettled
            ),
        ),
        sources=tuple(record.source for record in records),
        lines=tuple(_line(drop) for drop in drops),
        drawings=drawings,
        folder=workplace.figures_beside([record.path for record in records]),
    )


def _line(drop: "Drop") -> str:
    words = (
        f"{1000 * drop.weight_kg:5g} g: {drop.speed_rad_per_s:6.1f} rad/s from {drop.from_s:.2f} to {drop.to_s:.2f} s, "
    )
    if not drop.settled:
        return words + "never settles"
    return words + f"{drop.coefficient_nms_per_rad:.4g} N m s/rad, tends to {drop.terminal_rad_per_s:.1f}"


def _parameters(found: "FrictionEstimate", drops: "Sequence[Drop]") -> "dict[str, Parameter]":
    from cfid.records.parameters import Parameter

    return {
        "friction.viscous_nms_per_rad": Parameter(
            value=found.viscous_nms_per_rad, std=found.viscous_std, unit="N m s/rad"
        ),
        "friction.coulomb_nm": Parameter(value=found.coulomb_nm, std=found.coulomb_std, unit="N m"),
        "friction.setup_inertia_kg_m2": Parameter(
            value=found.setup_inertia_kg_m2, std=found.setup_inertia_std, unit="kg m^2"
        ),
        "friction.runs": Parameter(value=[_row(drop) for drop in drops], unit="as named"),
    }


def _row(drop: "Drop") -> dict[str, Any]:
    return {
        "weight_g": 1000 * drop.weight_kg,
        "settled": drop.settled,
        "speed_rad_per_s": drop.speed_rad_per_s,
        "speed_std_rad_per_s": drop.speed_std_rad_per_s,
        "terminal_rad_per_s": drop.terminal_rad_per_s if drop.settled else None,
        "coefficient_nms_per_rad": drop.coefficient_nms_per_rad if drop.settled else None,
        "from_s": drop.from_s,
        "to_s": drop.to_s,
        "time_constant_s": drop.time_constant_s if drop.settled else None,
    }
