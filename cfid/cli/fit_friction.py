"""`cfid fit friction`: dropping weights to Coulomb and viscous friction of the axis."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.cli.inputs import KnownInertia, Named, Workplace, open_workplace, positive, read_named
from cfid.cli.options import CutOptions, Delivery, Method, ReadingOptions, RigOptions, flat
from cfid.cli.outcome import Outcome, deliver
from cfid.errors import ConfigError, DataError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from cfid.analysis.drops import Drop
    from cfid.analysis.friction import Friction
    from cfid.parameters import Parameter


@flat
def friction(
    *,
    runs: Annotated[
        list[str],
        typer.Argument(metavar="GRAMS=FILE|RUN ...", help="Dropped weights; a run has its own label."),
    ],
    cut: CutOptions,
    rig: RigOptions,
    reading: ReadingOptions,
    delivery: Delivery,
    radius_mm: Annotated[float | None, typer.Option(help="Radius of the axis that the line is wound around.")] = None,
    method: Method = "default",
) -> None:
    """Fit the friction of the swing's axis to weights dropped on a line wound around it.

    The steady speed's window is found; --from and --to set it by hand (for a single run, best).

    Example: [bold]cfid fit friction 20=drop_20g.csv 30=drop_30g.csv 40=drop_40g.csv --radius-mm 2[/bold]
    """
    from cfid.analysis.friction import fit_friction, thesis_friction

    workplace = open_workplace(rig)
    items = read_named(runs, reading.reading(), workplace, label="grams")
    radius_m, radius_std_m, notes = _radius_m(workplace, radius_mm)
    gravity = workplace.rig.site.gravity_mps2
    drops = [_drop(item, cut, radius_m, gravity) for item in items]
    if not any(drop.settled for drop in drops):
        found = None
    elif method == "thesis":
        found = thesis_friction(drops)
    else:
        found = fit_friction(drops, radius_m=radius_m, radius_std_m=radius_std_m, gravity_mps2=gravity)
    files = [item for item in items if isinstance(item, Named)]
    outcome = _outcome(
        found=found, drops=drops, files=files, workplace=workplace, radius_m=radius_m, method=method, notes=notes
    )
    deliver(outcome, delivery, workplace.campaign)


def _radius_m(workplace: Workplace, radius_mm: float | None) -> tuple[float, float, tuple[str, ...]]:
    from cfid.campaign import MM

    if radius_mm is not None:
        return MM * positive(radius_mm, "--radius-mm"), 0.0, ()
    if workplace.rig.friction is None:
        raise ConfigError("the radius of the axis is not known: add [friction] to rig.toml, or say --radius-mm.")
    axis = workplace.rig.friction
    return MM * axis.radius_mm, MM * axis.radius_std_mm, workplace.notes


def _drop(item: Named | KnownInertia, cut: CutOptions, radius_m: float, gravity: float) -> "Drop":
    from cfid.analysis.drops import measure_drop

    if isinstance(item, KnownInertia):
        raise ConfigError(f"{item.name}={item.value_kg_m2:g}: expected GRAMS=FILE.")
    try:
        grams = positive(float(item.name), "GRAMS=")
    except ValueError:
        raise ConfigError(f"'{item.name}' is no weight in grams: write GRAMS=FILE.") from None
    try:
        return measure_drop(
            item.record.time_s,
            item.record.angle_rad,
            weight_kg=grams / 1000,
            radius_m=radius_m,
            gravity_mps2=gravity,
            from_s=cut.from_s,
            to_s=cut.to_s,
        )
    except DataError as error:
        raise DataError(f"{item.record.path}: {error}") from None


def _outcome(
    *,
    found: "Friction | None",
    drops: "Sequence[Drop]",
    files: "Sequence[Named]",
    workplace: Workplace,
    radius_m: float,
    method: str,
    notes: tuple[str, ...],
) -> Outcome:
    def drawings() -> "dict[str, Figure]":
        from cfid.report.friction_figures import drops_figure, friction_figure

        labels = [f"{file.name} g, {file.record.name}" for file in files]
        gravity = workplace.rig.site.gravity_mps2
        figures = {"friction_runs": drops_figure(drops, labels=labels)}
        if found is not None:
            figures["friction"] = friction_figure(drops, found, radius_m=radius_m, gravity_mps2=gravity)
        return figures

    from cfid.analysis.friction import NEVER_SETTLED

    unsettled = [file for file, drop in zip(files, drops, strict=True) if not drop.settled]
    return Outcome(
        command="fit friction",
        method=method,
        parameters=_parameters(found, drops),
        quality={"settled": sum(drop.settled for drop in drops), "left_out": len(unsettled)},
        warnings=(
            *notes,
            *(note for file in files for note in file.record.notes),
            *(found.warnings if found else ()),
            *(f"{f.record.name} ({f.name} g): the speed never settles; it is left out." for f in unsettled),
        ),
        sources=tuple(file.record.source for file in files),
        doubts=() if found else (NEVER_SETTLED,),
        lines=tuple(_line(drop) for drop in drops),
        drawings=drawings,
        beside=files[0].record.path.parent if workplace.campaign is None else workplace.campaign.folder / "figures",
    )


def _line(drop: "Drop") -> str:
    words = (
        f"{1000 * drop.weight_kg:5g} g: {drop.speed_rad_per_s:6.1f} rad/s from {drop.from_s:.2f} to {drop.to_s:.2f} s, "
    )
    if not drop.settled:
        return words + "never settles"
    return words + f"{1e5 * drop.coefficient_nms_per_rad:.4f}e-5 N m s/rad, tends to {drop.terminal_rad_per_s:.1f}"


def _parameters(found: "Friction | None", drops: "Sequence[Drop]") -> "dict[str, Parameter]":
    from cfid.parameters import Parameter

    runs = Parameter(value=[_row(drop) for drop in drops], unit="see names")
    if found is None:
        return {"friction.runs": runs}
    return {
        "friction.viscous_nms_per_rad": Parameter(
            value=found.viscous_nms_per_rad, std=found.viscous_std, unit="N m s/rad"
        ),
        "friction.coulomb_nm": Parameter(value=found.coulomb_nm, std=found.coulomb_std, unit="N m"),
        "friction.setup_inertia_kg_m2": Parameter(
            value=found.setup_inertia_kg_m2, std=found.setup_inertia_std, unit="kg m^2"
        ),
        "friction.runs": runs,
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
