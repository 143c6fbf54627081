"""`cfid fit thrust`, `cfid fit speed` and `cfid fit torque`: steady points of the motors to maps."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.inputs import open_workplace
from cfid.console.options import Delivery, GravityMps2, LoadCellOptions, Method, ReadingOptions, RigOptions, flat
from cfid.errors import ConfigError, FitError
from cfid.findings import rejection
from cfid.motors.maps.evidence import StandOptions
from cfid.motors.maps.inputs import read_evidence
from cfid.motors.maps.outcome import by_speed, by_voltage, deliver_map, noted_first, verified
from cfid.motors.vibration.command import RotorOptions

if TYPE_CHECKING:
    from cfid.motors.maps.estimation import Order
    from cfid.motors.maps.inverse import MaximumThrust

Words = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="COMMAND=FILE|RUN ...",
        help="Load-cell files by command, or runs of cfid log; default: all complete ones.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """How a map is fitted."""

    order: Annotated[
        str | None, typer.Option(metavar="N|auto", help="Order; default: the thesis', auto: by corrected AIC.")
    ] = None
    robust: Annotated[bool, typer.Option(help="Let single points that stand apart count little.")] = True

    def chosen(self, usual: int) -> "Order":
        """Return the order. Raises ConfigError for what is none."""
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
        Path | None, typer.Option(help="Scales: a table cmd,grams, or a run of cfid log scales (figure 3.9).")
    ] = None,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
) -> None:
    """Fit one motor's thrust over command, its inverse, the most it gives, and, with a battery's voltage, over that.

    Example: [bold]cfid fit thrust 2026-11-21_083012_thrust[/bold]
    """
    from cfid.motors.maps import result as told
    from cfid.motors.maps.estimation import fit_thrust
    from cfid.motors.maps.inverse import invert, maximum_thrust

    workplace = open_workplace(rig, gravity_mps2=gravity_mps2)
    gravity = workplace.rig.site.gravity_mps2
    found = read_evidence(runs or [], stand, reading, scale, workplace, kind="thrust", method=method)
    order = fit.chosen(2)
    with noted_first(found):
        mapped = fit_thrust(
            found.points, method=method, order=order, robust=fit.robust, expected=found.expected or None
        )
    most = maximum_thrust(mapped, gravity_mps2=gravity)
    parameters, lines = told.map_parameters(mapped), told.map_lines(mapped)
    findings = [*most.findings]
    given: MaximumThrust | None = None
    try:
        inverse = invert(mapped)
        parameters |= told.inverse_parameters(inverse, most)
        lines += [] if told.is_rejected(mapped) else told.inverse_lines(inverse, most)
        given = most
        findings += inverse.findings
    except FitError as error:
        findings.append(rejection("inverse-not-given", str(error), "motor.command_of_thrust"))
    voltage, about_voltage = by_voltage(found, max_thrust_n=given.thrust_n if given else None)
    if voltage is not None:
        parameters |= told.voltage_parameters(voltage)
    over_speed, about_speed = by_speed(found, method, robust=fit.robust)
    if over_speed is not None:
        parameters |= told.speed_parameters(over_speed)
    verification, about_scales = verified(verify, mapped, stand, workplace)
    if verification is not None:
        lines += told.verification_lines(verification)
    deliver_map(
        "fit thrust",
        mapped,
        found,
        wanted="motor.thrust_poly",
        parameters={**parameters, **told.table_parameter(found.points)},
        covariances=told.covariances(mapped, most=given, voltage=voltage, over_speed=over_speed),
        lines=lines,
        findings=(*findings, *about_voltage, *about_speed, *about_scales),
        workplace=workplace,
        delivery=delivery,
        verification=verification,
        over_speed=over_speed,
        voltage=voltage,
        quality={
            "voltage_rms_n": voltage.voltage_rms if voltage else None,
            "command_rms_n": voltage.command_rms if voltage else None,
            "better_form": voltage.better if voltage else None,
            "verification_rms_n": verification.rms_n if verification else None,
            "verification_rms_percent": verification.rms_percent if verification else None,
        },
    )


@flat
def speed(
    *,
    runs: Words = None,
    stand: StandOptions,
    fit: MapOptions,
    vibration: RotorOptions,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
    method: Method = "default",
) -> None:
    """Fit one rotor's speed over command; a tachometer's readings are divided by --markers.

    Without one, the speed is estimated from the load cell's vibration.

    Example: [bold]cfid fit speed --table rpm.csv --markers 2[/bold]
    """
    from cfid.motors.maps import result as told
    from cfid.motors.maps.estimation import fit_speed

    rotors = vibration.rotors_known()
    workplace = open_workplace(rig)
    found = read_evidence(runs or [], stand, reading, scale, workplace, kind="speed", method=method, rotors=rotors)
    with noted_first(found):
        mapped = fit_speed(
            found.points, method=method, order=fit.chosen(1), robust=fit.robust, expected=found.expected or None
        )
    over_speed, about_speed = by_speed(found, method, robust=fit.robust)
    parameters = told.map_parameters(mapped) | (told.speed_parameters(over_speed) if over_speed else {})
    deliver_map(
        "fit speed",
        mapped,
        found,
        wanted="motor.speed_poly",
        parameters={**parameters, **told.table_parameter(found.points)},
        covariances=told.covariances(mapped, over_speed=over_speed),
        lines=told.map_lines(mapped),
        findings=about_speed,
        workplace=workplace,
        delivery=delivery,
        over_speed=over_speed,
    )


@flat
def torque(
    *,
    runs: Words = None,
    stand: StandOptions,
    fit: MapOptions,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
    method: Method = "default",
) -> None:
    """Fit one motor's torque over its thrust.

    Example: [bold]cfid fit torque 2026-11-21_083012_thrust[/bold]
    """
    from cfid.motors.maps import result as told
    from cfid.motors.maps.estimation import fit_torque

    workplace = open_workplace(rig)
    found = read_evidence(runs or [], stand, reading, scale, workplace, kind="thrust", method=method)
    with noted_first(found):
        mapped = fit_torque(
            found.points, method=method, order=fit.chosen(1), robust=fit.robust, expected=found.expected or None
        )
    parameters = {**told.map_parameters(mapped), **told.table_parameter(found.points)}
    deliver_map(
        "fit torque",
        mapped,
        found,
        wanted="motor.torque_poly",
        parameters=parameters,
        covariances=told.covariances(mapped),
        lines=told.map_lines(mapped),
        findings=(),
        workplace=workplace,
        delivery=delivery,
    )
