"""Tables of thrust stands: points of some motors or speeds alone, and recordings that are reduced step by step."""

import hashlib
import json
import math
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy.signal import lfilter

from cfid.errors import ConfigError, DataError, FitError
from cfid.motors.data import reduce_speeds
from cfid.motors.maps import fit_speed, fit_thrust
from cfid.motors.maps.data import Stand
from cfid.recordings.stand import read_stand, stand_of
from cfid.records.plausibility import judged
from cfid.records.result import Result
from cfid.records.rig_file import thesis_rig
from cfid.records.run import read_run
from tests.lab import Cfid, codes, new_campaign

Array = npt.NDArray[np.float64]

K = "motor.thrust_per_speed_squared_n_s2"
RPM = 30 / np.pi


def table(path: Path, head: str, *columns: object) -> Path:
    rows = zip(*(np.asarray(column).tolist() for column in columns), strict=True)
    path.write_text("\n".join([head, *(",".join(f"{value:.10g}" for value in row) for row in rows)]) + "\n")
    return path


def parameters(cfid: Cfid, what: str, path: Path, *options: object) -> dict[str, Any]:
    ended = cfid("fit", what, "--table", path, "--json", "--no-figures", *options)
    assert ended.returncode == 0, ended.stderr
    return dict(json.loads(ended.stdout)["parameters"])


# Points of one motor or of four


COMMANDS = np.arange(5000, 65001, 2500)
THRUST_N = 2.2e-11 * COMMANDS**2 + 6e-7 * COMMANDS  # of one motor; 0.132 N at 65000
ARM_M = 0.007  # torque over thrust


def points(path: Path, *, motors: int, rotors: int, units: str = "Thrust (N),Torque (Nm)", arm: float = 1) -> Path:
    """Write a table of the sums of `motors` motors, with the speeds of `rotors` rotors."""
    head = ",".join(["pwm", units, *(f"rpm{rotor + 1}" for rotor in range(rotors))])
    speeds = [np.sqrt(THRUST_N / 2e-8) * RPM] * rotors
    return table(path, head, COMMANDS, motors * THRUST_N, motors * arm * ARM_M * THRUST_N, *speeds)


def assert_one_motors(cfid: Cfid, path: Path, *options: object) -> None:
    slope, _ = parameters(cfid, "torque", path, *options)["motor.torque_poly"]["value"]
    assert slope == pytest.approx(ARM_M, rel=1e-4)
    largest = parameters(cfid, "thrust", path, *options)["motor.max_thrust_n"]["value"]
    assert largest == pytest.approx(2.2e-11 * 65535**2 + 6e-7 * 65535, rel=1e-3)


def test_a_stand_s_head_or_the_motors_option_divides_thrust_and_torque_alike(cfid: Cfid, tmp_path: Path) -> None:
    """Bitcraze's stand states the sums of four motors; another stand with the speeds of four rotors is a question."""
    assert_one_motors(cfid, points(tmp_path / "b.csv", motors=4, rotors=4, units="thrust[N],torque_z[N]"))
    path = points(tmp_path / "a.csv", motors=4, rotors=4)
    for what in ("torque", "thrust"):
        asked = cfid("fit", what, "--table", path, "--no-figures")
        assert asked.returncode == 2
        assert "--motors" in asked.stderr
    assert_one_motors(cfid, path, "--motors", 4)


def test_a_torque_of_four_motors_beside_the_thrust_of_one_reaches_no_firmware(cfid: Cfid, tmp_path: Path) -> None:
    campaign = ("--campaign", new_campaign(tmp_path / "campaign").folder)
    path = points(tmp_path / "t.csv", motors=1, rotors=0, units="thrust_n,torque_nm", arm=4)
    export = ("export", "firmware", "--out", tmp_path / "motors.h", *campaign)
    rejected = cfid("fit", "torque", "--table", path, "--no-figures", *campaign)
    assert rejected.returncode == 5
    assert "0.003 to 0.012" in rejected.stderr

    assert cfid("fit", "torque", "--table", path, "--no-figures", "--force", *campaign).returncode == 0
    assert cfid(*export).returncode == 4
    assert not (tmp_path / "motors.h").exists()
    assert cfid(*export, "--force").returncode == 0
    assert "THRUST2TORQUE 0.028" in (tmp_path / "motors.h").read_text()


