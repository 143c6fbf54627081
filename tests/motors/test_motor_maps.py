"""Maps of a motor: recovery of the thesis' equations from points on them, the thesis method, and findings."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import FitError
from cfid.motors.maps.estimation import MotorMap, fit_speed, fit_thrust, fit_thrust_of_speed, fit_torque
from cfid.motors.maps.inverse import hover_mass_kg, invert, maximum_thrust
from cfid.motors.maps.scales import scales_findings, scales_thrust_n, verify_thrust
from cfid.motors.points import MotorPoints, TableRow, command_means, joined, motor_table, per_motor, rotor_speed_rad_s
from tests.motors.sentences import rejections, remarks

Array = npt.NDArray[np.float64]

COMMANDS = np.arange(0.0, 64001.0, 2000.0)
EQ_3_3 = (2.130295e-11, 1.032633e-6, 5.484560e-4)
EQ_3_4 = ((0.03950236, 420.9420), (0.04076521, 380.8359))
EQ_3_5 = (0.005964552, 1.563383e-5)


def made(command: Array = COMMANDS, *, series: int = 1) -> MotorPoints:
    """Return points on the thesis' three equations; a motor that stands still is zero in all of them."""
    running = command > 1000
    thrust = np.where(running, np.polyval(EQ_3_3, command), 0.0)
    return MotorPoints(
        command=command,
        thrust_n=thrust,
        torque_nm=np.where(running, np.polyval(EQ_3_5, thrust), 0.0),
        speed_rad_s=np.where(running, np.polyval(EQ_3_4[series], command), 0.0),
    )


def running(points: MotorPoints) -> MotorPoints:
    """Leave out the first point: the motor stands still and has no torque, whereas eq. 3.5 has a constant."""
    columns: dict[str, Any] = {name: column for name, column in vars(points).items() if column is not None}
    return MotorPoints(**{name: column[1:] for name, column in columns.items()})


def noisy(seed: int, *, relative: float = 2e-3) -> MotorPoints:
    """Return points with noise that grows with the measured value, and its standard uncertainties."""
    rng, exact = np.random.default_rng(seed), made()
    columns: dict[str, Array] = {}
    for name, std_name, floor in (
        ("thrust_n", "thrust_std_n", 5e-5),
        ("torque_nm", "torque_std_nm", 1e-6),
        ("speed_rad_s", "speed_std_rad_s", 2.0),
    ):
        value = getattr(exact, name)
        columns[std_name] = np.where(value > 0, floor + relative * value, 0.0)
        columns[name] = value + columns[std_name] * rng.standard_normal(len(value))
    return dataclasses.replace(exact, **columns)


# The thesis' equations


@pytest.mark.parametrize("with_deviations", [False, True])
def test_equation_3_3_comes_back_to_its_last_printed_digit(with_deviations: bool) -> None:
    points = dataclasses.replace(made(), thrust_std_n=1e-4 + 1e-3 * COMMANDS / 65535 if with_deviations else None)
    square, slope, level = fit_thrust(points).fit.coefficients

    assert f"{square:.6e} {slope:.6e} {level:.6e}" == "2.130295e-11 1.032633e-06 5.484560e-04"


@pytest.mark.parametrize("series", [0, 1])
def test_both_series_of_equation_3_4_come_back_to_their_last_printed_digit(series: int) -> None:
    slope, level = fit_speed(made(series=series)).fit.coefficients

    assert f"{slope:.8f} {level:.4f}" == ("0.03950236 420.9420", "0.04076521 380.8359")[series]


def test_equation_3_5_comes_back_to_its_last_printed_digit() -> None:
    slope, level = fit_torque(running(made())).fit.coefficients

    assert f"{slope:.9f} {level:.6e}" == "0.005964552 1.563383e-05"


def test_the_equations_lie_within_four_deviations_of_what_noisy_points_give() -> None:
    points = noisy(1)
    torque = fit_torque(running(points))
    for found, truth in ((fit_thrust(points), EQ_3_3), (fit_speed(points), EQ_3_4[1]), (torque, EQ_3_5)):
        assert np.all(np.abs(found.fit.coefficients - truth) < 3 * found.fit.std), found.quantity
        assert not rejections(found)


