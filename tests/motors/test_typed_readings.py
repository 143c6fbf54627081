"""A typed reading that no small quadrocopter gives is questioned, and a verdict names what the fit will lack."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import DataError, FitError
from cfid.motors.maps import fit_speed, fit_thrust, fit_torque
from cfid.motors.maps.verdict import of_forces, of_readings
from cfid.motors.plan import expected_of
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import RigFacts, Tachometer, new_rig_text
from cfid.records.run import DeviceRecord, Label, Run
from cfid.records.run_writer import create_run
from tests.motors.stand_in_a_folder import BEGIN_S, climbed, write_run


def test_a_speed_that_no_small_rotor_has_is_implausible_by_the_markers_that_are_counted() -> None:
    once = expected_of("rpm", motors=1, markers=None, platform="crazyflie")
    twice = expected_of("rpm", motors=1, markers=2, platform="crazyflie")

    assert once is not None
    assert twice is not None
    assert once.fault(30000) == ""
    assert once.fault(150000).startswith("the reading is implausible, 1.5e+05 rpm. Expected 0 to 95493 rpm.")
    assert twice.fault(150000) == ""


def test_a_speed_of_a_rotor_that_stands_is_implausible() -> None:
    expected = expected_of("rpm", motors=1, markers=None, platform="crazyflie")

    assert expected is not None
    assert expected.fault(7290, [], command=0) == (
        "the reading is implausible, 7290 rpm of a rotor that stands. Expected 0 rpm."
    )
    assert expected.fault(0, [], command=0) == ""
    assert expected.fault(7290, [], command=2000) == ""


def test_a_speed_with_a_digit_missing_or_doubled_is_implausible_beside_that_of_the_nearest_command() -> None:
    expected = expected_of("rpm", motors=1, markers=None, platform="crazyflie")
    others, commands = [0.0, 7500.0, 15300.0], [0, 10000, 30000]

    assert expected is not None
    assert expected.fault(190, others, command=40000, commands=commands) == (
        "the reading 190 rpm is implausible beside 15300 at command 30000. Expected 7650 to 102000 rpm."
    )
    assert "beside 7500 at command 10000" in expected.fault(1140, others, command=20000, commands=commands)
    assert "beside 7500 at command 10000" in expected.fault(52000, others, command=8000, commands=commands)
    for speed, command in ((19000, 40000), (11400, 20000), (5000, 8000), (0, 0), (21000, 60000)):
        assert expected.fault(speed, others, command=command, commands=commands) == ""


def test_a_weight_while_motors_stand_is_plausible() -> None:
    expected = expected_of("grams", motors=2, markers=None, platform="cf21")

    assert expected is not None
    assert expected.fault(5028, [5020.0], command=0) == ""


def test_a_weight_is_compared_with_the_others_since_scales_may_carry_a_stand() -> None:
    expected = expected_of("grams", motors=2, markers=None, platform="cf21")

    assert expected is not None
    assert expected.fault(28.0) == ""
    assert expected.fault(77777) != ""
    assert expected.fault(5010, [5028.0, 5020.0]) == ""
    assert "the reading 50.2 g is implausible: its distance from the others (5024)" in expected.fault(
        50.2, [5028, 5020]
    )


def test_nothing_is_implausible_for_a_body_of_another_kind() -> None:
    assert expected_of("grams", motors=4, markers=None, platform="other") is None


@pytest.mark.parametrize(("commands", "lacking"), [((0, 30000), "here is 1."), ((0, 20000, 30000, 40000), "")])
def test_a_staircase_too_short_for_a_map_says_what_the_fit_takes(
    tmp_path: Path, commands: tuple[int, ...], lacking: str
) -> None:
    run = write_run(tmp_path, climbed(commands), steps=commands, motors=[1, 3], hold_s=2.0, rest_s=1.0)
    said = of_forces(run)

    assert ("`cfid fit thrust` takes at least 3 commands above 1000, from this run and others" in said) == bool(lacking)
    assert said.endswith(lacking or "mN.")


def test_a_staircase_whose_torque_is_dead_is_good_for_thrust_and_says_why_it_gives_no_torque(tmp_path: Path) -> None:
    commands = tuple(range(0, 60001, 10000))
    record = climbed(commands)
    record.wrench[:, 5] = 2e-4 * np.random.default_rng(1).standard_normal(len(record.wrench))
    run = write_run(tmp_path, record, steps=commands, motors=[1, 3], hold_s=2.0, rest_s=1.0)
    (reason,) = (one.text for one in fit_torque(run).findings if one.code == "map-misfit")
    said = of_forces(run)

    assert said.startswith("6 of 6 steps are steady, Fz from")
    assert f"Torque: `cfid fit torque` rejects it: {reason}" in said


def typed(folder: Path, kind: str, column: str, readings: Mapping[int, float], *, markers: int = 2) -> Run:
    """Write a run with the readings that an operator typed at commands."""
    with create_run(
        folder / "runs",
        kind=kind,
        label=Label(),
        devices={"readings": DeviceRecord(file="readings.csv", columns=("t", "command", column))},
        started=datetime(2026, 11, 21, tzinfo=UTC),
        cfid_version="0",
        facts=RigFacts(tachometer=Tachometer(markers=markers)),
        requested={"steps": tuple(readings), "motors": (1,), "hold_s": 2.0, "rest_s": 1.0},
    ) as writer:
        command, value = np.array(list(readings)), np.array(list(readings.values()))
        if len(command):
            writer.append("readings", (BEGIN_S + np.arange(len(command)), command, value))
        return writer.close("complete")


def test_speeds_that_count_one_marker_of_two_are_of_no_use_as_the_fit_will_say(tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    half = {20000: 11470.0, 25000: 13500.0, 30000: 15300.0}
    with pytest.raises(FitError, match=r"implausible.*`cfid fit speed` with `markers` takes these readings"):
        of_readings(typed(tmp_path, "speed", "rpm", half))
    assert of_readings(typed(tmp_path, "speed", "rpm", {at: 2 * rpm for at, rpm in half.items()}))


def test_such_speeds_are_good_in_a_campaign_of_another_body(tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text().replace('platform = "cf2"', 'platform = "other"'))
    half = {20000: 11470.0, 25000: 13500.0, 30000: 15300.0}

    assert of_readings(typed(tmp_path, "speed", "rpm", half)).startswith("3 readings at 3 steps")


def test_weights_that_verify_no_map_are_of_no_use(tmp_path: Path) -> None:
    with pytest.raises(FitError, match="the display stands still"):
        of_readings(typed(tmp_path, "scales", "grams", dict.fromkeys(range(0, 40001, 10000), 60.0)))


def test_a_map_of_a_run_of_scales_is_refused_with_the_option_that_takes_it(tmp_path: Path) -> None:
    run = typed(tmp_path, "scales", "grams", {0: 60.0, 20000: 57.5})
    with pytest.raises(DataError, match=rf"a run of scales gives no map of its own.*`verify` {run.folder.name}"):
        fit_thrust(run)
    with pytest.raises(DataError, match="no reading was typed in it"):
        fit_speed(typed(tmp_path, "speed", "rpm", {}))
