"""What the motor maps share: the battery's form, thrust of speed, scales as a second opinion, and their result."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.console.inputs import Workplace
from cfid.console.options import Delivery
from cfid.console.outcome import deliver
from cfid.errors import FitError
from cfid.findings import SEVERITIES, Finding, rejection, texts, warning
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
    """Print what is found about the points even where nothing can be fitted to them: that may be why."""
    from cfid.console.messages import note
    from cfid.motors.maps.result import merged

    try:
        yield
    except FitError:
        for text in texts(merged(found.findings), *SEVERITIES):
            note(text)
        raise


def by_voltage(
    found: Evidence, *, max_thrust_n: float | None
) -> "tuple[VoltageComparison | None, tuple[Finding, ...]]":
    """Judge thrust of motor voltage against thrust of command, where the battery's voltage is known."""
    import numpy as np

    from cfid.motors.maps.voltage import KEY, compare_thrust

    points = found.points
    if found.vbat_v is None or points.thrust_n is None or not np.isfinite(found.vbat_v).any():
        return None, ()
    try:
        compared = compare_thrust(
            command=points.command,
            vbat_v=found.vbat_v,
            thrust_n=points.thrust_n,
            std_n=points.thrust_std_n,
            shared_n=points.thrust_shared_n,
            max_thrust_n=max_thrust_n,
        )
    except FitError as error:
        return None, (rejection("voltage-not-fitted", f"thrust of motor voltage: {error}", KEY),)
    return compared, (compared.verdict, *compared.findings)


def by_speed(found: Evidence, method: Any, *, robust: bool) -> "tuple[SpeedThrustMap | None, tuple[Finding, ...]]":
    """Fit thrust over speed, where both were measured."""
    from cfid.motors.maps.estimation import OVER_SPEED, fit_thrust_of_speed

    if found.points.thrust_n is None or found.points.speed_rad_s is None:
        return None, ()
    try:
        mapped = fit_thrust_of_speed(found.points, method=method, robust=robust)
    except FitError as error:
        return None, (rejection("thrust-of-speed-not-fitted", f"thrust of speed: {error}", *OVER_SPEED),)
    return mapped, mapped.findings


def verified(
    path: Path | None, mapped: "MotorMap", stand: StandOptions, workplace: Workplace
) -> "tuple[Verification | None, tuple[Finding, ...]]":
    """Compare the map with scales: of a run, or of a table."""
    from cfid.console.inputs import find_recording
    from cfid.motors.maps.scales import scales_thrust_n, verify_thrust
    from cfid.motors.maps.scales_data import read_scales

    if path is None:
        return None, ()
    command, grams, motors = read_scales(find_recording(str(path), workplace), stand)
    gravity = workplace.rig.site.gravity_mps2
    try:
        thrust_n = scales_thrust_n(command, grams, motors=motors, gravity_mps2=gravity)
        return verify_thrust(mapped, command=command, thrust_n=thrust_n), ()
    except FitError as error:
        return None, (warning("scales-not-comparable", f"the map is not verified: {error}"),)


def deliver_map(
    command: str,
    mapped: "MotorMap",
    found: Evidence,
    *,
    wanted: str,
    parameters: "dict[str, Parameter]",
    covariances: "tuple[Covariance, ...]",
    lines: Sequence[str],
    findings: Sequence[Finding],
    workplace: Workplace,
    delivery: Delivery,
    verification: "Verification | None" = None,
    over_speed: "SpeedThrustMap | None" = None,
    voltage: "VoltageComparison | None" = None,
    quality: Mapping[str, Any] | None = None,
) -> None:
    """Draw, keep and print a map. Raises FitError when it is rejected."""
    from cfid.motors.maps.result import joined_quality, merged

    def drawings() -> dict[str, Any]:
        from cfid.motors.maps.figures import map_figure, speed_thrust_figure, staircase_figure, voltage_figure

        name = command.replace(" ", "_")
        pages = {
            f"{name}_{r.name}": staircase_figure(r.time_s, r.thrust_n, r.staircase, title=r.name, thrust=r.thrust)
            for r in found.reduced[:_MOST_PAGES]
        }
        figures = {name: map_figure(mapped, verification=verification), **pages}
        if over_speed is not None:
            figures["thrust_of_speed"] = speed_thrust_figure(over_speed)
        if voltage is not None:
            figures["thrust_of_voltage"] = voltage_figure(voltage)
        return figures

    result = Result(
        command=command,
        method=mapped.method,
        quantities=parameters,
        wanted=(wanted,),
        covariances=covariances,
        quality=joined_quality(mapped, **(quality or {})),
        findings=merged((*found.findings, *mapped.findings, *findings)),
        sources=found.sources,
        drawings=drawings,
        folder=workplace.figures_beside(found.paths),
        lines=(*found.lines, *lines),
    )
    deliver(result, delivery, workplace.campaign)
