"""Logs of the uSD-card deck: what the firmware writes is read value by value, and damage is named."""

from pathlib import Path

import numpy as np
import pytest

from cfid.errors import ConfigError, DataError
from cfid.records.logs.any_kind import read_log
from cfid.records.logs.log import FlightLog
from cfid.records.tables.schema import Foreign
from tests.logs.usd_bytes import FIXED, POSE, Record, bytes_of, rows, single, written
from tests.places import DATA


def gyro(log: FlightLog) -> list[float]:
    return list(np.degrees(log.channel("gyro.x")[1]))


def test_every_type_of_number_and_two_events_are_read(tmp_path: Path) -> None:
    poses: list[Record] = [(3, 5_000_500 + 10_000 * at, (200, 0.5 * at, 65535, -32768, -(2**31))) for at in range(5)]
    log = read_log(written(tmp_path, bytes_of([POSE, FIXED], sorted(rows(50) + poses, key=lambda row: row[1]))))

    time_s, motor = log.channel("motor.m1")
    np.testing.assert_array_equal(motor, 60 * np.arange(50))
    np.testing.assert_allclose(time_s, 5 + 1e-3 * np.arange(50), rtol=1e-15)
    np.testing.assert_array_equal(log.channel("pm.state")[1], np.arange(50) - 50)
    np.testing.assert_array_equal(log.channel("x")[1], 0.5 * np.arange(5))
    assert [set(log.channel(name)[1]) for name in ("source", "count", "low", "wide")] == [
        {200.0},
        {65535.0},
        {-32768.0},
        {-(2.0**31)},
    ]
    assert log.notes == ()


@pytest.mark.parametrize(("version", "per_s"), [(1, 1000), (2, 1_000_000)])
def test_stamps_become_the_seconds_that_are_nearest_to_them(tmp_path: Path, version: int, per_s: int) -> None:
    stamps = [2_000_001 + 1003 * at for at in range(2000)]
    log = read_log(written(tmp_path, bytes_of([FIXED], [(65535, at, (0, 0, 0, 0)) for at in stamps], version=version)))
    assert log.series[0].time_s.tolist() == [at / per_s for at in stamps]


def test_units_become_si_and_what_is_assumed_is_stated(tmp_path: Path) -> None:
    log = read_log(written(tmp_path, single()))
    np.testing.assert_allclose(log.channel("acc.z")[1], -1.5 * 9.81)
    np.testing.assert_allclose(log.channel("gyro.x")[1], np.radians(np.arange(100) / 8))
    assert log.assumed == ("1 g is 9.81 m/s^2",)
    assert "acc.z in g" in log.understood
    assert "pm.state in an unknown unit" in log.understood
    assert "100 rows at 1000 Hz" in log.understood


@pytest.mark.parametrize("interval_ms", [1, 2, 4, 10, 20])
def test_a_clock_shows_beside_the_scheduler_also_where_rows_are_missing(tmp_path: Path, interval_ms: int) -> None:
    draw = np.random.default_rng(2)
    for rate in (84 / 85, 1.002):
        true_us = 5_000_000 + 1000 * interval_ms * np.cumsum(draw.choice([1, 1, 1, 3], 300))
        late_us = draw.integers(0, 40, 300)  # the delay of some writes
        records = [(65535, round(rate * at), (0, 0, 0, 0)) for at in true_us + late_us]
        log = read_log(written(tmp_path, bytes_of([FIXED], records)))
        np.testing.assert_allclose(log.series[0].time_s, 1e-6 * true_us, rtol=2.1e-3, atol=1e-4)


def test_the_clock_is_as_given_in_place_of_what_rows_show(tmp_path: Path) -> None:
    path = written(tmp_path, single())
    assert read_log(path).channel("gyro.x")[0][-1] == pytest.approx(5.099)
    assert read_log(path, Foreign(clock="84/85")).channel("gyro.x")[0][-1] == pytest.approx(5.099 * 85 / 84)


