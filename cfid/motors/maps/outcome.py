"""What the motor maps share: the battery's form, thrust of speed, scales as a second opinion, and how they are told."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.console.inputs import Workplace
from cfid.console.options import Delivery
from cfid.console.outcome import deliver
from cfid.errors import FitError
from cfid.findings import rejection, warning
from cfid.motors.maps.evidence import Evidence, StandOptions
from cfid.records.result import Result

if TYPE_CHECKING:
    from cfid.motors.maps.estimation import MotorMap, SpeedThrustMap
    from cfid.motors.maps.scales import Verification
    from cfid.motors.maps.voltage import VoltageComparison
    from cfid.records.covariances import Covariance
    from cfid.records.parameters import Parameter

_MOST_PAGES = 4  # of reduced records, each a figure


@contextmanager
def noted_first(found: Evidence) -> Iterator[None]:
    """Say what is to be said of the evidence even where nothing can be fitted to it: that may be why."""
    from cfid.console.messages import note
    from cfid.motors.maps.result import unique

    try:
        yield
    except FitError:
        for said in unique(found.warnings):
            note(said)
        raise


def by_voltage(found: Evidence, warnings: list[str], *, max_thrust_n: float | None) -> "VoltageComparison | None":
    """Judge thrust of motor voltage against thrust of command, where the battery's voltage is known."""
    import numpy as np

    from cfid.motors.maps.voltage import compare_thrust

    if found.vbat_v is None or found.points.thrust_n is None or not np.isfinite(found.vbat_v).any():
        return None
    try:
        points = found.points
        assert points.thrust_n is not None
        compared = compare_thrust(
            command=points.command,
            vbat_v=found.vbat_v,
            thrust_n=points.thrust_n,
            std_n=points.thrust_std_n,
            shared_n=points.thrust_shared_n,
            max_thrust_n=max_thrust_n,
        )
    except FitError as error:
        warnings.append(f"thrust of motor voltage: {error}")
        return None
    warnings += compared.warnings
    return compared


def by_speed(found: Evidence, method: Any, warnings: list[str], *, robust: bool) -> "SpeedThrustMap | None":
    """Fit thrust over speed, where both were measured."""
    from cfid.motors.maps.estimation import fit_thrust_of_speed

    if found.points.thrust_n is None or found.points.speed_rad_s is None:
        return None
    try:
        mapped = fit_thrust_of_speed(found.points, method=method, robust=robust)
    except FitError as error:
        warnings.append(f"thrust of speed: {error}")
        return None
    warnings += (*mapped.warnings, *mapped.doubts)
    return mapped


def verified(path: Path | None, mapped: "MotorMap", stand: StandOptions, workplace: Workplace) -> "Verification | None":
    """Compare the map with scales: of a run, or of a table."""
    from cfid.console.inputs import find_recording
    from cfid.motors.maps.scales import scales_thrust_n, verify_thrust
    from cfid.motors.maps.scales_data import read_scales

    if path is None:
        return None
    command, grams, motors = read_scales(find_recording(str(path), workplace), stand)
    gravity = workplace.rig.site.gravity_mps2
    thrust_n = scales_thrust_n(command, grams, motors=motors, gravity_mps2=gravity)
    return verify_thrust(mapped, command=command, thrust_n=thrust_n)


def deliver_map(
    command: str,
    mapped: "MotorMap",
    found: Evidence,
    *,
    parameters: "dict[str, Parameter]",
    covariances: "tuple[Covariance, ...]",
    lines: list[str],
    warnings: list[str],
    workplace: Workplace,
    delivery: Delivery,
    verification: "Verification | None" = None,
    over_speed: "SpeedThrustMap | None" = None,
    voltage: "VoltageComparison | None" = None,
    quality: dict[str, Any] | None = None,
    rejected: dict[str, str] | None = None,
) -> None:
    """Draw, keep and print a map. Raises FitError when it is not believed."""
    from cfid.motors.maps.result import joined_quality, unique

    def drawings() -> dict[str, Any]:
        from cfid.motors.maps.figures import map_figure, speed_thrust_figure, staircase_figure, voltage_figure

        name = command.replace(" ", "_")
        pages = {
            f"{name}_{r.name}": staircase_figure(r.time_s, r.thrust_n, r.staircase, title=r.name, thrust=r.thrust)
            for r in drawn
        }
        figures = {name: map_figure(mapped, verification=verification), **pages}
        if over_speed is not None:
            figures["thrust_of_speed"] = speed_thrust_figure(over_speed)
        if voltage is not None:
            figures["thrust_of_voltage"] = voltage_figure(voltage)
        return figures

    drawn = found.reduced[:_MOST_PAGES]
    deliver(
        Result(
            command=command,
            method=mapped.method,
            quantities=parameters,
            covariances=covariances,
            quality=joined_quality(mapped, **(quality or {})),
            findings=(
                *(warning("motor-warning", text) for text in unique([*found.warnings, *warnings])),
                *(rejection("map-rejected", text) for text in mapped.doubts),
                *(rejection("quantity-rejected", text, key) for key, text in (rejected or {}).items()),
            ),
            sources=found.sources,
            lines=(*found.lines, *lines),
            drawings=drawings,
            folder=workplace.figures_beside(found.paths),
        ),
        delivery,
        workplace.campaign,
    )
