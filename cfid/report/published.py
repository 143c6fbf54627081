"""Published values of the Crazyflie: each number with its vehicle, its frame and its source.

These are facts only, in the units of the columns of `comparison`. A note marks values that were copied from the thesis
without turning its frame: in the thesis x is the pitch axis and y the roll axis; in all copies x is forward.
"""

from typing import NamedTuple

from cfid.records.rig_file import BodyFrame
from cfid.transfer.model import EQ_3_15, EQ_3_16, TransferFunction
from cfid.units import RPM

X_FORWARD = BodyFrame()
X_PITCH = BodyFrame(forward="y", left="-x", up="z")  # the thesis' figure 2.4

THESIS = "J. Förster: System identification of the Crazyflie 2.0 nano quadrocopter, ETH Zürich 2015"
APPENDIX_A = f"{THESIS}, appendix A"
FIRMWARE = "bitcraze/crazyflie-firmware at 2a18fc2 (August 2026)"
GAZEBO = "bitcraze/crazyflie-simulation at 7e93752 (March 2026), gazebo/crazyflie/model.sdf"
STAND_2015 = "bitcraze/crazyflie-firmware, docs/functional-areas/pwm-to-thrust.md"
STAND_2021 = "IMRCLab/crazyflie-system-id, Bitcraze's recordings of 2021"
CRAZYFLOW = "crazyflow: learnsyslab/drone-models at 6b8319a (May 2026), data/params.toml"
CRAZYFLOW_LAG = "crazyflow: learnsyslab/drone-models at 6b8319a (May 2026), so_rpy_rotor/params.toml"
ROTORPY = "spencerfolk/rotorpy at 9b760b8 (April 2026), vehicles/crazyflie_params.py"
ROTORPY_BL = "spencerfolk/rotorpy at 9b760b8 (April 2026), vehicles/crazyfliebrushless_params.py"
PYBULLET = "utiasDSL/gym-pybullet-drones at 90b178a (May 2026), assets/cf2x.urdf"
LUIS = "C. Luis, J. Le Ny: Design of a trajectory tracking controller for a nanoquadcopter, arXiv 1608.05786 (2016)"
LANDRY = "B. Landry: Planning and control for quadrotor flight through cluttered environments, MIT 2015"

_COPIED = "the thesis' numbers under another frame: its x and y were not turned"
_QUOTED = "as others quote it; the original was not read"


class Published(NamedTuple):
    """The numbers of one source, one for each column; None where the source gives no number."""

    who: str
    vehicle: str
    values: tuple[float | None, ...]
    source: str
    note: str = ""


class PublishedInertia(NamedTuple):
    """An inertia matrix as printed in its source: xx, yy, zz, xy, xz, yz in kg m^2, and the directions of its axes."""

    who: str
    vehicle: str
    matrix_kg_m2: tuple[float, float, float, float, float, float]
    axes: BodyFrame
    source: str
    note: str = ""


MASS_KG = (
    Published("thesis", "Crazyflie 2.0", (0.0280,), APPENDIX_A),
    Published("Bitcraze firmware", "Crazyflie 2.x", (0.029,), f"{FIRMWARE}, platform_defaults_cf2.h"),
    Published("Bitcraze firmware", "2.x, thrust upgrade kit", (0.0325,), f"{FIRMWARE}, platform_defaults_cf2.h"),
    Published(
        "Bitcraze firmware",
        "2.1 Brushless",
        (0.0393,),
        f"{FIRMWARE}, platform_defaults_cf21bl.h",
        note="with propeller guards and a Lighthouse deck",
    ),
    Published("crazyflow", "2.x, L250", (0.0319,), CRAZYFLOW),
    Published("crazyflow", "2.x, P250", (0.0318,), CRAZYFLOW),
    Published("crazyflow", "2.x, T350", (0.0379,), CRAZYFLOW),
    Published("crazyflow", "2.1 Brushless", (0.04338,), CRAZYFLOW),
    Published("RotorPy", "Crazyflie", (0.030,), ROTORPY),
    Published("RotorPy", "Brushless", (0.044,), ROTORPY_BL, note="with propeller guards"),
    Published("gym-pybullet-drones", "Crazyflie 2.x", (0.027,), PYBULLET),
)