def test_milliseconds_of_the_scheduler_are_right(tmp_path: Path) -> None:
    path = written(tmp_path, bytes_of([FIXED], [(e, at // 1000, v) for e, at, v in rows(100)], version=1))
    assert read_log(path).channel("gyro.x")[0][-1] == pytest.approx(5.099)
    with pytest.raises(ConfigError, match="clock` is for logs in microseconds"):
        read_log(path, Foreign(clock="84/85"))


@pytest.mark.parametrize("missing", [1, 4, 5, 17, 23, 24, 60])
def test_a_cut_log_gives_its_whole_records_and_reports_the_cut(tmp_path: Path, missing: int) -> None:
    size = 2 + 8 + 13
    log = read_log(written(tmp_path, single()[:-missing]))
    whole = 100 - max(0, -(-(missing - 4) // size))
    assert gyro(log) == pytest.approx([at / 8 for at in range(whole)])
    assert len(log.notes) == 1
    assert "cut" in log.notes[0]
    assert f"{whole} whole records" in log.notes[0]


def test_a_changed_byte_is_found_by_the_crc(tmp_path: Path) -> None:
    content = bytearray(single())
    content[-10] ^= 1
    (note,) = read_log(written(tmp_path, bytes(content))).notes
    assert "CRC32 does not match" in note


def test_a_second_variable_of_one_name_gets_a_number(tmp_path: Path) -> None:
    number, name, variables = FIXED
    twice = (number, name, (variables[0], variables[0], *variables[2:]))
    log = read_log(written(tmp_path, bytes_of([twice], rows(50))))
    first = log.series[0].names[0]

    assert log.series[0].names[1] == f"{first}_2"
    assert any(f"variable 2 is named {first} again: it is read as {first}_2" in text for text in log.notes)


def test_reading_stops_at_a_record_of_no_known_event(tmp_path: Path) -> None:
    content = bytearray(single())
    content[-4 - 40 * 23] ^= 0x55
    log = read_log(written(tmp_path, bytes(content)))
    assert len(gyro(log)) == 59
    assert "no event has the id" in log.notes[0]
    assert "59 records before the last one there" in log.notes[0]


def test_the_record_in_which_bytes_are_lost_is_left_out(tmp_path: Path) -> None:
    whole = single()
    place = len(whole) - 4 - 40 * 23 + 12  # within the numbers of record 60
    found = gyro(read_log(written(tmp_path, whole[:place] + whole[place + 1 :])))
    assert found == pytest.approx([at / 8 for at in range(60)])


@pytest.mark.parametrize("behind", [bytes(5000), bytes(1), single(50), b"\x01\xff" * 300])
def test_what_is_behind_a_whole_log_costs_none_of_its_records(tmp_path: Path, behind: bytes) -> None:
    log = read_log(written(tmp_path, single() + behind))
    assert gyro(log) == pytest.approx([at / 8 for at in range(100)])
    (note,) = log.notes
    size = len(single())
    assert note.startswith(
        f"a whole log of 100 records, whose CRC32 matches, ends at byte {size} of {size + len(behind)}"
    )


@pytest.mark.parametrize(("stamp", "kept"), [(2**40, 60), (1, 60)])
def test_reading_stops_at_a_stamp_that_cannot_be(tmp_path: Path, stamp: int, kept: int) -> None:
    records = rows(100)
    records[60] = (65535, stamp, records[60][2])
    log = read_log(written(tmp_path, bytes_of([FIXED], records)))
    assert len(gyro(log)) == kept
    assert "record 61 of 100 is damaged: reading stops there" in log.notes[0]


@pytest.mark.parametrize("back_us", [5_000, 4_000_000])
def test_of_two_recordings_in_one_file_the_first_is_read_and_the_other_named(tmp_path: Path, back_us: int) -> None:
    records = rows(100)
    records[60:] = [(event, stamp - back_us, values) for event, stamp, values in records[60:]]
    log = read_log(written(tmp_path, bytes_of([FIXED], records)))
    assert len(gyro(log)) == 60
    (note,) = log.notes
    assert f"time goes back from stamp {records[59][1]} to {records[60][1]} at record 61 of 100" in note
    assert "two recordings are in one file" in note
    assert "the 40 records from there on are not used" in note
    assert "damaged" not in note


@pytest.mark.parametrize("length", [1, 4, 9, 30, 50])
def test_a_log_cut_in_its_header_ends_in_a_sentence(tmp_path: Path, length: int) -> None:
    with pytest.raises(DataError, match=r"cut or damaged|was cut after"):
        read_log(written(tmp_path, single()[:length]))


def test_an_unknown_version_and_an_unknown_type_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="version 7; versions 1 and 2"):
        read_log(written(tmp_path, b"\xbc\x07\0" + single()[3:]))
    with pytest.raises(DataError, match=r"'gyro.x\(Z\)' is no variable"):
        read_log(written(tmp_path, single().replace(b"gyro.x(f)", b"gyro.x(Z)")))


def test_control_characters_of_a_name_never_reach_the_terminal(tmp_path: Path) -> None:
    log = read_log(written(tmp_path, single().replace(b"pm.state", b"pm.\x1b[2Je")))
    assert "\x1b" not in log.understood


@pytest.mark.parametrize(("name", "count", "rate_hz"), [("10", 50496, 999), ("15", 62774, 999)])
def test_public_logs_are_read_whole(name: str, count: int, rate_hz: int) -> None:
    path = DATA / "flights" / f"eschmann_log{name}.usd"
    if not path.exists():
        pytest.skip("the public flights are not here (CFID_DATA)")
    log = read_log(path)
    assert log.notes == ()
    assert log.series[0].rows == count
    assert f"at {rate_hz} Hz" in log.understood
    assert "corrected by 85/84" in log.understood
    assert np.median(log.channel("acc.z")[1][:1000]) == pytest.approx(9.81, rel=0.01)
