"""Motor maps as `cfid fit thrust`, `speed` and `torque` tell them: parameters of the contract, lines, doubts."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cfid.motors.maps.estimation import MotorMap, SpeedThrustMap
    from cfid.motors.maps.inverse import InverseMap, MaximumThrust
    from cfid.motors.maps.scales import Verification
    from cfid.motors.maps.voltage import VoltageComparison
    from cfid.motors.points import MotorPoints
    from cfid.records.covariances import Covariance
    from cfid.records.parameters import Parameter

_UNITS = {"thrust": "N(cmd)", "speed": "rad/s(cmd)", "torque": "Nm(N)"}
_MOST_NAMES = 2
_Y = {"thrust": "N", "speed": "rad/s", "torque": "Nm"}


def map_parameters(found: "MotorMap") -> "dict[str, Parameter]":
    """Return a map's polynomial, highest power first."""
    from cfid.records.parameters import Parameter

    value, std = found.fit.coefficients.tolist(), found.fit.std.tolist()
    return {f"motor.{found.quantity}_poly": Parameter(value=value, std=std, unit=_UNITS[found.quantity])}


def table_parameter(points: "MotorPoints") -> "dict[str, Parameter]":
    """Return all that was measured at each command."""
    from cfid.motors.points import motor_table
    from cfid.records.parameters import Parameter

    rows = [row._asdict() for row in motor_table(points)]
    return {"motor.table": Parameter(value=rows, unit="as named")}


def inverse_parameters(inverse: "InverseMap", most: "MaximumThrust") -> "dict[str, Parameter]":
    """Return what a controller takes from the thrust map, and section 3.3.1's check of it."""
    from cfid.records.parameters import Parameter

    root = {
        "coefficients": inverse.coefficients.tolist(),
        "command_min": inverse.command_range[0],
        "command_max": inverse.command_range[1],
        "thrust_min_n": inverse.thrust_range_n[0],
        "thrust_max_n": inverse.thrust_range_n[1],
        "round_trip_command": inverse.round_trip_command,
        "round_trip_n": inverse.round_trip_n,
    }
    return {
        "motor.command_of_thrust": Parameter(value=[root], unit="as named"),
        "motor.max_thrust_n": Parameter(value=most.thrust_n, std=most.std_n, unit="N"),
        "motor.hover_mass_kg": Parameter(value=most.hover_mass_kg, std=most.hover_mass_std_kg, unit="kg"),
    }


def map_covariances(found: "MotorMap", most: "MaximumThrust | None" = None) -> "tuple[Covariance, ...]":
    """Return the covariance of a map's coefficients, and of what is calculated from them: the most a motor gives."""
    import numpy as np

    from cfid.motors.points import FULL_COMMAND
    from cfid.records.covariances import covariance_between

    values: dict[str, Any] = {f"motor.{found.quantity}_poly": found.fit.coefficients.tolist()}
    outward = np.eye(found.fit.order + 1)
    if most is not None:
        full = np.vander([float(FULL_COMMAND)], found.fit.order + 1)
        outward = np.vstack([outward, full, full * most.hover_mass_kg / most.thrust_n])
        values |= {"motor.max_thrust_n": most.thrust_n, "motor.hover_mass_kg": most.hover_mass_kg}
    return covariance_between(values, outward @ found.fit.covariance @ outward.T)


def speed_covariances(found: "SpeedThrustMap") -> "tuple[Covariance, ...]":
    """Return the covariance of both forms of thrust over speed, which came from the same points."""
    import numpy as np

    from cfid.records.covariances import covariance_between

    moved = np.vstack([found.square.moved[:1], found.quadratic.moved])
    values = {
        "motor.thrust_per_speed_squared_n_s2": found.k_n_s2,
        "motor.thrust_speed_poly": found.quadratic.coefficients.tolist(),
    }
    return covariance_between(values, moved @ moved.T)


def voltage_covariances(found: "VoltageComparison") -> "tuple[Covariance, ...]":
    """Return the covariance of thrust over motor voltage, lowest power first."""
    from cfid.records.covariances import covariance_between

    values = {"motor.thrust_voltage_poly": found.lowest_first.tolist()}
    return covariance_between(values, found.by_voltage.covariance[::-1, ::-1])


