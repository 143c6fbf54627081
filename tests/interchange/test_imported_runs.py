"""`cfid import`: a foreign recording is kept, and becomes a run with its origin that commands read like their own."""

import hashlib
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from cfid.cli.main import main
from cfid.recordings.read import read_recording
from cfid.recordings.vehicle import VEHICLE_LOG, read_commands, read_rows
from cfid.recordings.wrench import wrench_of
from cfid.records.logs.any_kind import read_log
from cfid.records.logs.run import log_of_run
from cfid.records.run import Run, read_run
from cfid.records.tables.angle import Reading, read_angle
from tests.campaigns import Cfid
from tests.logs.usd_bytes import FIXED, Event, Record, bytes_of, rows, written

TIME_S = np.arange(3000) / 500
ANGLE_RAD = 0.5 * np.exp(-TIME_S / 20) * np.cos(8 * TIME_S)
MOTORS = tuple(f"motor.m{motor}(H)" for motor in (1, 2, 3, 4))


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    code("new", str(tmp_path / "campaign"))
    return tmp_path / "campaign"


def code(*words: str) -> int | str | None:
    with pytest.raises(SystemExit) as end:
        main(words)
    return end.value.code


def imported(campaign: Path, file: Path, *options: str) -> Run:
    before = set((campaign / "runs").iterdir())
    assert code("import", str(file), "--campaign", str(campaign), *options) == 0
    (made,) = set((campaign / "runs").iterdir()) - before
    return read_run(made)