@pytest.mark.parametrize("times", [3.0, 8.0])
def test_scatter_is_stated_in_the_standard_uncertainties_that_were_given(times: float) -> None:
    sound = running(noisy(3))
    stated = np.asarray(sound.thrust_std_n) / times
    points = dataclasses.replace(sound, thrust_std_n=stated)
    command, thrust = np.asarray(points.command), np.asarray(points.thrust_n)
    left = (thrust - np.polyval(np.polyfit(command, thrust, 2, w=1 / stated), command)) / stated
    expected = math.sqrt(left @ left / (len(left) - 3))

    assert expected == pytest.approx(times, rel=0.3)
    assert fit_thrust(points, robust=False).fit.inflation == pytest.approx(expected, rel=0.15)


MAPS: dict[str, tuple[Callable[[MotorPoints], MotorMap], Array, tuple[float, ...]]] = {
    "thrust": (fit_thrust, COMMANDS[1:], EQ_3_3),
    "speed": (fit_speed, COMMANDS[1:], EQ_3_4[1]),
    "torque": (fit_torque, np.polyval(EQ_3_3, COMMANDS[1:]), EQ_3_5),
}


@pytest.mark.parametrize(
    "quantity", ["thrust", *(pytest.param(one, marks=pytest.mark.slow) for one in ("speed", "torque"))]
)
def test_the_95_percent_band_holds_the_true_map_in_93_to_97_of_100_noisy_staircases(quantity: str) -> None:
    fit, x, equation = MAPS[quantity]
    maps = [fit(running(noisy(seed))).fit for seed in range(400)]
    held = np.mean([np.abs(one.at(x) - np.polyval(equation, x)) <= one.confidence(x) for one in maps])
    print(f"{quantity}: {held:.3f}")

    assert 0.93 <= held <= 0.97


def test_the_thesis_method_is_polyfit_without_command_2000_and_with_zero_at_command_0() -> None:
    points = noisy(2)
    thrust, torque, speed = (np.asarray(column) for column in (points.thrust_n, points.torque_nm, points.speed_rad_s))
    kept = COMMANDS != 2000
    command = COMMANDS[kept]
    zeroed = [np.where(command == 0, 0.0, column[kept]) for column in (thrust, torque, speed)]

    found = [fit(points, method="thesis") for fit in (fit_thrust, fit_torque, fit_speed)]
    expected = [
        np.polyfit(command, zeroed[0], 2),
        np.polyfit(zeroed[0], zeroed[1], 1),
        np.polyfit(command, zeroed[2], 1),
    ]
    for one, coefficients in zip(found, expected, strict=True):
        assert one.fit.coefficients == pytest.approx(coefficients, rel=1e-9)
        assert one.left_out == (2000,)
        assert "command 2000 is left out and command 0 is a point at zero" in " ".join(remarks(one))
        assert len(one.x) == 32
    assert found[2].fit.residual_norm > 0.8 * EQ_3_4[1][1]  # the point of the standing motor is far below the line


def test_the_thesis_method_puts_the_zero_where_nobody_measured_command_0() -> None:
    with_zero = fit_thrust(made(), method="thesis").fit.coefficients

    assert fit_thrust(made(COMMANDS[1:]), method="thesis").fit.coefficients == pytest.approx(with_zero)


def test_the_default_leaves_the_dead_zone_out_of_thrust_and_speed_and_says_so() -> None:
    command = np.concatenate([[0.0, 500.0, 1000.0], COMMANDS[1:]])
    for found in (fit_thrust(made(command)), fit_speed(made(command))):
        assert found.left_out == (0, 500, 1000)
        assert "up to command 1000 the motor stands (dead zone)" in remarks(found)[0]
        assert "3 points there are left out" in remarks(found)[0]
    assert fit_torque(made(command)).left_out == ()


def test_a_dead_zone_in_which_no_point_lies_is_not_spoken_of() -> None:
    assert not any("dead zone" in remark for remark in remarks(fit_thrust(made(COMMANDS[1:]))))


def test_order_auto_takes_what_the_points_have_and_tells_all_criteria() -> None:
    found = fit_thrust(noisy(5), order="auto")

    assert found.fit.order == 2
    assert min(found.aicc, key=lambda order: found.aicc[order]) == 2
    assert set(found.aicc) == {1, 2, 3, 4}
    assert fit_speed(noisy(5), order="auto").fit.order == 1


