"""Firmware parameters for a robot type of Crazyswarm2's crazyflies.yaml."""

from cfid.export.hover import inertia_kg_m2
from cfid.export.target import Target
from cfid.export.vehicle import Vehicle
from cfid.export.wording import HASH, identifier, number


def write(vehicle: Vehicle) -> str:
    """Return the robot type; it sets what is measured and nothing else."""
    matrix = inertia_kg_m2(vehicle)
    moments = "".join(f"        J_{axis}: {number(matrix[i][i])}  # kg m^2\n" for i, axis in enumerate("xyz"))
    return f"""
robot_types:
  {identifier(vehicle.name)}:
    firmware_params:
      ctrlMel:
        mass: {number(vehicle["mass"])}  # kg
      ctrlLee:
        mass: {number(vehicle["mass"])}  # kg
{moments}"""


TARGET = Target(
    name="crazyswarm2",
    file_name="crazyflies.yaml",
    about="Firmware parameters for Crazyswarm2",
    comment=HASH,
    needs=("mass", "inertia"),
    notes=(
        "Merge firmware_params into a robot type of crazyflies.yaml. The controllers take the diagonal of the",
        "inertia alone. Arm, torque over thrust and thrust curves stand in the firmware: `cfid export firmware`.",
        "The simulator's own numbers (mass, J, arm_length diagonally in m, t2t in m) stand in the source of its",
        "backends.",
    ),
    write=write,
)