def flight(folder: Path) -> Path:
    records: list[Record] = [(65535, 1000 * at, (at / 4, 0, 0, at // 50 * 1000, 7)) for at in range(200)]
    return written(folder, bytes_of([(65535, "fixedFrequency", ("gyro.x(f)", *MOTORS))], records))


def test_a_flight_s_log_becomes_a_run_with_its_commands_and_origin(tmp_path: Path, campaign: Path) -> None:
    file = flight(tmp_path)
    run = imported(campaign, file, "--note", "outdoors")
    assert (run.header.kind, run.header.state, run.header.label.note) == ("flight", "complete", "outdoors")
    np.testing.assert_array_equal(read_rows(run, VEHICLE_LOG).columns["gyro.x"], np.arange(200) / 4)
    rows, commands = read_commands(run)
    np.testing.assert_array_equal(commands, [[0, 0, at, 7] for at in (0, 1000, 2000, 3000)])
    np.testing.assert_allclose(rows.time_s, [0, 0.05, 0.1, 0.15])  # stamps agree with the scheduler
    origin = tomllib.loads((run.folder / "run.toml").read_text())["origin"]
    assert origin["file"] == file.name
    assert origin["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    assert origin["program"] == "Crazyflie uSD-card log, version 2"
    assert origin["clock"] == "true"


def test_units_in_the_heads_of_a_flight_s_log_are_those_of_its_run(tmp_path: Path, campaign: Path) -> None:
    file = tmp_path / "log.csv"
    rows = [f"{at / 100:.2f},{at},{at},{at}\n" for at in range(200)]
    file.write_text("t,motor.m1 [PWM],gyro.x [rad/s],acc.z (m/s^2)\n" + "".join(rows))
    log, run = read_log(file), log_of_run(imported(campaign, file))
    for name in ("motor.m1", "gyro.x", "acc.z"):
        np.testing.assert_array_equal(log.channel(name)[1], np.arange(200))
        np.testing.assert_array_equal(run.channel(name)[1], np.arange(200))


def test_a_slow_clock_is_corrected_once_by_an_import_and_not_again_by_what_reads_the_run(
    tmp_path: Path, campaign: Path, cfid: Cfid
) -> None:
    records: list[Record] = [(65535, round(1000 * at * 84 / 85), (at, 0, 0, 0, 7)) for at in range(200)]
    file = written(tmp_path, bytes_of([(65535, "fixedFrequency", ("gyro.x(f)", *MOTORS))], records))
    run = imported(campaign, file)
    assert run.header.origin is not None
    assert run.header.origin.clock == "84/85"
    np.testing.assert_allclose(read_rows(run, VEHICLE_LOG).time_s, np.arange(200) * 1e-3, atol=1e-6)

    again = imported(campaign, run.device_file(VEHICLE_LOG))
    np.testing.assert_allclose(read_rows(again, VEHICLE_LOG).time_s, np.arange(200) * 1e-3, atol=1e-6)
    refused = cfid("convert", run.folder, "--to", "csv", "--clock", "84/85")
    assert refused.returncode == 2
    assert "as they were taken" in refused.stderr

    left = imported(campaign, file, "--clock", "true")
    np.testing.assert_allclose(read_rows(left, VEHICLE_LOG).time_s, np.arange(200) * 84e-3 / 85, atol=1e-6)


def test_importing_again_makes_another_run_and_changes_neither_file_nor_run(tmp_path: Path, campaign: Path) -> None:
    file = flight(tmp_path)
    content = file.read_bytes()
    first = imported(campaign, file)
    before = {path.name: path.read_bytes() for path in first.folder.iterdir()}
    assert imported(campaign, file).folder != first.folder
    assert {path.name: path.read_bytes() for path in first.folder.iterdir()} == before
    assert file.read_bytes() == content


def test_an_imported_angle_is_the_angle_of_the_file(tmp_path: Path, campaign: Path) -> None:
    savemat(tmp_path / "a.mat", {"time": TIME_S, "theta": ANGLE_RAD})
    run = imported(campaign, tmp_path / "a.mat", "--angle-unit", "rad", "--axis", "x")
    found, direct = read_angle(run.folder, Reading()), read_angle(tmp_path / "a.mat", Reading(angle_unit="rad"))
    assert run.header.kind == "swing"
    assert found.label.axis == "x"
    np.testing.assert_allclose(found.angle_rad, direct.angle_rad, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(found.time_s, direct.time_s)


def test_times_between_microseconds_keep_all_their_digits(tmp_path: Path, campaign: Path) -> None:
    time_s = TIME_S / 7
    savemat(tmp_path / "a.mat", {"time": time_s, "theta": ANGLE_RAD})
    run = imported(campaign, tmp_path / "a.mat", "--angle-unit", "rad")
    assert code("convert", str(run.folder), "--to", "csv", "--out", str(tmp_path / "back.csv")) == 0
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "back.csv", delimiter=",", skiprows=1)[:, 0], time_s)


def test_imported_forces_are_those_of_the_file(tmp_path: Path, campaign: Path) -> None:
    names = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
    values = np.column_stack([TIME_S, *(at + ANGLE_RAD for at in range(6))])
    np.savetxt(tmp_path / "a.csv", values, "%.17g", delimiter=",", header=f"t,{','.join(names)}", comments="")
    run = imported(campaign, tmp_path / "a.csv", "--unit", "Fx=N", "--unit", "Tx=Nm")
    found = wrench_of(read_recording(run.folder))
    np.testing.assert_array_equal(found.force_n[:, 2], 2 + ANGLE_RAD)
    np.testing.assert_array_equal(found.torque_nm[:, 2], 5 + ANGLE_RAD)


def test_imported_forces_under_known_weights_calibrate_the_cell(
    tmp_path: Path, campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The cell shows 2 % too much of Fz and 1 % too little of Ty; z points up, and weights hang along -z."""
    rng = np.random.default_rng(1)
    for grams, x_mm in ((0, 0), (50, 46), (100, 46), (100, -46), (200, 46), (200, -46)):
        force = -9.81e-3 * grams
        wrench = np.array([0, 0, 1.02 * force, 0, -0.99 * force * x_mm / 1000, 0])
        shown = wrench + rng.normal(0, [1e-3] * 3 + [1e-5] * 3, (3000, 6))
        file = tmp_path / f"{grams}_{x_mm}.csv"
        np.savetxt(
            file,
            np.column_stack([TIME_S, shown]),
            delimiter=",",
            header="t,Fx (N),Fy (N),Fz (N),Tx (N-m),Ty (N-m),Tz (N-m)",
            comments="",
        )
        weight = ("--weight", f"{grams}:0.01", "--at-mm", f"{x_mm},0,0:0.05") if grams else ()
        imported(campaign, file, "--pull", "-z", *weight)
    capsys.readouterr()
    assert code("fit", "loadcell", "--campaign", str(campaign), "--json") == 0
    found = json.loads(capsys.readouterr().out)["parameters"]
    assert found["loadcell.gain.fz"]["value"] == pytest.approx(1.02, abs=3e-4)
    assert found["loadcell.gain.ty"]["value"] == pytest.approx(0.99, abs=3e-4)
    assert code("import", str(tmp_path / "0_0.csv"), "--campaign", str(campaign), "--at-mm", "1,2,3") == 2


def test_forces_are_known_by_their_columns_in_any_unit_and_one_that_is_not_read_is_named(
    tmp_path: Path, campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [";".join(f"{x:.3f}" for x in (1e3 * t, *[250 * phi] * 6)) for t, phi in zip(TIME_S, ANGLE_RAD, strict=True)]
    head = "Time [ms];Fx [{0}];Fy [{0}];Fz [{0}];Tx [mNm];Ty [mNm];Tz [mNm]"
    (tmp_path / "a.csv").write_text("\n".join([head.format("mN"), *rows, ""]), encoding="utf-8")
    found = wrench_of(read_recording(imported(campaign, tmp_path / "a.csv", "--pull", "z").folder))
    np.testing.assert_allclose(found.force_n[:, 2], 0.25 * ANGLE_RAD, atol=1e-6)
    np.testing.assert_allclose(found.torque_nm[:, 2], 0.25 * ANGLE_RAD, atol=1e-6)
    (tmp_path / "b.csv").write_text("\n".join([head.format("dyn"), *rows, ""]), encoding="utf-8")
    assert code("import", str(tmp_path / "b.csv"), "--campaign", str(campaign), "--pull", "z") == 2
    assert "Fx [dyn]" in " ".join(capsys.readouterr().err.split())


def test_what_is_ambiguous_is_a_question_and_makes_no_run(
    tmp_path: Path, campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    savemat(tmp_path / "a.mat", {"time": TIME_S, "phi": np.round(100 * ANGLE_RAD)})
    assert code("import", str(tmp_path / "a.mat"), "--campaign", str(campaign)) == 4
    assert "give --counts-per-turn N, or --angle-unit" in capsys.readouterr().err
    savemat(tmp_path / "b.mat", {"time": TIME_S, "u": ANGLE_RAD})
    assert code("import", str(tmp_path / "b.mat"), "--campaign", str(campaign)) == 2
    assert "give --kind angle, wrench or flight" in capsys.readouterr().err
    assert list((campaign / "runs").iterdir()) == []


def test_a_bad_column_is_left_out_and_named(tmp_path: Path, campaign: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records: list[Record] = [(65535, 1000 * at, (at, float("nan"))) for at in range(50)]
    file = written(tmp_path, bytes_of([(65535, "fixedFrequency", ("gyro.x(f)", "pm.vbat(f)"))], records))
    run = imported(campaign, file)
    assert list(read_rows(run, VEHICLE_LOG).columns) == ["gyro.x"]
    assert "no finite number: pm.vbat" in capsys.readouterr().err


def test_a_column_in_which_one_number_is_missing_keeps_the_others(
    tmp_path: Path, campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    records: list[Record] = [(65535, 1000 * at, (at, float("nan") if at == 7 else 2 * at)) for at in range(50)]
    file = written(tmp_path, bytes_of([(65535, "fixedFrequency", ("gyro.x(f)", "rpm.m1(f)"))], records))
    run = imported(campaign, file)
    assert "of their own, since some rows have no number: rpm.m1" in capsys.readouterr().err
    time_s, speed = log_of_run(run).channel("rpm.m1")
    whole, direct = read_log(file).channel("rpm.m1")
    np.testing.assert_array_equal(speed, direct[np.isfinite(direct)])
    np.testing.assert_allclose(np.diff(time_s), np.diff(whole[np.isfinite(direct)]), atol=2e-6)
    assert len(log_of_run(run).channel("gyro.x")[1]) == 50


def test_columns_with_the_same_gaps_are_one_device_and_others_another(tmp_path: Path, campaign: Path) -> None:
    rows = [
        f"{10 * at},{at},{at if at % 2 else ''},{2 * at if at % 2 else ''},{at if at % 3 else ''}" for at in range(60)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["timestamp,gyro.x,rpm.m1,rpm.m2,pm.vbat", *rows, ""]))
    run = imported(campaign, tmp_path / "a.csv", "--time-unit", "ms", "--kind", "flight")
    together = {record.columns[1:]: record.rows for record in run.header.devices.values()}
    assert together == {("gyro.x",): 60, ("rpm.m1", "rpm.m2"): 30, ("pm.vbat",): 40}
    np.testing.assert_allclose(log_of_run(run).channel("rpm.m2")[1], np.pi / 15 * np.arange(1.0, 60.0, 2.0), rtol=1e-12)


def test_columns_beside_an_angle_are_named_where_they_are_not_kept(
    tmp_path: Path, campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = "".join(f"{t:.3f},{phi:.6f},21,x\n" for t, phi in zip(TIME_S, ANGLE_RAD, strict=True))
    (tmp_path / "a.csv").write_text("time_s,theta_rad,temp_c,label\n" + rows)
    imported(campaign, tmp_path / "a.csv")
    assert "of the columns time_s, theta_rad, temp_c, label time and angle alone are kept" in capsys.readouterr().err


def test_a_card_s_log_of_a_swing_has_true_seconds(tmp_path: Path, campaign: Path) -> None:
    rate_dps = np.degrees(4 * np.sin(8 * np.arange(3000) / 1000)) + 0.5
    records: list[Record] = [(65535, round(84e3 / 85 * at), (rate, 0.5, 0.5)) for at, rate in enumerate(rate_dps)]
    gyro = ("gyro.x(f)", "gyro.y(f)", "gyro.z(f)")
    file = written(tmp_path, bytes_of([(65535, "fixedFrequency", gyro)], records))

    run = imported(campaign, file, "--axis", "x")
    found = read_angle(run.folder, Reading())

    assert (run.header.kind, run.header.label.axis) == ("swing", "x")
    assert found.rates is not None
    assert found.rates.axis == pytest.approx((1, 0, 0), abs=1e-3)
    assert "rejection" not in [finding.severity for finding in found.findings]
    assert found.time_s[-1] == pytest.approx(2.999, abs=1e-5)

    # Version 0.2 imported a log that does not show its clock, and stated so in run.toml.
    header = run.folder / "run.toml"
    undecided = "not corrected: the log does not show whether they run at 84/85 of real time, as on"
    header.write_text(header.read_text().replace('clock = "84/85"', f'clock = "{undecided}"'))
    assert "gyro-clock-undecided" in [finding.code for finding in read_angle(run.folder, Reading()).findings]


def test_an_event_without_variables_keeps_its_times(tmp_path: Path, campaign: Path) -> None:
    taken_off: Event = (7, "takeOff", ())
    records: list[Record] = [*rows(100), (7, 5_100_500, ()), (7, 5_200_500, ())]
    file = written(tmp_path, bytes_of([FIXED, taken_off], records))
    run = imported(campaign, file)

    times = np.loadtxt(run.device_file("takeOff"), skiprows=1, ndmin=1)
    assert times.tolist() == pytest.approx([5.1005, 5.2005])


def test_a_stands_columns_are_imported_by_the_names_that_are_given(campaign: Path, tmp_path: Path) -> None:
    rows = [f"{at / 50},{1000 + 200 * (at // 100)},{at // 100},{3 * (at // 100)},{12.0}" for at in range(500)]
    (tmp_path / "odd.csv").write_text("\n".join(["clock (s),pulse,F (kgf),Thrust (N),volts", *rows, ""]))
    names = "time_s=clock (s),esc_us=pulse,thrust_n=F (kgf)"
    run = imported(campaign, tmp_path / "odd.csv", "--kind", "stand", "--columns", names)

    assert run.header.devices["stand"].columns == ("t", "esc_us", "thrust(kgf)", "unused Thrust (N)", "volts")


@pytest.mark.parametrize(("columns", "said"), [([], "rows differ in 'Prop'"), (["Prop=A"], "chooses rows")])
def test_a_stands_recording_of_two_propellers_is_not_imported_as_one(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], columns: list[str], said: str
) -> None:
    head = "Time (s),ESC signal (us),Thrust (gf),Prop"
    rows = [f"{at / 50},{1000 + 100 * (at // 20 % 10)},{(at // 20 % 10) ** 2},{'AB'[at // 200]}" for at in range(400)]
    (tmp_path / "two.csv").write_text("\n".join([head, *rows, ""]))
    options = [word for one in columns for word in ("--columns", one)]
    assert code("import", str(tmp_path / "two.csv"), "--campaign", str(campaign), *options) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert imported(campaign, tmp_path / "two.csv", "--columns", "Prop=*").header.kind == "stand"


def test_a_log_whose_time_is_named_alone_is_a_log(tmp_path: Path, campaign: Path) -> None:
    rows = "".join(f"{at / 100},{at}\n" for at in range(200))
    (tmp_path / "log.csv").write_text(f"when,gyro.x\n{rows}")
    run = imported(campaign, tmp_path / "log.csv", "--columns", "when", "--time-unit", "s")
    assert read_rows(run, VEHICLE_LOG).columns["gyro.x"].tolist() == list(range(200))


def test_a_swing_without_the_three_gyros_is_refused_with_the_names_that_serve(
    tmp_path: Path, campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = "".join(f"{at / 100},{at},0,0\n" for at in range(200))
    (tmp_path / "log.csv").write_text(f"t,Gyroscope x (rad/s),Gyroscope y (rad/s),Gyroscope z (rad/s)\n{rows}")
    words = ("import", str(tmp_path / "log.csv"), "--campaign", str(campaign), "--axis", "x", "--kind", "flight")
    assert code(*words) == 4
    assert "give them these names, with their unit, as in gyro.x [rad/s]" in " ".join(capsys.readouterr().err.split())
    assert not list((campaign / "runs").iterdir())
