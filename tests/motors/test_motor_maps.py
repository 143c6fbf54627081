"""Maps of a motor: the thesis' equations from points on them, public measurements, refusals, and what cannot be."""

import itertools
import math
from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import FitError
from cfid.estimate.polynomials import fit_polynomial
from cfid.motors.maps.estimation import (
    fit_map,
    fit_thrust_of_speed,
    invert,
    maximum_thrust,
)
from cfid.motors.maps.scales import verify_thrust
from cfid.motors.points import Points, command_means, frame, joined, motor_table, rotor_speed_rad_s
from cfid.motors.weighing import scales_thrust_n
from cfid.recordings.stand import StandTable, read_stand, stand_of
from tests.lab import DATA

Array = npt.NDArray[np.float64]

COMMANDS = np.arange(0.0, 64001.0, 2000.0)
EQ_3_3 = (2.130295e-11, 1.032633e-6, 5.484560e-4)
EQ_3_4 = ((0.03950236, 420.9420), (0.04076521, 380.8359))
EQ_3_5 = (0.005964552, 1.563383e-5)
OLD = DATA / "bitcraze_2015" / "cf20_pwm_thrust_2015.csv"
STEPS = DATA / "bitcraze_2021" / "cf21_stock2.csv"

fit_thrust = partial(fit_map, "thrust")
fit_speed = partial(fit_map, "speed")
fit_torque = partial(fit_map, "torque")
needs_data = pytest.mark.skipif(not DATA.exists(), reason="Bitcraze's public measurements are not here (CFID_DATA)")


def made(command: Array = COMMANDS, *, series: int = 1) -> Points:
    """Return points on the thesis' three equations; a motor that stands still is zero in all of them."""
    running = command > 1000
    thrust = np.where(running, np.polyval(EQ_3_3, command), 0.0)
    return frame(
        command,
        thrust_n=thrust,
        torque_nm=np.where(running, np.polyval(EQ_3_5, thrust), 0.0),
        speed_rad_s=np.where(running, np.polyval(EQ_3_4[series], command), 0.0),
    )


def noisy(seed: int, *, relative: float = 2e-3) -> Points:
    """Return points with noise that grows with the measured value, and its standard uncertainties."""
    rng, points = np.random.default_rng(seed), made()
    for name, std_name, floor in (
        ("thrust_n", "thrust_std_n", 5e-5),
        ("torque_nm", "torque_std_nm", 1e-6),
        ("speed_rad_s", "speed_std_rad_s", 2.0),
    ):
        points[std_name] = np.where(points[name] > 0, floor + relative * points[name], 0.0)
        points[name] += points[std_name] * rng.standard_normal(len(points))
    return points


def running(points: Points) -> Points:
    """Leave out the first point: the motor stands still and has no torque, whereas eq. 3.5 has a constant."""
    return points[1:]


def codes(fit: object) -> dict[str, str]:
    return {finding.code: finding.severity for finding in fit.findings}  # type: ignore[attr-defined]


# The thesis' equations


def test_the_equations_come_back_to_their_last_printed_digit() -> None:
    for std in (None, 1e-4 + 1e-3 * COMMANDS / 65535):
        points = made() if std is None else made().assign(thrust_std_n=std)
        square, slope, level = fit_thrust(points).fit.coefficients
        assert f"{square:.6e} {slope:.6e} {level:.6e}" == "2.130295e-11 1.032633e-06 5.484560e-04"
    for series, printed in enumerate(("0.03950236 420.9420", "0.04076521 380.8359")):
        slope, level = fit_speed(made(series=series)).fit.coefficients
        assert f"{slope:.8f} {level:.4f}" == printed
    slope, level = fit_torque(running(made())).fit.coefficients
    assert f"{slope:.9f} {level:.6e}" == "0.005964552 1.563383e-05"


