"""Real files and files of a known truth are read, or refused, as whoever made them says: one table of all of them.

python -m tests.recordings.test_supported_inputs    prints the table with what each file gives
"""

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.errors import CfidError
from cfid.recordings.read import read_recording
from tests.lab import DATA, INPUTS, run_cfid

GRAVITY = 9.81
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
SWING, MAP = "swing.natural_frequency_squared_s2", "motor.thrust_per_speed_squared_n_s2"


@dataclass(frozen=True, kw_only=True)
class Input:
    """A file, the words that import it, and the number that its makers state, which a command finds in its run.

    Without `command` the number is that of `number`, a function of the imported run; without either, the import is
    refused with an exit code.
    """

    file: Path
    origin: str
    words: str = ""
    command: str = ""
    key: str = ""
    number: Callable[[Path], float] | None = None
    value: float = 0.0
    off: float = 0.0
    code: int = 0


def mean(device: str, name: str) -> Callable[[Path], float]:
    """Return the function that gives the mean of a column of a run's device."""
    return lambda run: float(np.mean(read_recording(run).series[device].column(name).values))


def duration(device: str) -> Callable[[Path], float]:
    """Return the function that gives the time from the first to the last row of a run's device."""
    return lambda run: float(np.ptp(read_recording(run).series[device].frame()["t"]))


def angular_frequency(run: Path) -> float:
    """Return the angular frequency of a swing, from its times through zero."""
    frame = read_recording(run).series["encoder"].frame()
    time_s, angle = frame["t"].to_numpy(), frame["phi"].to_numpy()
    before = np.flatnonzero(angle[1:] * angle[:-1] < 0)
    through_s = time_s[before] - angle[before] * np.diff(time_s)[before] / np.diff(angle)[before]
    return float(np.pi / np.mean(np.diff(through_s)))


def last(key: str, place: int = -1) -> str:
    """Return a key with a place of its value."""
    return f"{key}:{place}"


BITCRAZE = DATA / "bitcraze_2021"
SLOW = 85 / 84  # of a uSD card's microseconds, as the rows of both logs show
TABLE = (
    Input(file=INPUTS / "ae483.json", origin="flight client, JSON", code=4),
    Input(
        file=INPUTS / "ati_demo.csv", origin="ATI Net F/T demo", number=mean("loadcell", "Fz"), value=-1.2345, off=1e-3
    ),
    Input(
        file=INPUTS / "ati_demo_lbf.csv",
        origin="ATI Net F/T demo, lbf",
        number=mean("loadcell", "Fz"),
        value=-0.4905,
        off=1e-3,
    ),
    Input(
        file=INPUTS / "bitcraze_static_torque_N.csv",
        origin="Bitcraze stand with torque",
        command="fit torque",
        key=last("motor.torque_poly", -2),
        value=0.007,
        off=1e-5,
    ),
    Input(
        file=INPUTS / "bitcraze_static_torque_nm.csv",
        origin="the same, torque_nm",
        command="fit torque",
        key=last("motor.torque_poly", -2),
        value=0.007,
        off=1e-5,
    ),
    Input(
        file=INPUTS / "loadcell_8hz.csv",
        origin="forces, 8 Hz",
        number=mean("loadcell", "Fz"),
        value=-0.49,
        off=2e-3,
    ),
    Input(
        file=INPUTS / "stand_short_rows.csv",
        origin="RCbenchmark script, ragged rows",
        number=duration("stand"),
        value=7.98,
        off=1e-9,
    ),
    Input(
        file=INPUTS / "stand_slow_start.csv",
        origin="stand, 100 Hz, slow start",
        number=duration("stand"),
        value=9.79,
        off=1e-9,
    ),
    Input(
        file=INPUTS / "stand_thr_big.csv",
        origin="stand to 2000 us",
        command="fit thrust",
        key="motor.max_thrust_n",
        value=12.8,
        off=0.1,
    ),
    Input(
        file=INPUTS / "stand_thr_ok.csv",
        origin="stand to 1800 us, 0.7 times",
        command="fit thrust",
        key="motor.max_thrust_n",
        value=0.7 * 12.8,
        off=0.1,
    ),
    Input(
        file=INPUTS / "stand_thr_rej.csv",
        origin="stand to 1800 us",
        command="fit thrust",
        key="motor.max_thrust_n",
        value=12.8,
        off=0.1,
    ),
    *(
        Input(
            file=INPUTS / f"swing_{name}.csv",
            origin="gyro of a swing, times of a computer",
            words="--axis z",
            command="fit swing",
            key=SWING,
            value=60.0,
            off=0.06,
        )
        for name in ("24hz_gyro", "25hz_gyro", "24hz_brackets")
    ),
    Input(file=INPUTS / "swing_ns.csv", origin="rostopic echo -p", code=2),
    Input(
        file=INPUTS / "swing_ns.csv",
        origin="rostopic echo -p",
        words="--kind angle --columns t=1,phi=2 --unit t=ns --unit phi=rad",
        number=angular_frequency,
        value=8.0,
        off=0.01,
    ),
    Input(
        file=INPUTS / "torque_without_command.csv",
        origin="thrust and torque alone",
        command="fit torque",
        key=last("motor.torque_poly", -2),
        value=5.96e-3,
        off=1e-5,
    ),
    Input(
        file=DATA / "multiarm_pendulum" / "single_free_swing.csv",
        origin="MultiArm-Pendulum",
        command="fit swing",
        key=SWING,
        value=64.02,
        off=0.1,
    ),
    Input(
        file=DATA / "rotary_inverted_pendulum" / "pendulum_free_swing_data_01.txt",
        origin="rotary inverted pendulum, a bad rig",
        words="--kind angle --skip-lines 2 --rate-hz 1000 --columns phi=1 --unit phi=deg",
        command="fit swing",
        code=5,
    ),
    Input(
        file=BITCRAZE / "cf21_stock2.csv",
        origin="Bitcraze stand, four motors",
        command="fit thrust",
        key=MAP,
        value=1.96e-8,
        off=6e-10,
    ),
    Input(
        file=BITCRAZE / "cf2.1-stock-prop.csv",
        origin="Bitcraze stand, a ramp",
        number=duration("stand"),
        value=25.72,
        off=1e-9,
    ),
    Input(
        file=DATA / "bitcraze_2015" / "cf20_pwm_thrust_2015.csv",
        origin="Crazyflie firmware's documentation",
        command="fit thrust",
        key=MAP,
        value=2.22e-8,
        off=3e-10,
    ),
    Input(
        file=DATA / "flights" / "eschmann_log10.usd",
        origin="uSD-card log",
        number=duration("crazyflie"),
        value=50.006959 * SLOW,
        off=1e-6,
    ),
    Input(
        file=DATA / "flights" / "eschmann_log15.usd",
        origin="uSD-card log",
        number=duration("crazyflie"),
        value=62.188119 * SLOW,
        off=1e-6,
    ),
    *(
        Input(
            file=DATA / "flights" / f"nanobench_{name}.csv",
            origin="NanoBench",
            number=duration("crazyflie"),
            value=seconds,
            off=1e-5,
        )
        for name, seconds in (("B2_circle_fast_rep2", 42.262240), ("B5_helix_fast_rep1", 42.260396))
    ),
    *(
        Input(file=path, origin="packets, no recording", code=4)
        for path in (
            DATA / "crtp" / "real_firmware_transcript.jsonl",
            DATA / "supervisor" / "s01_connect_idle.cf2_app.jsonl",
        )
    ),
)


