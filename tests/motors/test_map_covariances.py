"""Maps of the same windows covary: the scatter of many simulated staircases equals what each staircase states."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from cfid.motors.maps.estimation import compare_thrust, fit_map, fit_thrust_of_speed, maximum_thrust
from cfid.motors.maps.result import covariances
from cfid.motors.points import Points, frame, joined
from cfid.records.covariances import Covariance

Array = npt.NDArray[np.float64]
Staircase = Callable[[np.random.Generator], Points]

COMMAND = np.concatenate([np.arange(4000.0, 65000.0, 4000.0), np.arange(64000.0, 3000.0, -4000.0)])
VOLTS = COMMAND / 65535 * 4.0
THRUST_N = 2.1e-3 + 1.3e-2 * VOLTS + 3e-3 * VOLTS**2 + 1.5e-3 * VOLTS**3
SPEED_RAD_S = np.sqrt(THRUST_N / 2e-8)
THRUST_STD_N = 5e-5 + 1e-3 * THRUST_N
TARE_STD_N = 2e-4
SPEED_STD_RAD_S = 1.0
STAIRCASES = 400

LOOKED_AT = {  # one number per map: the factors of its coefficients, in the order of parameters.toml
    "motor.thrust_poly": [40000.0**3, 40000.0**2, 40000.0, 1.0],
    "motor.max_thrust_n": [1.0],
    "motor.thrust_voltage_poly": [1.0, 2.5, 2.5**2, 2.5**3],
    "motor.thrust_per_speed_squared_n_s2": [1.0],
    "motor.thrust_speed_poly": [2500.0**2, 2500.0, 1.0],
}


def tares(count: int) -> Array:
    """Return the shares of the pauses between steps in the tare of each step: half of each neighbouring pause."""
    shares = np.zeros((count, count + 1))
    for step in range(count):
        shares[step, step : step + 2] = TARE_STD_N / 2
    return shares


def stated(rng: np.random.Generator) -> Points:
    """Return a staircase whose windows state their noise, and whose neighbouring steps share the pause between them."""
    shared = tares(len(COMMAND))
    noise = THRUST_STD_N * rng.standard_normal(len(COMMAND)) + shared @ rng.standard_normal(shared.shape[1])
    return frame(
        COMMAND,
        thrust_n=THRUST_N + noise,
        thrust_std_n=np.hypot(THRUST_STD_N, np.linalg.norm(shared, axis=1)),
        thrust_shared_n=shared,
        speed_rad_s=SPEED_RAD_S + SPEED_STD_RAD_S * rng.standard_normal(len(COMMAND)),
        speed_std_rad_s=np.full(len(COMMAND), SPEED_STD_RAD_S),
        vbat_v=np.full(len(COMMAND), 4.0),
    )


def unstated(rng: np.random.Generator) -> Points:
    """Return a table without standard uncertainties; only the scatter of its points shows them."""
    return frame(
        COMMAND,
        vbat_v=np.full(len(COMMAND), 4.0),
        thrust_n=THRUST_N + 1e-4 * rng.standard_normal(len(COMMAND)),
        speed_rad_s=SPEED_RAD_S + SPEED_STD_RAD_S * rng.standard_normal(len(COMMAND)),
    )


def all_but_square(rng: np.random.Generator) -> Points:
    """Return a staircase on whose thrust the firmware's constraint is active in every second fit."""
    points = stated(rng)
    more_n = 2.4e-3 * VOLTS**2 - 4.4e-4 * VOLTS**3
    faster = np.sqrt(1 + more_n / THRUST_N)
    return points.assign(thrust_n=points["thrust_n"] + more_n, speed_rad_s=points["speed_rad_s"] * faster)


def looked_at(block: Covariance) -> Array:
    """Return the matrix that maps the numbers of a covariance to the numbers in LOOKED_AT."""
    count = {**{key: len(powers) for key, powers in LOOKED_AT.items()}, "motor.hover_mass_kg": 1}
    return np.array(
        [
            np.concatenate([LOOKED_AT[one] if one == key else np.zeros(count[key]) for key in block.of])
            for one in LOOKED_AT
        ]
    )


