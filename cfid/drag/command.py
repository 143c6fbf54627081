"""Provide `cfid fit drag`: drag coefficients from forces on a vehicle held in wind."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from cfid.console.flat import flat
from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.options import Delivery, FlipFz, Markers, Method, RigOptions, YawDeg, finite
from cfid.console.outcome import deliver
from cfid.console.selection import chosen
from cfid.drag.wind.command import AzimuthRad, azimuth
from cfid.records.choose import labelled

_INPUT, _MODELS = "What was measured", "Models"

Runs = Annotated[
    list[str] | None,
    typer.Argument(metavar="RUN ...", help="Runs of cfid log wind; default: the campaign's complete ones."),
]


@dataclass(frozen=True, kw_only=True)
class WindInputs:
    """The location of forces in wind, and the placement of the vehicle and the wind generator."""

    index: Annotated[
        Path | None,
        typer.Option(
            help="CSV file with one row per run: command, angle_deg, wind_min_mps, wind_max_mps, tach_rpm, loadcell; "
            "optionally azimuth_deg, from_s, to_s; paths are relative to the file; rows with wind 0 are "
            "references; a load cell is a file whose columns name their unit (Fz_n, Fz_counts) or a run.",
            rich_help_panel=_INPUT,
        ),
    ] = None
    table: Annotated[
        Path | None,
        typer.Option(
            help="CSV file of reduced forces: command, angle_deg, vx_mps, vy_mps, vz_mps, speed_sum_rad_s, fx_n, fy_n, "
            "fz_n.",
            rich_help_panel=_INPUT,
        ),
    ] = None
    azimuth_deg: Annotated[
        float | None,
        typer.Option(
            help="Azimuth of the wind generator, to the right of the nose, for runs that do not state it; default: "
            "rig.toml's.",
            rich_help_panel=_INPUT,
        ),
    ] = None
    azimuth_rad: AzimuthRad = None
    yaw_deg: YawDeg = None
    markers: Markers = None
    flip_fz: FlipFz = None


@dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """The options of the thesis' models, and the grouping of the simple one."""

    grouping: Annotated[
        Literal["each", "lateral", "command", "wind", "angle"] | None,
        typer.Option(
            help="Runs that share simple coefficients, as in C.3.1: each run and axis alone, x and y together, all "
            "winds of a command, all commands of a wind, all runs of an angle.",
            rich_help_panel=_MODELS,
        ),
    ] = None
    mended: Annotated[
        bool,
        typer.Option(
            "--mended", help="Let cross-coupling lose lift in both directions: kappa_4 |v_xy|.", rich_help_panel=_MODELS
        ),
    ] = False
    intercepts: Annotated[
        bool,
        typer.Option(
            "--intercepts", help="Fit a constant force in each wind, for tare drift.", rich_help_panel=_MODELS
        ),
    ] = False
    parasitic: Annotated[
        bool, typer.Option("--parasitic", help="Fit the drag of the body too: k |v| v.", rich_help_panel=_MODELS)
    ] = False


@flat
def drag(
    *,
    runs: Runs = None,
    wind: WindInputs,
    models: ModelOptions,
    rig: RigOptions,
    delivery: Delivery,
    method: Method = "default",
) -> None:
    """Fit the simple, cross-coupling and complex drag models, and choose the one that the data support.

    Example: [bold]cfid fit drag --index wind.csv --azimuth-deg 28.46 --yaw-deg 45[/bold]
    """
    from cfid.drag import fit, read_forces

    place = open_workplace(rig)
    paths = _paths(runs or [], wind, place)
    result = fit(
        read_forces(wind.table) if wind.table is not None else paths,
        index=wind.index,
        azimuth_deg=azimuth(wind.azimuth_deg, wind.azimuth_rad),
        yaw_deg=None if wind.yaw_deg is None else finite(wind.yaw_deg, "--yaw-deg"),
        markers=wind.markers,
        flip_fz=wind.flip_fz,
        rig=place.facts,
        mended=models.mended,
        intercepts=models.intercepts,
        parasitic=models.parasitic,
        grouping=models.grouping,
        method=method,
    )
    deliver(replace(result, folder=place.figures), delivery, place.campaign, place.own_rig)


def _paths(words: list[str], wind: WindInputs, place: Workplace) -> list[Path]:
    """Return the given runs, or all runs of the campaign if none is given. Raises ConfigError."""
    from cfid.errors import ConfigError

    if wind.table is not None:
        if words or wind.index is not None:
            raise ConfigError(f"--table {wind.table} contains forces that are reduced already: give it alone.")
        return []
    if wind.index is None:
        if not words and place.campaign is None:
            raise ConfigError("nothing to fit: give RUNs of `cfid log wind`, --index FILE, or --table FILE.")
        words = chosen(words, place.campaign, suits=labelled("wind"), wanted="runs in wind and without")
    return [find_recording(word, place) for word in words]
