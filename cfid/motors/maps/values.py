"""Motor maps as quantities of the contract, with covariances, lines and figures of merit."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from cfid.counted import counted
from cfid.estimate.polynomials import PointFit, PolynomialFit, joint_covariance
from cfid.findings import Finding, note
from cfid.motors.maps.estimation import MotorMap, SpeedThrustMap
from cfid.motors.maps.inverse import InverseMap, MaximumThrust
from cfid.motors.maps.scales import ScalesCheck
from cfid.motors.maps.voltage import VoltageComparison
from cfid.motors.points import MotorPoints, motor_table
from cfid.records.covariances import Covariance, covariance_between
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent
from cfid.units import FULL_COMMAND, ROTORS

Array = npt.NDArray[np.float64]

_Y = {"thrust": "N", "speed": "rad/s", "torque": "Nm"}


class _Part(NamedTuple):
    """A fit, the parameters that it gives, and how these follow from its coefficients."""

    fit: PointFit
    values: dict[str, Any]
    outward: Array
    own: Array | None = None  # covariance in addition to the fit's


def map_parameters(found: MotorMap) -> dict[str, Parameter]:
    """Return a map's polynomial, highest power first."""

    value, std = found.fit.coefficients.tolist(), found.fit.std.tolist()
    return {f"motor.{found.quantity}_poly": Parameter(value=value, std=std)}


def table_parameter(points: MotorPoints) -> dict[str, Parameter]:
    """Return everything that was measured at each command."""

    rows = [row._asdict() for row in motor_table(points)]
    return {"motor.table": Parameter(value=rows)}


def inverse_parameters(inverse: InverseMap) -> dict[str, Parameter]:
    """Return the inverse of the thrust map."""

    root = {
        "coefficients": inverse.coefficients.tolist(),
        "command_min": inverse.command_range[0],
        "command_max": inverse.command_range[1],
        "thrust_min_n": inverse.thrust_range_n[0],
        "thrust_max_n": inverse.thrust_range_n[1],
        "round_trip_command": inverse.round_trip_command,
        "round_trip_n": inverse.round_trip_n,
    }
    return {"motor.command_of_thrust": Parameter(value=[root])}


def maximum_parameters(most: MaximumThrust) -> dict[str, Parameter]:
    """Return the check of the map in section 3.3.1."""
    return {
        "motor.max_thrust_n": Parameter(value=most.thrust_n, std=most.std_n),
        "motor.hover_mass_kg": Parameter(value=most.hover_mass_kg, std=most.hover_mass_std_kg),
    }


def covariances(
    found: MotorMap | None = None,
    *,
    most: MaximumThrust | None = None,
    voltage: VoltageComparison | None = None,
    over_speed: SpeedThrustMap | None = None,
) -> tuple[Covariance, ...]:
    """Return the covariance of maps fitted to the same points, and of the numbers calculated from them.

    A rejected voltage cubic is kept apart, so that it can be removed alone.
    """
    together = [*([_of_map(found, most)] if found else []), *(_of_speed(over_speed) if over_speed else ())]
    if most is not None and most.by_volts is not None and voltage is not None:
        together.append(_of_maximum(most, most.by_volts, voltage))
    cubic = [_of_voltage(voltage)] if voltage else []
    if voltage is not None and voltage.rejected:
        return (*_joint(together), *_joint(cubic))
    return _joint([*together, *cubic])


def _joint(parts: Sequence[_Part]) -> tuple[Covariance, ...]:
    """Return the joint covariance of several fits, those whose own covariance is known."""
    known = [part for part in parts if np.isfinite(part.fit.fit.covariance).all()]
    if not known:
        return ()
    outward = block_diag(*(part.outward for part in known))
    values = {key: value for part in known for key, value in part.values.items()}
    own = block_diag(*(np.zeros((len(part.outward),) * 2) if part.own is None else part.own for part in known))
    return covariance_between(values, outward @ joint_covariance([part.fit for part in known]) @ outward.T + own)


