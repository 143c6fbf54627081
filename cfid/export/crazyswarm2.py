"""Crazyswarm2's crazyflies.yaml with one vehicle and the firmware parameters of its type."""

from cfid.export.hover import inertia_kg_m2
from cfid.export.target import Target
from cfid.export.vehicle import SOURCES, ExportVehicle
from cfid.export.wording import HASH, identifier, number


def write(vehicle: ExportVehicle) -> str:
    """Return the file."""
    matrix = inertia_kg_m2(vehicle)
    kind = identifier(vehicle.name)
    moments = "".join(f"        J_{axis}: {number(matrix[i][i])}  # kg m^2\n" for i, axis in enumerate("xyz"))
    return f"""
fileversion: 3

robots:
  cf1:
    enabled: true
    uri: radio://0/80/2M/E7E7E7E7E7  # the address it left the factory with
    initial_position: [0.0, 0.0, 0.0]
    type: {kind}

robot_types:
  {kind}:
    motion_capture:
      tracking: "librigidbodytracker"
      marker: default_single_marker
      dynamics: default
    big_quad: false
    battery:
      voltage_warning: 3.8  # V
      voltage_critical: 3.7  # V
    firmware_params:
      ctrlMel:
        mass: {number(vehicle["mass"])}  # kg
      ctrlLee:
        mass: {number(vehicle["mass"])}  # kg
{moments}
all:
  firmware_logging:
    enabled: true
    default_topics:
      pose:
        frequency: 10  # Hz
      status:
        frequency: 1  # Hz
  firmware_params:
    commander:
      enHighLevel: 1
    stabilizer:
      estimator: 2  # Kalman
      controller: 2  # Mellinger
    locSrv:
      extPosStdDev: 1.0e-3
      extQuatStdDev: 0.5e-1
  reference_frame: "world"
  broadcasts:
    num_repeats: 15
    delay_between_repeats_ms: 1
"""


TARGET = Target(
    name="crazyswarm2",
    file_name="crazyflies.yaml",
    about="Robots and firmware parameters for Crazyswarm2",
    comment=HASH,
    needs=("mass", "inertia"),
    no_place=tuple(name for name in SOURCES if name not in {"mass", "inertia"}),
    notes=(
        "A complete file for one vehicle: put it into the config folder of Crazyswarm2 and set its uri. Only ctrlMel",
        "and ctrlLee are measured; all else is as Crazyswarm2 has it. The controllers take the diagonal of the inertia",
        "alone. Arm, torque over thrust and thrust curves stand in the firmware: `cfid export firmware`. The",
        "simulator's own numbers stand in the source of its backends.",
    ),
    write=write,
)