# The mass that four motors hover, from two that ran on a battery: four draw its voltage further down


OHM, EFFICIENCY, NEWTON_PER_V2, WATT_PER_N15 = 0.15, 0.5, 0.0125, 45.0
UP = np.arange(4000.0, 64001.0, 4000.0)


def steady(command: Array, *, motors: int, open_v: Array) -> tuple[Array, Array]:
    """Return one motor's thrust and the battery's voltage: its inner resistance carries the current of all motors."""
    volts = open_v + 0 * command
    for _ in range(300):
        thrust = NEWTON_PER_V2 * (command / 65535 * volts) ** 2
        amperes = motors * WATT_PER_N15 * thrust**1.5 / EFFICIENCY / volts
        volts = 0.5 * volts + 0.5 * (open_v - OHM * amperes)
    return thrust, volts


def of_battery(path: Path, command: Array, open_v: Array, *, motors: int, noise: float = 0.002) -> Path:
    """Write a table of the thrust of `motors` motors together, with relative errors of `noise`."""
    thrust, vbat = steady(command, motors=motors, open_v=open_v)
    noisy = motors * thrust * (1 + noise * np.random.default_rng(1).standard_normal(len(command)))
    return table(path, "command,thrust [N],vbat [V]", command, noisy, vbat)


@pytest.mark.parametrize("motors", [1, 2, 4])
def test_the_hover_mass_is_that_of_four_motors_however_many_ran(cfid: Cfid, tmp_path: Path, motors: int) -> None:
    """Up, down and up again while the battery empties: at the voltage under two motors it would be a fifth more."""
    command = np.concatenate([UP, UP[::-1], UP])
    path = of_battery(tmp_path / "a.csv", command, np.linspace(4.1, 3.8, len(command)), motors=motors)
    (true_n,), _ = steady(np.array([65535.0]), motors=4, open_v=np.array([3.95]))
    found = parameters(cfid, "thrust", path, "--motors", motors)
    mass = found["motor.hover_mass_kg"]

    assert mass["value"] == pytest.approx(4 * true_n / 9.81, rel=0.03)
    assert abs(mass["value"] - 4 * true_n / 9.81) < 2 * mass["std"]
    assert mass["value"] == pytest.approx(4 * found["motor.max_thrust_n"]["value"] / 9.81, rel=1e-3)


def test_where_command_and_voltage_explain_thrust_alike_the_uncertainty_spans_both(cfid: Cfid, tmp_path: Path) -> None:
    """On the way up alone, the voltage is a function of the command."""
    path = of_battery(tmp_path / "a.csv", UP, np.full(len(UP), 3.95), motors=2, noise=0.01)
    mass = parameters(cfid, "thrust", path, "--motors", 2)["motor.hover_mass_kg"]
    for motors in (2, 4):
        (newton,), _ = steady(np.array([65535.0]), motors=motors, open_v=np.array([3.95]))
        assert abs(mass["value"] - 4 * newton / 9.81) < 2 * mass["std"]


@pytest.mark.parametrize(("motors", "columns", "noted"), [(2, 2, True), (4, 2, False), (2, 3, False)])
def test_a_finding_states_under_how_many_motors_a_maximum_without_a_voltage_holds(
    tmp_path: Path, motors: int, columns: int, noted: bool
) -> None:
    path = of_battery(tmp_path / "a.csv", UP, np.full(len(UP), 3.95), motors=motors)
    pd.read_csv(path).iloc[:, :columns].to_csv(path, index=False)
    found = fit_thrust(path, gravity_mps2=9.81, stand=Stand(motors=motors))
    assert ("maximum-of-fewer-motors" in codes(found)) == noted


# Speeds


COMMAND = np.arange(5000, 65000, 5000)
SPEED = 0.0408 * COMMAND + 381


def noisy(value: npt.NDArray[Any], seed: int = 0) -> Array:
    return np.asarray(value * (1 + 0.003 * np.random.default_rng(seed).standard_normal(value.shape)))


def speed_at_40000(result: Result) -> float:
    return float(np.polyval(result.quantities["motor.speed_poly"].value, 40000) / (0.0408 * 40000 + 381))


def test_thrust_and_speed_without_a_command_give_k(tmp_path: Path) -> None:
    found = fit_speed(table(tmp_path / "a.csv", "rpm_mean,thrust_n", RPM * SPEED, noisy(2e-8 * SPEED**2)))
    assert found.quantities[K].value == pytest.approx(2e-8, rel=0.005)
    assert found.accepted
    assert "motor.speed_poly" not in found.quantities


