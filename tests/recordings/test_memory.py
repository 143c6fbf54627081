"""A file of 400 MB is imported, converted, shown and fitted below 500 MB of anonymous memory."""

import itertools
import re
import shutil
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp

Array = npt.NDArray[np.float64]

pytestmark = pytest.mark.slow

LIMIT_MB, SIZE_MB = 500, 400
WATCHED = """
import re, sys, threading, time
from cfid.cli.main import main
peak = 0
def watch():
    global peak
    while True:
        peak = max(peak, int(re.search(r"RssAnon:\\s+(\\d+)", open("/proc/self/status").read())[1]))
        time.sleep(0.02)
threading.Thread(target=watch, daemon=True).start()
try:
    main(sys.argv[1:])
finally:
    print("peak", peak / 1024, file=sys.stderr)
"""


def check_peak(log: Path, tmp_path: Path, words: str) -> None:
    """Check and print the peak of anonymous memory of a command; {log} in `words` stands for the file."""
    subprocess.run([sys.executable, "-c", WATCHED, "new", tmp_path / "campaign"], check=True, capture_output=True)
    places = {"log": log, "out": tmp_path / "out", "campaign": tmp_path / "campaign"}
    given = [word.format(**places) for word in words.split()]
    ended = subprocess.run(
        [sys.executable, "-c", WATCHED, *given], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    shutil.rmtree(tmp_path)  # it may hold up to 1.3 GB
    peak = re.search(r"^peak (\S+)$", ended.stderr, re.MULTILINE)
    assert ended.returncode == 0, ended.stderr
    assert peak is not None
    print(f"{words.partition('{')[0]}{words.partition('}')[2]}: {float(peak[1]):.0f} MB of anonymous memory")
    assert float(peak[1]) < LIMIT_MB


THRUST_MPS2 = 7e-9  # per square of a rotor's speed in rpm, for a vehicle of 30 g
COLUMNS = {
    **dict.fromkeys(("acc.x", "acc.y", "acc.z", "gyro.x", "gyro.y", "gyro.z", "pm.vbat"), "f"),
    **{f"{name}.m{motor}": "H" for name in ("motor", "rpm") for motor in (1, 2, 3, 4)},
}


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
def angles(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Write hours of angles at 1 kHz, in which a pendulum of 1.6 Hz is held, released at 300 s, and comes to rest."""
    path, count, size = tmp_path_factory.mktemp("large") / "angle.csv", 200_000, 0
    found = solve_ivp(
        lambda _, y: (y[1], -101.0 * np.sin(y[0]) - 0.08 * y[1]),
        (0, 200),
        (0.6, 0.0),
        "DOP853",
        dense_output=True,
        rtol=1e-11,
        atol=1e-12,
    )
    draw = np.random.default_rng(5)
    with path.open("w") as file:
        file.write("t_s,phi_rad\n")
        for block in itertools.count():
            time_s = 1e-3 * (block * count + np.arange(count))
            swung = found.sol((time_s - 300).clip(0, 200))[0] * (time_s < 500)
            angle = swung + 1.5 + draw.normal(0, 6e-6, count)
            text = "".join(f"{t:.6f},{one:.6f}\n" for t, one in zip(time_s.tolist(), angle.tolist(), strict=True))
            size += file.write(text)
            if size > SIZE_MB * 1_000_000:
                break
    yield path
    path.unlink()


@pytest.mark.parametrize(
    "words",
    [
        "convert {log} --to csv --out {out}",
        "import {log} --campaign {campaign}",
        "show {log} --no-figures",
        "fit dynamics {log} --motor 1 --to 700 --no-figures",
        "fit flight {log} --from 100 --to 300 --mass-kg 0.03 --no-figures --force",
    ],
)
def test_a_large_log_takes_little_memory(log: Path, tmp_path: Path, words: str) -> None:
    check_peak(log, tmp_path, words)


@pytest.mark.parametrize("words", ["fit swing {log} --no-figures", "show {log}", "import {log} --campaign {campaign}"])
def test_a_large_table_of_angles_takes_little_memory(angles: Path, tmp_path: Path, words: str) -> None:
    check_peak(angles, tmp_path, words)