def told(points: Points) -> tuple[Array, Array]:
    """Return the numbers (5,) of LOOKED_AT for one staircase, and their stated covariance (5, 5)."""
    thrust, over_speed = fit_map("thrust", points, order=3, robust=False), fit_thrust_of_speed(points, robust=False)
    most = maximum_thrust(thrust, gravity_mps2=9.81)
    voltage = compare_thrust(points)
    (block,) = covariances(thrust, most=most, voltage=voltage, over_speed=over_speed)
    outward = looked_at(block)
    found = {
        "motor.thrust_poly": thrust.fit.coefficients,
        "motor.max_thrust_n": [most.thrust_n],
        "motor.hover_mass_kg": [most.hover_mass_kg],
        "motor.thrust_voltage_poly": voltage.lowest_first,
        "motor.thrust_per_speed_squared_n_s2": [over_speed.k_n_s2],
        "motor.thrust_speed_poly": over_speed.quadratic.coefficients,
    }
    return outward @ np.concatenate([found[key] for key in block.of]), outward @ np.array(block.matrix) @ outward.T


def correlations(covariance: Array) -> Array:
    std = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(std, std))


@pytest.mark.parametrize(
    ("staircase", "count"),
    [
        pytest.param(stated, STAIRCASES, marks=pytest.mark.slow),
        pytest.param(unstated, STAIRCASES, marks=pytest.mark.slow),
        (all_but_square, 150),
    ],
)
def test_many_staircases_scatter_as_each_of_them_states(staircase: Staircase, count: int) -> None:
    rng = np.random.default_rng(1)
    numbers, each = map(np.array, zip(*(told(staircase(rng)) for _ in range(count)), strict=True))
    scatter, mean = np.cov(numbers.T), each.mean(axis=0)
    print(
        np.round(correlations(scatter), 2), np.round(correlations(mean), 2), np.sqrt(np.diag(mean) / np.diag(scatter))
    )

    assert np.sqrt(np.diag(mean)) == pytest.approx(np.sqrt(np.diag(scatter)), rel=0.15)
    assert correlations(mean) == pytest.approx(correlations(scatter), abs=0.15)


def apart(points: Points) -> Points:
    """Return thrusts and speeds as if they came from two runs, one after the other."""
    return joined(points[["command", "thrust_n"]], points[["command", "speed_rad_s"]])


def brushless(rng: np.random.Generator) -> Points:
    """Return a table of a motor whose speed is linear in the command."""
    speed = 380 + 0.0408 * COMMAND
    noise = 1e-4 * rng.standard_normal(len(COMMAND))
    read = speed + SPEED_STD_RAD_S * rng.standard_normal(len(COMMAND))
    return frame(COMMAND, thrust_n=2e-8 * speed**2 + noise, speed_rad_s=read)


@pytest.mark.parametrize(
    "points",
    [
        pytest.param(brushless, id="one run", marks=pytest.mark.slow),
        pytest.param(lambda rng: apart(brushless(rng)), id="two runs"),
    ],
)
def test_speed_over_command_and_thrust_over_speed_covary_by_the_speeds_error(points: Staircase) -> None:
    rng = np.random.default_rng(2)
    level, square, correlation = [], [], []
    for _ in range(60):
        one = points(rng)
        speed, over_speed = fit_map("speed", one, robust=False), fit_thrust_of_speed(one, robust=False)
        (block,) = covariances(speed, over_speed=over_speed)
        outward = np.zeros((2, 6))
        outward[0, :2], outward[1, 2] = [40000.0, 1.0], 1.0
        level.append(float(speed.fit.at(40000.0)))
        square.append(over_speed.k_n_s2)
        correlation.append(correlations(outward @ np.array(block.matrix) @ outward.T)[0, 1])

    scatter = np.corrcoef(level, square)[0, 1]
    print(f"correlation {np.mean(correlation):.2f}, of the fits {scatter:.2f}")
    assert scatter < -0.1
    assert np.mean(correlation) == pytest.approx(scatter, abs=0.1)
