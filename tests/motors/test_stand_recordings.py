"""A table with times is a recording: it is reduced step by step, or refused; a faulty part leaves the others valid."""

import hashlib
import json
import math
import re
import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import ConfigError, DataError, FitError
from cfid.motors.maps import fit_speed, fit_thrust
from cfid.motors.maps.data import Stand
from cfid.motors.rotor import fit as fit_dynamics
from cfid.recordings.stand import read_stand, stand_of
from cfid.records.result import Result
from cfid.records.run import read_run
from tests.lab import Cfid

Array = npt.NDArray[np.float64]

K = 6.0e-8  # N s^2/rad^2
HOLD_S, RATE_HZ = 4.0, 40.0
PULSES_US = (1000, 1200, 1350, 1500, 1650, 1800, 1000)
LAG_S, CELL_LAG_S = 0.12, 0.35  # lags of the rotor, and of the stand's filter on the load cell
KEY = "motor.thrust_per_speed_squared_n_s2"


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
        shown += (K * speed**2 - shown) * step_s / CELL_LAG_S
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


def fitted(folder: Path, one: Sweep) -> Result:
    return fit_thrust(write(folder, one), gravity_mps2=9.81)


def off(result: Result, *, widest: float = 0.01) -> float:
    """Return the error of k in standard uncertainties, which are at most a fraction `widest` of k."""
    found = result.quantities[KEY]
    assert isinstance(found.value, float)
    assert isinstance(found.std, float)
    assert found.std < widest * K
    return abs(found.value - K) / found.std


def test_a_stepped_sweep_gives_the_settled_truth_within_its_uncertainty(tmp_path: Path) -> None:
    one = sweep()
    result = fitted(tmp_path, one)
    rows = one.pulse_us > 1000
    as_it_stands = float(one.thrust_n[rows] @ one.speed_rad_s[rows] ** 2 / np.sum(one.speed_rad_s[rows] ** 4))

    assert as_it_stands < 0.99 * K  # an average of all rows would give this
    assert off(result) < 3
    assert any("a recording of 27.98 s in 1120 rows, 40 Hz" in finding.text for finding in result.findings)


def test_a_stand_whose_motor_rests_at_longer_pulses_than_usual_is_told_the_option(tmp_path: Path) -> None:
    one = sweep()
    path = write(tmp_path, one._replace(pulse_us=1100 + 0.8 * (one.pulse_us - 1000)))

    with pytest.raises(DataError, match=r"motors stand at its shortest pulses, of 1100 us, give .* `esc_us` 1100,2000"):
        fit_thrust(path, gravity_mps2=9.81)


