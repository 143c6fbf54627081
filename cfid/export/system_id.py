"""The parameter file of the system identification that comes with the Crazyflie firmware; speeds are in rpm."""

from collections.abc import Iterator, Sequence

from cfid.export.crazyflow import rotor_coefficients, rpm_to_thrust, rpm_to_torque
from cfid.export.hover import moment_per_thrust_m, thrust_of_voltage
from cfid.export.target import Target
from cfid.export.vehicle import Vehicle
from cfid.export.wording import HASH, number, numbers


def write(vehicle: Vehicle) -> str:
    """Return the file: what is known, in the names and orders that the identification writes.

    Raises DataError when the thrust over motor voltage is no cubic.
    """
    cubic = thrust_of_voltage(vehicle)
    return "\n" + "".join(f"{name} = {value}  # {words}\n" for name, value, words in _entries(vehicle, cubic))


def _entries(vehicle: Vehicle, cubic: Sequence[float]) -> Iterator[tuple[str, str, str]]:
    yield "vmotor2thrust", f"[{numbers(cubic)}]", "N of one motor, power 0 to 3 of its voltage"
    yield "THRUST_MAX", number(vehicle["max_thrust"]), "N of one motor at the full command, battery as it was measured"
    if "thrust_per_speed_squared" in vehicle:
        yield "rpm2thrust", f"[{numbers(rpm_to_thrust(vehicle))}]", "N of one motor, power 0 to 2 of rpm"
        if "torque_of_thrust" in vehicle:
            yield "rpm2torque", f"[{numbers(rpm_to_torque(vehicle))}]", "N m of one motor, power 0 to 2 of rpm"
    if "torque_of_thrust" in vehicle:
        yield "thrust2torque", number(moment_per_thrust_m(vehicle)), "m, slope of torque over thrust at hovering"
    if "rising" in vehicle and "falling" in vehicle:
        words = "rising 1/s, 1/(rpm s), falling 1/s, 1/(rpm s)"
        yield "rpm_coef", f"[{numbers(rotor_coefficients(vehicle))}]", words
    if "thrust_lag" in vehicle:
        yield "thrust_coef", number(1 / vehicle["thrust_lag"]), "1/s, of thrust behind its command"


TARGET = Target(
    name="system-id",
    file_name="parameters_cfid.toml",
    about="Parameters as the firmware's tools/system_id writes them",
    comment=HASH,
    directional=False,
    needs=("mass", "thrust_of_voltage", "max_thrust"),
    uses=("thrust_per_speed_squared", "thrust_of_speed", "torque_of_thrust", "rising+falling", "thrust_lag"),
    notes=(
        "Speeds are in rpm, polynomials have the lowest power first, everything is that of one motor. There",
        "thrust2torque is a line through zero, here the slope at hovering: what differs is the torque at rest.",
        "THRUST_MIN, VMOTOR_MIN and VMOTOR_MAX are choices of that tool and no measurements: they are left out.",
    ),
    write=write,
)
