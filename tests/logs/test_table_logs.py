"""Logs in CSV files: each program's header is recognised, and variables get the firmware's names and units."""

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from cfid.errors import ConfigError, DataError
from cfid.recordings.crazyflie import channel
from cfid.recordings.read import read_recording
from cfid.recordings.recording import How
from tests.lab import DATA
from tests.recordings.made import only


def written(folder: Path, text: str) -> Path:
    (folder / "log.txt").write_text(text)
    return folder / "log.txt"


def lines(head: str, row: str, count: int = 40, step: float = 10) -> str:
    return "\n".join([head, *(row.format(t=1000 + step * at, x=at / 4) for at in range(count)), ""])


def test_the_client_s_log_is_in_milliseconds_and_firmware_units(tmp_path: Path) -> None:
    log = read_recording(written(tmp_path, lines("Timestamp,stabilizer.roll,gyro.z", "{t:.0f},{x},{x}")))
    time_s, rate = channel(log, "gyro.z")
    np.testing.assert_allclose(time_s, 0.01 * np.arange(40))
    np.testing.assert_allclose(rate, np.radians(np.arange(40) / 4))
    assert log.facts.program == "CSV log of the Crazyflie client"
    assert only(log).begin_s == 1.0


def test_a_client_s_log_whose_times_are_in_seconds_is_refused_and_read_with_its_unit(tmp_path: Path) -> None:
    rows = "".join(f"23.{at:03d},0\n" for at in range(0, 900, 10))
    path = written(tmp_path, f"Timestamp,gyro.z\n{rows}")
    with pytest.raises(DataError, match="`unit` Timestamp=s") as refused:
        read_recording(path)
    assert refused.value.code == "other-unit"
    assert channel(read_recording(path, How(units={"Timestamp": "s"})), "gyro.z").time_s[-1] == pytest.approx(0.89)


@pytest.mark.parametrize(("unit", "second"), [("s", 1.0), ("ms", 1e3), ("us", 1e6)])
def test_a_table_decoded_from_a_card_has_the_clock_that_is_given(tmp_path: Path, unit: str, second: float) -> None:
    slow_s = 84 / 85 * (5 + 0.01 * np.arange(300))
    path = written(tmp_path, "\n".join(["timestamp,gyro.x", *(f"{second * at:.6f},{at}" for at in slow_s), ""]))
    clocks: dict[Literal["true", "84/85"] | None, float] = {None: 1.0, "true": 1.0, "84/85": 85 / 84}
    for clock, ratio in clocks.items():
        log = read_recording(path, How(units={"timestamp": unit}, clock=clock))
        np.testing.assert_allclose(channel(log, "gyro.x").time_s, ratio * (slow_s - slow_s[0]), atol=2e-6)
        assert log.facts.clock == clock


def test_a_clock_is_refused_for_a_table_that_no_vehicle_made_and_beside_a_rate(tmp_path: Path) -> None:
    """Before, an option that a table does not use was ignored without a word."""
    for head, how in (("t_s,a", How(clock="84/85")), ("t_s,gyro.x", How(clock="84/85", rate_hz=100.0))):
        with pytest.raises(ConfigError) as refused:
            read_recording(written(tmp_path, lines(head, "{t},{x}", step=0.01)), how)
        assert refused.value.code == "unused"


def test_nanobench_is_read_with_the_firmware_s_names() -> None:
    path = DATA / "flights" / "nanobench_B2_circle_fast_rep2.csv"
    if not path.exists():
        pytest.skip("the public flights are not here (CFID_DATA)")
    log = read_recording(path)
    assert log.facts.program == "CSV log of NanoBench"
    time_s, acceleration = channel(log, "acc.z")
    assert np.median(np.diff(time_s)) == pytest.approx(0.01, rel=1e-3)
    assert np.median(acceleration) == pytest.approx(9.81, rel=0.05)
    assert {"motor.m1", "pm.vbat", "stateEstimate.vx", "wx_vicon", "imu_gyro_y"} <= set(only(log).names)
    assert channel(log, "stateEstimate.roll").value.max() < np.pi
    gyro, seen = channel(log, "imu_gyro_x").value, channel(log, "wx_vicon").value  # late and smoothed
    assert gyro @ seen == pytest.approx(seen @ seen, rel=0.3)


def test_units_in_brackets_behind_the_firmware_s_names_are_the_columns_own(tmp_path: Path) -> None:
    head = "time [s],motor.m1 [PWM],gyro.x [rad/s],gyro.y (deg/s),acc.z [m/s^2],acc.x [g],pm.vbat [mV],rpm.m1 [rpm]"
    log = read_recording(written(tmp_path, lines(head, "{t},{x},{x},{x},{x},{x},{x},{x}", step=0.01)))
    x = np.arange(40) / 4
    expected = {"motor.m1": x, "gyro.x": x, "gyro.y": np.radians(x), "acc.z": x, "acc.x": 9.81 * x, "pm.vbat": x / 1e3}
    for name, value in expected.items():
        np.testing.assert_allclose(channel(log, name).value, value)
    assert only(log).names[:4] == ("motor.m1", "gyro.x", "gyro.y", "acc.z")
    assert not log.findings


@pytest.mark.parametrize("unit", ["rad/s", ""])
def test_a_unit_by_its_name_alone_is_a_finding_that_has_a_code(tmp_path: Path, unit: str) -> None:
    head = f"t,gyro.x [{unit}]" if unit else "t,gyro.x"
    log = read_recording(written(tmp_path, lines(head, "{t},{x}", step=0.01)))
    assert [one.code for one in log.findings] == ([] if unit else ["log-units-by-names"])


def test_underscores_stand_for_the_firmware_s_dots_where_a_column_can_be_no_other_vehicle_s(tmp_path: Path) -> None:
    log = read_recording(written(tmp_path, lines("t_ms,motor_m1,gyro_x,range_x", "{t:.0f},{x},{x},{x}", step=2)))
    assert only(log).names == ("motor.m1", "gyro.x", "range_x")
    assert channel(log, "gyro.x").value[-1] == pytest.approx(np.radians(39 / 4))
    log = read_recording(written(tmp_path, lines("t,gyro_x,acc_x", "{t},{x},{x}", step=0.01)))
    assert only(log).names == ("gyro_x", "acc_x")
