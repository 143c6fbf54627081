"""`cfid import`: a foreign recording becomes a run with its origin, which commands read like their own; it is kept."""

import hashlib
import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cfid.errors import ConfigError
from cfid.recordings.angle import angle_of
from cfid.recordings.importing import import_recording
from cfid.recordings.read import read_recording
from cfid.recordings.recording import How
from cfid.recordings.wrench import wrench_of
from cfid.records.run import Run, read_run
from tests.lab import Cfid, new_campaign
from tests.logs.usd_bytes import FIXED, Event, Record, bytes_of, rows, written

TIME_S = np.arange(3000) / 500
ANGLE_RAD = 0.5 * np.exp(-TIME_S / 20) * np.cos(8 * TIME_S)
EPOCH_S = 1_600_000_000.0
MOTORS = tuple(f"motor.m{motor}(H)" for motor in (1, 2, 3, 4))
HEAD_N = "t [s],Fx [N],Fy [N],Fz [N],Tx [Nm],Ty [Nm],Tz [Nm]"

Import = Callable[..., Run]


@pytest.fixture
def imported(cfid: Cfid, tmp_path: Path) -> Import:
    """Import a file into a campaign with some options, and return the run."""
    (new_campaign(tmp_path / "lab").runs_folder).mkdir()

    def run(file: Path, *options: object) -> Run:
        before = set((tmp_path / "lab" / "runs").iterdir())
        ended = cfid("import", file, "--campaign", tmp_path / "lab", *options)
        assert ended.returncode == 0, ended.stderr
        (made,) = set((tmp_path / "lab" / "runs").iterdir()) - before
        return read_run(made)

    return run


def table(path: Path, head: str, *columns: np.ndarray) -> Path:
    lines = [",".join(map(repr, row)) for row in np.column_stack(columns).tolist()]
    path.write_text("\n".join([*([head] if head else []), *lines, ""]), encoding="utf-8")
    return path


def forces(path: Path, head: str = HEAD_N, scale: float = 1.0) -> Path:
    return table(path, head, TIME_S, *(scale * (at + ANGLE_RAD) for at in range(6)))