def _of_map(found: MotorMap, most: MaximumThrust | None) -> _Part:
    values: dict[str, Any] = {f"motor.{found.quantity}_poly": found.fit.coefficients.tolist()}
    outward, own = np.eye(found.fit.order + 1), np.zeros((found.fit.order + 1,) * 2)
    if most is not None and most.by_volts is None:
        values |= _maximum(most)
        outward = np.vstack([outward, _to_maximum(most, found.fit.order, float(FULL_COMMAND))])
        own = block_diag(own, _beyond(most))
    return _Part(PointFit(found.fit, found.windows), values, outward, own)


def _of_maximum(most: MaximumThrust, fit: PolynomialFit, voltage: VoltageComparison) -> _Part:
    outward = _to_maximum(most, fit.order, most.volts or 0.0)
    return _Part(PointFit(fit, _windows(voltage)), _maximum(most), outward, _beyond(most))


def _maximum(most: MaximumThrust) -> dict[str, Any]:
    return {"motor.max_thrust_n": most.thrust_n, "motor.hover_mass_kg": most.hover_mass_kg}


def _to_maximum(most: MaximumThrust, order: int, at: float) -> Array:
    """Return how largest thrust and mass follow from a polynomial (2, order + 1) `at` a command or voltage."""
    full = np.vander([at], order + 1)
    return np.vstack([full, full * most.hover_mass_kg / most.thrust_n])


def _beyond(most: MaximumThrust) -> Array:
    """Return the covariance (2, 2) of largest thrust and mass from what is not the polynomial's own."""
    both = np.array([1.0, most.hover_mass_kg / most.thrust_n])
    return np.asarray(most.beyond_std_n**2 * np.outer(both, both))


def _windows(found: VoltageComparison) -> Array:
    return np.eye(len(found.used))[found.used]


def _of_voltage(found: VoltageComparison) -> _Part:
    values = {"motor.thrust_voltage_poly": found.lowest_first.tolist()}
    return _Part(PointFit(found.by_voltage, _windows(found)), values, np.eye(len(found.lowest_first))[::-1])


def _of_speed(found: SpeedThrustMap) -> tuple[_Part, _Part]:
    square, quadratic = (PointFit(fit, found.windows) for fit in (found.square, found.quadratic))
    return (
        _Part(square, {"motor.thrust_per_speed_squared_n_s2": found.k_n_s2}, np.eye(3)[:1]),
        _Part(quadratic, {"motor.thrust_speed_poly": found.quadratic.coefficients.tolist()}, np.eye(3)),
    )


def speed_parameters(found: SpeedThrustMap) -> dict[str, Parameter]:
    """Return thrust over speed as k w^2 and as a full quadratic."""

    quadratic = found.quadratic
    return {
        "motor.thrust_per_speed_squared_n_s2": Parameter(value=found.k_n_s2, std=found.k_std_n_s2),
        "motor.thrust_speed_poly": Parameter(value=quadratic.coefficients.tolist(), std=quadratic.std.tolist()),
    }


def voltage_parameters(found: VoltageComparison) -> dict[str, Parameter]:
    """Return thrust over motor voltage, lowest power first, as in the firmware."""

    return {
        "motor.thrust_voltage_poly": Parameter(
            value=found.lowest_first.tolist(), std=found.by_voltage.std[::-1].tolist()
        )
    }


def map_lines(found: MotorMap) -> list[Dependent]:
    """Return lines with a map as the thesis writes it, and with how its order was chosen."""
    lines = [_polynomial_line(found), *_aicc_line(found)]
    return [Dependent(line, f"motor.{found.quantity}_poly") for line in lines]


def _polynomial_line(found: MotorMap) -> str:
    over = "thrust" if found.quantity == "torque" else "cmd"
    powers = range(found.fit.order, -1, -1)
    terms = [
        f"{value:+.7g}" + (f" {over}^{power}" if power > 1 else f" {over}" if power else "")
        for value, power in zip(found.fit.coefficients.tolist(), powers, strict=True)
    ]
    norm = f"norm of residuals {found.fit.residual_norm:.4g} {_Y[found.quantity]}"
    return f"{found.quantity} = {' '.join(terms)} ({norm}, {counted(len(found.x), 'point')})"


