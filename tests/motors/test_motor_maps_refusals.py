"""Points that are faulty or that allow no map: each case with its message."""

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import FitError
from cfid.findings import texts
from cfid.motors.maps.checks import marker_findings, missing_commands
from cfid.motors.maps.estimation import fit_speed, fit_thrust, fit_thrust_of_speed, fit_torque
from cfid.motors.points import MotorPoints
from tests.motors.sentences import rejections, remarks

Array = npt.NDArray[np.float64]

COMMANDS = np.arange(0.0, 64001.0, 2000.0)
SPEED = np.where(COMMANDS > 1000, 0.04076521 * COMMANDS + 380.8359, 0.0)
THRUST = 1.9e-8 * SPEED**2
POINTS = MotorPoints(command=COMMANDS, thrust_n=THRUST, torque_nm=0.006 * THRUST, speed_rad_s=SPEED)


def markers(*points: Any) -> tuple[str, ...]:
    """Return the reasons that reject speeds; every finding concerns the speed map and rejects it."""
    found = marker_findings(*points, quantities=("motor.speed_poly",))
    assert all(one.code in ("speed-marker-count", "speed-unusual") and one.severity == "rejection" for one in found)
    assert all(one.quantities == ("motor.speed_poly",) for one in found)
    return texts(found, "rejection")


def test_a_thrust_that_is_negative_throughout_is_said_to_have_the_wrong_sign() -> None:
    noise = 2e-4 * np.random.default_rng(1).standard_normal(len(COMMANDS))
    upside_down = dataclasses.replace(POINTS, thrust_n=noise - THRUST)
    for fit in (fit_thrust, fit_torque, fit_thrust_of_speed):
        with pytest.raises(FitError, match=r"negative throughout, down to -0\.1\d+ N: Fz counts downwards here"):
            fit(upside_down)


def test_motors_that_never_ran_are_told_by_thrust_and_by_speed() -> None:
    noise = 2e-4 * np.random.default_rng(2).standard_normal(len(COMMANDS))
    off = MotorPoints(command=COMMANDS, thrust_n=noise, speed_rad_s=np.zeros_like(COMMANDS))
    with pytest.raises(FitError, match=r"the motors never ran: above command 1000 the largest thrust is 0\.000"):
        fit_thrust(off)
    with pytest.raises(FitError, match="the motors never ran: above command 1000 the largest speed is 0 rad/s"):
        fit_speed(off)


def test_motors_that_stand_below_command_1000_are_not_called_off() -> None:
    quiet = dataclasses.replace(POINTS, command=np.where(COMMANDS == 0, 900.0, COMMANDS))

    assert not rejections(fit_thrust(quiet))


@pytest.mark.parametrize("fit", [fit_thrust, fit_speed])
def test_nothing_above_the_dead_zone_is_refused(fit: type) -> None:
    low = MotorPoints(command=np.arange(0, 1001, 250.0), thrust_n=np.zeros(5), speed_rad_s=np.zeros(5))
    with pytest.raises(FitError, match="no command above 1000 was measured"):
        fit(low)


def test_a_quantity_that_was_not_measured_is_named() -> None:
    bare = MotorPoints(command=COMMANDS, thrust_n=THRUST)
    with pytest.raises(FitError, match="no known column of torque_nm: it was not measured"):
        fit_torque(bare)
    with pytest.raises(FitError, match="no known column of speed_rad_s"):
        fit_thrust_of_speed(bare)


def test_thrust_and_speed_of_different_commands_do_not_meet() -> None:
    odd = np.arange(len(COMMANDS)) % 2 == 1
    apart = MotorPoints(
        command=COMMANDS, thrust_n=np.where(odd, THRUST, np.nan), speed_rad_s=np.where(odd, np.nan, SPEED)
    )
    with pytest.raises(FitError, match="no command has both speed_rad_s and thrust_n"):
        fit_thrust_of_speed(apart)


def test_too_few_commands_are_refused_and_just_enough_are_said_to_prove_nothing() -> None:
    def of(count: int) -> MotorPoints:
        command = np.linspace(10_000, 60_000, count)
        return MotorPoints(command=command, thrust_n=4e-11 * command**2)

    with pytest.raises(FitError, match="2 points are too few for a polynomial of order 2"):
        fit_thrust(of(2))
    assert any("leave nothing to judge them by" in message for message in remarks(fit_thrust(of(3))))


# Missing commands


def test_a_gap_in_an_even_staircase_is_named_once_at_its_command() -> None:
    there = ~np.isin(COMMANDS, (26000, 28000))
    gap = MotorPoints(command=COMMANDS[there], thrust_n=THRUST[there])

    assert "command 26000, 28000 is missing." in remarks(fit_thrust(gap))
    assert not any("missing" in message for message in remarks(fit_thrust(POINTS)))