def test_a_wild_window_hardly_moves_the_map_and_is_named() -> None:
    points = noisy(6)
    wild = dataclasses.replace(points, thrust_n=np.where(COMMANDS == 30000, 0.0, np.asarray(points.thrust_n)))
    found, without = fit_thrust(wild), fit_thrust(points)

    assert found.fit.at(COMMANDS[1:]) == pytest.approx(without.fit.at(COMMANDS[1:]), rel=5e-3)
    assert any(said.startswith("command 30000 is off by more") for said in remarks(found))


def test_deviations_of_zero_and_unknown_ones_are_no_infinite_weight() -> None:
    std = np.full(len(COMMANDS), 1e-4)
    std[3], std[4] = 0.0, math.nan
    points = dataclasses.replace(noisy(7), thrust_std_n=std)

    assert np.all(np.isfinite(fit_thrust(points).fit.std))


def test_deviations_of_the_thrust_count_in_the_torque_map() -> None:
    points = noisy(8)
    rough = dataclasses.replace(points, thrust_std_n=np.full(len(COMMANDS), 5e-3))

    assert np.all(fit_torque(rough).fit.std > 2 * fit_torque(points).fit.std)


def test_a_torque_that_points_down_is_fitted_by_magnitude_and_that_is_said() -> None:
    points = made()
    assert points.torque_nm is not None
    found = fit_torque(dataclasses.replace(points, torque_nm=-points.torque_nm))

    assert found.fit.coefficients == pytest.approx(fit_torque(points).fit.coefficients)
    assert "Its magnitude is fitted" in remarks(found)[0]


# Points


def test_thrust_and_torque_are_divided_by_the_motors_that_ran_and_speed_is_not() -> None:
    two = MotorPoints(command=np.ones(1), thrust_n=np.ones(1), torque_std_nm=np.ones(1), speed_rad_s=np.ones(1))
    one = per_motor(two, motors=2)

    assert [one.thrust_n, one.torque_std_nm, one.speed_rad_s] == [pytest.approx([value]) for value in (0.5, 0.5, 1.0)]
    assert one.torque_nm is None


def test_a_tachometer_that_sees_two_markers_shows_twice_the_turns() -> None:
    assert rotor_speed_rad_s([60_000.0], markers=2) == pytest.approx([math.pi / 60 * 60_000])  # eq. 3.2


def test_runs_of_thrust_and_of_speed_meet_in_one_table() -> None:
    thrusts = MotorPoints(command=np.array([0.0, 2000.0, 2000.0]), thrust_n=np.array([0.0, 0.25, 0.5]))
    speeds = MotorPoints(command=np.array([2000.0, 4000.0]), speed_rad_s=np.array([400.0, 500.0]))

    assert motor_table(joined(thrusts, speeds)) == (
        TableRow(cmd=0.0, thrust_n=0.0, torque_nm=None, speed_rad_s=None, windows=1),
        TableRow(cmd=2000.0, thrust_n=0.375, torque_nm=None, speed_rad_s=400.0, windows=3),
        TableRow(cmd=4000.0, thrust_n=None, torque_nm=None, speed_rad_s=500.0, windows=1),
    )


def test_the_deviation_of_a_commands_mean_is_that_of_its_windows_together() -> None:
    points = MotorPoints(command=np.ones(4), thrust_n=np.arange(4.0), thrust_std_n=np.full(4, 0.2))

    assert command_means(points).thrust_std_n == pytest.approx([0.1])


# Speed to thrust


@pytest.mark.parametrize("apart", [False, True])
def test_thrust_of_speed_gives_k_with_its_deviation_and_the_quadratic(apart: bool) -> None:
    speed = np.asarray(made().speed_rad_s)
    rng = np.random.default_rng(3)
    thrust = 2.2e-8 * speed**2 * (1 + 0.003 * rng.standard_normal(len(speed))) + 1e-5 * rng.standard_normal(len(speed))
    std = 1e-5 + 0.003 * thrust.clip(0)
    points = MotorPoints(command=COMMANDS, thrust_n=thrust, thrust_std_n=std, speed_rad_s=speed)
    if apart:  # thrust and speed come from different runs and are joined by command
        points = joined(
            MotorPoints(command=COMMANDS, thrust_n=thrust, thrust_std_n=std),
            MotorPoints(command=COMMANDS, speed_rad_s=speed),
        )
    found = fit_thrust_of_speed(points)

    assert abs(found.k_n_s2 - 2.2e-8) < 3 * found.k_std_n_s2
    assert 0 < found.k_std_n_s2 < 0.005 * found.k_n_s2
    assert found.quadratic.coefficients[0] == pytest.approx(2.2e-8, rel=0.05)
    assert found.square_suffices
    assert not rejections(found)


