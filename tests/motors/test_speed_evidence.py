"""Speeds of other rotors, dead sensors and idling rotors, and tables without thrust, commands or pauses."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from cfid.motors.data import reduce_speeds
from cfid.motors.maps import fit_speed, fit_thrust
from cfid.records.plausibility import judged
from cfid.records.result import Result
from cfid.records.rig_file import thesis_rig

K = "motor.thrust_per_speed_squared_n_s2"
COMMAND = np.arange(5000, 65000, 5000)
SPEED = 0.0408 * COMMAND + 381
RPM = 60 / (2 * np.pi)


def table(folder: Path, head: str, *columns: object) -> Path:
    path = folder / "table.csv"
    rows = zip(*(np.asarray(column).tolist() for column in columns), strict=True)
    path.write_text("\n".join([head, *(",".join(f"{value:.10g}" for value in row) for row in rows)]) + "\n")
    return path


def codes(result: Result) -> set[str]:
    return {one.code for one in result.findings if one.severity == "rejection"}


def noisy(value: np.ndarray, seed: int = 0) -> np.ndarray:
    return value * (1 + 0.003 * np.random.default_rng(seed).standard_normal(value.shape))


def test_thrust_and_speed_without_a_command_give_k(tmp_path: Path) -> None:
    found = fit_speed(table(tmp_path, "rpm_mean,thrust_n", RPM * SPEED, noisy(2e-8 * SPEED**2)))
    assert abs(found.quantities[K].value / 2e-8 - 1) < 0.005
    assert found.accepted
    assert "motor.speed_poly" not in found.quantities


def test_a_sensor_that_shows_0_beside_turning_rotors_is_missing(tmp_path: Path) -> None:
    shown = [RPM * noisy(SPEED, i) for i in range(4)]
    shown[2] = np.zeros(len(SPEED))
    found = fit_speed(table(tmp_path, "cmd,rpm1,rpm2,rpm3,rpm4", COMMAND, *shown))
    assert abs(np.polyval(found.quantities["motor.speed_poly"].value, 40000) / (0.0408 * 40000 + 381) - 1) < 0.005
    assert any("'rpm3' shows 0 in 12 rows" in one.text for one in found.findings)


def test_a_record_of_speeds_needs_neither_thrust_nor_pause(tmp_path: Path) -> None:
    after_s = np.arange(300) / 100
    steps = [speed * (1 - np.exp(-after_s / 0.06)) for speed in SPEED[::3]]
    held = np.repeat(COMMAND[::3], len(after_s))
    time_s = np.arange(len(held)) / 100
    found = fit_speed(
        table(tmp_path, "t,pwm_percent,rpm_mean", time_s, 100 * held / 65535, noisy(RPM * np.concatenate(steps)))
    )
    assert abs(np.polyval(found.quantities["motor.speed_poly"].value, 40000) / (0.0408 * 40000 + 381) - 1) < 0.005
    assert "no-baseline-after" not in {one.code for one in found.findings}


def test_a_two_inch_rotor_passes_where_its_speeds_are_plausible(tmp_path: Path) -> None:
    speed = 0.8 * SPEED
    head = "cmd,speed_rad_s,thrust_n"
    found = judged(fit_speed(table(tmp_path, head, COMMAND, speed, noisy(6.5e-8 * speed**2))), None)
    assert codes(found) == set()
    assert abs(found.quantities[K].value / 6.5e-8 - 1) < 0.01


def test_one_marker_for_two_is_rejected_unless_the_rig_is_of_another_body(tmp_path: Path) -> None:
    path = table(tmp_path, "cmd,speed_rad_s", COMMAND, 2 * noisy(SPEED))
    found, rig = fit_speed(path), thesis_rig()
    other = rig.model_copy(update={"vehicle": rig.vehicle.model_copy(update={"platform": "other"})})
    assert codes(judged(found, rig)) == {"implausible"}
    assert codes(judged(found, other)) == set()


def test_thrust_of_speed_survives_a_rejected_map_of_the_command(tmp_path: Path) -> None:
    thrust = noisy(2e-8 * SPEED**2)
    mixed = np.random.default_rng(5).permutation(COMMAND)
    found = fit_thrust(table(tmp_path, "cmd,speed_rad_s,thrust_n", mixed, SPEED, thrust), gravity_mps2=9.81)
    left = found.without_rejected().quantities
    assert "motor.thrust_poly" not in left
    assert abs(left[K].value / 2e-8 - 1) < 0.01


def test_a_column_of_newtons_in_grams_is_never_accepted(tmp_path: Path) -> None:
    rig, head = thesis_rig(), "cmd,thrust_n"
    for seed in range(50):
        thrust_g = noisy(1e3 * 2e-8 * SPEED**2 / 9.81, seed)
        found = judged(fit_thrust(table(tmp_path, head, COMMAND, thrust_g), gravity_mps2=9.81), rig)
        assert not found.accepted
        assert "grams of thrust?" in found.rejected["motor.thrust_poly"]
        sound = judged(fit_thrust(table(tmp_path, head, COMMAND, thrust_g * 9.81e-3), gravity_mps2=9.81), rig)
        assert sound.accepted


@pytest.mark.parametrize("idle_share", [0.2, 0.5, 0.9])
def test_a_rotor_that_idles_in_the_pauses_takes_nothing_off_its_speeds(idle_share: float) -> None:
    rng, hold_s, pause_s, step_s = np.random.default_rng(4), 3.0, 1.0, 0.01
    commands, truth = np.arange(10000, 60000, 10000), 0.0377 * np.arange(10000, 60000, 10000)
    time_s = np.arange(0, len(commands) * (hold_s + pause_s) + pause_s, step_s)
    place, within_s = np.divmod(time_s, hold_s + pause_s)
    step = np.minimum(place.astype(int), len(commands) - 1)
    driven = (within_s >= pause_s) & (place < len(commands))
    idling = ~driven & (within_s > (1 - idle_share) * pause_s) & (place < len(commands))
    wanted = np.where(driven, truth[step], np.where(idling, 264.0, 0.0))
    speed = lfilter([step_s / 0.05], [1, step_s / 0.05 - 1], wanted) + rng.standard_normal(len(time_s))
    starts_s = np.concatenate([pause_s + (hold_s + pause_s) * np.arange(5), (hold_s + pause_s) * np.arange(1, 6)])
    order, levels = np.argsort(starts_s), np.concatenate([commands, np.zeros(5, int)])
    found = reduce_speeds(
        time_s, speed[:, np.newaxis], np.append(0.0, starts_s[order]), np.tile(np.append(0, levels[order]), (4, 1)).T
    )

    assert [point.mean[0] for point in found.points] == pytest.approx(truth, abs=0.5)
