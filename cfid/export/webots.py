"""A complete PROTO of a Crazyflie for Webots; speeds are in rad/s."""

from cfid.export.hover import (
    YAW_SIGNS,
    drag_kg_per_rad,
    inertia_kg_m2,
    middle_m,
    moment_per_speed_squared_nm_s2,
    most_speed_rad_s,
    rotor_places_m,
)
from cfid.export.target import Target
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import HASH, number, numbers


def write(vehicle: ExportVehicle) -> str:
    """Return the PROTO file."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia_kg_m2(vehicle)
    return f"""#VRML_SIM R2023b utf8

PROTO Crazyflie [
  field SFVec3f    translation     0 0 0.015
  field SFRotation rotation        0 0 1 0
  field SFString   name            "Crazyflie"
  field SFString   controller      "<generic>"
  field MFString   controllerArgs  []
  field SFString   customData      ""
  field SFBool     supervisor      FALSE
  field SFBool     synchronization TRUE
  field MFNode     extensionSlot   []
]
{{
  Robot {{
    translation IS translation
    rotation IS rotation
    name IS name
    controller IS controller
    controllerArgs IS controllerArgs
    customData IS customData
    supervisor IS supervisor
    synchronization IS synchronization
    model "Crazyflie"
    children [
      Group {{
        children IS extensionSlot
      }}
      GPS {{
      }}
      Gyro {{
      }}
      Accelerometer {{
      }}
      InertialUnit {{
        name "inertial_unit"
      }}
      DEF HULL Pose {{
        translation {numbers(middle_m(vehicle), " ")}
        children [
          Shape {{
            appearance PBRAppearance {{
            }}
            geometry DEF CYLINDER Cylinder {{
              height 0.025
              radius {number(vehicle["arm"])}
            }}
          }}
        ]
      }}
{"".join(_propeller(vehicle, motor) for motor in range(4))}\
    ]
    boundingObject Pose {{
      translation {numbers(middle_m(vehicle), " ")}
      children [
        USE CYLINDER
      ]
    }}
    physics Physics {{
      density -1
      mass {number(vehicle["mass"])}
      centerOfMass [
        0 0 0
      ]
      inertiaMatrix [
        {numbers((xx, yy, zz), " ")}
        {numbers((xy, xz, yz), " ")}
      ]
    }}
  }}
}}
"""


def _propeller(vehicle: ExportVehicle, motor: int) -> str:
    """Return a motor; Webots turns the vehicle against a positive torque, and thrust has the sign of the speed."""
    thrust = -YAW_SIGNS[motor] * float(vehicle["thrust_per_speed_squared"])
    along = drag_kg_per_rad(vehicle)[2] if "drag" in vehicle else 0.0
    return f"""      Propeller {{
        shaftAxis 0 0 1
        centerOfThrust {numbers(rotor_places_m(vehicle)[motor], " ")}
        thrustConstants {number(thrust)} {number(along)}
        torqueConstants {number(moment_per_speed_squared_nm_s2(vehicle))} 0
        device RotationalMotor {{
          name "m{motor + 1}_motor"
          maxVelocity {number(most_speed_rad_s(vehicle))}
          maxTorque 1
        }}
      }}
"""


TARGET = Target(
    name="webots",
    file_name="Crazyflie.proto",
    about="PROTO for Webots (R2023b)",
    comment=HASH,
    needs=("mass", "inertia", "arm", "thrust_per_speed_squared", "torque_of_thrust", "speed_of_command"),
    uses=("drag",),
    no_place=(
        "thrust_of_command",
        "thrust_range",
        "max_thrust",
        "thrust_of_voltage",
        "thrust_of_speed",
        "rising",
        "falling",
        "thrust_lag",
        "delay",
        "rotor_inertia",
        "rotor_radius",
    ),
    notes=(
        "A complete PROTO: put it into the protos folder of a project. A controller sets each motor's position to",
        "infinity and its velocity in rad/s: m1_motor and m3_motor positive, m2_motor and m4_motor negative, as the",
        "rotors turn. Bitcraze's own model takes speeds in a unit of its own and turns the other way: its controllers",
        "do not fly this one unchanged. thrustConstants: N/(rad/s)^2 and drag along the axis, kg/rad; torqueConstants:",
        "N m/(rad/s)^2. inertiaMatrix: xx yy zz, then xy xz yz. Rotors follow their commands at once, and drag across",
        "the rotors' axes has no place. The cylinder is there to be seen and to touch the floor.",
    ),
    write=write,
)