def test_a_thrust_that_is_no_square_of_the_speed_is_told() -> None:
    speed = np.asarray(made().speed_rad_s)
    found = fit_thrust_of_speed(
        MotorPoints(command=COMMANDS, thrust_n=2e-8 * speed**2 + 5e-6 * speed, speed_rad_s=speed)
    )

    assert not found.square_suffices
    assert found.difference_n == pytest.approx(
        np.abs(found.square.at(speed) - 2e-8 * speed**2 - 5e-6 * speed).max(), rel=1e-6
    )
    assert "k w^2 differs from the full quadratic by up to" in remarks(found)[0]


# Maps for a controller


def test_the_inverse_gives_each_command_back_within_a_tenth_and_its_thrust_within_half_a_command() -> None:
    inverse = invert(fit_thrust(made()))
    commands = np.arange(1000, 65536)

    assert inverse.command_range == (1000, 65535)
    assert inverse.thrust_range_n == pytest.approx(np.polyval(EQ_3_3, [1000, 65535]))
    assert inverse.command(np.polyval(EQ_3_3, commands[1:-1])) == pytest.approx(commands[1:-1], abs=1e-6)
    assert 1e-3 < inverse.round_trip_command < 0.1  # the error of single precision
    assert inverse.round_trip_n == pytest.approx(0.5 * (2 * EQ_3_3[0] * 65535 + EQ_3_3[1]), rel=1e-3)
    assert np.isnan(inverse.command([-0.01, 0.0, 0.2])).all()


@pytest.mark.parametrize(
    ("curve", "command_range"),
    [
        ((0.0, 2e-6, 0.0), (1000, 65535)),  # a line
        ((2e-11, -4e-7, 3e-3), (10001, 65535)),  # falls at first
        ((2e-11, 1e-6, -5.2e-3), (4749, 65535)),  # below zero at first
        ((-2e-11, 2e-6, 1e-3), (1000, 49999)),  # falls at the end
    ],
)
def test_the_inverse_ends_where_the_map_no_longer_rises_above_zero(
    curve: tuple[float, float, float], command_range: tuple[int, int]
) -> None:
    command = COMMANDS[1:]
    thrust = np.polyval(curve, command)
    inverse = invert(fit_thrust(MotorPoints(command=command, thrust_n=thrust)))
    inside = np.arange(command_range[0], command_range[1] + 1.0, 100.0)

    assert inverse.command_range == command_range
    assert inverse.command(np.polyval(curve, inside[1:-1])) == pytest.approx(inside[1:-1], abs=0.1)
    assert inverse.round_trip_command < 20  # single precision where the map is flat


def test_an_inverse_below_what_was_measured_is_called_extrapolated() -> None:
    assert invert(fit_thrust(made())).findings == ()
    assert "extrapolated below 30000" in remarks(invert(fit_thrust(made(np.arange(30000.0, 64001.0, 2000.0)))))[0]


def test_an_order_without_a_closed_inverse_is_refused_with_the_next_step() -> None:
    with pytest.raises(FitError, match="of order 3 has no inverse in closed form: fit it with order 2 too"):
        invert(fit_thrust(made(), order=3))


def test_the_maximum_is_that_of_full_command_and_carries_what_section_3_3_1_says() -> None:
    found = maximum_thrust(fit_thrust(noisy(4)), gravity_mps2=9.81)

    assert abs(found.thrust_n - np.polyval(EQ_3_3, 65535)) < 3 * found.std_n
    assert found.measured_command == 64000
    assert found.hover_mass_kg == pytest.approx(4 * found.thrust_n / 9.81)
    assert found.findings == ()
    assert f"{1e3 * hover_mass_kg(thrust_n=0.15, gravity_mps2=9.81):.2f}" == "61.16"


def test_a_maximum_far_from_what_was_measured_is_called_extrapolated() -> None:
    thrust = fit_thrust(made(np.arange(0.0, 40001.0, 2000.0)))

    assert "extrapolated: 40000" in remarks(maximum_thrust(thrust, gravity_mps2=9.81))[0]