def test_commands_that_were_asked_for_are_missed_at_the_ends_too() -> None:
    asked = [int(command) for command in COMMANDS]

    assert missing_commands(COMMANDS[1:-1], expected=asked) == (0, 64000)
    assert missing_commands(COMMANDS) == ()


def test_a_window_without_a_value_is_a_missing_command() -> None:
    thrust = np.where(COMMANDS == 44000, np.nan, THRUST)

    assert "command 44000 is missing." in texts(
        fit_thrust(MotorPoints(command=COMMANDS, thrust_n=thrust)).findings, "warning", "note"
    )


def test_commands_that_are_no_staircase_or_slightly_uneven_have_no_gaps() -> None:
    assert missing_commands(np.array([0, 1e4, 1.2e4, 3e4, 6e4, 6.1e4])) == ()
    assert missing_commands(COMMANDS + 300 * (np.arange(len(COMMANDS)) == 7)) == ()


# Markers


@pytest.mark.parametrize("factor", [2.0, 0.5])
@pytest.mark.parametrize("with_thrust", [False, True])
def test_speeds_that_are_all_counted_with_the_wrong_markers_are_doubted(factor: float, with_thrust: bool) -> None:
    found = markers(COMMANDS, factor * SPEED, THRUST if with_thrust else None)

    assert len(found) == 1
    assert ("thrust over speed squared is" in found[0]) == with_thrust
    assert "check the number of its reflective markers" in found[0]


@pytest.mark.parametrize("at", [(2000,), (30000,), (64000,), (4000, 30000, 32000, 34000, 36000, 64000)])
def test_single_speeds_counted_double_are_named(at: tuple[int, ...]) -> None:
    doubled = np.where(np.isin(COMMANDS, at), 2 * SPEED, SPEED)
    found = fit_speed(MotorPoints(command=COMMANDS, speed_rad_s=doubled))

    assert rejections(found)[0].startswith(
        f"at command {', '.join(str(command) for command in at)} the speed is about twice"
    )


def test_a_series_counted_double_beside_one_that_is_not_is_doubted() -> None:
    twice = MotorPoints(command=np.tile(COMMANDS, 3), speed_rad_s=np.concatenate([SPEED, 2 * SPEED, SPEED]))

    assert "the speed is about twice what the others say" in rejections(fit_speed(twice))[0]


def test_single_speeds_that_are_half_are_named() -> None:
    halved = np.where(COMMANDS == 50000, 0.5 * SPEED, SPEED)

    assert "at command 50000 the speed is about half" in markers(COMMANDS, halved)[0]


def test_sound_speeds_raise_no_doubt_nor_do_motors_of_another_kind() -> None:
    curved = 2900 * (COMMANDS / 65535) ** 0.7
    for speed in (SPEED, 0.8 * SPEED, 1.35 * SPEED, curved):
        assert markers(COMMANDS, speed) == ()
        assert markers(COMMANDS, speed, 2e-8 * speed**2) == ()
    assert markers(COMMANDS, SPEED, 3.2e-8 * SPEED**2) == ()


# Maps that do not describe their points


def test_points_far_from_any_polynomial_are_doubted() -> None:
    steps = np.where(COMMANDS > 30000, 0.15, 0.02)

    assert "misses the points by" in rejections(fit_thrust(MotorPoints(command=COMMANDS, thrust_n=steps)))[0]


def test_a_map_that_falls_is_doubted() -> None:
    bent = 0.1 - 0.1 * ((COMMANDS - 40000) / 40000) ** 2

    assert "does not rise throughout" in rejections(fit_thrust(MotorPoints(command=COMMANDS, thrust_n=bent)))[-1]


def test_scatter_beyond_the_windows_is_said() -> None:
    drifting = THRUST + 1e-3 * np.sin(COMMANDS / 5000)
    found = fit_thrust(MotorPoints(command=COMMANDS, thrust_n=drifting, thrust_std_n=np.full(len(COMMANDS), 1e-5)))

    assert any("as far about the curve as within their windows" in message for message in remarks(found))


def test_a_display_that_stands_still_gives_no_speed_map() -> None:
    commands = np.array([4000.0, 8000.0, 12000.0, 16000.0, 20000.0])
    points = MotorPoints(command=commands, speed_rad_s=np.full(5, 544.5))
    with pytest.raises(FitError, match=r"544\.5 rad/s at every command from 4000 to 20000: the instrument's display"):
        fit_speed(points)