@pytest.mark.parametrize("times", [3.0, 8.0])
def test_scatter_is_stated_in_the_standard_uncertainties_that_were_given(times: float) -> None:
    points = running(noisy(3))
    points = points.assign(thrust_std_n=points["thrust_std_n"] / times)
    command, thrust, stated = (points[name].to_numpy() for name in ("command", "thrust_n", "thrust_std_n"))
    left = (thrust - np.polyval(np.polyfit(command, thrust, 2, w=1 / stated), command)) / stated
    expected = math.sqrt(left @ left / (len(left) - 3))

    assert expected == pytest.approx(times, rel=0.3)
    assert fit_thrust(points, robust=False).fit.inflation == pytest.approx(expected, rel=0.15)
    assert "map-points-scatter" in codes(fit_thrust(points))


def test_the_thesis_method_is_polyfit_without_command_2000_and_with_zero_at_command_0() -> None:
    points = noisy(2)
    kept = COMMANDS != 2000
    command = COMMANDS[kept]
    thrust, torque, speed = (
        np.where(command == 0, 0.0, points[name].to_numpy()[kept]) for name in ("thrust_n", "torque_nm", "speed_rad_s")
    )
    fits = [fit(points, method="thesis") for fit in (fit_thrust, fit_torque, fit_speed)]
    expected = [np.polyfit(command, thrust, 2), np.polyfit(thrust, torque, 1), np.polyfit(command, speed, 1)]
    for fit, coefficients in zip(fits, expected, strict=True):
        assert fit.fit.coefficients == pytest.approx(coefficients, rel=1e-9)
        assert (fit.left_out, len(fit.x)) == ((2000,), 32)
    assert fits[2].fit.residual_norm > 0.8 * EQ_3_4[1][1]  # the point of the standing motor is far below the line
    unmeasured = fit_thrust(made(COMMANDS[1:]), method="thesis")  # the zero is put where nobody measured command 0
    assert unmeasured.fit.coefficients == pytest.approx(fit_thrust(made(), method="thesis").fit.coefficients)


def test_uncertainties_of_the_thrust_count_in_the_torque_map_and_its_sign_does_not() -> None:
    points = noisy(8)
    torque = fit_torque(points)

    assert np.all(fit_torque(points.assign(thrust_std_n=5e-3)).fit.std > 2 * torque.fit.std)
    turned = fit_torque(points.assign(torque_nm=-points["torque_nm"]))
    assert turned.fit.coefficients == pytest.approx(torque.fit.coefficients)


def test_runs_of_thrust_and_of_speed_meet_in_one_table() -> None:
    thrusts = frame([0.0, 2000.0, 2000.0], thrust_n=[0.0, 0.25, 0.5], thrust_std_n=[0.2] * 3)
    points = joined(thrusts, frame([2000.0, 4000.0], speed_rad_s=[400.0, 500.0]))

    assert motor_table(points) == [
        {"cmd": 0.0, "thrust_n": 0.0, "torque_nm": None, "speed_rad_s": None, "windows": 1},
        {"cmd": 2000.0, "thrust_n": 0.375, "torque_nm": None, "speed_rad_s": 400.0, "windows": 3},
        {"cmd": 4000.0, "thrust_n": None, "torque_nm": None, "speed_rad_s": 500.0, "windows": 1},
    ]
    assert command_means(points)["thrust_std_n"][1] == pytest.approx(0.2 / math.sqrt(2))
    assert rotor_speed_rad_s([60_000.0], markers=2) == pytest.approx([math.pi / 60 * 60_000])  # eq. 3.2


# Speed to thrust


@pytest.mark.parametrize("apart", [False, True])
def test_thrust_of_speed_gives_k_with_its_uncertainty_and_the_quadratic(apart: bool) -> None:
    speed, rng = made()["speed_rad_s"].to_numpy(), np.random.default_rng(3)
    thrust = 2.2e-8 * speed**2 * (1 + 0.003 * rng.standard_normal(len(speed))) + 1e-5 * rng.standard_normal(len(speed))
    thrusts = frame(COMMANDS, thrust_n=thrust, thrust_std_n=1e-5 + 0.003 * thrust.clip(0))
    points = joined(thrusts, frame(COMMANDS, speed_rad_s=speed)) if apart else thrusts.assign(speed_rad_s=speed)
    fit = fit_thrust_of_speed(points)  # of two runs, thrust and speed are joined by command

    assert abs(fit.k_n_s2 - 2.2e-8) < 3 * fit.k_std_n_s2
    assert 0 < fit.k_std_n_s2 < 0.005 * fit.k_n_s2
    assert fit.quadratic.coefficients[0] == pytest.approx(2.2e-8, rel=0.05)
    assert fit.square_suffices
    assert codes(fit) == {}


