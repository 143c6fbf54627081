"""Conventions of wind and frames: the vehicle's motion through the air, and the meaning of wind readings."""

import math

import numpy as np
import pytest

from cfid.drag.wind.frames import std_turned_about_z, velocity_in_air, wind_speed
from cfid.motors.points import rotor_speed_rad_s
from cfid.recordings.wrench import turn_about_z
from cfid.units import ROTORS


def test_wind_from_above_is_a_climb() -> None:
    np.testing.assert_allclose(velocity_in_air(speed_mps=2.0, angle_rad=0.0, azimuth_rad=0.4967), [0, 0, 2])


def test_wind_from_the_side_is_flight_forward_and_to_the_right() -> None:
    x, y, z = velocity_in_air(speed_mps=3.0, angle_rad=math.pi / 2, azimuth_rad=0.4967)

    assert (x, y) == pytest.approx((3 * math.cos(0.4967), -3 * math.sin(0.4967)))
    assert x > -y > 0
    assert z == pytest.approx(0)


def test_the_angle_is_that_to_the_vertical_and_the_speed_is_kept() -> None:
    speeds, angles = np.array([1.4, 4.15, 3.75]), np.radians([0, 48.4, 77.9])
    velocity = velocity_in_air(speed_mps=speeds, angle_rad=angles, azimuth_rad=0.4967)

    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), speeds)
    np.testing.assert_allclose(velocity[:, 2], speeds * np.cos(angles))


def test_uncertainties_turn_as_those_of_independent_axes() -> None:
    rng = np.random.default_rng(5)
    std = np.array([0.3, 1.2, 0.7])
    drawn = turn_about_z(std * rng.standard_normal((200_000, 3)), yaw_deg=34.4)

    np.testing.assert_allclose(std_turned_about_z(std, yaw_deg=34.4), drawn.std(axis=0), rtol=0.01)


def test_wind_is_the_middle_of_its_readings_and_uniformly_distributed_between_them() -> None:
    rng = np.random.default_rng(5)
    mean, std = wind_speed(min_mps=[2.8, 1.5], max_mps=[3.6, 1.5])

    np.testing.assert_allclose(mean, [3.2, 1.5])
    np.testing.assert_allclose(std, [float(rng.uniform(2.8, 3.6, 200_000).std()), 0], rtol=0.01)


def test_four_rotors_turn_at_half_of_what_a_tachometer_shows_of_two_markers() -> None:
    shown = [15400, 21900, 27800, 31600, 33400, 39300]

    assert ROTORS * rotor_speed_rad_s(shown, markers=2).mean() == pytest.approx(5913.2, abs=0.05)
    assert rotor_speed_rad_s(60, markers=1) == pytest.approx(2 * math.pi)
