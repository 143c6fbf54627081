"""Maps from Bitcraze's own measurements of the Crazyflie 2.0 (2015) and 2.1 (2021, IMRCLab/crazyflie-system-id)."""

import itertools

import numpy as np
import numpy.typing as npt
import pytest

from cfid.estimate.polynomials import fit_polynomial
from cfid.motors.maps.estimation import fit_speed, fit_thrust, fit_thrust_of_speed
from cfid.motors.maps.inverse import invert, maximum_thrust
from cfid.motors.points import MotorPoints
from cfid.recordings.stand import StandTable, read_stand, stand_of
from tests.motors.sentences import rejections, remarks
from tests.places import DATA

Array = npt.NDArray[np.float64]

OLD = DATA / "bitcraze_2015" / "cf20_pwm_thrust_2015.csv"
STEPS = DATA / "bitcraze_2021" / "cf21_stock2.csv"

needs_old = pytest.mark.skipif(not OLD.exists(), reason="Bitcraze's table of 2015 is not here (CFID_DATA)")
needs_steps = pytest.mark.skipif(not STEPS.exists(), reason="Bitcraze's stand record of 2021 is not here (CFID_DATA)")

EQ_3_3 = (2.130295e-11, 1.032633e-6, 5.484560e-4)


def points_of(table: StandTable) -> MotorPoints:
    return MotorPoints(
        command=table.command, thrust_n=table.thrust_n, speed_rad_s=np.asarray(table.square_mean_speed_rad_s)
    )


def steady(table: StandTable) -> MotorPoints:
    """Return the means over the last 0.3 s of every one-second step."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(table.command)) + 1, [len(table.command)]])
    tails = [slice(end - 30, end) for begin, end in itertools.pairwise(edges) if end - begin >= 90]
    whole = points_of(table)
    command, thrust, speed = (
        np.array([np.asarray(column)[tail].mean() for tail in tails])
        for column in (whole.command, whole.thrust_n, whole.speed_rad_s)
    )
    return MotorPoints(command=command, thrust_n=thrust, speed_rad_s=speed)


@needs_old
def test_the_published_polynomial_in_rpm_comes_out_to_four_digits() -> None:
    table = stand_of(read_stand(OLD))
    rpm = np.asarray(table.square_mean_speed_rad_s) * 60 / (2 * np.pi)
    total_g = np.asarray(table.thrust_n) * 4 / 9.81 * 1e3
    square, slope, level = fit_polynomial(rpm, total_g, order=2).coefficients

    assert f"{square:.4e} {slope:.4e} {level:.5f}" == "1.0942e-07 -2.1059e-04 0.15417"


@needs_old
@pytest.mark.parametrize("method", ["default", "thesis"])
def test_the_2015_propellers_have_k_of_2_22e_minus_8(method: str) -> None:
    found = fit_thrust_of_speed(points_of(stand_of(read_stand(OLD))), method=method)  # type: ignore[arg-type]
    print(f"k {method}: {found.k_n_s2:.4e} +- {found.k_std_n_s2:.1e}")

    assert f"{found.k_n_s2:.2e}" == "2.22e-08"
    assert not rejections(found)


@needs_old
def test_the_thesis_map_over_the_2015_table_is_0_85_to_1_03_from_an_eighth_of_the_command_on() -> None:
    table = stand_of(read_stand(OLD))
    there = table.command >= 0.125 * 65535
    ratio = np.polyval(EQ_3_3, table.command[there]) / np.asarray(table.thrust_n)[there]
    print("thesis over table:", ratio.round(3))

    assert f"{ratio.min():.2f} {ratio.max():.2f}" == "0.85 1.03"


@needs_old
def test_the_2015_table_makes_a_map_that_is_believed_and_a_mass_that_hovers() -> None:
    points = points_of(stand_of(read_stand(OLD)))
    thrust = fit_thrust(points)
    inverse = invert(thrust)

    assert not rejections(thrust)
    assert not rejections(fit_speed(points))
    assert thrust.left_out == (0,)
    assert inverse.round_trip_command < 0.1
    assert inverse.command_range[1] == 65535
    assert 0.060 < maximum_thrust(thrust, gravity_mps2=9.81).hover_mass_kg < 0.065  # 57.9 g at 93.75 %


@needs_old
def test_a_typo_in_the_2015_table_is_no_missing_command() -> None:
    # The table has 43.25 % where 43.75 % was meant.
    assert not any("missing" in said for said in remarks(fit_thrust(points_of(stand_of(read_stand(OLD))))))


@needs_steps
def test_steady_rows_of_the_2021_record_have_k_between_1_88_and_2_04e_minus_8() -> None:
    points = steady(stand_of(read_stand(STEPS)))
    found, plain = (fit_thrust_of_speed(points, method=method) for method in ("default", "thesis"))
    print(f"k: {found.k_n_s2:.3e} +- {found.k_std_n_s2:.1e}, unweighted {plain.k_n_s2:.3e}")

    assert len(points.command) == 16
    assert 1.88e-8 <= found.k_n_s2 <= 2.04e-8
    assert 1.88e-8 <= plain.k_n_s2 <= 2.04e-8
    assert not rejections(found)


@needs_steps
def test_the_2021_record_is_read_as_100_hz_and_as_one_of_four_motors() -> None:
    table = stand_of(read_stand(STEPS))

    assert (table.motors, table.speeds) == (4, "rotors")
    assert table.time_s is not None
    assert table.time_s[-1] == pytest.approx(17.34)
    assert table.speeds_rad_s is not None
    assert table.speeds_rad_s.shape == (1735, 4)
    assert "rate-assumed" in [one.code for one in table.findings]
