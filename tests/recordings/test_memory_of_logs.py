"""A log of 400 MB is converted, imported, shown and fitted below 500 MB of anonymous memory, one of ULog below 620."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from tests.logs.autopilot_bytes import BLACKBOX_END, blackbox_head, blackbox_row
from tests.recordings.memory import SIZE_MB, check_peak

Array = npt.NDArray[np.float64]

THRUST_MPS2 = 7e-9  # per square of a rotor's speed in rpm, for a vehicle of 30 g
COLUMNS = {
    **dict.fromkeys(("acc.x", "acc.y", "acc.z", "gyro.x", "gyro.y", "gyro.z", "pm.vbat"), "f"),
    **{f"{name}.m{motor}": "H" for name in ("motor", "rpm") for motor in (1, 2, 3, 4)},
}
FLIGHT = "fit flight {log} --from 100 --to 300 --mass-kg 0.03 --no-figures --force"


class Rotors:
    """Four rotors with a lag of 60 ms, whose commands are held for 20 to 90 ms; rows are 1 ms apart."""

    def __init__(self, draw: np.random.Generator) -> None:
        self._draw, self._speed = draw, np.full(4, 1500.0)

    def rows(self, count: int) -> Iterator[tuple[Array, Array]]:
        """Yield the next commands (count,), 0 to 65535, and speeds (count,) in rpm of each rotor."""
        held = np.searchsorted(self._draw.integers(20, 90, count // 20).cumsum(), np.arange(count), side="right")
        left = np.exp(-1 / 60)
        for rotor in range(4):
            command = self._draw.uniform(20000, 50000, count)[held]
            follows = np.convolve((400 + 2600 * command / 65535) * (1 - left), left ** np.arange(600))[:count]
            follows += self._speed[rotor] * left ** np.arange(1, 1 + count)
            self._speed[rotor] = follows[-1]
            yield command, follows * 30 / np.pi + self._draw.normal(0, 30, count)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Write a log of the uSD-card deck: two hours at 1 kHz of rotors with a lag of 60 ms."""
    path = tmp_path_factory.mktemp("large") / "LOG00.BIN"
    record = np.dtype(
        [("id", "<u2"), ("stamp", "<u8"), *((name, "<f4" if one == "f" else "<u2") for name, one in COLUMNS.items())]
    )
    words = b"".join(f"{name}({one})".encode() + b"\0" for name, one in COLUMNS.items())
    head = struct.pack("<BHHH", 0xBC, 2, 1, 65535) + b"fixedFrequency\0" + struct.pack("<H", len(COLUMNS)) + words
    draw, crc, count = np.random.default_rng(4), zlib.crc32(head), 200_000
    rotors = Rotors(draw)
    with path.open("wb") as file:
        file.write(head)
        for block in range(SIZE_MB * 1_000_000 // record.itemsize // count):
            rows = np.zeros(count, record)
            rows["id"], rows["stamp"] = 65535, 1000 * (block * count + np.arange(count))
            rows["pm.vbat"] = 4 + 0.01 * draw.standard_normal(count)
            rows["acc.z"] = 0.1 * draw.standard_normal(count)
            for motor, (command, speed) in enumerate(rotors.rows(count), start=1):
                rows[f"motor.m{motor}"], rows[f"rpm.m{motor}"] = command, speed
                rows["acc.z"] += THRUST_MPS2 / 9.81 * speed**2
            content = rows.tobytes()
            crc = zlib.crc32(content, crc)
            file.write(content)
        file.write(struct.pack("<I", crc))
    yield path
    path.unlink()


@pytest.fixture(scope="module")
def ulog(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Write a ULog file: an hour at 1 kHz of the same rotors under PX4's names, with two sensors and the battery."""
    path, count = tmp_path_factory.mktemp("large") / "log.ulg", 100_000
    topics = {
        "vehicle_angular_velocity": "float[3] xyz",
        "vehicle_acceleration": "float[3] xyz",
        "actuator_motors": "float[4] control",
        "esc_status": "esc_report[4] esc",
        "battery_status": "float voltage_v",
    }
    formats = [f"{name}:uint64_t timestamp;{field};" for name, field in topics.items()]
    parts = [("B", bytes(40)), ("F", b"esc_report:int32_t esc_rpm;"), *(("F", each.encode()) for each in formats)]
    parts += [("A", struct.pack("<BH", 0, at) + name.encode()) for at, name in enumerate(topics)]
    values = {"xyz": ("f4", 3), "control": ("f4", 4), "esc": ("i4", 4), "voltage_v": ("f4", 1)}
    shapes = [values[next(name for name in values if name in field)] for field in topics.values()]
    message = [[("size", "<u2"), ("type", "S1"), ("id", "<u2"), ("stamp", "<u8"), ("x", *shape)] for shape in shapes]
    record = np.dtype([(str(at), each) for at, each in enumerate(message)])
    draw = np.random.default_rng(7)
    rotors = Rotors(draw)
    with path.open("wb") as file:
        file.write(b"ULog\x01\x12\x35\x01" + bytes(8))
        file.write(b"".join(struct.pack("<Hc", len(data), kind.encode()) + data for kind, data in parts))
        for block in range(SIZE_MB * 1_000_000 // record.itemsize // count):
            rows = np.zeros(count, record)
            for at, _ in enumerate(topics):
                one = rows[str(at)]
                one["size"], one["type"], one["id"] = one.itemsize - 3, b"D", at
                one["stamp"] = 1000 * (1 + block * count + np.arange(count))
            rows["0"]["x"], rows["4"]["x"] = draw.normal(0, 0.1, (count, 3)), 16 + draw.normal(0, 0.01, (count, 1))
            rows["1"]["x"][:, 2] = draw.normal(0, 0.1, count)
            for at, (command, speed) in enumerate(rotors.rows(count)):
                rows["2"]["x"][:, at], rows["3"]["x"][:, at] = command / 65535, speed
                rows["1"]["x"][:, 2] -= THRUST_MPS2 * speed**2
            file.write(rows.tobytes())
    yield path
    path.unlink()


@pytest.fixture(scope="module")
def blackbox_log(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Write a blackbox log: two hours at 2 kHz, in which no row depends on another."""
    path = tmp_path_factory.mktemp("large") / "large.bbl"
    draw, at, speed = np.random.default_rng(4), 0, 200.0
    with path.open("wb") as file:
        file.write(blackbox_head())
        while file.tell() < SIZE_MB * 1_000_000:
            rows = bytearray()
            for roll in draw.integers(-100, 100, 20_000).tolist():
                held = 1100 + at // 40 * 7919 % 800
                speed += (held - 900 - speed) / 80  # a lag of 40 ms
                turning = [round(speed) + (roll + k) % 3 for k in range(4)]
                motors = [held + 100 * k for k in range(4)]
                rows += blackbox_row(at, gyro=(roll, -(at % 50), 0), motors=motors, turning=turning)
                at += 1
            file.write(rows)
        file.write(BLACKBOX_END)
    yield path
    path.unlink()


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", ["show {log}", "convert {log} --to parquet --out {out}", "fit dynamics {log} --rotor 1 --to 700", FLIGHT]
)
def test_a_large_ulog_file_takes_little_memory(ulog: Path, tmp_path: Path, words: str) -> None:
    pytest.importorskip("pyulog", reason='pyulog comes with pip install "cfid[ulog]"')
    check_peak(ulog, tmp_path, words, limit_mb=620)  # pyulog holds the whole file


@pytest.mark.slow  # decoding in Python takes six minutes; `convert`, which adds least to it, is left out
@pytest.mark.parametrize("words", ["show {log}", "fit dynamics {log} --rotor 1 --to 700 --force"])
def test_a_large_blackbox_log_takes_little_memory(blackbox_log: Path, tmp_path: Path, words: str) -> None:
    pytest.importorskip("orangebox", reason='orangebox comes with pip install "cfid[blackbox]"')
    check_peak(blackbox_log, tmp_path, words)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "convert {log} --to parquet --out {out}",
        "convert {log} --to csv --out {out}",
        "convert {log} --to mcap --out {out}",
        "import {log} --campaign {campaign}",
        "show {log} --no-figures",
        "fit dynamics {log} --rotor 1 --to 700 --no-figures",
        FLIGHT,
    ],
)
def test_a_large_log_takes_little_memory(log: Path, tmp_path: Path, words: str) -> None:
    check_peak(log, tmp_path, words)