_THESIS_INERTIA = (16.571710e-6, 16.655602e-6, 29.261652e-6, 0.830806e-6, 0.718277e-6, 1.800197e-6)
INERTIA = (
    PublishedInertia(
        "thesis",
        "Crazyflie 2.0",
        _THESIS_INERTIA,
        X_PITCH,
        f"{THESIS}, eq. 2.18",
        "the sign of its xy is doubtful: that mount has two directions in its calculation",
    ),
    PublishedInertia("Bitcraze Gazebo model", "Crazyflie 2.x", _THESIS_INERTIA, X_FORWARD, GAZEBO, _COPIED),
    PublishedInertia(
        "Bitcraze firmware (Brescianini)",
        "Crazyflie 2.x",
        (16.6e-6, 16.6e-6, 29.3e-6, 0.83e-6, 0.72e-6, 1.8e-6),
        X_FORWARD,
        f"{FIRMWARE}, controller_brescianini.c",
        f"rounded; {_COPIED}",
    ),
    PublishedInertia(
        "Bitcraze firmware (Lee)",
        "Crazyflie 2.x",
        (16.571710e-6, 16.655602e-6, 29.261652e-6, 0.0, 0.0, 0.0),
        X_FORWARD,
        f"{FIRMWARE}, controller_lee.c",
        f"diagonal alone; {_COPIED}",
    ),
    PublishedInertia(
        "crazyflow",
        "2.x, L250, P250, T350",
        (16.8e-6, 16.8e-6, 29.8e-6, 0.0, 0.0, 0.0),
        X_FORWARD,
        CRAZYFLOW,
        "one value for three vehicles, marked there as to be done",
    ),
    PublishedInertia("crazyflow", "2.1 Brushless", (25e-6, 28e-6, 49e-6, 0.0, 0.0, 0.0), X_FORWARD, CRAZYFLOW),
    PublishedInertia("RotorPy", "Crazyflie", (14.3e-6, 14.3e-6, 28.9e-6, 0.0, 0.0, 0.0), X_FORWARD, ROTORPY),
    PublishedInertia("RotorPy", "Brushless", (33e-6, 36e-6, 59e-6, 0.0, 0.0, 0.0), X_FORWARD, ROTORPY_BL),
    PublishedInertia("gym-pybullet-drones", "2.x", (14.0e-6, 14.0e-6, 21.7e-6, 0.0, 0.0, 0.0), X_FORWARD, PYBULLET),
    PublishedInertia(
        "Luis and Le Ny",
        "Crazyflie 2.0",
        (13.95e-6, 14.36e-6, 21.73e-6, 0.0, 0.0, 0.0),
        X_FORWARD,
        LUIS,
        f"{_QUOTED}: most quote xx and yy in this order, some the other way round",
    ),
    PublishedInertia(
        "Landry",
        "Crazyflie 2.0 with markers",
        (23.951e-6, 23.951e-6, 32.347e-6, 0.0, 0.0, 0.0),
        X_FORWARD,
        f"{LANDRY}, p. 39",
        f"{_QUOTED} (google-deepmind/mujoco_menagerie, whoenig/crazyflie_ros pull request 48)",
    ),
)

COMMANDS = (16384, 32768, 49152, 61440)  # 25, 50, 75 and 93.75 % of full scale, where Bitcraze's table has rows
_GRAM_OF_FOUR_N = 1e-3 * 9.80665 / 4


def _thesis_thrust_n(command: float) -> float:
    return 2.130295e-11 * command**2 + 1.032633e-6 * command + 5.484560e-4


def _thesis_speed_rad_s(command: float) -> float:
    return 0.04076521 * command + 380.8359