def speed_parameters(found: "SpeedThrustMap") -> "dict[str, Parameter]":
    """Return thrust of speed as k w^2 and as full quadratic."""
    from cfid.records.parameters import Parameter

    quadratic = found.quadratic
    return {
        "motor.thrust_per_speed_squared_n_s2": Parameter(value=found.k_n_s2, std=found.k_std_n_s2, unit="N s^2/rad^2"),
        "motor.thrust_speed_poly": Parameter(
            value=quadratic.coefficients.tolist(), std=quadratic.std.tolist(), unit="N(rad/s)"
        ),
    }


def voltage_parameters(found: "VoltageComparison") -> "dict[str, Parameter]":
    """Return thrust of motor voltage, lowest power first as the firmware has it."""
    from cfid.records.parameters import Parameter

    return {
        "motor.thrust_voltage_poly": Parameter(
            value=found.lowest_first.tolist(), std=found.by_voltage.std[::-1].tolist(), unit="N(V)"
        )
    }


def polynomial_line(found: "MotorMap") -> str:
    """Return a map as the thesis writes it, with the norm of its residuals."""
    over = "thrust" if found.quantity == "torque" else "cmd"
    powers = range(found.fit.order, -1, -1)
    terms = [
        f"{value:+.7g}" + (f" {over}^{power}" if power > 1 else f" {over}" if power else "")
        for value, power in zip(found.fit.coefficients.tolist(), powers, strict=True)
    ]
    norm = f"norm of residuals {found.fit.residual_norm:.4g} {_Y[found.quantity]}"
    return f"{found.quantity} = {' '.join(terms)} ({norm}, {len(found.x)} points)"


def aicc_line(found: "MotorMap") -> list[str]:
    """Return how the order was chosen, nothing where it was given."""
    if not found.aicc:
        return []
    least = min(found.aicc.values())
    told = ", ".join(f"order {order}: {value - least:+.1f}" for order, value in found.aicc.items())
    return [f"corrected AIC above the best: {told}"]


def inverse_line(inverse: "InverseMap", most: "MaximumThrust") -> list[str]:
    """Return range and round trip of the inverse, and what can hover."""
    low, high = inverse.thrust_range_n
    return [
        f"command of thrust: from {low:.4g} to {high:.4g} N (commands {inverse.command_range[0]:.0f} to "
        f"{inverse.command_range[1]:.0f}), there and back within {inverse.round_trip_command:.2g} commands, "
        f"{1e3 * inverse.round_trip_n:.2g} mN by rounding",
        f"at most {most.thrust_n:.4g} N a motor, measured {most.measured_n:.4g} N at {most.measured_command:.0f}: four "
        f"motors hover {1e3 * most.hover_mass_kg:.4g} g",
    ]


def verification_lines(found: "Verification") -> list[str]:
    """Return how far a second instrument is from the map (figure 3.9)."""
    largest = max(abs(value) for value in found.difference_n.tolist())
    return [
        f"verification: {len(found.command)} readings, {1e3 * found.rms_n:.3g} mN rms ({found.rms_percent:.2g} %), at "
        f"most {1e3 * largest:.3g} mN from the map"
    ]


def joined_quality(found: "MotorMap", **more: Any) -> dict[str, Any]:
    """Return the figures that judge a map."""
    fit = found.fit
    return {
        "residual_norm": fit.residual_norm,
        "points": len(found.x),
        "degrees_of_freedom": fit.freedom,
        "inflation": fit.inflation,
        "left_out_commands": list(found.left_out),
        "aicc": {str(order): value for order, value in found.aicc.items()},
        **more,
    }


def unique(sentences: Sequence[str]) -> tuple[str, ...]:
    """Return sentences, each once, in their order; what is the same of several files, for all of them at once."""
    files: dict[str, list[str]] = {}
    for sentence in dict.fromkeys(sentences):
        name, colon, said = sentence.partition(": ")
        files.setdefault(said if colon else sentence, []).append(name if colon else "")
    return tuple(f"{_names(names)}{said}" for said, names in files.items())


def _names(names: Sequence[str]) -> str:
    if len(names) > _MOST_NAMES:
        return f"{names[0]} and {len(names) - 1} more: "
    return f"{', '.join(names)}: " if any(names) else ""
