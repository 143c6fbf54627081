"""ULog and blackbox: files composed byte by byte are read with their own libraries."""

import math
import os
import re
import struct
import sys
import tracemalloc
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.errors import ConfigError, DataError
from cfid.records.logs.any_kind import read_log
from cfid.records.logs.motor_numbers import NO_SQUARE
from cfid.records.logs.ulog_parts import PART_BYTES
from cfid.records.tables.schema import Foreign
from cfid.units import MOTORS
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
        read_log(written(tmp_path, content))


def test_topics_of_a_ulog_file_are_series_in_px4_s_units(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    log = read_log(written(tmp_path, ulog()))
    time_s, rate = log.channel("xyz[0]")
    np.testing.assert_allclose(time_s, 0.01 + 0.004 * np.arange(COUNT))
    np.testing.assert_array_equal(rate, np.arange(COUNT) / 8)
    assert {series.name: series.rows for series in log.series} == {
        "vehicle_angular_velocity": 200,
        "battery_status": 20,
        "actuator_motors": 20,
        "vehicle_acceleration": 20,
    }
    (rates,) = (series for series in log.series if series.name == "vehicle_angular_velocity")
    assert [channel.unit for channel in rates.channels] == ["rad/s"] * 3
    assert "FMU6" in log.program
    assert "1 dropout, of 0.025 s" in log.notes[0]


def test_the_battery_of_a_ulog_file_is_the_one_that_is_connected(tmp_path: Path) -> None:
    (tmp_path / "log.ulg").write_bytes(ulog(unconnected=True))
    log = read_log(tmp_path / "log.ulg")
    _, volts = log.channel("pm.vbat")
    assert len(volts) == 20
    assert np.all(volts == 16.5)


@pytest.mark.parametrize(
    ("geometry", "order"), [("", (1, 4, 2, 3)), ("FR RL FL RR", (1, 4, 2, 3)), ("FR RR RL FL", (1, 2, 3, 4))]
)
def test_motors_of_px4_get_the_crazyflie_s_numbers(tmp_path: Path, geometry: str, order: tuple[int, ...]) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    log = read_log(written(tmp_path, ulog(geometry=geometry)))
    for motor, of_px4 in enumerate(order, start=1):
        np.testing.assert_allclose(log.channel(f"control.m{motor}")[1], 65535 * 0.1 * of_px4, rtol=1e-6)
    np.testing.assert_allclose(log.channel("acc.z")[1], 9.81, rtol=1e-6)
    np.testing.assert_allclose(log.channel("pm.vbat")[1], 16.5)
    names = ", ".join(f"control[{of_px4 - 1}]" for of_px4 in order)
    assert f"control.m1 to m4 are {names}" in log.assumed[0]
    assert ("parameters" if geometry else "PX4's quad X") in log.assumed[0]


def test_a_ulog_file_that_its_library_wrote_is_read_alike(tmp_path: Path) -> None:
    pyulog = pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    pyulog.ULog(str(written(tmp_path, ulog()))).write_ulog(str(tmp_path / "again"))
    np.testing.assert_array_equal(read_log(tmp_path / "again").channel("xyz[1]")[1], -np.arange(COUNT))


def test_a_signalling_nan_of_a_damaged_ulog_file_is_a_missing_value_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    whole, value = ulog(), struct.pack("<3f", 7 / 8, -7, 0.5)
    log = read_log(written(tmp_path, whole.replace(value, b"\x01\x00\xa0\x7f" + value[4:])))
    (rates,) = (series for series in log.series if series.name == "vehicle_angular_velocity")
    assert sum(int(np.isnan(block).sum()) for block in rates.blocks()) == 1


@pytest.mark.parametrize("damaged", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_ulog_file_that_is_read_in_parts_keeps_every_row(tmp_path: Path, damaged: bool) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    wide, rows = 2000, 3 * PART_BYTES // 8000
    early, late, words = (b"\0" + bytes([at, 0]) + name for at, name in enumerate((b"wide", b"late", b"wide")))
    words = b"\1" + words[1:]  # the same topic from a second sensor
    content = [
        b"ULog\x01\x12\x35\x01" + bytes(8),
        message("B", bytes(40)),
        message("F", f"wide:uint64_t timestamp;float[{wide}] x;".encode()),
        message("F", b"late:uint64_t timestamp;uint8_t y;"),
        message("A", early) + message("A", words),
    ]
    for at in range(rows):
        if at == rows // 2:
            content.append(message("A", late))
        if damaged and at == rows - 100:
            content.append(b"\0\0\0")
        values = np.full(wide, at, "<f4").tobytes()
        content.append(message("D", struct.pack("<HQ", 2 * (at % 10 == 0), 1000 * at) + values))
        if at >= rows // 2:
            content.append(message("D", struct.pack("<HQB", 1, 1000 * at, at % 200)) + message("O", b"\1\0"))
    log = read_log(written(tmp_path, b"".join(content)))

    assert {one.name: one.rows for one in log.series} == {
        "late": rows - rows // 2, "wide": rows - -(-rows // 10), "wide_1": -(-rows // 10)
    }  # fmt: skip
    time_s, last = log.channel(f"x[{wide - 1}]")
    np.testing.assert_allclose(time_s, 1e-3 * last)
    np.testing.assert_array_equal(np.sort(last), [at for at in range(rows) if at % 10])
    np.testing.assert_array_equal(log.channel("y")[1], np.arange(rows // 2, rows) % 200)
    assert f"{rows - rows // 2} dropouts" in log.notes[0]
    broken = ("the file is damaged or cut after 99.6 % of it: 3 bytes in 1 place left out.",)
    assert (log.notes[1:] == broken) == damaged


def test_a_ulog_file_without_data_ends_in_a_sentence(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    with pytest.raises(DataError, match=r"without data|not readable as a ULog file"):
        read_log(written(tmp_path, ulog()[:60]))


def test_a_blackbox_log_with_a_damaged_header_is_named_with_what_to_do(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    damaged = blackbox().replace(b"I interval:1", b"I interval:x")
    with pytest.raises(DataError, match=r"cannot read the header of log 1 of 1 \(.*Error\)\. Copy it"):
        read_log(written(tmp_path, damaged))


def test_a_field_of_a_blackbox_log_whose_damaged_name_is_a_number_is_read_by_that_name(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    log = read_log(written(tmp_path, blackbox().replace(b"gyroADC[1]", b"17")))
    assert "17" in log.series[0].names


def test_zeros_after_a_blackbox_log_are_passed_over(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    path = written(tmp_path, blackbox())
    rows = read_log(path).series[0].rows
    os.truncate(path, 1 << 28)  # sparse; reading it byte by byte would take minutes

    assert rows - 1 <= read_log(path).series[0].rows <= rows + 1


def test_frames_of_a_blackbox_log_are_rows_in_si_units(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    log = read_log(written(tmp_path, blackbox()))
    time_s, rate = log.channel("gyroADC[0]")
    np.testing.assert_allclose(time_s, 1e-3 + 5e-4 * np.arange(COUNT))
    np.testing.assert_allclose(rate, np.radians(np.arange(COUNT) - 100.0))
    np.testing.assert_allclose(log.channel("accSmooth[2]")[1], 9.81)
    np.testing.assert_array_equal(log.channel("motor[0]")[1], 1000 + np.arange(COUNT))
    assert "Betaflight 2025.12.1" in log.program


def test_motors_of_betaflight_get_the_crazyflie_s_numbers(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    log = read_log(written(tmp_path, blackbox()))
    for motor, place in {1: 1, 2: 0, 3: 2, 4: 3}.items():
        part = (np.arange(COUNT) + 100 * place) / 1000
        np.testing.assert_allclose(log.channel(f"control.m{motor}")[1], 65535 * part)
        np.testing.assert_allclose(log.channel(f"rpm.m{motor}")[1], (70 + place) * 100 / 7 * np.pi / 30)
    np.testing.assert_allclose(log.channel("acc.z")[1], 9.81)
    assert "control.m1 to m4 are motor[1], motor[0], motor[2], motor[3], as in Betaflight's quad X" in log.assumed[0]


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
    log = read_log(written(tmp_path, blackbox_with_voltage(firmware=firmware, reference=counts[0], counts=counts)))
    for name in ("pm.vbat", "vbatLatest"):
        np.testing.assert_allclose(log.channel(name)[1], [16.4, 16.3, 15.2, 16.6])


@pytest.mark.parametrize("firmware", ["Betaflight 3.0.1 (abcdef0) NAZE", "INAV 7.1.0 (abcdef0) MATEKF405", "abcdef0"])
def test_a_voltage_of_a_blackbox_log_whose_step_is_not_known_keeps_its_raw_numbers(
    tmp_path: Path, firmware: str
) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    log = read_log(written(tmp_path, blackbox_with_voltage(firmware=firmware, reference=160, counts=(160, 158))))
    (channel,) = (one for one in log.series[0].channels if one.name == "vbatLatest")
    assert (channel.own_unit, "pm.vbat" in log.series[0].names) == ("", False)


def test_a_cut_blackbox_log_gives_its_whole_frames(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    log = read_log(written(tmp_path, blackbox()[:-200]))
    assert 150 < log.series[0].rows < COUNT
    assert "has a frame that cannot be read" in log.notes[0]


def test_frames_of_a_blackbox_log_are_those_that_its_library_reads(tmp_path: Path) -> None:
    orangebox = pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    path = written(tmp_path, blackbox())

    read = np.vstack(list(read_log(path).series[0].blocks()))

    parser = orangebox.Parser.load(str(path), 1)
    frames = np.array([frame.data for frame in parser.frames()], dtype=np.float64)
    place = parser.field_names.index("gyroADC[0]")
    np.testing.assert_array_equal(read[:, place], frames[:, place])
    np.testing.assert_allclose(read[:, 0], 1e-6 * frames[:, parser.field_names.index("time")])


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
    log = read_log(written(tmp_path, torn))

    series = log.series[0]
    loops = series.column(1 + series.names.index("loopIteration"))
    assert len(loops) >= COUNT - 1
    np.testing.assert_allclose(series.time_s, 1e-6 * (1000 + 500 * loops))
    np.testing.assert_array_equal(series.column(1 + series.names.index("gyroADC[0]")), loops - 100)


def test_a_blackbox_log_names_the_frames_that_do_not_follow(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    content = blackbox()
    middle = content.index(b"I" + unsigned(100) + unsigned(1000 + 500 * 100))
    log = read_log(written(tmp_path, content[:middle] + b"IIII" + content[middle:]))
    assert "log 1 of 1: 4 frames do not follow from those before: left out." in log.notes


def test_two_blackbox_logs_in_one_file_are_two_series(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    assert [series.rows for series in read_log(written(tmp_path, 2 * blackbox())).series] == [COUNT, COUNT]


def test_a_parameter_or_a_field_of_another_type_is_left_out_of_a_ulog_file(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    content = ulog(geometry="FR RL FL RR")
    text = b"float CA_ROTOR0_PX"
    of_text = b"char[4]" + text[5:]  # a type whose name has another length
    assert content.count(text) == 1
    parameter = message("P", bytes([len(text)]) + text + struct.pack("<f", 0.1))
    other = message("P", bytes([len(of_text)]) + of_text + b"0.10")
    (tmp_path / "log").write_bytes(content.replace(parameter, other))

    log = read_log(tmp_path / "log")

    assert "as in PX4's quad X" in " ".join(log.assumed)


def test_a_blackbox_log_without_a_time_ends_in_a_sentence(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    with pytest.raises(DataError, match="log 1 of 1 is a blackbox log without a field 'time'"):
        read_log(written(tmp_path, blackbox().replace(b"Iteration,time", b"Iteration,tide")))


@pytest.mark.parametrize("given", [{"rate_hz": 5.0}, {"time_unit": "ms"}, {"skip_lines": 1}, {"columns": ("t",)}])
def test_a_log_that_states_its_times_refuses_what_tables_need(tmp_path: Path, given: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=f"`{next(iter(given))}` is for tables"):
        read_log(written(tmp_path, ulog()), Foreign(**given))


@pytest.mark.parametrize("damage", [b"\xff", b"\0\0\0", -1, -20])
def test_a_ulog_file_that_breaks_off_within_says_where(tmp_path: Path, damage: bytes | int) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    content = ulog()
    middle = len(content) // 2
    torn = content[:middle] + (content[middle - damage :] if isinstance(damage, int) else damage + content[middle:])
    log = read_log(written(tmp_path, torn))
    assert re.search(r"the file is damaged or cut after (49|50)\.\d % of it", " ".join(log.notes))


@pytest.mark.parametrize(("damage", "kept"), [(b"\xff", 0), (b"\0\0\0", 0), (bytes(10**5), 0), (-20, 1)])
def test_damaged_bytes_of_a_ulog_file_cost_the_messages_that_they_are_in(
    tmp_path: Path, damage: bytes | int, kept: int
) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    content = ulog()
    middle = content.index(struct.pack("<HQ", 0, 10_000 + 4000 * 100)) - 3
    torn = content[:middle] + (content[middle - damage :] if isinstance(damage, int) else damage + content[middle:])
    log = read_log(written(tmp_path, torn))
    series = next(one for one in log.series if one.name == "vehicle_angular_velocity")

    assert series.rows == COUNT - kept
    assert "in 1 place left out" in " ".join(log.notes)


@pytest.mark.parametrize("whole_log", [True, False])
def test_data_among_the_definitions_of_a_ulog_file_are_left_out(tmp_path: Path, whole_log: bool) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    content = ulog()
    begin = content.index(message("B", bytes(40))[:3]) + 43
    torn = content[:begin] + message("S", b"\1" * 20_000) + (content[begin:] if whole_log else b"")
    if not whole_log:
        with pytest.raises(DataError, match="a ULog file without data"):
            read_log(written(tmp_path, torn))
        return
    log = read_log(written(tmp_path, torn))
    (rates,) = (series for series in log.series if series.name == "vehicle_angular_velocity")
    assert rates.rows == COUNT
    assert "20003 bytes in 1 place left out" in " ".join(log.notes)


def test_what_was_appended_to_a_ulog_file_after_a_cut_message_is_read(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    content = ulog()
    assert content[18:19] == b"B"
    cut = content[:-7]
    again = message("D", struct.pack("<HQ3f", 0, 90_000_000, 1, 2, 3))
    flags = bytes(8) + b"\1" + bytes(7) + struct.pack("<3Q", len(cut), 0, 0)
    log = read_log(written(tmp_path, cut[:19] + flags + cut[19 + len(flags) :] + again))
    series = next(one for one in log.series if one.name == "vehicle_angular_velocity")

    assert series.time_s[-1] == pytest.approx(90.0)


@pytest.mark.parametrize(
    "formats",
    [
        {"vast": "uint64_t timestamp;float[65535] a;float[65535] b;float[65535] c;float[65535] d;"},
        {"vast": "uint64_t timestamp;inner[60000] x;", "inner": "float[60000] y;"},
        {"vast": "uint64_t timestamp;vast x;"},
    ],
)
def test_a_ulog_file_that_states_fields_without_end_ends_in_a_sentence(tmp_path: Path, formats: dict[str, str]) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    head = b"ULog\x01\x12\x35\x01" + bytes(8) + message("B", bytes(40))
    stated = b"".join(message("F", f"{name}:{fields}".encode()) for name, fields in formats.items())
    with pytest.raises(DataError, match="it states more than 200000 fields"):
        read_log(written(tmp_path, head + stated + message("A", b"\0\0\0vast")))


def test_zeros_after_a_ulog_file_cost_neither_time_nor_memory(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    path = written(tmp_path, ulog())
    os.truncate(path, 1 << 29)  # sparse
    tracemalloc.start()
    log = read_log(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()

    assert peak < 1 << 25
    assert "what follows may be missing" in " ".join(log.notes)


def test_a_damaged_time_of_a_ulog_file_costs_its_row(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    content = ulog()
    for at, wrong in ((50, 90_000_000), (120, 3)):
        right = struct.pack("<HQ", 0, 10_000 + 4000 * at)
        assert content.count(right) == 1
        content = content.replace(right, struct.pack("<HQ", 0, wrong))
    log = read_log(written(tmp_path, content))
    series = next(one for one in log.series if one.name == "vehicle_angular_velocity")
    assert np.all(np.diff(series.time_s) > 0)
    assert series.rows == COUNT - 2
    assert "2 rows with a time that is not between those of the neighbours left out." in log.notes


def test_outputs_of_a_blackbox_log_beyond_full_throttle_are_left_out_and_counted(tmp_path: Path) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    outputs = [[1500, 1500, 1500, 3600 if at in (40, 41) else 2000] for at in range(COUNT)]
    rows = (blackbox_row(at, gyro=(at, 0, 0), motors=motors) for at, motors in enumerate(outputs))
    log = read_log(written(tmp_path, blackbox_head() + b"".join(rows) + BLACKBOX_END))

    odd = [one for one in (log.channel(f"control.m{motor}")[1] for motor in range(1, 5)) if np.isnan(one).any()]
    assert len(odd) == 1
    assert np.flatnonzero(np.isnan(odd[0])).tolist() == [40, 41]
    assert np.nanmax(odd[0]) == 65535
    assert log.channel("motor[3]")[1][40] == 3600  # as in the file
    assert any("2 outputs of motors are beyond full throttle" in one for one in log.notes)


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
    log = read_log(written(tmp_path, eight.encode() + rows + BLACKBOX_END))
    four_motors = read_log(written(tmp_path, blackbox()))

    assert log.channel("motor[7]")[1][5] == 1207
    (note,) = [one for one in log.notes if one.startswith(NO_SQUARE)]
    assert "there are 8, of which motor[0] to [3] alone are read" in note
    assert not any(one.startswith(NO_SQUARE) for one in four_motors.notes)


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
    log = read_log(written(tmp_path, reports(functions, [1000 * place for place, _ in enumerate(functions, start=1)])))

    speed = log.channel("rpm.m1")[1]  # PX4's first motor is front right, like the Crazyflie's
    np.testing.assert_allclose(speed, front_right * np.pi / 30)
    assert not any("_padding" in name for name in log.series[0].names)


def test_speeds_of_rotors_that_turn_the_other_way_are_counted_by_their_size(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    log = read_log(written(tmp_path, reports((101, 102, 103, 104), (1000, -2000, 3000, 0))))
    speeds = [log.channel(f"rpm.m{motor}")[1][0] for motor in MOTORS]
    np.testing.assert_allclose(speeds, np.array([1000, 0, 2000, 3000]) * np.pi / 30)
    np.testing.assert_allclose(log.channel("esc[1].esc_rpm")[1][0], -2000 * np.pi / 30)  # as in the file


@pytest.mark.parametrize(("count", "driven"), [(8, 4), (None, 8), (6, 6)])
def test_a_vehicle_of_more_than_four_motors_is_named_and_is_no_square(
    tmp_path: Path, count: int | None, driven: int
) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    content = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000) + message("B", bytes(40))
    if count is not None:
        key = b"int32_t CA_ROTOR_COUNT"
        content += message("P", bytes([len(key)]) + key + struct.pack("<i", count))
    content += message("F", b"actuator_motors:uint64_t timestamp;float[12] control;")
    content += message("A", struct.pack("<BH", 0, 0) + b"actuator_motors")
    controls = [0.5] * driven + [math.nan] * (12 - driven)
    for at in range(50):
        content += message("D", struct.pack("<HQ12f", 0, 10_000 + 4000 * at, *controls))
    log = read_log(written(tmp_path, content))
    (note,) = [one for one in log.notes if one.startswith(NO_SQUARE)]
    assert f"there are {max(count or 0, driven)}, of which control[0] to [3] alone are read" in note
