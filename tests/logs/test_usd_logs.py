"""Logs of the uSD-card deck: what the firmware writes is read value by value, and damage is named."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import ConfigError, DataError
from cfid.recordings.crazyflie import channel, is_flown
from cfid.recordings.read import read_recording
from cfid.recordings.recording import How, Recording
from tests.lab import DATA
from tests.logs.usd_bytes import FIXED, POSE, Record, bytes_of, rows, single, written


def gyro(log: Recording) -> list[float]:
    return list(log.series["fixedFrequency"].column("gyro.x").values)


def codes(log: Recording) -> list[str]:
    return [one.code for one in log.findings]


def test_every_type_of_number_and_two_events_are_read(tmp_path: Path) -> None:
    poses: list[Record] = [(3, 5_000_500 + 10_000 * at, (200, 0.5 * at, 65535, -32768, -(2**31))) for at in range(5)]
    log = read_recording(written(tmp_path, bytes_of([POSE, FIXED], sorted(rows(50) + poses, key=lambda row: row[1]))))

    time_s, motor = channel(log, "motor.m1")
    np.testing.assert_array_equal(motor, 60 * np.arange(50))
    np.testing.assert_allclose(time_s, 1e-3 * np.arange(50), atol=1e-15)
    np.testing.assert_array_equal(channel(log, "pm.state").value, np.arange(50) - 50)
    np.testing.assert_array_equal(channel(log, "x").value, 0.5 * np.arange(5))
    np.testing.assert_allclose(channel(log, "x").time_s, 5e-4 + 1e-2 * np.arange(5), rtol=1e-12)
    assert [set(channel(log, name).value) for name in ("source", "count", "low", "wide")] == [
        {200.0},
        {65535.0},
        {-32768.0},
        {-(2.0**31)},
    ]
    assert codes(log) == ["log-clock"]
    assert log.facts.clock == "true"


def sets_of(count: int) -> bytes:
    """Return a log in the format before version 1: names between commas, and sets with a CRC32 each."""
    head = b"\x03tick(I),acc.z(f),motor.m1(H),"
    content = head + struct.pack("<I", zlib.crc32(head))
    for begin in range(0, count, 7):
        each = range(begin, min(begin + 7, count))
        part = bytes([len(each)]) + b"".join(struct.pack("<IfH", 500 + 2 * at, 0.25 * at, at) for at in each)
        content += part + struct.pack("<I", zlib.crc32(part))
    return content


def test_the_format_before_version_1_is_read_set_by_set(tmp_path: Path) -> None:
    log = read_recording(written(tmp_path, sets_of(100)))
    series = log.series["log"]
    assert series.time_s is not None
    np.testing.assert_allclose(series.time_s, 2e-3 * np.arange(100))
    np.testing.assert_array_equal(series.column("acc.z").values, 0.25 * np.arange(100))
    np.testing.assert_array_equal(series.column("motor.m1").values, np.arange(100))
    assert log.findings == ()

    damaged = bytearray(sets_of(100))
    damaged[-30] ^= 1  # in the last but one set
    log = read_recording(written(tmp_path, bytes(damaged)))
    assert log.series["log"].rows == 91
    assert codes(log) == ["log-damaged"]
    with pytest.raises(DataError, match="its CRC32 does not match"):
        read_recording(written(tmp_path, sets_of(100).replace(b"acc.z", b"acc.y")))


def test_units_are_the_firmware_s(tmp_path: Path) -> None:
    log = read_recording(written(tmp_path, single()))
    np.testing.assert_allclose(channel(log, "acc.z").value, -1.5 * 9.81)
    np.testing.assert_allclose(channel(log, "gyro.x").value, np.radians(np.arange(100) / 8))
    series = log.series["fixedFrequency"]
    assert [series.column(name).unit for name in ("acc.z", "gyro.x", "motor.m1", "pm.state")] == ["g", "deg/s", "1", ""]
    assert all(map(is_flown, ("gyro.x", "imu_gyro_x", "motor.m1 [PWM]")))


@pytest.mark.parametrize("interval_ms", [1, 2, 4, 10, 20])
def test_a_clock_shows_beside_the_scheduler_also_where_rows_are_missing(tmp_path: Path, interval_ms: int) -> None:
    draw = np.random.default_rng(2)
    for rate, clock in ((84 / 85, "84/85"), (1.002, "true")):
        true_us = 5_000_000 + 1000 * interval_ms * np.cumsum(draw.choice([1, 1, 1, 3], 300))
        late_us = draw.integers(0, 40, 300)  # the delay of some writes
        records = [(65535, round(rate * at), (0, 0, 0, 0)) for at in true_us + late_us]
        log = read_recording(written(tmp_path, bytes_of([FIXED], records)))
        time_s = log.series["fixedFrequency"].time_s
        assert time_s is not None
        assert log.facts.clock == clock
        np.testing.assert_allclose(time_s, 1e-6 * (true_us - true_us[0]), rtol=2.1e-3, atol=1e-4)


@pytest.mark.parametrize("rate_hz", range(1, 21))
def test_the_slow_clock_is_never_taken_for_a_true_one(tmp_path: Path, rate_hz: int) -> None:
    """Before, rows of 15 Hz and less by a slow clock passed for those of a true one, which is 1.2 % wrong."""
    for period_us in (1e6 / rate_hz, 1e3 * (1000 // rate_hz)):
        stamps = [round(5e6 + at * period_us * 84 / 85) for at in range(200)]
        log = read_recording(written(tmp_path, bytes_of([FIXED], [(65535, at, (0, 0, 0, 0)) for at in stamps])))
        assert log.facts.clock in ("84/85", "unknown")
        assert ("log-clock-unknown" in codes(log)) == (log.facts.clock == "unknown")


def test_the_clock_is_as_given_in_place_of_what_rows_show(tmp_path: Path) -> None:
    path = written(tmp_path, single())
    assert channel(read_recording(path), "gyro.x").time_s[-1] == pytest.approx(0.099)
    slow = read_recording(path, How(clock="84/85"))
    assert slow.facts.clock == "84/85"
    assert channel(slow, "gyro.x").time_s[-1] == pytest.approx(0.099 * 85 / 84)


def test_milliseconds_of_the_scheduler_are_right(tmp_path: Path) -> None:
    path = written(tmp_path, bytes_of([FIXED], [(e, at // 1000, v) for e, at, v in rows(100)], version=1))
    log = read_recording(path)
    assert channel(log, "gyro.x").time_s[-1] == pytest.approx(0.099)
    assert log.facts.clock == "true"
    with pytest.raises(ConfigError, match="clock` is for logs in microseconds"):
        read_recording(path, How(clock="84/85"))


@pytest.mark.parametrize("missing", [1, 4, 5, 17, 23, 24, 60])
def test_a_cut_log_gives_its_whole_records_and_reports_the_cut(tmp_path: Path, missing: int) -> None:
    size = 2 + 8 + 13
    log = read_recording(written(tmp_path, single()[:-missing]))
    whole = 100 - max(0, -(-(missing - 4) // size))
    assert gyro(log) == pytest.approx([at / 8 for at in range(whole)])
    assert "log-damaged" in codes(log)


@pytest.mark.parametrize("behind", [bytes(5000), bytes(1), single(50), b"\x01\xff" * 300])
def test_what_is_behind_a_whole_log_costs_none_of_its_records(tmp_path: Path, behind: bytes) -> None:
    log = read_recording(written(tmp_path, single() + behind))
    assert gyro(log) == pytest.approx([at / 8 for at in range(100)])
    assert "log-bytes-behind" in codes(log)


@pytest.mark.parametrize("back_us", [5_000, 4_000_000])
def test_of_two_recordings_in_one_file_the_first_is_read_and_the_other_named(tmp_path: Path, back_us: int) -> None:
    records = rows(100)
    records[60:] = [(event, stamp - back_us, values) for event, stamp, values in records[60:]]
    log = read_recording(written(tmp_path, bytes_of([FIXED], records)))
    assert len(gyro(log)) == 60
    assert "log-time-back" in codes(log)


def test_an_unknown_version_and_an_unknown_type_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="version 7; versions 1 and 2"):
        read_recording(written(tmp_path, b"\xbc\x07\0" + single()[3:]))
    with pytest.raises(DataError, match=r"'gyro.x\(Z\)' is no variable"):
        read_recording(written(tmp_path, single().replace(b"gyro.x(f)", b"gyro.x(Z)")))


@pytest.mark.parametrize(("name", "count"), [("10", 50496), ("15", 62774)])
def test_public_logs_are_read_whole_bit_by_bit(name: str, count: int) -> None:
    path = DATA / "flights" / f"eschmann_log{name}.usd"
    if not path.exists():
        pytest.skip("the public flights are not here (CFID_DATA)")
    log = read_recording(path)
    (series,) = log.series.values()
    assert log.facts.clock == "84/85"
    assert codes(log) == ["log-clock"]
    assert series.rows == count
    begin = path.read_bytes().index(b"motor.m4(I)\0") + len(b"motor.m4(I)\0")
    layout = [("id", "<u2"), ("stamp", "<u8"), ("f", "<f4", 6), ("u", "<u4", 4)]
    plain = np.frombuffer(path.read_bytes()[begin:-4], np.dtype(layout))  # all records are of one event
    np.testing.assert_array_equal(np.column_stack([one.values for one in series.columns[:6]]), plain["f"])
    np.testing.assert_array_equal(np.column_stack([one.values for one in series.columns[6:]]), plain["u"])