def test_a_maximum_that_three_points_far_below_leave_open_is_rejected() -> None:
    few = fit_thrust(made(np.array([20000.0, 22000.0, 24000.0])))
    (finding,) = maximum_thrust(few, gravity_mps2=9.81).findings

    assert (finding.code, finding.severity) == ("maximum-open", "rejection")
    assert "24000 is the largest that was measured, and of unknown uncertainty" in finding.text


# Scales


@pytest.mark.parametrize("sense", [-1, 1])
@pytest.mark.parametrize("tare_g", [0.0, 412.3])
def test_scales_give_one_motors_newtons_and_the_difference_to_the_map(sense: int, tare_g: float) -> None:
    command = np.arange(0.0, 64001.0, 4000.0)
    truth = np.asarray(made(command).thrust_n)
    grams = tare_g + sense * 2 * truth / 9.81 * 1e3 * 1.01
    thrust = scales_thrust_n(command, grams, motors=2, gravity_mps2=9.81)
    found = verify_thrust(fit_thrust(made()), command=command, thrust_n=thrust)

    assert thrust == pytest.approx(1.01 * truth, abs=1e-12)
    assert found.percent[1:] == pytest.approx(np.ones(16), rel=1e-6)
    assert math.isnan(found.percent[0])
    assert found.difference_n[0] == 0
    assert found.rms_n == pytest.approx(0.01 * math.sqrt(np.mean(truth[1:] ** 2)), rel=1e-6)
    assert found.rms_percent == pytest.approx(1, rel=1e-6)


def test_scales_without_a_reading_of_standing_motors_are_refused() -> None:
    with pytest.raises(FitError, match="readings at command 0 and above 1000 are needed, and these are from 4000 to"):
        scales_thrust_n(COMMANDS[2:], COMMANDS[2:], motors=2, gravity_mps2=9.81)


def test_scales_whose_display_stands_still_are_refused() -> None:
    command = np.arange(0.0, 40001.0, 10000.0)
    with pytest.raises(FitError, match="the scales show 60 to 60 g at every command from 0 to 40000: the"):
        scales_thrust_n(command, np.full(5, 60.0), motors=2, gravity_mps2=9.81)


def test_a_slip_among_the_readings_of_scales_is_named() -> None:
    command, grams = np.arange(0.0, 40001.0, 10000.0), np.array([60, 59, 57.5, 90, 53])
    with pytest.raises(FitError, match="the reading 90 g at command 30000 is off the curve through the others"):
        scales_thrust_n(command, grams, motors=2, gravity_mps2=9.81)


@pytest.mark.parametrize("step_g", [0.1, 1.0])
def test_scales_with_a_coarse_display_are_taken(step_g: float) -> None:
    for step in (4000.0, 8000.0, 10000.0):
        command = np.arange(0.0, 64001.0, step)
        grams = step_g * np.round((60 - 2 * np.asarray(made(command).thrust_n) / 9.81 * 1e3) / step_g)
        assert scales_thrust_n(command, grams, motors=2, gravity_mps2=9.81)[-1] > 0.05


def test_scales_that_show_half_of_the_maps_thrust_are_a_warning_with_the_limit() -> None:
    command = np.arange(0.0, 64001.0, 4000.0)
    truth = np.asarray(made(command).thrust_n)
    found, close = (verify_thrust(fit_thrust(made()), command=command, thrust_n=part * truth) for part in (0.5, 0.93))

    (finding,) = scales_findings(found)
    assert (finding.code, finding.severity) == ("scales-differ", "warning")
    assert "(limit 10 %), and show 0.50 times the map's thrust" in finding.text
    assert not scales_findings(close)


def test_a_line_through_two_points_is_as_uncertain_as_a_map_may_miss_its_points() -> None:
    """The windows of the two points alone show nothing about the line between them."""
    two = made(np.array([20000.0, 30000.0]))
    tiny = np.full(2, 1e-7)
    known = fit_torque(dataclasses.replace(two, torque_std_nm=tiny, thrust_std_n=tiny))
    unknown = fit_torque(two)
    largest = float(np.max(np.asarray(two.torque_nm)))

    assert known.fit.confidence([float(known.x[1])])[0] > 0.09 * largest
    assert not any(one.code == "map-points-scatter" for one in known.findings)  # two points show no scatter
    for found, taken in ((known, True), (unknown, False)):
        (finding,) = [one for one in found.findings if one.code == "map-without-freedom"]
        assert finding.text.endswith("as far as a map may miss its points.") == taken
