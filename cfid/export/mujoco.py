"""A complete MuJoCo model: floor, light, the vehicle with its sensors, four motors with lag, and drag."""

from cfid.export.hover import (
    YAW_SIGNS,
    drag_n_s_per_m,
    has_lag,
    inertia_kg_m2,
    lags_s,
    middle_m,
    moment_per_thrust_m,
    rotor_places_m,
)
from cfid.export.target import Target, has
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import XML, number, numbers

_DRAG = "drag+thrust_per_speed_squared"


def write(vehicle: ExportVehicle) -> str:
    """Return the model: a free body with a site and an actuator for each motor, whose control is thrust in N."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia_kg_m2(vehicle)
    places = enumerate(rotor_places_m(vehicle), start=1)
    sites = "".join(f'      <site name="motor{i}" pos="{numbers(place, " ")}"/>\n' for i, place in places)
    return f"""<mujoco model="{_NAME}">
  <compiler autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast" gravity="0 0 -{number(vehicle.gravity_mps2)}"/>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="0 0 0.05"/>
    <body name="{_NAME}" pos="0 0 0.02">
      <freejoint/>
      <inertial pos="0 0 0" mass="{number(vehicle["mass"])}" fullinertia="{numbers((xx, yy, zz, xy, xz, yz), " ")}"/>
      <geom type="cylinder" size="{number(vehicle["arm"])} 0.0125" pos="{numbers(middle_m(vehicle), " ")}"/>
      <site name="imu"/>
{sites}    </body>
  </worldbody>
  <actuator>
{"".join(_motor(vehicle, i + 1, sign) for i, sign in enumerate(YAW_SIGNS))}{_drag(vehicle)}  </actuator>
  <sensor>
    <gyro site="imu"/>
    <accelerometer site="imu"/>
    <framequat objtype="site" objname="imu"/>
  </sensor>
</mujoco>
"""


def _motor(vehicle: ExportVehicle, motor: int, yaw_sign: int) -> str:
    yaw = number(yaw_sign * moment_per_thrust_m(vehicle))
    lag = f' dyntype="filterexact" dynprm="{number(sum(lags_s(vehicle)) / 2)}"' if has_lag(vehicle) else ""
    return (
        f'    <general name="motor{motor}" site="motor{motor}" gear="0 0 1 0 0 {yaw}" '
        f'ctrlrange="0 {number(vehicle["max_thrust"])}"{lag}/>\n'
    )


def _drag(vehicle: ExportVehicle) -> str:
    """Return actuators that brake along the body axes, whatever their control, as MuJoCo models such a force."""
    if not has(vehicle, _DRAG):
        return ""
    return "".join(
        f'    <general name="drag_{axis}" site="imu" gear="{gear} 0 0 0" gainprm="0" '
        f'biastype="affine" biasprm="0 0 -{number(drag)}"/>\n'
        for axis, gear, drag in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), drag_n_s_per_m(vehicle), strict=True)
    )


_NAME = "crazyflie"
TARGET = Target(
    name="mujoco",
    file_name="crazyflie_mujoco.xml",
    about="MuJoCo model",
    comment=XML,
    needs=("mass", "inertia", "arm", "torque_of_thrust", "max_thrust"),
    uses=("rising+falling+thrust_per_speed_squared|thrust_lag", _DRAG),
    no_place=(
        "thrust_of_command",
        "thrust_range",
        "thrust_of_voltage",
        "thrust_of_speed",
        "speed_of_command",
        "delay",
        "rotor_inertia",
        "rotor_radius",
    ),
    notes=(
        "A complete model with floor, light and sensors. fullinertia: kg m^2, entries xx yy zz xy xz yz. Sites: motors",
        "m1 to m4, m from the centre of mass; their heights were not measured and are zero. data.ctrl[:4] is each",
        "motor's thrust in N; gear's sixth number is the yaw moment over it, in m (N m/N). ctrlrange ends at the full",
        "command's thrust, with the battery as it was measured. dynprm is the lag of thrust behind its command in s,",
        "the mean of rising and falling: MuJoCo has one for both. The actuators drag_x, drag_y and drag_z, where there",
        "are some, brake with N/(m/s) as at hovering, along the body's axes; their controls do nothing. The cylinder",
        "is there to touch the floor; its height was not measured.",
    ),
    write=write,
)
