"""A C header that replaces the Crazyflie firmware's defaults with measured numbers."""

from collections.abc import Iterator

from cfid.errors import DataError
from cfid.estimate.voltage_cubic import IDLE, cubic_fault, least_thrust_n
from cfid.export.hover import drag_n_s_per_m, inertia_kg_m2, moment_per_thrust_m, thrust_of_voltage
from cfid.export.target import Target, has
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import SLASHES, number
from cfid.quantities.values import ENTRIES


def write(vehicle: ExportVehicle) -> str:
    """Return the header, with a macro for each known quantity.

    Raises DataError when the thrust over motor voltage is not a cubic that the firmware can invert.
    """
    if "thrust_of_voltage" in vehicle and (fault := _fault(vehicle)):
        raise DataError(f"no header: {fault} Fit again with `cfid fit thrust`, which constrains the cubic.")
    lines = ["", "#pragma once", ""]
    for name, value, words in _macros(vehicle):
        lines += [f"#undef {name}", f"#define {name} {number(value)}f  // {words}"]
    return "\n".join(lines) + "\n"


def _macros(vehicle: ExportVehicle) -> Iterator[tuple[str, float, str]]:
    yield "CF_MASS", vehicle["mass"], "kg"
    if "arm" in vehicle:
        yield "ARM_LENGTH", vehicle["arm"], "m, from the centre to a motor, diagonally"
    if "torque_of_thrust" in vehicle:
        yield "THRUST2TORQUE", moment_per_thrust_m(vehicle), "m, slope of torque (N m) over thrust (N) at hovering"
    if "max_thrust" in vehicle:
        yield "THRUST_MAX", vehicle["max_thrust"], "N of one motor"
        yield "THRUST_MIN", _least_thrust_n(vehicle), "N of one motor: below it the firmware stops a motor"
    if "thrust_of_voltage" in vehicle:
        for power, coefficient in enumerate(thrust_of_voltage(vehicle)):
            yield f"VMOTOR2THRUST{power}", coefficient, f"N/V^{power} of one motor" if power else "N of one motor"
    if has(vehicle, "drag+thrust_per_speed_squared"):
        for axis, drag in zip("XYZ", drag_n_s_per_m(vehicle), strict=True):
            yield f"DRAG_B_{axis}", drag / vehicle["mass"], "1/s, drag over velocity and mass while hovering"
    if "inertia" in vehicle:
        matrix = inertia_kg_m2(vehicle)
        for name, (i, j) in sorted(ENTRIES.items()):
            yield f"CFID_INERTIA_{name.upper()}", matrix[i][j], "kg m^2"


def _fault(vehicle: ExportVehicle) -> str:
    """Return why the firmware cannot invert the map of thrust over voltage from its least thrust up, or ""."""
    known = vehicle.quantities.get("max_thrust")
    return cubic_fault(thrust_of_voltage(vehicle), max_thrust_n=known.value if known else None)


def _least_thrust_n(vehicle: ExportVehicle) -> float:
    most_n = float(vehicle["max_thrust"])
    return least_thrust_n(thrust_of_voltage(vehicle), most_n) if "thrust_of_voltage" in vehicle else IDLE * most_n


TARGET = Target(
    name="firmware",
    file_name="cfid_platform_defaults.h",
    about="Defaults for the Crazyflie firmware (2026.08)",
    comment=SLASHES,
    needs=("mass",),
    uses=(
        "arm",
        "inertia",
        "torque_of_thrust",
        "max_thrust",
        "thrust_of_voltage",
        "drag+thrust_per_speed_squared",
    ),
    notes=(
        "Copy this file to src/platform/interface/ of the firmware and add, as the last line of",
        "platform_defaults.h there,",
        '    #include "cfid_platform_defaults.h"',
        "Each macro then replaces the default of every platform, and of menuconfig's mass and largest thrust.",
        "Thrust and voltage are those of one motor; motor voltage is command/65535 times the battery's voltage.",
        "The cubic VMOTOR2THRUST rises over all voltages, as the firmware's inverse needs it. THRUST_MAX is the",
        "thrust at the full command with the battery as it was measured. A battery that is lower gives less: for",
        "the same thrust at every charge choose a smaller one. THRUST_MIN is no measurement: it is 7000/65535 of",
        "THRUST_MAX, as in the maps that the firmware ships, or the cubic's thrust at zero volts if that is more.",
        "DRAG_B is commented as N s/m in the firmware, but its estimator takes it as an acceleration over velocity",
        "(1/s). The firmware has no macro for the inertia: CFID_INERTIA_XX, _YY, _ZZ go",
        "into .J of controller_lee.c (or the parameters ctrlLee.J_x, J_y, J_z), all six into CRAZYFLIE_INERTIA of",
        "controller_brescianini.c.",
    ),
    write=write,
)