def test_a_thrust_that_is_no_square_of_the_speed_is_a_warning() -> None:
    speed = made()["speed_rad_s"]
    fit = fit_thrust_of_speed(frame(COMMANDS, thrust_n=2e-8 * speed**2 + 5e-6 * speed, speed_rad_s=speed))
    furthest = np.abs(fit.square.at(speed) - 2e-8 * speed**2 - 5e-6 * speed).max()

    assert codes(fit) == {"thrust-not-square-of-speed": "warning"}
    assert fit.difference_n == pytest.approx(furthest, rel=1e-6)


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
    assert codes(inverse) == {}
    high = invert(fit_thrust(made(np.arange(30000.0, 64001.0, 2000.0))))
    assert codes(high) == {"inverse-extrapolated-below": "note"}
    with pytest.raises(FitError, match="of order 3 has no inverse in closed form: fit it with order 2 too"):
        invert(fit_thrust(made(), order=3))


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
    inverse = invert(fit_thrust(frame(command, thrust_n=np.polyval(curve, command))))
    inside = np.arange(command_range[0], command_range[1] + 1.0, 100.0)

    assert inverse.command_range == command_range
    assert inverse.command(np.polyval(curve, inside[1:-1])) == pytest.approx(inside[1:-1], abs=0.1)
    assert inverse.round_trip_command < 20  # single precision where the map is flat


def test_the_maximum_is_that_of_full_command_or_is_called_extrapolated() -> None:
    most = maximum_thrust(fit_thrust(noisy(4)), gravity_mps2=9.81)
    assert abs(most.thrust_n - np.polyval(EQ_3_3, 65535)) < 3 * most.std_n
    assert most.measured_command == 64000
    assert most.hover_mass_kg == pytest.approx(4 * most.thrust_n / 9.81)
    assert codes(most) == {}
    far, few = np.arange(0.0, 40001.0, 2000.0), np.array([20000.0, 22000.0, 24000.0])
    for command, severity in ((far, {"maximum-extrapolated": "warning"}), (few, {"maximum-open": "rejection"})):
        assert codes(maximum_thrust(fit_thrust(made(command)), gravity_mps2=9.81)) == severity


def test_a_thrust_beyond_the_points_widens_by_what_the_last_points_surprise() -> None:
    command = np.arange(4000.0, 48001.0, 4000.0)
    exact = np.polyval(EQ_3_3, command)
    std = 1e-5 + 1e-3 * exact
    noise = std * np.random.default_rng(0).standard_normal(len(command))
    even, bent = (  # no polynomial of order 2 describes the second
        maximum_thrust(fit_thrust(frame(command, thrust_n=factor * exact + noise, thrust_std_n=std)), gravity_mps2=9.81)
        for factor in (1.0, 1 - 0.1 * (command / 65535) ** 2)
    )
    assert even.beyond_std_n == 0
    assert bent.beyond_std_n > 10 * even.std_n
    assert abs(bent.thrust_n - 0.9 * float(np.polyval(EQ_3_3, 65535))) < 2 * bent.std_n


# Scales


