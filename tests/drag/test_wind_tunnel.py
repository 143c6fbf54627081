"""The simulated wind tunnel: its air, its readings, and its forces, the same as means and as a whole record."""

import math

import numpy as np
import pytest

from cfid.sim.loadcell import LoadCellTruth
from tests.drag.wind_tunnel import (
    COMMANDS,
    ComplexAir,
    CrossAir,
    SimpleAir,
    Tunnel,
    TunnelRun,
    Wind,
    known_to,
    record,
    simulate_campaign,
)

EXACT = LoadCellTruth(noise_std=(0,) * 6, drift_per_s=(0,) * 6)
AIR = SimpleAir(kg_per_rad=(-9e-7, -9e-7, -10e-7))
SIDE = Wind(90.0, 3.0, 3.0)


def runs_of(tunnel: Tunnel, *winds: Wind, seed: int = 3) -> dict[tuple[float, int], TunnelRun]:
    runs = simulate_campaign(tunnel, winds, rng=np.random.default_rng(seed))
    return {(run.max_mps, run.command): run for run in runs}


def test_seven_references_and_seven_commands_in_each_wind_make_112_runs_of_15_winds() -> None:
    winds = [Wind(angle, speed, speed) for angle in (0, 48.4, 77.9) for speed in (1, 2, 3, 4, 5)]
    runs = simulate_campaign(Tunnel(air=AIR), winds, rng=np.random.default_rng(3))

    assert len(runs) == 112
    assert [run.command for run in runs[:7]] == list(COMMANDS)
    assert all(run.max_mps == 0 and math.isnan(run.angle_deg) for run in runs[:7])


def test_standing_rotors_feel_no_wind_since_the_cell_was_zeroed_in_it() -> None:
    run = runs_of(Tunnel(air=AIR, cell=EXACT), SIDE)[3.0, 0]

    assert run.shown_rpm == 0
    np.testing.assert_allclose(run.force_n, 0, atol=1e-15)


def test_wind_along_the_bodys_x_pushes_on_two_axes_of_a_load_cell_that_is_turned() -> None:
    wind = SIDE._replace(azimuth_rad=0.0)
    runs = runs_of(Tunnel(air=AIR, cell=EXACT, unsteady=0.0), wind)
    drag = runs[3.0, 30000].force_n - runs[0.0, 30000].force_n
    speed_sum = 4 * runs[3.0, 30000].shown_rpm / 2 * math.tau / 60

    assert drag[0] == pytest.approx(-drag[1])
    assert math.hypot(drag[0], drag[1]) == pytest.approx(9e-7 * 3.0 * speed_sum)
    assert drag[0] < 0


def test_rotors_turn_a_little_faster_in_wind() -> None:
    runs = runs_of(Tunnel(air=AIR), SIDE)

    assert runs[0.0, 30000].shown_rpm == 27800
    assert 1.01 < runs[3.0, 30000].shown_rpm / 27800 < 1.02


def test_the_terms_of_the_complex_air_are_those_of_equation_4_5() -> None:
    velocity, speed = np.array([1.0, -2.0, 3.0]), 5.0
    terms = [speed * velocity, velocity**2, speed**2, velocity, speed, 1.0]
    for i, term in enumerate(terms):
        k = np.zeros((6, 3))
        k[i] = (7, 11, 13)
        np.testing.assert_allclose(ComplexAir(k=k).force_n(velocity, speed), k[i] * term)


def test_the_cross_coupled_air_lifts_when_flown_backwards_unless_it_is_mended() -> None:
    matrix = np.array([[-1, 0, 0], [0, -1, 0], [-0.7, -0.7, -1]])
    forward, backward = np.array([3.0, 4.0, 0.0]), np.array([-3.0, -4.0, 0.0])
    printed, mended = CrossAir(kg_per_rad=matrix), CrossAir(kg_per_rad=matrix, mended=True)

    assert [printed.force_n(v, 10)[2] for v in (forward, backward)] == pytest.approx([-49, 49])
    assert [mended.force_n(v, 10)[2] for v in (forward, backward)] == pytest.approx([-35, -35])


def test_readings_lie_apart_as_the_relative_deviation_says_and_the_wind_anywhere_between() -> None:
    (read,) = known_to(0.05, [Wind(90.0, 1.0, 5.0, azimuth_rad=0.0)])
    tunnel = Tunnel(air=AIR, cell=EXACT, unsteady=0.0)
    campaign = simulate_campaign(tunnel, [read] * 2000, rng=np.random.default_rng(3), commands=(40000,))
    forces = np.array([run.force_n[0] for run in campaign[1:]])

    assert (read.min_mps + read.max_mps) / 2 == pytest.approx(3.0)
    assert forces.std() / abs(forces.mean()) == pytest.approx(0.05, rel=0.05)
    assert np.ptp(forces) / abs(forces.mean()) == pytest.approx(math.sqrt(12) * 0.05, rel=0.01)


def test_all_commands_of_a_setting_feel_the_same_wind() -> None:
    runs = runs_of(Tunnel(air=AIR, cell=EXACT, unsteady=0.0), Wind(90.0, 2.0, 4.0))
    drag = {command: runs[4.0, command].force_n - runs[0.0, command].force_n for command in COMMANDS[1:]}
    ratio = [drag[command][0] / runs[4.0, command].shown_rpm for command in COMMANDS[1:]]

    np.testing.assert_allclose(ratio, ratio[0])


def test_means_scatter_by_the_stated_noise_and_by_drift_that_nobody_stated() -> None:
    runs = simulate_campaign(Tunnel(air=AIR), [SIDE] * 3000, rng=np.random.default_rng(3), commands=(0,))
    scatter = np.std([run.force_n for run in runs], axis=0)

    drift = 10.0 * np.abs(LoadCellTruth().drift_per_s[:3])
    np.testing.assert_allclose(scatter, np.hypot(runs[0].force_std_n, drift), rtol=0.05)


def test_a_record_holds_a_tare_and_then_the_force_that_the_means_have() -> None:
    tunnel = Tunnel(air=AIR, cell=EXACT, unsteady=0.0)
    run = runs_of(tunnel, SIDE)[3.0, 30000]
    time_s, counts = record(tunnel, SIDE, command=30000, rng=np.random.default_rng(3))
    force = counts[:, :3] / 1e6

    assert (len(time_s), time_s[1]) == (12000, 0.001)
    np.testing.assert_allclose(force[time_s > 4].mean(axis=0) - force[:500].mean(axis=0), run.force_n, atol=2e-6)


def test_equal_seeds_make_equal_campaigns_and_records() -> None:
    first, again, other = (runs_of(Tunnel(air=AIR), SIDE, seed=seed)[3.0, 40000].force_n for seed in (1, 1, 2))
    one, two = (record(Tunnel(air=AIR), SIDE, command=20000, rng=np.random.default_rng(1))[1] for _ in range(2))

    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    np.testing.assert_array_equal(one, two)