THRUST_N = (
    Published("thesis", "Crazyflie 2.0", tuple(map(_thesis_thrust_n, COMMANDS)), APPENDIX_A),
    Published(
        "Bitcraze 2015",
        "Crazyflie 2.0",
        tuple(_GRAM_OF_FOUR_N * grams for grams in (10.9, 24.4, 41.7, 57.9)),
        STAND_2015,
        note="a quarter of four motors' thrust, on a supply that sagged from 3.88 to 3.30 V",
    ),
)
SPEED_RAD_S = (
    Published("thesis", "Crazyflie 2.0", tuple(map(_thesis_speed_rad_s, COMMANDS)), APPENDIX_A),
    Published("Bitcraze 2015", "Crazyflie 2.0", tuple(RPM * x for x in (10885, 15924, 20539, 23882)), STAND_2015),
    Published(
        "Luis and Le Ny",
        "Crazyflie 2.0",
        tuple(RPM * (0.2685 * command + 4070.3) for command in COMMANDS),
        LUIS,
        note=f"{_QUOTED} (gym-pybullet-drones has the same line)",
    ),
)

SPEEDS_RAD_S = (1000.0, 1500.0, 2000.0)


def _of_rpm(*coefficients: float) -> tuple[float, ...]:
    """Return the thrust at SPEEDS_RAD_S from a polynomial in rpm, lowest power first."""
    return tuple(sum(c * (speed / RPM) ** i for i, c in enumerate(coefficients)) for speed in SPEEDS_RAD_S)


def _squared(k_n_s2: float) -> tuple[float, ...]:
    return tuple(k_n_s2 * speed**2 for speed in SPEEDS_RAD_S)


THRUST_AT_SPEED_N = (
    Published(
        "thesis",
        "Crazyflie 2.0",
        tuple(_thesis_thrust_n((speed - 380.8359) / 0.04076521) for speed in SPEEDS_RAD_S),
        APPENDIX_A,
        note="its two maps of the command, one put into the other",
    ),
    Published(
        "Bitcraze 2015",
        "Crazyflie 2.0",
        _of_rpm(*(_GRAM_OF_FOUR_N * c for c in (1.5417e-1, -2.1059e-4, 1.0942e-7))),
        STAND_2015,
        note="a quarter of four motors' thrust",
    ),
    Published(
        "Bitcraze 2021",
        "Crazyflie 2.1",
        _squared(1.96e-8),
        STAND_2021,
        note="k ω² with k from 1.90e-8 to 2.02e-8 N s²/rad², calculated from the steady parts of cf21_stock2.csv",
    ),
    Published("crazyflow", "2.x, L250", _of_rpm(0.0, -5.382196214637237e-7, 2.4582929831265485e-10), CRAZYFLOW),
    Published("crazyflow", "2.x, P250", _of_rpm(0.0, -3.6200226530383495e-7, 1.6060924304100328e-10), CRAZYFLOW),
    Published("RotorPy", "Crazyflie", _squared(2.3e-8), ROTORPY, note="from 14.5 g at 2500 rad/s, as the file states"),
    Published("gym-pybullet-drones", "2.x", _of_rpm(0.0, 0.0, 3.16e-10), PYBULLET, note="N/rpm² there"),
    Published("Luis and Le Ny", "Crazyflie 2.0", _of_rpm(0.0, 0.0, 3.1582e-10), LUIS, note=f"N/rpm²; {_QUOTED}"),
)

TORQUE_PER_THRUST_M = (
    Published("thesis", "Crazyflie 2.0", (0.005964552,), APPENDIX_A, note="its slope; the line misses 0"),
    Published("Bitcraze firmware", "2.x, legacy propellers", (0.007350862856566459,), f"{FIRMWARE}, THRUST2TORQUE"),
    Published("Bitcraze firmware", "2.1+", (0.0069928948992470565,), f"{FIRMWARE}, THRUST2TORQUE"),
    Published("Bitcraze firmware", "2.x, thrust upgrade kit", (0.0051648627905205285,), f"{FIRMWARE}, THRUST2TORQUE"),
    Published("Bitcraze firmware", "2.1 Brushless", (0.00569278844371417,), f"{FIRMWARE}, THRUST2TORQUE"),
    Published("Bitcraze Gazebo model", "2.x", (0.005964552,), GAZEBO, note="the thesis' number"),
    Published("RotorPy", "Crazyflie", (7.8e-10 / 2.3e-8,), ROTORPY, note="its k_m over its k_eta"),
    Published("gym-pybullet-drones", "2.x", (7.94e-12 / 3.16e-10,), PYBULLET, note="its km over its kf"),
    Published("Luis and Le Ny", "2.0", (7.9379e-12 / 3.1582e-10,), LUIS, note=f"torque over thrust; {_QUOTED}"),
)

