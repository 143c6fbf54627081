"""`cfid fit thrust`, `cfid fit speed` and `cfid fit torque`: from steady points of the motors to maps."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.flat import flat
from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.lists import measured, span
from cfid.console.options import (
    Delivery,
    FlipFz,
    GravityMps2,
    Markers,
    Method,
    RigOptions,
)
from cfid.console.outcome import deliver
from cfid.errors import ConfigError
from cfid.motors.vibration.command import RotorOptions
from cfid.records.choose import labelled

if TYPE_CHECKING:
    from cfid.motors.maps.data import Stand
    from cfid.motors.maps.estimation import Order
    from cfid.records.result import Result

_INPUT = "What was measured"

Words = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="FILE|COMMAND=FILE|RUN ...",
        help="Thrust stands' CSV files, load-cell files by command, or runs; default: all complete runs.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class StandOptions:
    """Facts that files do not contain."""

    table: Annotated[
        Path | None,
        typer.Option(
            help="Table with columns cmd, thrust_n, ..., or a thrust stand's CSV file.", rich_help_panel=_INPUT
        ),
    ] = None
    motors: Annotated[
        int | None,
        typer.Option(min=1, max=4, help="Number of motors that ran, for files; runs state it.", rich_help_panel=_INPUT),
    ] = None
    markers: Markers = None
    window: Annotated[
        str | None,
        typer.Option(metavar="FROM,TO", help="Time window to use in every file, in seconds.", rich_help_panel=_INPUT),
    ] = None
    flip_fz: FlipFz = None

    def known(self) -> "Stand":
        """Return the facts in the form that fits take. Raises ConfigError for an invalid window."""
        from cfid.motors.maps.data import Stand

        window_s = None if self.window is None else span(self.window, "--window", unit="seconds", example="4,8")
        return Stand(motors=self.motors, markers=self.markers, window_s=window_s, flip_fz=self.flip_fz)


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """How a map is fitted."""

    order: Annotated[
        str | None,
        typer.Option(
            metavar="N|auto", help="Order of the polynomial; default: as in the thesis; auto: by corrected AIC."
        ),
    ] = None
    robust: Annotated[bool, typer.Option(help="Reduce the weight of outliers.")] = True

    def chosen(self, usual: int) -> "Order":
        """Return the order. Raises ConfigError for an invalid one."""
        if self.order is None:
            return usual
        if self.order == "auto":
            return "auto"
        if not self.order.isdecimal() or not 1 <= int(self.order) <= 5:
            raise ConfigError(f"--order {self.order}: should be a whole number from 1 to 5, or auto.")
        return int(self.order)


@flat
def thrust(
    *,
    runs: Words = None,
    stand: StandOptions,
    fit: MapOptions,
    verify: Annotated[
        list[Path] | None,
        typer.Option(
            help="Readings of scales to compare with: a table cmd,grams, or a run of cfid log scales (figure 3.9); "
            "can be repeated."
        ),
    ] = None,
    rig: RigOptions,
    delivery: Delivery,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
) -> None:
    """Fit one motor's thrust over command, its inverse and largest thrust, and thrust over a logged voltage.

    Example: [bold]cfid fit thrust 2026-11-21_083012_thrust[/bold]
    """
    from cfid.motors.maps import fit_thrust
    from cfid.motors.maps.data import read_evidence

    gravity = measured(gravity_mps2, "--gravity-mps2")
    workplace = open_workplace(rig, gravity=gravity)
    result = fit_thrust(
        read_evidence(
            runs or [],
            workplace,
            known=stand.known(),
            table=stand.table,
            kind="thrust",
            method=method,
        ),
        gravity_mps2=workplace.rig.site.gravity_mps2,
        order=fit.chosen(2),
        robust=fit.robust,
        stand=replace(stand.known(), facts=workplace.rig.facts),
        scales=[find_recording(str(one), workplace, labelled("scales")) for one in verify or ()],
        method=method,
    )
    _deliver(result, workplace, delivery)


@flat
def speed(
    *,
    runs: Words = None,
    stand: StandOptions,
    fit: MapOptions,
    vibration: RotorOptions,
    rig: RigOptions,
    delivery: Delivery,
    method: Method = "default",
) -> None:
    """Fit one rotor's speed over command; a tachometer's readings are divided by its markers.

    Without a tachometer, the speed is estimated from the load cell's vibration.

    Example: [bold]cfid fit speed --table rpm.csv --markers 2[/bold]
    """
    from cfid.motors.maps import fit_speed
    from cfid.motors.maps.data import read_evidence

    rotors = vibration.rotors_known()
    workplace = open_workplace(rig)
    result = fit_speed(
        read_evidence(
            runs or [],
            workplace,
            known=stand.known(),
            table=stand.table,
            kind="speed",
            method=method,
            rotors=rotors,
        ),
        order=fit.chosen(1),
        robust=fit.robust,
        method=method,
    )
    _deliver(result, workplace, delivery)


@flat
def torque(
    *,
    runs: Words = None,
    stand: StandOptions,
    fit: MapOptions,
    rig: RigOptions,
    delivery: Delivery,
    method: Method = "default",
) -> None:
    """Fit one motor's torque over its thrust.

    Example: [bold]cfid fit torque 2026-11-21_083012_thrust[/bold]
    """
    from cfid.motors.maps import fit_torque
    from cfid.motors.maps.data import read_evidence

    workplace = open_workplace(rig)
    found = read_evidence(
        runs or [],
        workplace,
        known=stand.known(),
        table=stand.table,
        kind="thrust",
        method=method,
    )
    _deliver(fit_torque(found, order=fit.chosen(1), robust=fit.robust, method=method), workplace, delivery)


def _deliver(result: "Result", workplace: Workplace, delivery: Delivery) -> None:
    deliver(replace(result, folder=workplace.figures), delivery, workplace.campaign, workplace.own_rig)
