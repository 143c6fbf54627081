"""A complete SDF model for Gazebo, with four motors of type MulticopterMotorModel; speeds are in rad/s."""

from cfid.export import sdf
from cfid.export.target import Target
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import XML

_NAME = "crazyflie"
_BODY = f"{_NAME}/body"
_TOPIC = f"""<robotNamespace>{_NAME}</robotNamespace>
      <commandSubTopic>gazebo/command/motor_speed</commandSubTopic>"""


def write(vehicle: ExportVehicle) -> str:
    """Return the model file."""
    rotors = "".join(sdf.rotor(vehicle, motor, body_name=_BODY, link=_link(motor), joint=_joint(motor)) for motor in _M)
    motors = "".join(
        sdf.motor_model(vehicle, motor, number_=motor, link=_link(motor), joint=_joint(motor), topic=_TOPIC)
        for motor in _M
    )
    return f"""<?xml version="1.0"?>
<sdf version="1.9">
  <model name="{_NAME}">
    <pose>0 0 0.02 0 0 0</pose>
{sdf.body(vehicle, _BODY)}{rotors}{motors}\
    <plugin filename="gz-sim-odometry-publisher-system" name="gz::sim::systems::OdometryPublisher">
      <dimensions>3</dimensions>
      <robot_base_frame>{_BODY}</robot_base_frame>
    </plugin>
  </model>
</sdf>
"""


_M = range(4)


def _link(motor: int) -> str:
    return f"{_NAME}/m{motor + 1}_prop"


def _joint(motor: int) -> str:
    return f"{_NAME}/m{motor + 1}_joint"


TARGET = Target(
    name="gazebo",
    file_name="crazyflie_gazebo.sdf",
    about="Model for Gazebo (Harmonic)",
    comment=XML,
    needs=sdf.NEEDS,
    uses=("drag", "rotor_inertia", "rotor_radius"),
    no_place=sdf.NO_PLACE,
    notes=(
        "A complete model; names of links and joints are those of Bitcraze's. Its motors listen to",
        "/crazyflie/gazebo/command/motor_speed for gz.msgs.Actuators with velocity [m1, m2, m3, m4] in rad/s. There is",
        "no controller in it: MulticopterVelocityControl would take the motors' commands over.",
        *sdf.NOTES,
    ),
    write=write,
)
