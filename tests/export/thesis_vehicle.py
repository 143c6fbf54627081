"""The thesis' vehicle in the form of a campaign's results: the values of appendix A and of the thesis' text."""

import math
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from cfid.export.vehicle import ExportVehicle, collect
from cfid.quantities.registry import unit_of
from cfid.records.parameters import Parameter, Section, Source
from cfid.records.rig_file import thesis_rig
from tests.lab import values_of

MASS_KG = 0.028
INERTIA_KG_M2 = [  # about x (pitch), y (roll), z
    [16.571710e-6, 0.830806e-6, 0.718277e-6],
    [0.830806e-6, 16.655602e-6, 1.800197e-6],
    [0.718277e-6, 1.800197e-6, 29.261652e-6],
]
INERTIA_STD_KG_M2 = [[1e-8, 2e-8, 3e-8], [2e-8, 4e-8, 5e-8], [3e-8, 5e-8, 6e-8]]  # invented, with six different values
THRUST_POLY = [2.130295e-11, 1.032633e-6, 5.484560e-4]
SPEED_POLY = [0.04076521, 380.8359]
TORQUE_POLY = [0.005964552, 1.563383e-5]
DRAG_KG_PER_RAD = [-9.1785e-7, -9.1785e-7, -10.311e-7]
CROSS_KG_PER_RAD = [
    [-10.2506e-7, -0.3177e-7, -0.4332e-7],
    [-0.3177e-7, -10.2506e-7, -0.4332e-7],
    [-7.7050e-7, -7.7050e-7, -7.5530e-7],
]
TIME_CONSTANT_S = -0.002 / math.log(0.9695404)  # of H(z) at 500 samples per second
ARM_M = 0.046  # half of 92 mm (C.1.7)

# The thesis' maps of thrust and speed agree on k at one speed only; here this is the speed in hover.
HOVER_COMMAND = (
    -THRUST_POLY[1] + math.sqrt(THRUST_POLY[1] ** 2 - 4 * THRUST_POLY[0] * (THRUST_POLY[2] - MASS_KG * 9.81 / 4))
) / (2 * THRUST_POLY[0])
HOVER_SPEED_RAD_S = SPEED_POLY[0] * HOVER_COMMAND + SPEED_POLY[1]
K_N_S2 = MASS_KG * 9.81 / 4 / HOVER_SPEED_RAD_S**2
MAX_THRUST_N = (THRUST_POLY[0] * 65535 + THRUST_POLY[1]) * 65535 + THRUST_POLY[2]

# Not from the thesis, which measured neither voltage nor steps: round numbers, easy to recognise in exports.
VOLTAGE_POLY = [-0.01, 0.04, -0.02, 0.006]
RISING, FALLING = [7.0, 0.002], [3.0, 0.001]


# What flights show, along forward, left and up.
FLOWN = {
    "flight.inertia_kg_m2.roll": 1.6e-5, "flight.inertia_kg_m2.pitch": 1.7e-5, "flight.inertia_kg_m2.yaw": 2.9e-5,
    "flight.drag_kg_per_s.forward": -8e-3, "flight.drag_kg_per_s.left": -9e-3,
    "flight.moment_per_velocity_ns.roll": 6e-4, "flight.moment_per_velocity_ns.pitch": -8e-4,
    "rotor_inertia_kg_m2": 3e-8,
}  # fmt: skip


def section(parameters: Mapping[str, Any], *, rejected: str = "", run: str = "run_1") -> Section:
    """Return a section of parameters, each given as a value or as a Parameter."""
    return Section(
        method="thesis",
        found=datetime(2015, 8, 31, 12, 30, tzinfo=UTC),
        cfid_version="9.8.7",
        accepted=not rejected,
        sources=(Source(f"runs/{run}/loadcell.csv", "0" * 64), Source(f"runs/{run}", "0" * 64)),
        parameters={
            key: value if isinstance(value, Parameter) else Parameter(value=value, unit=unit_of(key))
            for key, value in parameters.items()
        },
        rejected=dict.fromkeys(parameters, rejected) if rejected else {},
    )


def sections() -> dict[str, Section]:
    """Return all sections that an export can use."""
    inertia = Parameter(value=INERTIA_KG_M2, std=INERTIA_STD_KG_M2, unit="kg m^2")
    root = {"coefficients": THRUST_POLY, "thrust_min_n": 0.001, "thrust_max_n": MAX_THRUST_N, "command_min": 435.0}
    return {
        "inertia": section({"inertia.matrix_kg_m2": inertia}, run="2026-11-21_083012_swing_x"),
        "thrust": section(
            {
                "motor.thrust_poly": THRUST_POLY,
                "motor.command_of_thrust": [root],
                "motor.max_thrust_n": Parameter(value=MAX_THRUST_N, std=0.0012, unit="N"),
                "motor.thrust_per_speed_squared_n_s2": K_N_S2,
                "motor.thrust_speed_poly": [K_N_S2, 0.0, 0.0],
                "motor.thrust_voltage_poly": VOLTAGE_POLY,
            }
        ),
        "speed": section({"motor.speed_poly": SPEED_POLY}),
        "torque": section({"motor.torque_poly": TORQUE_POLY}),
        "dynamics": section({"dynamics.rising": RISING, "dynamics.falling": FALLING}),
        "tf identify": section({"tf.time_constant_s": TIME_CONSTANT_S}),
        "drag": section(
            {"drag.simple_kg_per_rad": DRAG_KG_PER_RAD, "drag.cross_coupling_kg_per_rad": CROSS_KG_PER_RAD}
        ),
        "set": section({"arm_m": Parameter(value=ARM_M, std=1e-4, unit="m")}),
    }


def flown_sections() -> dict[str, Section]:
    """Return the sections of a campaign with a flight, and without swings and wind."""
    parameters = {key: Parameter(value=v, std=0.01 * abs(v), unit=unit_of(key)) for key, v in FLOWN.items()}
    rest = {name: found for name, found in sections().items() if name not in ("inertia", "drag")}
    return rest | {"flight": section(parameters)}


def vehicle(*without: str, frame: Mapping[str, str] | None = None, rejected: str = "") -> ExportVehicle:
    """Return the thesis' vehicle, optionally without some parameters, in another frame or with a rejected section."""
    rig = thesis_rig()
    if frame is not None:
        body = rig.vehicle.model_copy(update={"body_frame": rig.vehicle.body_frame.model_validate(dict(frame))})
        rig = rig.model_copy(update={"vehicle": body})
    if "arm_m" in without:
        rig = rig.model_copy(update={"loadcell": rig.loadcell.model_copy(update={"arm_mm": None})})
    kept = {
        name: replace(
            found,
            accepted=name != rejected,
            rejected=dict.fromkeys(found.parameters, "too little.") if name == rejected else {},
            parameters={key: p for key, p in found.parameters.items() if key not in without},
        )
        for name, found in sections().items()
    }
    return collect(rig, values_of(kept), campaign="thesis")


def with_value(known: ExportVehicle, key: str, value: Any) -> ExportVehicle:
    """Return a vehicle with another value of one quantity, or with a quantity that it lacks."""
    quantity = known.find(key)
    if quantity is None:
        quantity = replace(known.quantities["arm_m"], key=key, unit=unit_of(key), std=None)
    return replace(known, quantities={**known.quantities, quantity.key: replace(quantity, value=value)})
