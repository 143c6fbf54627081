"""A wind campaign of 112 recordings of 12 s at 7 kHz: read and reduced by `cfid fit drag`, against read with pandas.

The recordings come from the simulated wind tunnel at the thesis' wind settings (C.3.1), in the format of its logger.
cfid reads two files at once, pandas one after the other as a script does; both read the same files. The goal is a ratio
of at least 0.6 by the wall clock; processor time is printed too, because others may use the machine meanwhile.
"""

import os
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from cfid.drag.comparison import fit_models
from cfid.drag.data import read_index
from cfid.drag.plan import THESIS_WINDS
from tests.drag.wind_tunnel import COMMANDS, SHOWN_RPM, SimpleAir, Tunnel, Wind, record

RATE_HZ = 7000.0
WINDS = int(os.environ.get("BENCH_WINDS", str(len(THESIS_WINDS))))
EQ_4_8 = (-9.1785e-7, -9.1785e-7, -10.311e-7)
COLUMNS = ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]


def write(path: Path, wind: Wind, command: int, rng: np.random.Generator) -> None:
    tunnel = Tunnel(air=SimpleAir(kg_per_rad=EQ_4_8))
    time_s, counts = record(tunnel, wind, command=command, rng=rng, rate_hz=RATE_HZ)
    table = pd.DataFrame(counts, columns=[f"{axis}_counts" for axis in COLUMNS])
    table.insert(0, "t", [f"{1763712345 + t:.6f}" for t in time_s])
    table.to_csv(path, index=False)


def campaign(folder: Path) -> tuple[Path, list[Path]]:
    """Write the recordings and their index; return the paths of the index and of the recordings."""
    rng = np.random.default_rng(3)
    rows, files = ["command,angle_deg,wind_min_mps,wind_max_mps,tach_rpm,loadcell"], []
    still = Wind(0.0, 0.0, 0.0)
    winds = [
        Wind(setting.angle_deg or 0.0, setting.min_mps, setting.max_mps)
        for setting in THESIS_WINDS[:: -(-len(THESIS_WINDS) // WINDS)]
    ]
    for number, wind in enumerate([still, *winds]):
        for command, shown in zip(COMMANDS, SHOWN_RPM, strict=True):
            path = folder / f"{number}_{command}.csv"
            write(path, wind, command, rng)
            files.append(path)
            angle = f"{wind.angle_deg:g}" if wind.max_mps else ""
            rows.append(f"{command},{angle},{wind.min_mps},{wind.max_mps},{shown},{path.name}")
    index = folder / "wind.csv"
    index.write_text("\n".join(rows) + "\n")
    return index, files


def now() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        index, files = campaign(folder)
        pd.read_csv(files[0])
        begin = now()
        for path in files:
            pd.read_csv(path)
        alone = now()
        experiments = read_index(index)
        reduced = now()
        found = fit_models(experiments)
        fitted = now()
    off = 100 * (found.fits["simple"].value / np.array(EQ_4_8) - 1)
    spent = np.diff([begin, alone, reduced, fitted], axis=0).T
    for clock, (read_s, reduce_s, fit_s) in zip(("wall", "processor"), spent, strict=True):
        print(f"{clock}: pandas reads {len(files)} files in {read_s:.2f} s")
        print(f"    cfid reads and reduces them in {reduce_s:.2f} s")
        print(f"    ratio, {clock}: {read_s / reduce_s:.2f}  (goal: at least 0.6)")
        print(f"    all models are fitted and compared in {fit_s:.2f} s")
    print(f"simple coefficients {off[0]:+.2f} and {off[2]:+.2f} % off, model {found.chosen}")


if __name__ == "__main__":
    main()