def _aicc_line(found: MotorMap) -> list[str]:
    if not found.aicc:
        return []
    least = min(found.aicc.values())
    orders = ", ".join(f"order {order}: {value - least:+.1f}" for order, value in found.aicc.items())
    return [f"corrected AIC above the best: {orders}"]


def inverse_lines(inverse: InverseMap) -> list[Dependent]:
    """Return a line with range and round trip of the inverse."""
    low, high = (_plain(1e3 * thrust_n) for thrust_n in inverse.thrust_range_n)
    line = (
        f"command of thrust: from {low} to {high} mN (commands {inverse.command_range[0]:.0f} to "
        f"{inverse.command_range[1]:.0f}), there and back within {inverse.round_trip_command:.2g} commands, "
        f"{1e3 * inverse.round_trip_n:.2g} mN by rounding"
    )
    return [Dependent(line, "motor.thrust_poly", "motor.command_of_thrust")]


def fewer_motors(most: MaximumThrust, voltage: VoltageComparison | None, *, motors: float) -> tuple[Finding, ...]:
    """Return a note where no voltage shows to what four motors lower the one that fewer `motors` had."""
    if motors >= ROTORS or most.volts is not None or (voltage and voltage.better == "command"):
        return ()
    text = (
        f"thrust at full command and hover mass hold at the voltage under {counted(round(motors), 'motor')}: four lower"
        " a battery's further, and hover up to a fifth less. Log the battery's voltage (pm.vbat)."
    )
    return (note("maximum-of-fewer-motors", text, "motor.max_thrust_n", "motor.hover_mass_kg"),)


def maximum_lines(most: MaximumThrust) -> list[Dependent]:
    """Return a line on the mass that can hover, and on the battery's voltage for that."""
    at = "" if most.volts is None else f" at {most.volts:.2f} V, to which the battery sags under four"
    line = (
        f"at most {_plain(1e3 * most.thrust_n)} mN a motor{at}, measured {_plain(1e3 * most.measured_n)} mN at "
        f"{most.measured_command:.0f}: four motors hover {_plain(1e3 * most.hover_mass_kg)} g"
    )
    return [Dependent(line, "motor.thrust_poly", "motor.max_thrust_n", "motor.hover_mass_kg")]


def verification_merits(found: ScalesCheck | None) -> dict[str, Dependent]:
    """Return the figures of the comparison with a second instrument, None where there was none."""
    names = ("rms_n", "rms_percent", "gain", "gain_std")
    return {f"verification_{name}": Dependent(getattr(found, name, None), "motor.thrust_poly") for name in names}


def verification_lines(found: ScalesCheck) -> list[Dependent]:
    """Return a line on how far a second instrument is from the map (figure 3.9)."""
    largest = max(abs(value) for value in found.difference_n.tolist())
    line = (
        f"verification: {counted(len(found.command), 'reading')}, {1e3 * found.rms_n:.3g} mN rms "
        f"({_percent(found.rms_percent)}), at "
        f"most {1e3 * largest:.3g} mN from the map"
    )
    return [Dependent(line, "motor.thrust_poly")]


def figures_of_merit(found: MotorMap, **more: Any) -> dict[str, Any]:
    """Return the figures that judge a map."""
    fit = found.fit
    return {
        "residual_norm": fit.residual_norm,
        "points": len(found.x),
        "degrees_of_freedom": fit.degrees_of_freedom,
        "inflation": fit.inflation,
        "left_out_commands": list(found.left_out),
        "aicc": {str(order): value for order, value in found.aicc.items()},
        **more,
    }


def _percent(value: float) -> str:
    return f"{value:.2g} %" if value < 10 else f"{value:.0f} %"  # 100 % is not 1e+02 %


def _plain(value: float) -> str:
    """Return a number with four digits and no exponent: a large motor's thrust is 20340 mN, not 2e+04."""
    return np.format_float_positional(value, precision=4, fractional=False, trim="-")