def write_total(folder: Path, one: Sweep, head: str, speeds: int) -> Path:
    """Write a sweep as a stand's table with the total thrust of all motors in N, and a speed for some of the motors."""
    path, command = folder / "total.csv", np.rint((one.pulse_us - 1000) / 1000 * 65535)
    names = ["time[s]", "pwm", head, *(f"rpm{1 + at}" for at in range(speeds))]
    columns = [one.time_s, command, one.thrust_n, *[one.speed_rad_s * 30 / math.pi] * speeds]
    rows = [",".join(f"{x:.8g}" for x in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([",".join(names), *rows, ""]))
    return path


@pytest.mark.parametrize(("head", "speeds"), [("thrust_total(N)", 1), ("thrust[N]", 3), ("thrust_n", 4)])
def test_thrust_beside_the_speeds_of_another_number_of_rotors_is_a_question_that_motors_answers(
    cfid: Cfid, tmp_path: Path, head: str, speeds: int
) -> None:
    one = sweep()
    path = write_total(tmp_path, one._replace(thrust_n=speeds * one.thrust_n), head, speeds)
    asked = cfid("fit", "thrust", path, "--no-figures")
    usual = "4 motors" if "total" in head else "1 motor"
    rotors = "1 rotor" if speeds == 1 else f"{speeds} rotors"
    question = f"'{head}' is usually the thrust of {usual}, but the file has the speed of {rotors}. Give --motors"

    assert asked.returncode == 2
    assert question in " ".join(asked.stderr.split())
    assert off(fit_thrust(path, gravity_mps2=9.81, stand=Stand(motors=speeds))) < 3


def test_a_total_beside_the_speeds_of_four_rotors_needs_no_option(tmp_path: Path) -> None:
    one = sweep()
    assert off(fit_thrust(write_total(tmp_path, one._replace(thrust_n=4 * one.thrust_n), "thrust[N]", 4))) < 3


def test_a_number_of_motors_that_comes_after_the_table_was_divided_is_refused(tmp_path: Path) -> None:
    table = stand_of(read_stand(write_total(tmp_path, sweep(), "thrust[N]", 4)))
    with pytest.raises(ConfigError, match="was read as the thrust of 4 motors: read the table with `motors` 1"):
        fit_thrust(table, stand=Stand(motors=1))


def test_a_number_of_motors_beside_speeds_alone_is_reported_as_unused(tmp_path: Path) -> None:
    path = tmp_path / "speeds.csv"
    path.write_text("cmd,rpm\n0,0\n20000,9000\n40000,14000\n60000,18000\n")
    texts = [finding.text for finding in fit_speed(path, stand=Stand(motors=2)).findings]
    assert "speeds.csv: `motors` is not used: the table has no thrust and no torque." in texts


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
        fitted(tmp_path, flown)


def test_a_step_at_which_the_stand_was_touched_is_left_out_and_named(tmp_path: Path) -> None:
    one = sweep()
    touched = (one.time_s > 9.0) & (one.time_s < 12.0)
    pushed = one.thrust_n + np.where(touched, 0.05 * (one.time_s - 9), 0.0)
    result = fitted(tmp_path, one._replace(thrust_n=pushed))

    assert off(result) < 3
    assert any(one.code == "step-left-out" and "command 22937" in one.text for one in result.findings)


def test_a_stretch_in_which_the_load_cell_was_dead_costs_only_its_steps(tmp_path: Path) -> None:
    one = sweep()
    dead = (one.time_s > 8.0) & (one.time_s < 12.2)
    result = fitted(tmp_path, one._replace(thrust_n=np.where(dead, math.nan, one.thrust_n)))

    assert off(result, widest=0.02) < 3  # from the four remaining points
    assert any("'Thrust (N)' is no number in 167 of 1120 rows" in finding.text for finding in result.findings)


def test_dynamics_of_a_stand_whose_tachometer_is_dead_are_refused(cfid: Cfid, tmp_path: Path) -> None:
    one = sweep()
    path = write(tmp_path, one._replace(speed_rad_s=np.zeros(len(one.time_s))))
    ended = cfid("fit", "dynamics", path, "--no-figures")

    assert ended.returncode == 4
    assert "the speed is 0 or missing under every command: was the tachometer connected?" in ended.stderr


@pytest.mark.parametrize(("times", "kept"), [(1.0, True), (20.0, False)])
def test_time_constants_of_seconds_are_rejected_with_the_unit_of_the_times(
    tmp_path: Path, times: float, *, kept: bool
) -> None:
    one = sweep()
    result = fit_dynamics(write(tmp_path, one._replace(time_s=times * one.time_s)))
    assert ("dynamics.rising" not in result.rejected) is kept
    assert ("implausible" in [finding.code for finding in result.findings]) is not kept


@pytest.mark.parametrize("rate_hz", [10, 100])
def test_a_table_of_exact_plateaus_gives_its_own_curve(tmp_path: Path, rate_hz: int) -> None:
    time_s = np.arange(76 * rate_hz) / rate_hz
    step = (time_s // HOLD_S).astype(int)  # step 0 stands still at exactly 0
    share = np.where(step % 2, 0.1 + 0.05 * step, 0.0)
    rows = zip(time_s, 1000 + 1000 * share, 5 * share**2, strict=True)
    path = tmp_path / "exact.csv"
    lines = [f"{t:.3f},{pulse:.0f},{force:.6f}" for t, pulse, force in rows]
    path.write_text("\n".join(["Time (s),ESC signal (µs),Thrust (N)", *lines, ""]))

    result = fit_thrust(path, gravity_mps2=9.81)

    largest = result.quantities["motor.max_thrust_n"]
    assert largest.value == pytest.approx(5.0, rel=2e-4)  # pulses are rounded to a command
    assert 0 < float(np.max(largest.std)) < 0.01
    assert "e+" not in " ".join(one.text for one in result.findings)
    scatter = next(one.text for one in result.findings if "times as far" in one.text)
    assert float(scatter.split()[3]) < 1000


def test_a_stand_of_a_larger_motor_gives_its_map_where_no_rig_states_a_smaller_vehicle(
    cfid: Cfid, tmp_path: Path
) -> None:
    one = sweep()
    table = write(tmp_path, one._replace(thrust_n=40 * one.thrust_n))

    alone = cfid("fit", "thrust", table, "--no-figures", "--verbose")
    assert alone.returncode == 0, alone.stderr
    assert "more than a motor of a small quadrocopter has (10 N)" in " ".join(alone.stderr.split())
    assert re.search(r"at most \d{5} mN a motor", alone.stdout)
    assert "e+0" not in alone.stdout

    assert cfid("new", tmp_path / "lab").returncode == 0
    within = cfid("fit", "thrust", table, "--campaign", tmp_path / "lab", "--no-figures")
    assert within.returncode == 5
    assert "implausible" in within.stderr


def test_a_script_s_log_whose_rows_leave_out_the_last_columns_gives_the_rotor_s_lag(tmp_path: Path) -> None:
    table = write(tmp_path, sweep())
    head, rest = table.read_text().split("\n", 1)
    table.write_text(f"{head}App message,90% settling time (s),Max acceleration (RPM/s),\n{rest}")
    steps = fit_dynamics(table).quantities["dynamics.time_constant_s"].value
    assert isinstance(steps, list)
    lags_s = [step["time_constant_s"] for step in steps if step["rising"]]
    assert lags_s == pytest.approx([LAG_S] * len(lags_s), rel=0.05)


def test_an_imported_stand_gives_what_its_file_gives_to_the_last_bit(cfid: Cfid, tmp_path: Path) -> None:
    table, lab = write(tmp_path, sweep()), tmp_path / "lab"
    assert cfid("new", lab).returncode == 0
    assert cfid("import", table, "--campaign", lab).returncode == 0
    (run,) = (lab / "runs").iterdir()
    header = tomllib.loads((run / "run.toml").read_text())
    assert header["kind"] == "stand"
    assert header["origin"]["sha256"] == hashlib.sha256(table.read_bytes()).hexdigest()

    for fit in ("thrust", "speed", "dynamics"):
        of_run, of_file = (
            json.loads(cfid("fit", fit, one, "--json", "--campaign", lab, "--no-figures").stdout)
            for one in (run, table)
        )
        assert of_run["parameters"] == of_file["parameters"]
        assert [Path(source["path"]).name for source in of_run["sources"]] == ["stand.csv"]
    assert fit_thrust(read_run(run)).quantities == fit_thrust(run).quantities == fit_thrust(table).quantities


def test_imported_points_and_how_many_motors_they_are_of_give_what_their_table_gives(
    cfid: Cfid, tmp_path: Path
) -> None:
    table = tmp_path / "points.csv"
    rows = "".join(f"{pwm},{1e-8 * pwm**2},9000,9000,9000,9000\n" for pwm in range(0, 60001, 5000))
    table.write_text(f"pwm,weight[g],rpm1,rpm2,rpm3,rpm4\n{rows}")
    assert cfid("new", tmp_path / "lab").returncode == 0
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


def test_a_stand_s_times_without_a_unit_are_asked_for(cfid: Cfid, tmp_path: Path) -> None:
    rows = "".join(f"{1.7 * at},{5000 * at},{0.01 * at}\n" for at in range(12))
    (tmp_path / "slow.csv").write_text(f"t,cmd,thrust_n\n{rows}")
    assert cfid("new", tmp_path / "lab").returncode == 0
    said = cfid("import", tmp_path / "slow.csv", "--campaign", tmp_path / "lab")
    assert said.returncode == 2
    assert "--unit t=s" in " ".join(said.stderr.split())
