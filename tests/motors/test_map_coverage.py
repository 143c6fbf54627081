"""Motor maps of points that scatter between steps by more than their windows show, in proportion to the thrust."""

import numpy as np
import pytest

from cfid.findings import texts
from cfid.motors.maps.estimation import fit_map
from cfid.motors.points import Points, frame
from tests.coverage_rows import Array, Row

COMMAND = np.arange(4000.0, 64001.0, 4000.0)
AT = np.array([12000.0, 30000.0, 48000.0, 65535.0])
NOISE_N, RATIO_M, SPEED_STD = 2e-4, 0.006, 0.5


def thrust_n(command: Array) -> Array:
    return np.asarray(2.1e-11 * command**2 + 1.03e-6 * command)


def speed_rad_s(command: Array) -> Array:
    return 380 + 0.0408 * command


def scattered(part: float, rng: np.random.Generator, *, both_ways: bool) -> Points:
    """Return points whose steps differ from the map by a fraction of their values, plus the noise of their windows."""
    command = np.concatenate([COMMAND, COMMAND[::-1]]) if both_ways else COMMAND
    thrust = thrust_n(command) * (1 + part * rng.standard_normal(len(command)))
    own, shape = RATIO_M * thrust_n(command), len(command)
    return frame(
        command,
        thrust_n=thrust + NOISE_N * rng.standard_normal(shape),
        thrust_std_n=np.full(shape, NOISE_N),
        torque_nm=RATIO_M * thrust + part * own * rng.standard_normal(shape) + 1e-6 * rng.standard_normal(shape),
        torque_std_nm=np.full(shape, 1e-6),
        speed_rad_s=speed_rad_s(command) * (1 + part * rng.standard_normal(shape))
        + SPEED_STD * rng.standard_normal(shape),
        speed_std_rad_s=np.full(shape, SPEED_STD),
    )


def rows(part: float, campaigns: int, *, both_ways: bool, seed: int) -> list[Row]:
    rng, thrusts, speeds, torques, rejected = np.random.default_rng(seed), [], [], [], 0
    for _ in range(campaigns):
        points = scattered(part, rng, both_ways=both_ways)
        thrust, speed, torque = fit_map("thrust", points), fit_map("speed", points), fit_map("torque", points)
        rejected += any(texts(found.findings, "rejection") for found in (thrust, speed, torque))
        thrusts.append((thrust.fit.at(AT) - thrust_n(AT), thrust.fit.std_at(AT)))
        speeds.append((speed.fit.at(AT) - speed_rad_s(AT), speed.fit.std_at(AT)))
        torques.append((torque.fit.coefficients[:1] - RATIO_M, torque.fit.std[:1]))
    kind = f"{100 * part:g} % scatter, {'both ways' if both_ways else 'one way'}"
    each = {"thrust": (thrusts, 0.15), "speed": (speeds, 3000.0), "torque": (torques, RATIO_M)}
    return [
        Row(f"{name}: {kind}", error, std, scale, rejected)
        for name, (found, scale) in each.items()
        for error, std in [np.array(found).transpose(1, 0, 2)]
    ]


@pytest.mark.parametrize("part", [0.005, pytest.param(0.02, marks=pytest.mark.slow)])
def test_maps_lie_within_their_intervals_where_steps_scatter_in_proportion(part: float) -> None:
    for row in rows(part, 40, both_ways=True, seed=1):
        print(row)
        assert row.covers()
        assert row.rejected == 0


@pytest.mark.slow
@pytest.mark.parametrize("both_ways", [True, False])
@pytest.mark.parametrize("part", [0.0, 0.002, 0.005, 0.02])
def test_maps_cover_over_many_campaigns(part: float, both_ways: bool) -> None:
    for row in rows(part, 1000, both_ways=both_ways, seed=2):
        print(row)
        assert row.covers()