def test_a_record_of_speeds_needs_neither_thrust_nor_pause(tmp_path: Path) -> None:
    after_s = np.arange(300) / 100
    steps = [speed * (1 - np.exp(-after_s / 0.06)) for speed in SPEED[::3]]
    held = np.repeat(COMMAND[::3], len(after_s))
    columns = (np.arange(len(held)) / 100, 100 * held / 65535, noisy(RPM * np.concatenate(steps)))
    found = fit_speed(table(tmp_path / "a.csv", "t,pwm_percent,rpm_mean", *columns))
    assert speed_at_40000(found) == pytest.approx(1, abs=0.005)
    assert "no-baseline-after" not in codes(found)


def test_implausible_speeds_are_rejected_unless_thrust_or_platform_fit_another_rotor(tmp_path: Path) -> None:
    """A rotor of two inches is plausible; one marker that counts for two is not, unless the body is another."""
    rig = thesis_rig()
    small = table(
        tmp_path / "a.csv", "cmd,speed_rad_s,thrust_n", COMMAND, 0.8 * SPEED, noisy(6.5e-8 * (0.8 * SPEED) ** 2)
    )
    found = judged(fit_speed(small), None)
    assert codes(found, "rejection") == []
    assert found.quantities[K].value == pytest.approx(6.5e-8, rel=0.01)

    twice = fit_speed(table(tmp_path / "b.csv", "cmd,speed_rad_s", COMMAND, 2 * noisy(SPEED)))
    other = rig.model_copy(update={"vehicle": rig.vehicle.model_copy(update={"platform": "other"})})
    assert codes(judged(twice, rig), "rejection") == ["implausible"]
    assert codes(judged(twice, other), "rejection") == []


