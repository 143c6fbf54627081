"""ULog and blackbox: files composed byte by byte are read with their own libraries."""

import contextlib
import struct
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import ConfigError, DataError
from cfid.recordings.crazyflie import channel
from cfid.recordings.read import read_recording
from cfid.recordings.recording import How, Recording
from tests.logs.autopilot_bytes import (
    BLACKBOX_END,
    COUNT,
    blackbox,
    blackbox_head,
    blackbox_row,
    blackbox_with_voltage,
    message,
    ulog,
    unsigned,
)
from tests.recordings.made import only


def codes(log: Recording) -> list[str]:
    return [one.code for one in log.findings]


def written(folder: Path, content: bytes) -> Path:
    (folder / "log").write_bytes(content)
    return folder / "log"


@pytest.mark.parametrize(("content", "extra"), [(ulog(), "ulog"), (blackbox(), "blackbox")])
def test_a_missing_library_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes, extra: str
) -> None:
    for name in ("pyulog", "orangebox"):
        monkeypatch.setitem(sys.modules, name, None)  # as if it were not installed
    with pytest.raises(ConfigError, match=rf'pip install "cfid\[{extra}\]"'):
        read_recording(written(tmp_path, content))


def test_topics_of_a_ulog_file_are_series_in_px4_s_units(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    log = read_recording(written(tmp_path, ulog()))
    time_s, rate = channel(log, "xyz[0]")
    np.testing.assert_allclose(time_s, 0.004 * np.arange(COUNT))
    np.testing.assert_array_equal(rate, np.arange(COUNT) / 8)
    assert {series.name: series.rows for series in log.series.values()} == {
        "vehicle_angular_velocity": 200,
        "battery_status": 20,
        "actuator_motors": 20,
        "vehicle_acceleration": 20,
    }
    rates = log.series["vehicle_angular_velocity"]
    assert [column.unit for column in rates.columns] == ["rad/s"] * 3
    assert "FMU6" in log.facts.program
    assert codes(log) == ["log-dropouts", "log-motors"]


@pytest.mark.parametrize(
    ("geometry", "order"), [("", (1, 4, 2, 3)), ("FR RL FL RR", (1, 4, 2, 3)), ("FR RR RL FL", (1, 2, 3, 4))]
)
def test_motors_of_px4_get_the_crazyflie_s_numbers(tmp_path: Path, geometry: str, order: tuple[int, ...]) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    log = read_recording(written(tmp_path, ulog(geometry=geometry)))
    for motor, of_px4 in enumerate(order, start=1):
        np.testing.assert_allclose(channel(log, f"control.m{motor}").value, 65535 * 0.1 * of_px4, rtol=1e-6)
    np.testing.assert_allclose(channel(log, "acc.z").value, 9.81, rtol=1e-6)
    np.testing.assert_allclose(channel(log, "pm.vbat").value, 16.5)
    assert log.facts.square is (True if geometry else None)


def test_frames_of_a_blackbox_log_are_rows_in_si_units(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    log = read_recording(written(tmp_path, blackbox()))
    time_s, rate = channel(log, "gyroADC[0]")
    np.testing.assert_allclose(time_s, 5e-4 * np.arange(COUNT))
    np.testing.assert_allclose(rate, np.radians(np.arange(COUNT) - 100.0))
    np.testing.assert_allclose(channel(log, "accSmooth[2]").value, 9.81)
    np.testing.assert_array_equal(channel(log, "motor[0]").value, 1000 + np.arange(COUNT))
    assert "Betaflight 2025.12.1" in log.facts.program


def test_motors_of_betaflight_get_the_crazyflie_s_numbers(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    log = read_recording(written(tmp_path, blackbox()))
    for motor, place in {1: 1, 2: 0, 3: 2, 4: 3}.items():
        part = (np.arange(COUNT) + 100 * place) / 1000
        np.testing.assert_allclose(channel(log, f"control.m{motor}").value, 65535 * part)
        np.testing.assert_allclose(channel(log, f"rpm.m{motor}").value, (70 + place) * 100 / 7 * np.pi / 30)
    np.testing.assert_allclose(channel(log, "acc.z").value, 9.81)
    assert "motor[1], motor[0], motor[2], motor[3]" in log.findings[0].sentence


@pytest.mark.parametrize(
    ("firmware", "step_v"),
    [
        ("Betaflight 3.1.0 (abcdef012) SPRACINGF3", 0.1),
        ("Betaflight 3.5.7 (e7c2c2a0e) OMNIBUSF4", 0.1),
        ("Betaflight 4.0.0 (22b9f34b5) OMNIBUSF4", 0.01),
        ("Betaflight 2025.12.1 (abcdef012) STM32H743", 0.01),
    ],
)
def test_the_voltage_of_a_blackbox_log_has_the_step_of_its_firmware_s_version(
    tmp_path: Path, firmware: str, step_v: float
) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    counts = [round(volts / step_v) for volts in (16.4, 16.3, 15.2, 16.6)]
    log = read_recording(
        written(tmp_path, blackbox_with_voltage(firmware=firmware, reference=counts[0], counts=counts))
    )
    for name in ("pm.vbat", "vbatLatest"):
        np.testing.assert_allclose(channel(log, name).value, [16.4, 16.3, 15.2, 16.6])


def test_a_cut_blackbox_log_gives_its_whole_frames(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    log = read_recording(written(tmp_path, blackbox()[:-200]))
    assert 150 < only(log).rows < COUNT
    assert "log-cut" in codes(log)


@pytest.mark.parametrize("damage", [b"\0\0\xff", b"I\1", b"P", b"IIII", b"\xff" * 40, -1, -2, -5, -13])
def test_damaged_bytes_of_a_blackbox_log_cost_the_frames_that_they_are_in(tmp_path: Path, damage: bytes | int) -> None:
    """After some of these, the library continues with misaligned frames, in which fields have the numbers of others."""
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    content = blackbox()
    middle = content.index(b"I" + unsigned(100) + unsigned(1000 + 500 * 100))
    if isinstance(damage, int):
        torn = content[: middle + 3] + content[middle + 3 - damage :]
    else:
        torn = content[:middle] + damage + content[middle:]
    log = read_recording(written(tmp_path, torn))

    series = only(log)
    loops = series.column("loopIteration").values
    assert len(loops) >= COUNT - 1
    assert series.time_s is not None
    np.testing.assert_allclose(series.time_s, 1e-6 * 500 * (loops - loops[0]))
    np.testing.assert_allclose(series.column("gyroADC[0]").values, loops - 100)


def test_a_blackbox_log_of_eight_motors_names_those_that_are_not_read(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    head = blackbox_head().decode()
    four = ",".join(f"motor[{place}]" for place in range(4))
    eight = head.replace(four, f"{four},motor[4],motor[5],motor[6],motor[7]")
    for line in ("I signed", "I predictor", "I encoding", "P predictor", "P encoding"):
        values = next(one for one in head.splitlines() if line in one)
        eight = eight.replace(values, f"{values}{4 * (',1' if 'encoding' in line else ',0')}")
    rows = b"".join(
        blackbox_row(at, gyro=(0, 0, 0), motors=[1200 + place for place in range(8)]) for at in range(COUNT)
    )
    log = read_recording(written(tmp_path, eight.encode() + rows + BLACKBOX_END))
    four_motors = read_recording(written(tmp_path, blackbox()))

    assert channel(log, "motor[7]").value[5] == 1207
    assert (log.facts.motors, log.facts.square) == (8, False)
    assert (four_motors.facts.motors, four_motors.facts.square) == (4, None)


def reports(functions: Sequence[int], rpm: Sequence[int]) -> bytes:
    """Return a ULog file of 50 reports of motor controllers; `functions` states the motor of each controller."""
    content = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000) + message("B", bytes(40))
    content += message("F", b"esc_report:int32_t esc_rpm;uint8_t actuator_function;uint8_t[3] _padding0;")
    content += message("F", f"esc_status:uint64_t timestamp;esc_report[{len(rpm)}] esc;".encode())
    content += message("A", struct.pack("<BH", 0, 0) + b"esc_status")
    for at in range(50):
        each = b"".join(struct.pack("<iB3x", *report) for report in zip(rpm, functions, strict=True))
        content += message("D", struct.pack("<HQ", 0, 10_000 + 4000 * at) + each)
    return content


@pytest.mark.parametrize(
    ("functions", "front_right"),
    [
        ((103, 101, 104, 102), 2000),
        ((0, 0, 0, 0), 1000),
        ((0, 0, 0, 0, 101, 102, 103, 104), 5000),
        ((0, 104, 0, 103, 0, 102, 0, 101), 8000),
    ],
)
def test_speeds_of_px4_are_of_the_motors_that_their_controllers_state(
    tmp_path: Path, functions: tuple[int, ...], front_right: float
) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    log = read_recording(
        written(tmp_path, reports(functions, [1000 * place for place, _ in enumerate(functions, start=1)]))
    )

    speed = channel(log, "rpm.m1").value  # PX4's first motor is front right, like the Crazyflie's
    np.testing.assert_allclose(speed, front_right * np.pi / 30)
    assert not any("_padding" in name for name in only(log).names)


@pytest.mark.parametrize("missing", [1, 7, 20])
def test_a_ulog_file_that_was_cut_keeps_its_whole_rows_and_says_so(tmp_path: Path, missing: int) -> None:
    """Before, such a file was said to be damaged after 100.0 % of it."""
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    whole = read_recording(written(tmp_path, ulog())).series["vehicle_angular_velocity"]
    log = read_recording(written(tmp_path, ulog()[:-missing]))
    rates = log.series["vehicle_angular_velocity"]
    assert whole.rows - missing // 16 - 1 <= rates.rows <= whole.rows
    np.testing.assert_array_equal(rates.columns[0].values, whole.columns[0].values[: rates.rows])
    assert "log-cut" in codes(log)


@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_ulog_file_ends_in_a_sentence_or_in_rows(tmp_path: Path, seed: int) -> None:
    """Damaged definitions, alone, made the library read the last message of a file without end."""
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    draw = np.random.default_rng(seed)
    content = bytearray(ulog(geometry="FR RL FL RR"))
    at = int(draw.integers(16, 900))
    if seed % 2:
        del content[at : at + int(draw.integers(1, 100))]
    else:
        content[at:at] = draw.integers(0, 256, int(draw.integers(1, 1000)), dtype=np.uint8).tobytes()
    with contextlib.suppress(DataError):
        read_recording(written(tmp_path, bytes(content)))


@pytest.mark.parametrize("logs", [1, 2])
def test_the_longest_flight_of_a_blackbox_file_is_read_and_another_by_its_number(tmp_path: Path, logs: int) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    content = blackbox() if logs == 1 else blackbox()[:-1000] + BLACKBOX_END + blackbox()
    log = read_recording(written(tmp_path, content))
    assert only(log).rows == COUNT
    assert ("log-of-several" in codes(log)) == (logs == 2)
    if logs == 2:
        assert only(read_recording(written(tmp_path, content), How(log=1))).rows < COUNT
    with pytest.raises(ConfigError, match="`log` 3"):
        read_recording(written(tmp_path, content), How(log=3))
