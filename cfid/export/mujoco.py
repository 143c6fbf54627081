"""A MuJoCo model of the vehicle's mass, inertia and four motors, to load as it is or to include."""

from cfid.export.hover import YAW_SIGNS, has_lag, inertia_kg_m2, lags_s, moment_per_thrust_m, rotor_places_m
from cfid.export.target import Target
from cfid.export.vehicle import Vehicle
from cfid.export.wording import XML, number, numbers


def write(vehicle: Vehicle) -> str:
    """Return the model: a free body with a site and an actuator for each motor, whose control is thrust in N."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia_kg_m2(vehicle)
    places = enumerate(rotor_places_m(vehicle), start=1)
    sites = "".join(f'      <site name="motor{i}" pos="{numbers(place, " ")}"/>\n' for i, place in places)
    return f"""<mujoco model="{_NAME}">
  <compiler autolimits="true"/>
  <option gravity="0 0 -{number(vehicle.gravity_mps2)}"/>
  <worldbody>
    <body name="{_NAME}">
      <freejoint/>
      <inertial pos="0 0 0" mass="{number(vehicle["mass"])}" fullinertia="{numbers((xx, yy, zz, xy, xz, yz), " ")}"/>
{sites}    </body>
  </worldbody>
  <actuator>
{"".join(_motor(vehicle, i + 1, sign) for i, sign in enumerate(YAW_SIGNS))}  </actuator>
</mujoco>
"""


def _motor(vehicle: Vehicle, motor: int, yaw_sign: int) -> str:
    yaw = number(yaw_sign * moment_per_thrust_m(vehicle))
    lag = f' dyntype="filterexact" dynprm="{number(sum(lags_s(vehicle)) / 2)}"' if has_lag(vehicle) else ""
    return (
        f'    <general name="motor{motor}" site="motor{motor}" gear="0 0 1 0 0 {yaw}" '
        f'ctrlrange="0 {number(vehicle["max_thrust"])}"{lag}/>\n'
    )


_NAME = "crazyflie"
TARGET = Target(
    name="mujoco",
    file_name="crazyflie_mujoco.xml",
    about="MuJoCo model",
    comment=XML,
    needs=("mass", "inertia", "arm", "torque_of_thrust", "max_thrust"),
    uses=("rising+falling+thrust_per_speed_squared|thrust_lag",),
    notes=(
        "fullinertia: kg m^2, entries xx yy zz xy xz yz. Sites: motors m1 to m4, m from the centre of mass; their",
        "heights were not measured and are zero. A control is the thrust of one motor in N; gear's sixth number is",
        "the yaw moment over it, in m (N m/N). ctrlrange ends at the full command's thrust, with the battery as it",
        "was measured. dynprm is the lag of thrust behind its command in s, the mean of rising and falling: MuJoCo",
        "has one for both. Drag over rotor speed has no place in this format and is left out.",
    ),
    write=write,
)
