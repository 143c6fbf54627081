"""43 sine runs from CSV files to a transfer function, against reading the files with pandas and the thesis' loop.

The files are those of a series as the thesis recorded it: five of the load cell, one of crossings per run, an index.
Whole processes are compared first: the command against a program that reads the same files with pandas and ends. Then
the fit and the thesis' loop are compared within this process, with the same reader for both; the loop is
`transfer_thesis`, a transcription of C.2.5. A rate in Hz may be given; the load cell's own rate is 7000.
"""

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from cfid.transfer import estimation
from cfid.transfer.alignment import RecordedSine, Reports
from cfid.transfer.data import thrust_of
from cfid.transfer.plan import Sine
from cfid.transfer.thesis import fit_thesis
from tests.offline.sine_bench import ARM_M, Bench, LinearTruth, SimulatedSine, simulate_sines
from tests.transfer.sine_recordings import GAIN_N, LAG_S

PERIODS = [*range(16), *range(20, 101, 5), *range(110, 191, 10), 500]
FILES = 5
ROUNDS = 7
FULL_HZ = 7000.0
READ = """
import sys
from pathlib import Path
import pandas as pd
tables = [pd.read_csv(path) for path in Path(sys.argv[1]).glob("c*.csv")]
"""
INDEX_COLUMNS = ["l", "n", "amplitude", "motor", "loadcell", "crossings"]
CELL_COLUMNS = ["t", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]


def write(folder: Path, rate_hz: float) -> list[tuple[SimulatedSine, int]]:
    truth = LinearTruth(static_gain_n=GAIN_N, time_constant_s=LAG_S, vibration_n=0.0386)
    rng = np.random.default_rng(43)
    runs = simulate_sines(truth, periods=PERIODS, samples=4000, rng=rng, bench=Bench(rate_hz=rate_hz))
    files = [len(PERIODS) * number // FILES for number in range(FILES + 1)]
    for number in range(FILES):
        cell = [np.column_stack([run.time_s, run.counts]) for run in runs[files[number] : files[number + 1]]]
        frame = pd.DataFrame(np.vstack(cell), columns=CELL_COLUMNS).astype(dict.fromkeys(CELL_COLUMNS[1:], np.int64))
        frame.to_csv(folder / f"cell_{number}.csv", index=False, float_format="%.6f")
    for place, run in enumerate(runs):
        rows = np.column_stack([run.report_host_s, run.report_command, run.report_sample, run.report_vehicle_us])
        frame = pd.DataFrame(rows, columns=["t", "thrust_rec", "sample", "vehicle_us"])
        frame.to_csv(folder / f"crossings_{place}.csv", index=False, float_format="%.6f")
    number_of = np.searchsorted(files, np.arange(len(runs)), side="right") - 1
    listed = [
        (run.periods, run.samples, run.amplitude, run.motor, f"cell_{number}.csv", f"crossings_{place}.csv")
        for place, (run, number) in enumerate(zip(runs, number_of, strict=True))
    ]
    pd.DataFrame(listed, columns=INDEX_COLUMNS).to_csv(folder / "index.csv", index=False)
    return [(run, int(number)) for run, number in zip(runs, number_of, strict=True)]


def read(folder: Path) -> tuple[list[pd.DataFrame], list[pd.DataFrame]]:
    cells = [pd.read_csv(folder / f"cell_{number}.csv") for number in range(FILES)]
    return cells, [pd.read_csv(folder / f"crossings_{place}.csv") for place in range(len(PERIODS))]


def recorded(folder: Path, index: list[tuple[SimulatedSine, int]], sign: int = 1) -> list[RecordedSine]:
    cells, crossings = read(folder)
    records = []
    for cell in cells:
        torque_nm = cell[["Tx", "Ty", "Tz"]].to_numpy() / 1e6
        records.append((cell["t"].to_numpy(), sign * thrust_of("Ty", torque_nm, torque_nm, arm_m=ARM_M, yaw_deg=0.0)))
    runs = []
    for (run, number), rows in zip(index, crossings, strict=True):
        sine = Sine(periods=run.periods, samples=4000, amplitude=20000)
        reports = Reports(*rows.to_numpy(dtype=np.float64).T)
        time_s, force_n = records[number]
        runs.append(RecordedSine(name=f"l = {run.periods}", sine=sine, reports=reports, time_s=time_s, force_n=force_n))
    return runs


def identify(folder: Path, index: list[tuple[SimulatedSine, int]]) -> tuple[float, float]:
    fit = estimation.identify({"1": recorded(folder, index)}).fit
    return fit.gain_n, fit.time_constant_s


def as_thesis(folder: Path, index: list[tuple[SimulatedSine, int]]) -> tuple[float, float]:
    fit = fit_thesis(recorded(folder, index, sign=-1))
    return fit.function.static_gain_n, fit.function.time_constant_s or 0.0


def process(*words: object) -> Callable[[], object]:
    command = [sys.executable, *map(str, words)]
    return lambda: subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def race(contestants: dict[str, Callable[[], object]]) -> float:
    """Run all contestants in turns; print medians of each and of its ratios to the first; return the second's ratio.

    The goal applies to the wall clock; processor time is printed too, because others may use the machine meanwhile.
    """
    seconds: dict[str, list[tuple[float, float]]] = {what: [] for what in contestants}
    for _ in range(ROUNDS):
        for what, run in contestants.items():
            began = time.perf_counter(), _processor_s()
            run()
            seconds[what].append((time.perf_counter() - began[0], _processor_s() - began[1]))
    first = np.array(next(iter(seconds.values())))
    ratios = {what: np.median(np.array(taken) / first, axis=0) for what, taken in seconds.items()}
    for what, taken in seconds.items():
        clock_s, processor_s = np.median(taken, axis=0)
        clock, processor = ratios[what]
        print(
            f"{what:<24}{clock_s:7.3f} s, {clock:5.2f} times reading; of processor time {processor_s:7.3f} s, "
            f"{processor:5.2f} times"
        )
    return float(list(ratios.values())[1][0])


def _processor_s() -> float:
    """Return the processor time of this process and of the processes that it waited for."""
    used = [resource.getrusage(whose) for whose in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def main() -> None:
    rate_hz = float(sys.argv[1]) if len(sys.argv) > 1 else 1000.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        index = write(folder, rate_hz)
        size = sum(file.stat().st_size for file in folder.iterdir())
        print(f"{len(index)} runs at {rate_hz:.0f} Hz, {size / 1e6:.0f} MB; whole processes, then within one")
        words = ("-m", "cfid.cli.main", "tf", "identify", "--index", folder / "index.csv", "--no-figures")
        whole = race({"python, pandas reads": process("-c", READ, folder), "cfid tf identify": process(*words)})
        race(
            {
                "pandas reads": lambda: read(folder),
                "identify": lambda: identify(folder, index),
                "thesis' loop": lambda: as_thesis(folder, index),
            }
        )
        for what, (gain, lag_s) in (("identify", identify(folder, index)), ("thesis' loop", as_thesis(folder, index))):
            gain_off, lag_off = gain / GAIN_N - 1, lag_s / LAG_S - 1
            print(f"{what:<30}gain {100 * gain_off:+.2f} %   time constant {100 * lag_off:+.2f} %")
    goal = 1.8 if rate_hz >= FULL_HZ else 2
    print(f"whole process over reading, {rate_hz:g} Hz: {whole:.2f}  (goal: at most {goal})")


if __name__ == "__main__":
    main()
