"""A steady wind on the simulated vehicle: its forces on rotors and body."""

import math

import numpy as np
import pytest

from cfid.sim.propulsion import RotorTruth, SimulatedRotors, WindTruth

WIND = WindTruth(speed_mps=3.0, angle_deg=48.4)


def test_wind_from_above_presses_on_turning_rotors_along_z_alone() -> None:
    above = WindTruth(speed_mps=3.0, angle_deg=0.0)
    assert above.drag_ns_per_rad == pytest.approx([0, 0, 3 * -10.311e-7])


def test_what_the_load_cell_feels_is_turned_into_its_own_frame() -> None:
    across, azimuth = 3 * math.sin(math.radians(48.4)), math.radians(28.46)
    x, y = -9.1785e-7 * across * np.array([math.cos(azimuth), -math.sin(azimuth)])
    cos = math.cos(math.pi / 4)

    assert WIND.drag_ns_per_rad[:2] == pytest.approx([cos * (x + y), cos * (y - x)])
    assert WindTruth(speed_mps=3.0, angle_deg=48.4, yaw_deg=0.0).drag_ns_per_rad[:2] == pytest.approx([x, y])


def test_the_bodys_drag_grows_with_the_square_of_the_wind() -> None:
    twice = WIND.model_copy(update={"speed_mps": 6.0})
    assert twice.body_n == pytest.approx(4 * WIND.body_n)


def test_rotors_feel_the_wind_by_the_sum_of_their_speeds_and_only_while_they_turn() -> None:
    calm, windy = (
        SimulatedRotors(RotorTruth(), np.random.default_rng(3), drag_ns_per_rad=drag)
        for drag in ((0, 0, 0), WIND.drag_ns_per_rad)
    )
    time_s, commands = np.linspace(0, 2, 500), np.array([20000.0, 0, 40000, 0])
    for standing in (True, False):
        more = [rotors.advance(time_s + 3 * (not standing), commands * (not standing)) for rotors in (calm, windy)]
        felt = (more[1] - more[0])[-1]
        assert felt == pytest.approx(np.append(calm.speed_rad_per_s.sum() * WIND.drag_ns_per_rad, np.zeros(3)))
