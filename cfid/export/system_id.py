"""The parameter file of the system identification in the Crazyflie firmware; speeds are in rpm."""

from collections.abc import Iterator, Sequence

from cfid.errors import DataError
from cfid.estimate.voltage_cubic import least_thrust_n
from cfid.export.crazyflow import rotor_coefficients, rpm_to_thrust, rpm_to_torque
from cfid.export.hover import (
    has_lag,
    hover_speed_rad_s,
    hover_thrust_n,
    lags_s,
    moment_per_thrust_m,
    slope_of,
    thrust_of_voltage,
    value_of,
)
from cfid.export.target import Target
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import HASH, number, numbers
from cfid.units import RPM


def write(vehicle: ExportVehicle) -> str:
    """Return the file of known quantities, with the names and the order that the identification writes.

    Raises DataError when the thrust over motor voltage is not a cubic, or does not reach THRUST_MAX.
    """
    cubic = thrust_of_voltage(vehicle)
    return "\n" + "".join(f"{name} = {value}  # {words}\n" for name, value, words in _entries(vehicle, cubic))


def _entries(vehicle: ExportVehicle, cubic: Sequence[float]) -> Iterator[tuple[str, str, str]]:
    most = float(vehicle["max_thrust"])
    least = least_thrust_n(cubic, most)
    yield "vmotor2thrust", f"[{numbers(cubic)}]", "N of one motor, power 0 to 3 of its voltage"
    yield "THRUST_MIN", number(least), "N of one motor, not measured: 7000/65535 of THRUST_MAX, or more at 0 V"
    yield "THRUST_MAX", number(most), "N of one motor at the full command, battery as it was measured"
    yield "VMOTOR_MIN", number(_voltage_of(cubic, least)), "V at THRUST_MIN"
    yield "VMOTOR_MAX", number(_voltage_of(cubic, most)), "V at THRUST_MAX"
    if "thrust_per_speed_squared" in vehicle:
        yield (
            "vmotor2rpm",
            f"[{numbers(_voltage_to_rpm(vehicle, cubic))}]",
            "rpm, power 0 and 1 of V: the tangent at hovering",
        )
        yield "rpm2thrust", f"[{numbers(rpm_to_thrust(vehicle))}]", "N of one motor, power 0 to 2 of rpm"
        if "torque_of_thrust" in vehicle:
            yield "rpm2torque", f"[{numbers(rpm_to_torque(vehicle))}]", "N m of one motor, power 0 to 2 of rpm"
    if "torque_of_thrust" in vehicle:
        slope = moment_per_thrust_m(vehicle)
        offset = value_of(vehicle["torque_of_thrust"], hover_thrust_n(vehicle)) - slope * hover_thrust_n(vehicle)
        torques = [offset + slope * cubic[0], *(slope * coefficient for coefficient in cubic[1:])]
        yield "vmotor2torque", f"[{numbers(torques)}]", "N m of one motor, power 0 to 3 of its voltage"
        yield "thrust2torque", number(slope), "m, slope of torque over thrust at hovering"
    if "rising" in vehicle and "falling" in vehicle:
        words = "rising 1/s, 1/(rpm s), falling 1/s, 1/(rpm s)"
        yield "rpm_coef", f"[{numbers(rotor_coefficients(vehicle))}]", words
    if has_lag(vehicle):
        yield "rpm_coef_simple", number(2 / sum(lags_s(vehicle))), "1/s, of speed behind its command, around hovering"
        yield "thrust_coef", number(_thrust_lag(vehicle)), "1/s, of thrust behind its command"


def _thrust_lag(vehicle: ExportVehicle) -> float:
    """Return the rate of the thrust lag in 1/s; for small changes, thrust lags as its rotor does."""
    return 1 / vehicle["thrust_lag"] if "thrust_lag" in vehicle else 2 / sum(lags_s(vehicle))


def _voltage_of(cubic: Sequence[float], thrust_n: float) -> float:
    """Return the motor voltage that gives a thrust.

    Raises DataError when no voltage up to 5 V gives this thrust.
    """
    poly = list(reversed(cubic))
    low, high = 0.0, 5.0
    if not value_of(poly, low) <= thrust_n <= value_of(poly, high):
        raise DataError(f"motor.thrust_voltage_poly gives {thrust_n:.4g} N at no voltage from 0 to 5 V.")
    while high - low > 1e-9:
        middle = (low + high) / 2
        low, high = (middle, high) if value_of(poly, middle) < thrust_n else (low, middle)
    return (low + high) / 2


def _voltage_to_rpm(vehicle: ExportVehicle, cubic: Sequence[float]) -> tuple[float, float]:
    """Return rpm over motor voltage, lowest power first, from thrust over voltage and thrust as k omega^2."""
    voltage, speed = _voltage_of(cubic, hover_thrust_n(vehicle)), hover_speed_rad_s(vehicle)
    slope = slope_of(list(reversed(cubic)), voltage) / (2 * vehicle["thrust_per_speed_squared"] * speed)
    return (speed - slope * voltage) / RPM, slope / RPM


TARGET = Target(
    name="system-id",
    file_name="parameters_cfid.toml",
    about="Parameters as the firmware's tools/system_id writes them",
    comment=HASH,
    directional=False,
    needs=("mass", "thrust_of_voltage", "max_thrust"),
    uses=("thrust_per_speed_squared", "thrust_of_speed", "torque_of_thrust", "rising+falling", "thrust_lag"),
    no_place=(
        "inertia", "arm", "thrust_of_command", "thrust_range", "speed_of_command", "drag", "delay", "rotor_inertia",
        "rotor_radius",
    ),
    notes=(
        "A complete file: beside system_id.py it serves `--comb cfid` in the modes static_verification and dynamic.",
        "Speeds are in rpm, polynomials have the lowest power first, everything is that of one motor. There",
        "thrust2torque is a line through zero, here the slope at hovering: what differs is the torque at rest.",
    ),
    write=write,
)  # fmt: skip
