"""Real files and files of a known truth are read, or refused, as whoever made them says: one table of all of them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from cfid.recordings.read import read_recording
from tests.lab import DATA, INPUTS, run_cfid

THREADS = """
[vehicle]
name = "threads"
mass_kg = 0.03
centre_of_mass_mm = [0.0, 0.0, 0.0]

[site]
gravity_mps2 = 9.81

[mounts.z]
direction = [0, 0, 1]
threads = { above_mm = 92.0, below_mm = 92.0, length_mm = 2000.0 }
"""
BITCRAZE = DATA / "bitcraze_2021"
FLIGHTS = DATA / "flights"
SLOW = 85 / 84  # of a uSD card's microseconds, as the rows of both logs show

Number = Callable[[Path], float]


def mean_fz(run: Path) -> float:
    return float(np.mean(read_recording(run).series["loadcell"].column("Fz").values))


def duration(run: Path) -> float:
    """Return the time from the first to the last row of a stand or a vehicle."""
    series = next(one for name, one in read_recording(run).series.items() if name in ("stand", "crazyflie"))
    return float(np.ptp(series.frame()["t"]))


def angular_frequency(run: Path) -> float:
    """Return the angular frequency of a swing, from its times through zero."""
    frame = read_recording(run).series["encoder"].frame()
    time_s, angle = frame["t"].to_numpy(), frame["phi"].to_numpy()
    before = np.flatnonzero(angle[1:] * angle[:-1] < 0)
    through_s = time_s[before] - angle[before] * np.diff(time_s)[before] / np.diff(angle)[before]
    return float(np.pi / np.mean(np.diff(through_s)))


def fitted(command: str, key: str, place: int | None = None) -> Number:
    """Return the function that gives a number of the fit of a run."""

    def number(run: Path) -> float:
        ended = run_cfid([*command.split(), run, "--json", "--no-figures"], run.parents[2])
        assert ended.returncode == 0, ended.stderr
        value: Any = json.loads(ended.stdout)["parameters"][key]["value"]
        return float(value if place is None else value[place])

    return number


TORQUE = fitted("fit torque", "motor.torque_poly", -2)
THRUST = fitted("fit thrust", "motor.max_thrust_n")
SWING = fitted("fit swing", "swing.natural_frequency_squared_s2")
MAP = fitted("fit thrust", "motor.thrust_per_speed_squared_n_s2")


class Input(NamedTuple):
    """A file and who made it, the number that its makers state within `off`, and the words that import it."""

    file: Path
    maker: str
    number: Number
    value: float
    off: float
    words: str = ""


READ = (
    Input(INPUTS / "ati_demo.csv", "ATI Net F/T demo", mean_fz, -1.2345, 1e-3),
    Input(INPUTS / "ati_demo_lbf.csv", "ATI Net F/T demo, lbf", mean_fz, -0.4905, 1e-3),
    Input(INPUTS / "bitcraze_static_torque_N.csv", "Bitcraze stand with torque", TORQUE, 0.007, 1e-5),
    Input(INPUTS / "bitcraze_static_torque_nm.csv", "the same, torque_nm", TORQUE, 0.007, 1e-5),
    Input(INPUTS / "loadcell_8hz.csv", "forces, 8 Hz", mean_fz, -0.49, 2e-3),
    Input(INPUTS / "stand_short_rows.csv", "RCbenchmark script, ragged rows", duration, 7.98, 1e-9),
    Input(INPUTS / "stand_slow_start.csv", "stand, 100 Hz, slow start", duration, 9.79, 1e-9),
    Input(INPUTS / "stand_thr_big.csv", "stand to 2000 us", THRUST, 12.8, 0.1),
    Input(INPUTS / "stand_thr_ok.csv", "stand to 1800 us, 0.7 times", THRUST, 0.7 * 12.8, 0.1),
    Input(INPUTS / "stand_thr_rej.csv", "stand to 1800 us", THRUST, 12.8, 0.1),
    Input(INPUTS / "swing_24hz_gyro.csv", "gyro, times of a computer", SWING, 60.0, 0.06, "--axis z"),
    Input(INPUTS / "swing_25hz_gyro.csv", "gyro, times of a computer", SWING, 60.0, 0.06, "--axis z"),
    Input(INPUTS / "swing_24hz_brackets.csv", "gyro, units in brackets", SWING, 60.0, 0.06, "--axis z"),
    Input(
        INPUTS / "swing_ns.csv", "rostopic echo -p", angular_frequency, 8.0, 0.01,
        "--kind angle --columns t=1,phi=2 --unit t=ns --unit phi=rad",
    ),
    Input(INPUTS / "torque_without_command.csv", "thrust and torque alone", TORQUE, 5.96e-3, 1e-5),
    Input(DATA / "multiarm_pendulum" / "single_free_swing.csv", "MultiArm-Pendulum", SWING, 64.02, 0.1),
    Input(BITCRAZE / "cf21_stock2.csv", "Bitcraze stand, four motors", MAP, 1.96e-8, 6e-10),
    Input(BITCRAZE / "cf2.1-stock-prop.csv", "Bitcraze stand, a ramp", duration, 25.72, 1e-9),
    Input(DATA / "bitcraze_2015" / "cf20_pwm_thrust_2015.csv", "Crazyflie firmware's pages", MAP, 2.22e-8, 3e-10),
    Input(FLIGHTS / "eschmann_log10.usd", "uSD-card log", duration, 50.006959 * SLOW, 1e-6),
    Input(FLIGHTS / "eschmann_log15.usd", "uSD-card log", duration, 62.188119 * SLOW, 1e-6),
    Input(FLIGHTS / "nanobench_B2_circle_fast_rep2.csv", "NanoBench", duration, 42.262240, 1e-5),
    Input(FLIGHTS / "nanobench_B5_helix_fast_rep1.csv", "NanoBench", duration, 42.260396, 1e-5),
)  # fmt: skip


def imported(file: Path, words: str, folder: Path) -> tuple[int, Path]:
    """Import a file into a new campaign; return the exit code and the folder of its runs."""
    if not file.exists():
        pytest.skip(f"{file.name} is not here (CFID_DATA, CFID_INPUTS)")
    (folder / "campaign" / "runs").mkdir(parents=True)
    (folder / "campaign" / "rig.toml").write_text(THREADS)
    ended = run_cfid(["import", file, *words.split()], folder / "campaign")
    return ended.returncode, folder / "campaign" / "runs"


@pytest.mark.parametrize("one", READ, ids=lambda one: one.file.stem)
def test_a_file_gives_what_its_makers_state(one: Input, tmp_path: Path) -> None:
    code, runs = imported(one.file, one.words, tmp_path)
    assert code == 0
    (run,) = runs.iterdir()
    assert one.number(run) == pytest.approx(one.value, abs=one.off)


@pytest.mark.parametrize(
    ("file", "code"),
    [
        (INPUTS / "ae483.json", 4),
        (INPUTS / "swing_ns.csv", 2),
        (DATA / "crtp" / "real_firmware_transcript.jsonl", 4),
        (DATA / "supervisor" / "s01_connect_idle.cf2_app.jsonl", 4),
    ],
    ids=lambda value: getattr(value, "stem", ""),
)
def test_a_file_that_is_no_recording_or_leaves_a_question_is_refused(file: Path, code: int, tmp_path: Path) -> None:
    assert imported(file, "", tmp_path)[0] == code


def test_the_swing_of_a_bad_rig_is_rejected(tmp_path: Path) -> None:
    file = DATA / "rotary_inverted_pendulum" / "pendulum_free_swing_data_01.txt"
    words = "--kind angle --skip-lines 2 --rate-hz 1000 --columns phi=1 --unit phi=deg"
    code, runs = imported(file, words, tmp_path)
    assert code == 0
    assert run_cfid(["fit", "swing", next(runs.iterdir()), "--no-figures"], tmp_path).returncode == 5