def test_thrust_of_speed_survives_a_rejected_map_of_the_command(tmp_path: Path) -> None:
    mixed = np.random.default_rng(5).permutation(COMMAND)
    path = table(tmp_path / "a.csv", "cmd,speed_rad_s,thrust_n", mixed, SPEED, noisy(2e-8 * SPEED**2))
    kept = fit_thrust(path, gravity_mps2=9.81).without_rejected().quantities
    assert "motor.thrust_poly" not in kept
    assert kept[K].value == pytest.approx(2e-8, rel=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_a_column_of_newtons_in_grams_is_never_accepted(tmp_path: Path, seed: int) -> None:
    thrust_g = noisy(1e3 * 2e-8 * SPEED**2 / 9.81, seed)
    for scale, accepted in ((1.0, False), (9.81e-3, True)):
        path = table(tmp_path / "a.csv", "cmd,thrust_n", COMMAND, scale * thrust_g)
        found = judged(fit_thrust(path, gravity_mps2=9.81), thesis_rig())
        assert found.accepted == accepted
        assert ("grams of thrust?" in found.rejected.get("motor.thrust_poly", "")) != accepted


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


# Recordings of a stepped sweep


TRUE_K = 6.0e-8  # N s^2/rad^2
HOLD_S, RATE_HZ = 4.0, 40.0
PULSES_US = (1000, 1200, 1350, 1500, 1650, 1800, 1000)
LAG_S, CELL_LAG_S = 0.12, 0.35  # lags of the rotor, and of the stand's filter on the load cell


class Sweep(NamedTuple):
    """A stepped sweep as a stand records it, columns (n,)."""

    time_s: Array
    pulse_us: Array
    thrust_n: Array
    speed_rad_s: Array


def sweep(seed: int = 3) -> Sweep:
    """Return the sweep of a rotor and a load cell with first-order lags, integrated in small steps."""
    rng, fine = np.random.default_rng(seed), 25
    pulse = np.repeat(PULSES_US, round(HOLD_S * RATE_HZ * fine)).astype(float)
    step_s, speed, shown = 1 / (RATE_HZ * fine), 0.0, 0.0
    speeds, thrusts = np.empty(len(pulse)), np.empty(len(pulse))
    for i, target in enumerate(2.6 * (pulse - 1000)):
        speed += (target - speed) * step_s / LAG_S
        shown += (TRUE_K * speed**2 - shown) * step_s / CELL_LAG_S
        speeds[i], thrusts[i] = speed, shown
    rows = slice(fine - 1, None, fine)
    count = len(pulse) // fine
    return Sweep(
        time_s=np.arange(count) / RATE_HZ,
        pulse_us=pulse[rows],
        thrust_n=thrusts[rows] + 5e-4 * rng.standard_normal(count),
        speed_rad_s=np.maximum(speeds[rows] + 2.0 * rng.standard_normal(count), 0.0),
    )


def write(folder: Path, one: Sweep) -> Path:
    path = folder / "sweep.csv"
    rows = [",".join("" if math.isnan(x) else f"{x:.6g}" for x in row) + "," for row in zip(*one, strict=True)]
    path.write_text("Time (s),ESC signal (µs),Thrust (N),Motor Optical Speed (rad/s),\n" + "\n".join(rows) + "\n")
    return path


def off(result: Result, *, widest: float = 0.01) -> float:
    """Return the error of k in standard uncertainties, which are at most a fraction `widest` of k."""
    found = result.quantities[K]
    assert isinstance(found.value, float)
    assert isinstance(found.std, float)
    assert found.std < widest * TRUE_K
    return abs(found.value - TRUE_K) / found.std


def test_a_stepped_sweep_gives_the_settled_truth_within_its_uncertainty(tmp_path: Path) -> None:
    one = sweep()
    result = fit_thrust(write(tmp_path, one), gravity_mps2=9.81)
    rows = one.pulse_us > 1000
    as_it_stands = float(one.thrust_n[rows] @ one.speed_rad_s[rows] ** 2 / np.sum(one.speed_rad_s[rows] ** 4))

    assert as_it_stands < 0.99 * TRUE_K  # an average of all rows would give this
    assert off(result) < 3
    assert any("a recording of 27.98 s in 1120 rows, 40 Hz" in finding.text for finding in result.findings)


def test_a_stand_whose_motor_rests_at_longer_pulses_than_usual_is_told_the_option(tmp_path: Path) -> None:
    one = sweep()
    path = write(tmp_path, one._replace(pulse_us=1100 + 0.8 * (one.pulse_us - 1000)))

    with pytest.raises(DataError, match=r"motors stand at its shortest pulses, of 1100 us, give .* `esc_us` 1100,2000"):
        fit_thrust(path, gravity_mps2=9.81)


def write_total(folder: Path, one: Sweep, head: str, speeds: int) -> Path:
    """Write a sweep as a stand's table with the total thrust of all motors in N, and a speed for some of the motors."""
    names = ["time[s]", "pwm", head, *(f"rpm{1 + at}" for at in range(speeds))]
    command = np.rint((one.pulse_us - 1000) / 1000 * 65535)
    columns = [one.time_s, command, one.thrust_n, *[one.speed_rad_s * RPM] * speeds]
    return table(folder / "total.csv", ",".join(names), *columns)


@pytest.mark.parametrize(("head", "speeds"), [("thrust_total(N)", 1), ("thrust[N]", 3), ("thrust_n", 4)])
def test_thrust_beside_the_speeds_of_another_number_of_rotors_is_a_question_that_motors_answers(
    cfid: Cfid, tmp_path: Path, head: str, speeds: int
) -> None:
    one = sweep()
    path = write_total(tmp_path, one._replace(thrust_n=speeds * one.thrust_n), head, speeds)
    asked = cfid("fit", "thrust", path, "--no-figures")

    assert asked.returncode == 2
    assert "Give --motors" in " ".join(asked.stderr.split())
    assert off(fit_thrust(path, gravity_mps2=9.81, stand=Stand(motors=speeds))) < 3


def test_a_total_beside_the_speeds_of_four_rotors_is_divided_once(tmp_path: Path) -> None:
    one = sweep()
    path = write_total(tmp_path, one._replace(thrust_n=4 * one.thrust_n), "thrust[N]", 4)
    assert off(fit_thrust(path)) < 3
    with pytest.raises(ConfigError, match="`motors` 1"):
        fit_thrust(stand_of(read_stand(path)), stand=Stand(motors=1))


def test_a_record_without_a_command_gives_the_same_by_the_changes_it_shows(tmp_path: Path) -> None:
    one = sweep()
    assert off(fit_speed(write(tmp_path, one._replace(pulse_us=np.full(len(one.time_s), math.nan))))) < 3


def test_a_flight_read_as_a_table_of_motors_is_refused_as_unsteady(tmp_path: Path) -> None:
    time_s = np.arange(2000) / 100
    rng = np.random.default_rng(1)
    flown = Sweep(
        time_s,
        np.rint(1500 + 60 * np.sin(3 * time_s) + 20 * rng.standard_normal(2000)),
        0.3 + 0 * time_s,
        1500 + 0 * time_s,
    )

    with pytest.raises(FitError, match=r"unsteady: of \d+ commands none is held for longer than 0\.\d+ s"):
        fit_thrust(write(tmp_path, flown), gravity_mps2=9.81)


def test_a_step_at_which_the_stand_was_touched_is_left_out_and_named(tmp_path: Path) -> None:
    one = sweep()
    touched = (one.time_s > 9.0) & (one.time_s < 12.0)
    pushed = one.thrust_n + np.where(touched, 0.05 * (one.time_s - 9), 0.0)
    result = fit_thrust(write(tmp_path, one._replace(thrust_n=pushed)), gravity_mps2=9.81)

    assert off(result) < 3
    assert any(one.code == "step-left-out" and "command 22937" in one.text for one in result.findings)


@pytest.mark.parametrize("rate_hz", [10, 100])
def test_a_table_of_exact_plateaus_gives_its_own_curve(tmp_path: Path, rate_hz: int) -> None:
    time_s = np.arange(76 * rate_hz) / rate_hz
    step = (time_s // HOLD_S).astype(int)  # step 0 stands still at exactly 0
    share = np.where(step % 2, 0.1 + 0.05 * step, 0.0)
    pulse_us = np.rint(1000 + 1000 * share)
    path = table(tmp_path / "exact.csv", "Time (s),ESC signal (µs),Thrust (N)", time_s, pulse_us, 5 * share**2)
    largest = fit_thrust(path, gravity_mps2=9.81).quantities["motor.max_thrust_n"]
    assert largest.value == pytest.approx(5.0, rel=2e-4)  # pulses are rounded to a command
    assert 0 < float(np.max(largest.std)) < 0.01


def test_an_imported_stand_gives_what_its_file_gives_to_the_last_bit(cfid: Cfid, tmp_path: Path) -> None:
    path, lab = write(tmp_path, sweep()), tmp_path / "lab"
    new_campaign(lab)
    assert cfid("import", path, "--campaign", lab).returncode == 0
    (run,) = (lab / "runs").iterdir()
    header = tomllib.loads((run / "run.toml").read_text())
    assert header["kind"] == "stand"
    assert header["origin"]["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()

    for fit in ("thrust", "speed", "dynamics"):
        of_run, of_file = (
            json.loads(cfid("fit", fit, one, "--json", "--campaign", lab, "--no-figures").stdout) for one in (run, path)
        )
        assert of_run["parameters"] == of_file["parameters"]
        assert [Path(source["path"]).name for source in of_run["sources"]] == ["stand.csv"]
    assert fit_thrust(read_run(run)).quantities == fit_thrust(run).quantities == fit_thrust(path).quantities


def test_imported_points_and_how_many_motors_they_are_of_give_what_their_table_gives(
    cfid: Cfid, tmp_path: Path
) -> None:
    table = tmp_path / "points.csv"
    rows = "".join(f"{pwm},{1e-8 * pwm**2},9000,9000,9000,9000\n" for pwm in range(0, 60001, 5000))
    table.write_text(f"pwm,weight[g],rpm1,rpm2,rpm3,rpm4\n{rows}")
    new_campaign(tmp_path / "lab")
    assert cfid("import", table, "--campaign", tmp_path / "lab").returncode == 0
    (run,) = (tmp_path / "lab" / "runs").iterdir()
    of_run, of_file = (stand_of(read_stand(path)) for path in (run, table))
    assert (of_run.time_s, of_run.motors, of_run.rotors) == (None, 4, 4)
    assert np.array_equal(np.asarray(of_run.thrust_n), np.asarray(of_file.thrust_n))
    with pytest.raises(ConfigError):
        fit_thrust(run, stand=Stand(motors=1))
    for words in (("fit", "thrust", "last"), ("show", "last")):
        shown = cfid(*words, "--no-figures", "--campaign", tmp_path / "lab")
        assert shown.returncode == 0, shown.stderr
