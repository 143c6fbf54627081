"""Tables of forces and of a log with gaps, read by cfid and by pandas alone; and the memory that 400 MB take.

Reading includes the checksum of the file, its times in seconds, and the search for gaps and damaged lines.
"""

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from cfid.recordings.recording import How
from cfid.recordings.table import read_table
from cfid.recordings.times import series_of

RUNS = 5
FORCES_MB, MEMORY_MB, GAPS_ROWS = 171, 400, 100_000


def write_forces(path: Path, megabytes: int) -> None:
    random = np.random.default_rng(0)
    with path.open("w") as file:
        file.write("t_s,Fx_n,Fy_n,Fz_n,Tx_nm,Ty_nm,Tz_nm\n")
        begin = 0
        while file.tell() < megabytes * 1e6:
            rows = np.column_stack([1e-3 * np.arange(begin, begin + 100_000), random.normal(size=(100_000, 6))])
            pd.DataFrame(rows).round(6).to_csv(file, index=False, header=False)
            begin += len(rows)


def write_gaps(path: Path) -> None:
    random = np.random.default_rng(0)
    columns = {f"c{place}": random.normal(size=GAPS_ROWS).round(5) for place in range(16)}
    for place in range(1, 16, 2):
        columns[f"c{place}"][random.random(GAPS_ROWS) < 0.5] = np.nan
    pd.DataFrame({"t_s": 1e-3 * np.arange(GAPS_ROWS), **columns}).to_csv(path, index=False)


def read(path: Path) -> object:
    return series_of(read_table(path), How())


READERS = {"cfid": read, "pandas": pd.read_csv}


def alone(reader: str, path: Path) -> tuple[float, float]:
    """Return the seconds and the memory in MB that a reader takes in a process of its own, as in a command."""
    command = [sys.executable, __file__, reader, str(path)]
    seconds, memory_mb = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    return float(seconds), float(memory_mb)


def median_seconds(reader: str, path: Path) -> float:
    return statistics.median(alone(reader, path)[0] for _ in range(RUNS))


def most_memory_mb() -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return float(next(line.split()[1] for line in lines if line.startswith("VmHWM"))) / 1e3


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        forces, gaps, large = (Path(folder) / f"{name}.csv" for name in ("forces", "gaps", "large"))
        write_forces(forces, FORCES_MB)
        write_gaps(gaps)
        for name, path in ((f"{FORCES_MB} MB of forces", forces), ("a log with gaps", gaps)):
            ours, peer = median_seconds("cfid", path), median_seconds("pandas", path)
            print(f"{name}: cfid {ours:.3f} s, pandas {peer:.3f} s: ratio {ours / peer:.2f}")
        write_forces(large, MEMORY_MB)
        (_, ours), (_, peer) = alone("cfid", large), alone("pandas", large)
        print(f"{MEMORY_MB} MB of forces: cfid {ours:.0f} MB of memory, pandas {peer:.0f} MB: ratio {ours / peer:.2f}")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        begin = time.perf_counter()
        READERS[sys.argv[1]](Path(sys.argv[2]))
        print(time.perf_counter() - begin, most_memory_mb())
    else:
        main()