VOLTS = (2.0, 2.5, 3.0, 3.5)


def _of_volts(*coefficients: float) -> tuple[float, ...]:
    return tuple(sum(c * volts**i for i, c in enumerate(coefficients)) for volts in VOLTS)


THRUST_AT_VOLTAGE_N = (
    Published(
        "Bitcraze firmware",
        "2.x, legacy propellers",
        _of_volts(-0.014830744918356092, 0.04724465241828281, -0.01847364358025878, 0.005960923942142),
        f"{FIRMWARE}, VMOTOR2THRUST",
    ),
    Published(
        "Bitcraze firmware",
        "2.1+",
        _of_volts(-0.02476537915958403, 0.06523793527519485, -0.026792504967750107, 0.006776789303971145),
        f"{FIRMWARE}, VMOTOR2THRUST",
    ),
    Published(
        "Bitcraze firmware",
        "2.1 Brushless",
        _of_volts(-0.014058926705279723, 0.04265273261724981, 0.0018327760144017432, 0.0020576974784587178),
        f"{FIRMWARE}, VMOTOR2THRUST",
    ),
)


def _first_order(function: TransferFunction) -> tuple[float | None, float]:
    """Return the time constant and the static gain."""
    return function.time_constant_s, function.static_gain_n


_LATE = "of its pole; the latency of its stamps was left out"
DYNAMICS = (
    Published("thesis (3.16)", "2.0", _first_order(EQ_3_16), APPENDIX_A, note=_LATE),
    Published("thesis (3.15)", "2.0", _first_order(EQ_3_15), f"{THESIS}, eq. 3.15", note=_LATE),
    Published("RotorPy", "Crazyflie", (0.072, None), ROTORPY, note="of the rotor's speed, from flights"),
    Published("RotorPy", "Brushless", (0.050, None), ROTORPY_BL, note="of the rotor's speed"),
    *(
        Published("crazyflow", vehicle, (value, None), CRAZYFLOW_LAG, note="of the thrust")
        for vehicle, value in (
            ("2.x, L250", 0.0858607),
            ("2.x, P250", 0.0578952),
            ("2.x, T350", 0.05062676),
            ("2.1 Brushless", 0.02055366),
        )
    ),
)

DRAG_KG_PER_RAD = (
    Published("thesis (simple)", "2.0", (-9.1785e-7, -9.1785e-7, -10.311e-7), APPENDIX_A),
    Published("thesis (cross)", "2.0", (-10.2506e-7, -10.2506e-7, -7.5530e-7), APPENDIX_A, "diagonal of its matrix"),
    Published(
        "RotorPy",
        "Crazyflie",
        (-10.2506e-7, -10.2506e-7, -7.553e-7),
        ROTORPY,
        note="k_d and k_z, there without a sign; the thesis' numbers",
    ),
    Published(
        "gym-pybullet-drones",
        "2.x",
        (-9.1785e-7, -9.1785e-7, -10.311e-7),
        PYBULLET,
        note="there without a sign; the thesis' numbers",
    ),
)
DRAG_KG_PER_S = tuple(
    Published("crazyflow", vehicle, values, CRAZYFLOW, note="in proportion to velocity alone")
    for vehicle, values in (
        ("2.x, L250", (-0.01471782, -0.01471782, -0.01277641)),
        ("2.x, P250", (-0.01351483, -0.01351483, -0.01677452)),
        ("2.1 Brushless", (-0.02149163, -0.02149163, -0.02359736)),
    )
)
