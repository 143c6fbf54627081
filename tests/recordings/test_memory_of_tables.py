"""A table of 400 MB is imported, shown and fitted below 500 MB of anonymous memory."""

import itertools
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp

from tests.recordings.memory import SIZE_MB, check_peak

Array = npt.NDArray[np.float64]


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


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Write a day of a thrust stand at 100 Hz: a motor stands and runs in turn, 1000 s each, at nine commands."""
    path, count, size = tmp_path_factory.mktemp("large") / "stand.csv", 100_000, 0
    draw = np.random.default_rng(6)
    on = 1 - np.exp(-np.arange(count) / 6)  # share of the final thrust

    def rows(pulse_us: float) -> list[str]:
        thrust = -1e-3 * (pulse_us - 1000) ** 2 / 1000 * on * (pulse_us > 1000) + draw.normal(0, 1e-4, count)
        others = zip(thrust.tolist(), (0.01 * thrust).tolist(), (12 - 0.1 * thrust).tolist(), strict=True)
        return [f"{pulse_us:.0f},{f:.6f},{t:.7f},{v:.4f},{f:.3f},{v:.3f}\n" for f, t, v in others]

    cycle = [one for pulse_us in range(1100, 2000, 100) for one in (rows(1000), rows(pulse_us))]
    with path.open("w", encoding="utf-8") as file:
        file.write("Time (s),ESC signal (µs),Thrust (kgf),Torque (N·m),Voltage (V),Current (A),Vibration (g)\n")
        for block, part in enumerate(itertools.cycle(cycle)):
            size += file.write("".join(f"{(block * count + at) / 100:.2f},{row}" for at, row in enumerate(part)))
            if size > SIZE_MB * 1_000_000:
                break
    yield path
    path.unlink()


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Write 7 kHz load-cell data with three sines of a vehicle and a long step, and an index for each of the two."""
    folder = tmp_path_factory.mktemp("cell")
    count, rate_hz, size = 200_000, 7000, 0
    draw, periods, samples = np.random.default_rng(8), (100, 200, 400), 20_000  # of 2 ms each
    head = "t,Fx_counts,Fy_counts,Fz_counts,Tx_counts,Ty_counts,Tz_counts,status\n"

    def rows(time_s: Array) -> str:
        thrust = 0.3 * (time_s > 500) * (1 - np.exp(-20 * (time_s - 500).clip(0)))
        for run, of_run in enumerate(periods):
            own = time_s - 300 - 50 * run
            turn = 2 * np.pi * of_run / (0.002 * samples)
            swing = 0.03 * (np.exp(1j * turn * own) / (1 + 0.07j * turn)).real
            thrust += (0.1 + swing) * ((own > 0) & (own < 0.002 * samples))
        wrench = np.outer(thrust, [0.02, 0.01, 1.0, 0.0326, -0.0326, 0.01])
        counts = np.rint(1e6 * (wrench + draw.normal(0, 1e-3, wrench.shape))).astype(int)
        columns = zip(time_s.tolist(), counts.tolist(), strict=True)
        return "".join(f"{t:.6f},{','.join(map(str, row))},0\n" for t, row in columns)

    with (folder / "cell.csv").open("w") as file:
        file.write(head)
        for block in itertools.count():
            size += file.write(rows((block * count + np.arange(count)) / rate_hz))
            if size > SIZE_MB * 1_000_000:
                break
    (folder / "still.csv").write_text(head + rows(480 + np.arange(60 * 500) / 500))
    (folder / "drag.csv").write_text(
        "command,angle_deg,wind_min_mps,wind_max_mps,tach_rpm,loadcell,from_s,to_s\n"
        "37300,48.4,2.0,3.7,31600,cell.csv,550,600\n37300,48.4,0,0,31600,still.csv,,\n"
    )
    index = ["l,n,amplitude,motor,loadcell,crossings\n"]
    for run, of_run in enumerate(periods):
        places = np.append(0, np.ceil((np.arange(2 * of_run) + 0.5) * samples / (2 * of_run)))
        commands = np.rint(10_000 * np.cos(2 * np.pi * of_run * places / samples) + 30_000)
        reports = [
            f"{300 + 50 * run + 0.002 * at + 0.005:.6f},{u:.0f},{at:.0f}\n"
            for at, u in zip(places, commands, strict=True)
        ]
        end = f"{340.006 + 50 * run:.6f},0,{samples}\n"
        (folder / f"crossings{run}.csv").write_text("".join(["t,thrust_rec,sample\n", *reports, end]))
        index.append(f"{of_run},{samples},10000,1,cell.csv,crossings{run}.csv\n")
    (folder / "sines.csv").write_text("".join(index))
    yield folder
    shutil.rmtree(folder)


@pytest.mark.slow
@pytest.mark.parametrize("words", ["fit drag --index {log}/drag.csv", "tf identify --index {log}/sines.csv"])
def test_a_large_recording_of_a_load_cell_takes_little_memory(cell: Path, tmp_path: Path, words: str) -> None:
    check_peak(cell, tmp_path, f"{words} --no-figures --force")


@pytest.mark.slow
@pytest.mark.parametrize("words", ["fit thrust {log} --no-figures", "fit torque {log} --no-figures", "show {log}"])
def test_a_large_table_of_a_stand_takes_little_memory(stand: Path, tmp_path: Path, words: str) -> None:
    check_peak(stand, tmp_path, words)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    ["fit swing {log} --no-figures", "show {log} --no-figures", "show {log}", "import {log} --campaign {campaign}"],
)
def test_a_large_table_of_angles_takes_little_memory(angles: Path, tmp_path: Path, words: str) -> None:
    check_peak(angles, tmp_path, words)