@pytest.mark.parametrize(("sense", "tare_g"), [(-1, 0.0), (1, 412.3)])
def test_scales_give_one_motors_newtons_and_the_difference_to_the_map(sense: int, tare_g: float) -> None:
    command = np.arange(0.0, 64001.0, 4000.0)
    truth = made(command)["thrust_n"].to_numpy()
    grams = tare_g + sense * 2 * truth / 9.81 * 1e3 * 1.01
    thrust = scales_thrust_n(command, grams, motors=2, gravity_mps2=9.81)
    check, half, near = (
        verify_thrust(fit_thrust(made()), command=command, thrust_n=thrust_n)
        for thrust_n in (thrust, 0.5 * truth, 0.93 * truth)
    )
    assert thrust == pytest.approx(1.01 * truth, abs=1e-12)
    assert check.difference_n[0] == 0
    assert (check.rms_percent, check.gain) == pytest.approx((1, 1.01), rel=1e-6)
    assert check.rms_n == pytest.approx(0.01 * math.sqrt(np.mean(truth[1:] ** 2)), rel=1e-6)
    assert codes(half) == {"scales-differ": "warning"}
    assert codes(near) == {}
    stated = verify_thrust(fit_thrust(made()), command=command, thrust_n=thrust, scale_stds=(3e-3, 4e-3))
    assert stated.gain_std**2 == pytest.approx(check.gain_std**2 + (5e-3 * check.gain) ** 2)


# Points that allow no map


SPEED = np.where(COMMANDS > 1000, 0.04076521 * COMMANDS + 380.8359, 0.0)
THRUST = 1.9e-8 * SPEED**2
POINTS = frame(COMMANDS, thrust_n=THRUST, torque_nm=0.006 * THRUST, speed_rad_s=SPEED)
NOISE = 2e-4 * np.random.default_rng(1).standard_normal(len(COMMANDS))
LOW = frame(np.arange(0, 1001, 250.0), thrust_n=np.zeros(5), speed_rad_s=np.zeros(5))
EVEN = np.arange(len(COMMANDS)) % 2 == 0
APART = frame(COMMANDS, thrust_n=np.where(EVEN, THRUST, np.nan), speed_rad_s=np.where(EVEN, np.nan, SPEED))
STILL = frame(np.arange(4000.0, 20001, 4000), speed_rad_s=np.full(5, 544.5))


@pytest.mark.parametrize(
    ("fit", "points", "reason"),
    [
        *((fit, POINTS.assign(thrust_n=NOISE - THRUST), r"negative throughout, down to -0\.1\d+ N: Fz counts downwards")
          for fit in (fit_thrust, fit_torque, fit_thrust_of_speed)),
        (fit_thrust, POINTS.assign(thrust_n=NOISE), "never ran: above command 1000 the largest thrust is 0"),
        (fit_speed, POINTS.assign(speed_rad_s=0.0), "never ran: above command 1000 the largest speed is 0 rad/s"),
        (fit_thrust, LOW, "no command above 1000 was measured"),
        (fit_speed, LOW, "no command above 1000 was measured"),
        (fit_torque, frame(COMMANDS, thrust_n=THRUST), "no known column of torque_nm: it was not measured"),
        (fit_torque, POINTS.assign(torque_nm=np.nan), "turn against each other"),
        (fit_thrust_of_speed, frame(COMMANDS, thrust_n=THRUST), "no known column of speed_rad_s"),
        (fit_thrust_of_speed, APART, "no command has both speed_rad_s and thrust_n"),
        (fit_thrust, made(np.array([10000.0, 60000.0])), "2 points are too few for a polynomial of order 2"),
        (fit_speed, STILL, r"544\.5 rad/s at every command from 4000 to 20000: the instrument's display"),
    ],
)  # fmt: skip
def test_points_that_allow_no_map_are_refused(fit: Callable[[Points], object], points: Points, reason: str) -> None:
    with pytest.raises(FitError, match=reason):
        fit(points)


def test_a_map_that_does_not_describe_its_points_or_falls_is_rejected() -> None:
    steps = np.where(COMMANDS > 30000, 0.15, 0.02)
    bent = 0.1 - 0.1 * ((COMMANDS - 40000) / 40000) ** 2

    assert codes(fit_thrust(frame(COMMANDS, thrust_n=steps)))["map-misfit"] == "rejection"
    assert codes(fit_thrust(frame(COMMANDS, thrust_n=bent)))["map-not-monotone"] == "rejection"


