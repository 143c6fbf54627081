"""An SDF block for Gazebo: inertia and the four motors of its MulticopterMotorModel; speeds are in rad/s."""

from cfid.export.hover import YAW_SIGNS, drag_kg_per_rad, inertia_kg_m2, lags_s, moment_per_thrust_m, most_speed_rad_s
from cfid.export.target import Target
from cfid.export.vehicle import Vehicle
from cfid.export.wording import XML, number

_ENTRIES = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
_PLUGIN = "gz-sim-multicopter-motor-model-system"


def write(vehicle: Vehicle) -> str:
    """Return the block."""
    matrix = inertia_kg_m2(vehicle)
    entries = "".join(f"        <{name}>{number(matrix[i][j])}</{name}>\n" for name, (i, j) in _ENTRIES.items())
    return f"""<model name="crazyflie">
  <link name="crazyflie/body">
    <inertial>
      <mass>{number(vehicle["mass"])}</mass>
      <inertia>
{entries}      </inertia>
    </inertial>
  </link>
{"".join(_motor(vehicle, i, sign) for i, sign in enumerate(YAW_SIGNS))}</model>
"""


def _motor(vehicle: Vehicle, motor: int, yaw_sign: int) -> str:
    up, down = lags_s(vehicle)
    ahead, left, _ = drag_kg_per_rad(vehicle) if "drag" in vehicle else (0.0, 0.0, 0.0)
    fields = {
        "maxRotVelocity": most_speed_rad_s(vehicle),
        "motorConstant": vehicle["thrust_per_speed_squared"],
        "momentConstant": moment_per_thrust_m(vehicle),
        "rotorDragCoefficient": (ahead + left) / 2,
        "rollingMomentCoefficient": 0.0,
        "timeConstantUp": up,
        "timeConstantDown": down,
    }
    return f"""  <plugin filename="{_PLUGIN}" name="gz::sim::systems::MulticopterMotorModel">
    <robotNamespace>crazyflie</robotNamespace>
    <jointName>crazyflie/m{motor + 1}_joint</jointName>
    <linkName>crazyflie/m{motor + 1}_prop</linkName>
    <turningDirection>{"ccw" if yaw_sign < 0 else "cw"}</turningDirection>
    <motorNumber>{motor}</motorNumber>
    <motorType>velocity</motorType>
{"".join(f"    <{name}>{number(value)}</{name}>" + chr(10) for name, value in fields.items())}  </plugin>
"""


TARGET = Target(
    name="gazebo",
    file_name="crazyflie_gazebo.sdf",
    about="Inertia and motor block for Gazebo",
    comment=XML,
    needs=(
        "mass",
        "inertia",
        "thrust_per_speed_squared",
        "torque_of_thrust",
        "speed_of_command",
        "rising+falling|thrust_lag",
    ),
    uses=("drag",),
    notes=(
        "Put the children of <model> over those of your model; names of links and joints are those of Bitcraze's",
        "model. Mass and inertia are the whole vehicle's: links of rotors have to be next to weightless beside",
        "them. maxRotVelocity: rad/s (not rpm). motorConstant: N/(rad/s)^2 of one rotor. momentConstant: m (N m/N),",
        "not N m/rpm^2. rotorDragCoefficient: kg/rad over one rotor's speed and its velocity across the axis, mean",
        "of forward and left; zero means not measured, for Gazebo would take 1e-4. Drag along the axis has no place",
        "here. rollingMomentCoefficient: NOT MEASURED, zero switches it off, for Gazebo would take 1e-6.",
        "timeConstantUp, timeConstantDown: s, of rotor speeds around hovering.",
    ),
    write=write,
)