def flight(folder: Path, rate: float = 1.0) -> Path:
    records: list[Record] = [(65535, round(1000 * rate * at), (at / 4, 0, 0, at // 50 * 1000, 7)) for at in range(200)]
    return written(folder, bytes_of([(65535, "fixedFrequency", ("gyro.x(f)", *MOTORS))], records))


def column(run: Run, device: str, name: str) -> np.ndarray:
    return read_recording(run.folder).series[device].column(name).values


def times(run: Run, device: str) -> np.ndarray:
    series = read_recording(run.folder).series[device]
    assert series.time_s is not None
    assert series.begin_s is not None
    return series.time_s + series.begin_s


def test_a_flight_s_log_becomes_a_run_with_its_commands_and_origin(imported: Import, tmp_path: Path) -> None:
    file = flight(tmp_path)
    run = imported(file, "--note", "outdoors")
    assert (run.header.kind, run.header.state, run.header.label.note) == ("flight", "complete", "outdoors")
    np.testing.assert_array_equal(column(run, "crazyflie", "gyro.x"), np.arange(200) / 4)
    commands = np.column_stack([column(run, "commands", f"m{motor}") for motor in (1, 2, 3, 4)])
    np.testing.assert_array_equal(commands, [[0, 0, at, 7] for at in (0, 1000, 2000, 3000)])
    np.testing.assert_allclose(times(run, "commands"), [0, 0.05, 0.1, 0.15])
    content = tomllib.loads((run.folder / "run.toml").read_text())
    assert content["origin"]["file"] == file.name
    assert content["origin"]["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    assert content["origin"]["clock"] == "true"
    assert content["devices"]["crazyflie"]["channel_units"]["gyro.x"] == "deg/s"


def test_a_slow_clock_is_corrected_once_and_not_again_by_what_reads_the_run(imported: Import, tmp_path: Path) -> None:
    run = imported(flight(tmp_path, 84 / 85))
    assert read_recording(run.folder).facts.clock == "84/85"
    np.testing.assert_allclose(times(run, "crazyflie"), np.arange(200) * 1e-3, atol=1e-6)
    again = imported(run.device_file("crazyflie"))
    np.testing.assert_allclose(times(again, "crazyflie"), np.arange(200) * 1e-3, atol=1e-6)
    left = imported(tmp_path / "LOG00.BIN", "--clock", "true")
    np.testing.assert_allclose(times(left, "crazyflie"), np.arange(200) * 84e-3 / 85, atol=1e-6)


def test_a_clock_that_the_log_does_not_show_is_a_question(imported: Import, cfid: Cfid, tmp_path: Path) -> None:
    records: list[Record] = [(65535, 1310 * at, (at, 0, 0, 0, 7)) for at in range(300)]
    file = written(tmp_path, bytes_of([(65535, "fixedFrequency", ("gyro.x(f)", *MOTORS))], records))
    asked = cfid("import", file, "--campaign", tmp_path / "lab")
    assert asked.returncode == 2
    assert "--clock" in asked.stderr
    assert not list((tmp_path / "lab" / "runs").iterdir())
    assert imported(file, "--clock", "84/85").header.origin is not None


def test_importing_again_makes_another_run_and_changes_neither_file_nor_run(imported: Import, tmp_path: Path) -> None:
    file = flight(tmp_path)
    content = file.read_bytes()
    first = imported(file)
    before = {path.name: path.read_bytes() for path in first.folder.iterdir()}
    assert imported(file).folder != first.folder
    assert {path.name: path.read_bytes() for path in first.folder.iterdir()} == before
    assert file.read_bytes() == content


def test_without_a_campaign_the_run_is_made_in_the_current_folder(cfid: Cfid, tmp_path: Path) -> None:
    file = table(tmp_path / "swing.csv", "t,phi_rad", TIME_S, ANGLE_RAD)
    made = cfid("import", file, "--axis", "x")
    assert made.returncode == 0, made.stderr
    (run,) = (path for path in tmp_path.iterdir() if path.is_dir())
    assert (run / "run.toml").is_file()
    step = made.stdout.splitlines()[-1].removeprefix("next: cfid ")
    assert step == f"fit swing {run.name}"
    assert cfid(*step.split(), "--no-figures").returncode == 0


@pytest.mark.parametrize("begin_s", [0.0, EPOCH_S])
def test_an_imported_angle_is_the_angle_of_the_file_and_keeps_its_date(
    imported: Import, tmp_path: Path, begin_s: float
) -> None:
    file = table(tmp_path / "a.csv", "t_s,theta_deg", begin_s + TIME_S, np.degrees(ANGLE_RAD))
    run = imported(file, "--axis", "x")
    kept, direct = angle_of(read_recording(run.folder)), angle_of(read_recording(file))
    assert (run.header.kind, kept.label.axis) == ("swing", "x")
    np.testing.assert_allclose(kept.angle_rad, direct.angle_rad, rtol=0, atol=1e-15)
    np.testing.assert_allclose(kept.time_s, direct.time_s, rtol=0, atol=3e-7)
    assert kept.begin_s == pytest.approx(begin_s)
    if begin_s:
        assert run.header.started.timestamp() == EPOCH_S


def test_imported_forces_are_those_of_the_file(imported: Import, tmp_path: Path) -> None:
    run = imported(forces(tmp_path / "a.csv"))
    record = wrench_of(read_recording(run.folder))
    np.testing.assert_array_equal(record.force_n[:, 2], 2 + ANGLE_RAD)
    np.testing.assert_array_equal(record.torque_nm[:, 2], 5 + ANGLE_RAD)
    head = "t [ms],Fx [mN],Fy [mN],Fz [mN],Tx [mNm],Ty [mNm],Tz [mNm]"
    scaled = table(tmp_path / "b.csv", head, 1e3 * TIME_S, *(1e3 * (at + ANGLE_RAD) for at in range(6)))
    np.testing.assert_allclose(wrench_of(read_recording(imported(scaled).folder)).force_n[:, 2], 2 + ANGLE_RAD)


def test_imported_forces_under_known_weights_calibrate_the_cell(imported: Import, cfid: Cfid, tmp_path: Path) -> None:
    """The cell shows 2 % too much of Fz and 1 % too little of Ty; z points up, and weights hang along -z."""
    rng = np.random.default_rng(1)
    for grams, x_mm in ((0, 0), (50, 46), (100, 46), (100, -46), (200, 46), (200, -46)):
        force = -9.81e-3 * grams
        wrench = np.array([0, 0, 1.02 * force, 0, -0.99 * force * x_mm / 1000, 0])
        shown = wrench + rng.normal(0, [1e-3] * 3 + [1e-5] * 3, (3000, 6))
        weight = ("--weight", f"{grams}:0.01", "--at-mm", f"{x_mm},0,0:0.05") if grams else ()
        imported(table(tmp_path / f"{grams}_{x_mm}.csv", HEAD_N, TIME_S, *shown.T), "--pull", "-z", *weight)
    fitted = cfid("fit", "loadcell", "--campaign", tmp_path / "lab", "--json")
    gains = json.loads(fitted.stdout)["parameters"]
    assert gains["loadcell.gain.fz"]["value"] == pytest.approx(1.02, abs=3e-4)
    assert gains["loadcell.gain.ty"]["value"] == pytest.approx(0.99, abs=3e-4)
    assert cfid("import", tmp_path / "0_0.csv", "--campaign", tmp_path / "lab", "--at-mm", "1,2,3").returncode == 2


@pytest.mark.parametrize(
    ("head", "answer"),
    [
        ("when,phi_rad", "--columns t=when"),
        ("t_s,phi", "--unit phi=rad"),
        ("", "--kind angle --columns 1,2 --unit phi=rad"),
    ],
)
def test_what_a_file_does_not_state_is_one_question_and_makes_no_run(
    imported: Import, cfid: Cfid, tmp_path: Path, head: str, answer: str
) -> None:
    file = table(tmp_path / "a.csv", head, TIME_S, ANGLE_RAD)
    asked = cfid("import", file, "--campaign", tmp_path / "lab")
    assert asked.returncode in (2, 4)
    assert len(asked.stderr.strip().splitlines()) == 1
    assert "--" in asked.stderr
    assert not list((tmp_path / "lab" / "runs").iterdir())
    np.testing.assert_allclose(column(imported(file, *answer.split()), "encoder", "phi"), ANGLE_RAD, atol=1e-15)


@pytest.mark.parametrize(
    ("file", "option"),
    [
        ("angle", "--counts-per-n 100"),
        ("forces", "--counts-per-turn 4096"),
        ("stand", "--counts-per-turn 4096"),
        ("log", "--rate-hz 100"),
    ],
)
def test_an_option_that_the_recording_does_not_use_is_an_error(
    imported: Import, cfid: Cfid, tmp_path: Path, file: str, option: str
) -> None:
    files = {
        "angle": lambda: table(tmp_path / "angle.csv", "t,phi_rad", TIME_S, ANGLE_RAD),
        "forces": lambda: forces(tmp_path / "forces.csv"),
        "stand": lambda: table(
            tmp_path / "stand.csv", "t_s,ESC signal (us),thrust_n", TIME_S, 1000 + TIME_S // 1 * 100, TIME_S // 1
        ),
        "log": lambda: flight(tmp_path),
    }
    path = files[file]()
    assert cfid("import", path, "--campaign", tmp_path / "lab").returncode == 0
    refused = cfid("import", path, "--campaign", tmp_path / "lab", *option.split())
    assert refused.returncode == 2
    assert option.split(maxsplit=1)[0] in refused.stderr
    assert len(list((tmp_path / "lab" / "runs").iterdir())) == 1


def test_columns_with_the_same_gaps_are_one_device_and_others_another(imported: Import, tmp_path: Path) -> None:
    lines = [
        f"{10 * at},{at},{at if at % 2 else ''},{2 * at if at % 2 else ''},{at if at % 3 else ''}," for at in range(60)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["timestamp,gyro.x,rpm.m1,rpm.m2,pm.vbat,none", *lines, ""]))
    run = imported(tmp_path / "a.csv", "--unit", "timestamp=ms")
    together = {record.columns[1:]: record.rows for record in run.header.devices.values()}
    assert together == {("gyro.x",): 60, ("rpm.m1", "rpm.m2"): 30, ("pm.vbat",): 40}
    of_speeds = next(name for name, record in run.header.devices.items() if "rpm.m2" in record.columns)
    np.testing.assert_array_equal(column(run, of_speeds, "rpm.m2"), 2.0 * np.arange(1, 60, 2))


@pytest.mark.parametrize(
    ("head", "scale"),
    [("gyro.x,gyro.y,gyro.z", 180 / np.pi), ("gyro.x [rad/s],gyro.y [rad/s],gyro.z [rad/s]", 1.0)],
)
def test_a_swing_that_a_gyro_recorded_is_fitted_in_the_unit_of_its_head(
    imported: Import, cfid: Cfid, tmp_path: Path, head: str, scale: float
) -> None:
    time_s = np.arange(0, 14, 1 / 24)
    swing = solve_ivp(
        lambda _, y: (y[1], -60 * np.sin(y[0]) - 0.1 * y[1]), (0, 14), (0.7, 0.0), t_eval=time_s, rtol=1e-10, atol=1e-12
    )
    rate = scale * (swing.y[1] + np.random.default_rng(1).normal(0, 2e-3, len(time_s)))
    off = 0 * time_s
    run = imported(table(tmp_path / "swing.csv", f"timestamp [s],{head}", time_s, off, off, rate), "--axis", "z")
    assert run.header.kind == "swing"
    fitted = cfid("fit", "swing", run.folder, "--json", "--no-figures")
    square = json.loads(fitted.stdout)["parameters"]["swing.natural_frequency_squared_s2"]["value"]
    assert square == pytest.approx(60.0, rel=1e-3)


def test_in_python_a_recording_is_imported_by_the_settings_that_read_it(tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    file = table(tmp_path / "a.csv", "when,phi_deg", TIME_S, np.degrees(ANGLE_RAD))
    how = How(columns=("t=when",))
    monkeypatch.chdir(tmp_path)
    run = import_recording(read_recording(file, how), how).run
    np.testing.assert_allclose(angle_of(read_recording(run.folder)).angle_rad, ANGLE_RAD, atol=1e-15)
    with pytest.raises(ConfigError) as refused:
        import_recording(read_recording(run.folder), How())
    assert refused.value.code == "a-run"


def test_an_event_without_variables_keeps_its_times(imported: Import, tmp_path: Path) -> None:
    taken_off: Event = (7, "takeOff", ())
    records: list[Record] = [*rows(100), (7, 5_100_500, ()), (7, 5_200_500, ())]
    run = imported(written(tmp_path, bytes_of([FIXED, taken_off], records)))
    assert times(run, "takeOff").tolist() == pytest.approx([5.1005, 5.2005])