def test_a_line_through_two_points_is_as_uncertain_as_a_map_may_miss_its_points() -> None:
    """The windows of the two points alone show nothing about the line between them."""
    two = made(np.array([20000.0, 30000.0]))
    known, unknown = fit_torque(two.assign(torque_std_nm=1e-7, thrust_std_n=1e-7)), fit_torque(two)

    assert known.fit.confidence([float(known.x[1])])[0] > 0.09 * float(two["torque_nm"].max())
    for fit, taken in ((known, True), (unknown, False)):
        assert codes(fit) == {"map-without-freedom": "warning"}  # two points show no scatter
        assert fit.findings[0].text.endswith("as far as a map may miss its points.") == taken


def test_two_exchanged_commands_are_rejected_or_count_little() -> None:
    command = COMMANDS[1:]
    thrust, accepted = np.polyval(EQ_3_3, command), 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        sound = thrust * (1 + 0.003 * rng.standard_normal(len(thrust)))
        pair = np.sort(rng.choice(len(thrust), 2, replace=False))
        exchanged = sound.copy()
        exchanged[pair] = sound[pair[::-1]]
        mapped = fit_thrust(frame(command, thrust_n=exchanged))
        if "rejection" not in codes(mapped).values():
            accepted += 1
            off = np.abs(mapped.fit.at(command) - thrust)
            assert set(command[pair]) <= set(mapped.command[mapped.fit.weight < 0.34])
            assert off.max() < 0.003 * thrust.max()
            assert np.all(off < 4 * mapped.fit.std_at(command))
    print(f"{accepted} of 50 accepted")


# Bitcraze's measurements of the Crazyflie 2.0 (2015) and 2.1 (2021, IMRCLab/crazyflie-system-id)


def points_of(table: StandTable) -> Points:
    return frame(table.command, thrust_n=table.thrust_n, speed_rad_s=table.square_mean_speed_rad_s)


@needs_data
def test_the_table_of_2015_gives_its_published_polynomial_and_a_map_that_hovers() -> None:
    table = stand_of(read_stand(OLD))
    points = points_of(table)
    rpm = points["speed_rad_s"].to_numpy() * 60 / (2 * np.pi)
    square, slope, level = fit_polynomial(rpm, points["thrust_n"].to_numpy() * 4 / 9.81 * 1e3, order=2).coefficients
    assert f"{square:.4e} {slope:.4e} {level:.5f}" == "1.0942e-07 -2.1059e-04 0.15417"

    from_eighth = points[points["command"] >= 0.125 * 65535]
    ratio = np.polyval(EQ_3_3, from_eighth["command"]) / from_eighth["thrust_n"]
    assert f"{ratio.min():.2f} {ratio.max():.2f}" == "0.85 1.03"

    thrust = fit_thrust(points)
    assert {**codes(thrust), **codes(fit_speed(points))} == {}
    assert thrust.left_out == (0,)
    assert invert(thrust).command_range[1] == 65535
    assert 0.060 < maximum_thrust(thrust, gravity_mps2=9.81).hover_mass_kg < 0.065  # 57.9 g at 93.75 %
    for fit in (fit_thrust_of_speed(points), fit_thrust_of_speed(points, method="thesis")):
        assert f"{fit.k_n_s2:.2e}" == "2.22e-08"
        assert "rejection" not in codes(fit).values()


@needs_data
def test_steady_rows_of_the_2021_record_have_k_between_1_88_and_2_04e_minus_8() -> None:
    table = stand_of(read_stand(STEPS))
    edges = np.concatenate([[0], np.flatnonzero(np.diff(table.command)) + 1, [len(table.command)]])
    tails = [slice(end - 30, end) for begin, end in itertools.pairwise(edges) if end - begin >= 90]
    points = points_of(table)
    means = {name: [points[name][tail].mean() for tail in tails] for name in ("thrust_n", "speed_rad_s")}
    steady = frame([points["command"][tail].mean() for tail in tails]).assign(**means)

    assert len(steady) == 16
    for fit in (fit_thrust_of_speed(steady), fit_thrust_of_speed(steady, method="thesis")):
        assert 1.88e-8 <= fit.k_n_s2 <= 2.04e-8
        assert "rejection" not in codes(fit).values()
    assert (table.motors, table.speeds, table.speeds_rad_s is not None) == (4, "rotors", True)
    assert table.time_s is not None
    assert table.time_s[-1] == pytest.approx(17.34)
