"""What the literature states of a Crazyflie, transcribed apart from the sets, which have every number of it.

Formulas are evaluated here to nine digits. Inertia is along forward, left and up: the thesis' matrix is turned.
"""

from collections.abc import Callable, Sequence

import pytest

from cfid.published import PublishedSet, published_sets, turned
from cfid.published.set_file import PublishedValue
from cfid.quantities.values import evaluate

Read = Callable[[PublishedValue, PublishedSet], list[float | None]]
COMMANDS = (16384.0, 32768.0, 49152.0, 61440.0)
NONE = (None, None, None)  # products that the source leaves out
LITERATURE: dict[str, list[tuple[str, str, list[float | None]]]] = {
    "Mass": [
        ("thesis", "Crazyflie 2.0", [0.028]),
        ("Bitcraze firmware", "2.x, legacy propellers", [0.029]),
        ("Bitcraze firmware", "2.x, thrust upgrade kit", [0.0325]),
        ("Bitcraze firmware", "2.1 Brushless", [0.0393]),
        ("crazyflow", "2.x, L250", [0.0328]),
        ("crazyflow", "2.x, P250", [0.0318]),
        ("crazyflow", "2.x, T350", [0.0379]),
        ("crazyflow", "2.1 Brushless", [0.0434]),
        ("l2f", "2.1", [0.0306]),
        ("IDSIA", "2.1 Brushless, 45 g", [0.045]),
        ("Gräfe et al.", "2.1 Brushless, guards", [0.044]),
        ("Bitcraze Gazebo model", "Crazyflie 2.x", [0.0282]),
        ("RotorPy", "Crazyflie", [0.03]),
        ("RotorPy", "Brushless", [0.044]),
        ("gym-pybullet-drones", "2.x", [0.027]),
    ],
    "Inertia about the centre of mass": [
        (
            "thesis",
            "Crazyflie 2.0",
            [1.6655602e-05, 1.657171e-05, 2.9261652e-05, -8.30806e-07, 1.800197e-06, -7.18277e-07],
        ),
        (
            "Bitcraze Gazebo model",
            "Crazyflie 2.x",
            [1.657171e-05, 1.6655602e-05, 2.9261652e-05, 8.30806e-07, 7.18277e-07, 1.800197e-06],
        ),
        (
            "Bitcraze firmware (Brescianini)",
            "2.x, legacy propellers",
            [1.66e-05, 1.66e-05, 2.93e-05, 8.3e-07, 7.2e-07, 1.8e-06],
        ),
        ("Bitcraze firmware (Lee)", "2.x, legacy propellers", [1.657171e-05, 1.6655602e-05, 2.9261652e-05, *NONE]),
        ("crazyflow", "2.x, L250", [1.68e-05, 1.68e-05, 2.98e-05, *NONE]),
        ("crazyflow", "2.1 Brushless", [2.5e-05, 2.8e-05, 4.9e-05, *NONE]),
        ("RotorPy", "Crazyflie", [1.43e-05, 1.43e-05, 2.89e-05, *NONE]),
        ("RotorPy", "Brushless", [3.3e-05, 3.6e-05, 5.9e-05, *NONE]),
        ("gym-pybullet-drones", "2.x", [1.4e-05, 1.4e-05, 2.17e-05, *NONE]),
        ("Luis and Le Ny", "Crazyflie 2.0", [1.395e-05, 1.436e-05, 2.173e-05, *NONE]),
        ("Landry", "Crazyflie 2.0 with markers", [2.3951e-05, 2.3951e-05, 3.2347e-05, *NONE]),
        ("l2f", "2.1", [9.416556729130406e-06, 9.644051701582312e-06, 1.745951732253285e-05, *NONE]),
        ("Bitcraze firmware (Lee)", "2.1 Brushless", [1.657171e-05, 1.6655602e-05, 2.9261652e-05, *NONE]),
        ("IDSIA", "2.1 Brushless, 45 g", [2.3951e-05, 2.3951e-05, 3.2347e-06, *NONE]),
    ],
    "Thrust of the command": [
        ("thesis", "Crazyflie 2.0", [0.0231855822, 0.0572596425, 0.102770637, 0.144409371]),
        ("Bitcraze 2015", "Crazyflie 2.0", [0.0267231213, 0.059820565, 0.102234326, 0.141951259]),
    ],
    "Rotor speed of the command": [
        ("thesis", "Crazyflie 2.0", [1048.7331, 1716.6303, 2384.5275, 2885.4504]),
        ("Bitcraze 2015", "Crazyflie 2.0", [1139.87453, 1667.55738, 2150.83905, 2500.91719]),
        ("Luis and Le Ny", "Crazyflie 2.0", [886.913913, 1347.58701, 1808.2601, 2153.76492]),
    ],
    "Thrust of the rotor's speed": [
        ("thesis", "Crazyflie 2.0", [0.0211470616, 0.0449546522, 0.0751718347]),
        ("Bitcraze 2015", "Crazyflie 2.0", [0.0199101746, 0.0480231218, 0.0883672999]),
        ("Bitcraze 2021", "Crazyflie 2.1", [0.0196, 0.0441, 0.0784]),
        ("crazyflow", "2.x, L250", [0.0172773251, 0.0427286957, 0.0793885381]),
        ("crazyflow", "2.x, P250", [0.0111889398, 0.0277677647, 0.051669493]),
        ("RotorPy", "Crazyflie", [0.023, 0.05175, 0.092]),
        ("gym-pybullet-drones", "2.x", [0.0288157446, 0.0648354254, 0.115262979]),
        ("Luis and Le Ny", "Crazyflie 2.0", [0.0287993306, 0.0647984938, 0.115197322]),
    ],
    "Thrust of the motor's voltage": [
        ("Bitcraze firmware", "2.x, legacy propellers", [0.0534513771, 0.0809600503, 0.121585367, 0.179798019]),
        ("Bitcraze firmware", "2.1+", [0.052754786, 0.0767636359, 0.112789193, 0.16591405]),
        ("Bitcraze firmware", "2.1 Brushless", [0.0950392224, 0.136179278, 0.185952087, 0.245900923]),
    ],
    "Torque per thrust": [
        ("thesis", "Crazyflie 2.0", [0.005964552]),
        ("Bitcraze firmware", "2.x, legacy propellers", [0.00735086286]),
        ("Bitcraze firmware", "2.1+", [0.0069928949]),
        ("Bitcraze firmware", "2.x, thrust upgrade kit", [0.00516486279]),
        ("Bitcraze firmware", "2.1 Brushless", [0.00569278844]),
        ("Bitcraze Gazebo model", "Crazyflie 2.x", [0.005964552]),
        ("RotorPy", "Crazyflie", [0.0339130435]),
        ("gym-pybullet-drones", "2.x", [0.0251265823]),
        ("l2f", "2.1", [0.004665]),
        ("IDSIA", "2.1 Brushless, 45 g", [2.08064516e-4]),
        ("RotorPy", "Brushless", [0.0192497532]),
        ("Luis and Le Ny", "Crazyflie 2.0", [0.0251342537]),
    ],
    "Time constant of motor and rotor": [
        ("thesis (3.16)", "Crazyflie 2.0", [0.0646555886]),
        ("thesis (3.15)", "Crazyflie 2.0", [0.0774917148]),
        ("RotorPy", "Crazyflie", [0.072]),
        ("RotorPy", "Brushless", [0.05]),
        ("crazyflow", "2.x, L250", [0.08671854102]),
        ("crazyflow", "2.x, P250", [0.0578952]),
        ("crazyflow", "2.x, T350", [0.05941543455]),
        ("crazyflow", "2.1 Brushless", [0.05180073413]),
    ],
    "Static gain of the transfer function": [
        ("thesis (3.16)", "Crazyflie 2.0", [2.37512554e-06]),
        ("thesis (3.15)", "Crazyflie 2.0", [2.38258829e-06]),
    ],
    "Drag per rotor speed and velocity": [
        ("thesis (simple)", "Crazyflie 2.0", [-9.1785e-07, -9.1785e-07, -1.0311e-06]),
        ("thesis (cross)", "Crazyflie 2.0", [-1.02506e-06, -1.02506e-06, -7.553e-07]),
        ("RotorPy", "Crazyflie", [-1.02506e-06, -1.02506e-06, -7.553e-07]),
        ("gym-pybullet-drones", "2.x", [-9.1785e-07, -9.1785e-07, -1.0311e-06]),
    ],
    "Drag per velocity": [
        ("crazyflow", "2.x, L250", [-0.014953790232821078, -0.014953790232821078, -0.013900090000325344]),
        ("crazyflow", "2.x, P250", [-0.01351483, -0.01351483, -0.01677452]),
        ("crazyflow", "2.x, T350", [-0.015203241038199845, -0.015203241038199845, -0.02204579179094129]),
        ("crazyflow", "2.1 Brushless", [-0.021643637770852733, -0.021643637770852733, -0.02477138502714662]),
    ],
}