def ended(one: Input, folder: Path) -> tuple[int, float, str]:
    """Import a file into a campaign, run the command on its run; return the exit code, the number and the last line."""
    campaign = folder / "campaign"
    (campaign / "runs").mkdir(parents=True)
    (campaign / "rig.toml").write_text(THREADS)
    made = run_cfid(["import", str(one.file), *one.words.split()], campaign)
    if made.returncode:
        return made.returncode, np.nan, made.stderr.strip().splitlines()[-1]
    (run,) = (campaign / "runs").iterdir()
    if one.number is not None:
        return 0, one.number(run), made.stdout.splitlines()[0]
    fitted = run_cfid([*one.command.split(), str(run), "--json", "--no-figures"], folder)
    if fitted.returncode:
        return fitted.returncode, np.nan, fitted.stderr.strip().splitlines()[-1]
    key, _, place = one.key.partition(":")
    value: Any = json.loads(fitted.stdout)["parameters"][key]["value"]
    return 0, float(value[int(place)] if place else value), made.stdout.splitlines()[0]


def name(one: Input) -> str:
    return f"{one.file.stem}{' ' if one.words else ''}{one.words}"


@pytest.mark.parametrize("one", TABLE, ids=name)
def test_a_file_gives_what_its_makers_state(one: Input, tmp_path: Path) -> None:
    if not one.file.exists():
        pytest.skip(f"{one.file.name} is not here (CFID_DATA, CFID_INPUTS)")
    code, value, said = ended(one, tmp_path)

    assert code == one.code, said
    if not code:
        assert abs(value - one.value) <= one.off, said


def rows(table: Sequence[Input]) -> list[str]:
    """Return the table of the record: file, origin, options, what it gives and what is right."""
    lines = ["| file | from | options | gives | right |", "|---|---|---|---|---|"]
    for one in table:
        with tempfile.TemporaryDirectory() as folder:
            try:
                code, value, said = ended(one, Path(folder)) if one.file.exists() else (-1, np.nan, "not here")
            except CfidError as error:
                code, value, said = error.exit_code, np.nan, str(error)
        right = f"refused ({one.code})" if one.code else f"{one.value:.6g}"
        gives = f"{one.key or 'mean'} {value:.6g}" if not code else f"refused ({code}): {said}"
        lines.append(f"| {one.file.name} | {one.origin} | {one.words} | {gives} | {right} |")
    return lines


if __name__ == "__main__":
    print("\n".join(rows(TABLE)))