def stated(published: PublishedSet, title: str) -> list[list[float | None]]:
    """Return what a set states under a title, one entry a value."""
    keys, of = READ[title]
    return [of(value, published) for value in published.values if value.key in keys]


def evaluated(places: Sequence[float], column: str = "") -> Read:
    def of(value: PublishedValue, _: PublishedSet) -> list[float | None]:
        if value.key == "motor.table":
            points = {row["cmd"]: row.get(column) for row in value.value}
            return [points.get(x) for x in places]
        if value.key.endswith("squared_n_s2"):
            return [value.value * x**2 for x in places]
        return [evaluate(value.key, value.value, x) for x in places]

    return of


def moments(value: PublishedValue, published: PublishedSet) -> list[float | None]:
    entries = list(turned(value.value, published.frame).values())
    return [*entries] if any(entries[3:]) else [*entries[:3], *NONE]


def along(value: PublishedValue, published: PublishedSet) -> list[float | None]:
    diagonal = [row[i] for i, row in enumerate(value.value)] if isinstance(value.value[0], list) else value.value
    return [diagonal[place] for place, _ in published.frame.axes]


def number(value: PublishedValue, _: PublishedSet) -> list[float | None]:
    return [value.value[-2] if isinstance(value.value, list) else value.value]


READ: dict[str, tuple[tuple[str, ...], Read]] = {
    "Mass": (("mass_kg",), number),
    "Inertia about the centre of mass": (("inertia.matrix_kg_m2",), moments),
    "Thrust of the command": (("motor.thrust_poly", "motor.table"), evaluated(COMMANDS, "thrust_n")),
    "Rotor speed of the command": (("motor.speed_poly", "motor.table"), evaluated(COMMANDS, "speed_rad_s")),
    "Thrust of the rotor's speed": (
        ("motor.thrust_speed_poly", "motor.thrust_per_speed_squared_n_s2"),
        evaluated((1000.0, 1500.0, 2000.0)),
    ),
    "Thrust of the motor's voltage": (("motor.thrust_voltage_poly",), evaluated((2.0, 2.5, 3.0, 3.5))),
    "Torque per thrust": (("motor.torque_poly",), number),
    "Time constant of motor and rotor": (("tf.time_constant_s",), number),
    "Static gain of the transfer function": (("tf.static_gain_n",), number),
    "Drag per rotor speed and velocity": (("drag.simple_kg_per_rad", "drag.cross_coupling_kg_per_rad"), along),
    "Drag per velocity": (("drag.complex.k4",), along),
}


@pytest.mark.parametrize("title", LITERATURE)
def test_the_sets_have_every_number_of_the_literature(title: str) -> None:
    for who, vehicle, values in LITERATURE[title]:
        sets = [
            each for each in published_sets().values() if (each.title, each.vehicle) == (who.split(" (")[0], vehicle)
        ]
        sets += [each for each in published_sets().values() if (each.title, each.vehicle) == (who, vehicle)]
        assert any(is_near(numbers, values) for each in sets for numbers in stated(each, title)), (who, vehicle)


def is_near(numbers: list[float | None], values: list[float | None]) -> bool:
    return len(numbers) == len(values) and all(
        number is value is None or (None not in (number, value) and number == pytest.approx(value, rel=1e-8))
        for number, value in zip(numbers, values, strict=True)
    )
