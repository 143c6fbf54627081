"""Load-cell files of 12 s at 7 kHz: read and reduced, against read with pandas alone.

The thesis has 112 such files: pause, one command for about 9 s, pause, with vibration, drift and spikes. Eight are
written as `cfid log loadcell` does, and both ways read them in turn, so that caches and clocks are equal. Times are of
the processor, because others may use it meanwhile. The goal is a ratio of at least 0.8.
"""

import os
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from cfid.estimate.staircase import Point, reduce_single
from cfid.sim.loadcell import LoadCellTruth
from cfid.sim.propulsion import BatteryTruth, RotorTruth
from tests.offline.stand import simulate_stand, staircase_steps

FILES = int(os.environ.get("BENCH_FILES", "112"))
COMMANDS = (4000, 12000, 20000, 28000, 36000, 44000, 52000, 60000)
AXES = ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]
COUNTS = 1e6


def write(path: Path, command: int) -> None:
    steps, duration_s = staircase_steps([command], motors=(1, 3), hold_s=9.0, rest_s=1.5)
    record = simulate_stand(
        rotors=RotorTruth(),
        loadcell=LoadCellTruth(),
        battery=BatteryTruth(),
        steps=steps,
        duration_s=duration_s,
        rate_hz=7000,
        rng=np.random.default_rng(command),
        spikes_per_s=0.3,
    )
    table = pd.DataFrame(np.rint(COUNTS * record.wrench).astype(np.int64), columns=AXES)
    table.insert(0, "t", [f"{1763712345 + t:.6f}" for t in record.time_s])
    number = np.arange(len(table))
    table.assign(rdt_sequence=number, ft_sequence=3 * number, status=record.status).to_csv(path, index=False)


def reduced(table: pd.DataFrame, command: int) -> Point:
    wrench = np.empty((len(AXES), len(table)))
    for axis, row in zip(AXES, wrench, strict=True):
        np.divide(table[axis].to_numpy(), COUNTS, out=row)
    return reduce_single(
        time_s=table["t"].to_numpy(),
        channels=wrench.T,
        status=table["status"].to_numpy(np.uint32),
        command=command,
    ).points[0]


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        files = [(Path(name) / f"{command}.csv", command) for command in COMMANDS]
        for path, command in files:
            write(path, command)
        reduced(pd.read_csv(files[0][0]), COMMANDS[0])
        spent_s = np.zeros(3)
        errors = {}
        for i in range(FILES):
            path, command = files[i % len(files)]
            begin_s = time.process_time()
            pd.read_csv(path)
            alone_s = time.process_time()
            table = pd.read_csv(path)
            read_s = time.process_time()
            point = reduced(table, command)
            spent_s += alone_s - begin_s, read_s - alone_s, time.process_time() - read_s
            truth_n = 2 * 1.8e-8 * (381 + 0.0408 * command) ** 2
            errors[command] = 100 * (point.mean[2] / truth_n - 1)
    alone_ms, read_ms, reduce_ms = 1e3 * spent_s / FILES
    print(f"pandas reads a file in               {alone_ms:7.2f} ms")
    print(f"cfid reduces it in                   {reduce_ms:7.2f} ms")
    print(f"speed of both over reading alone     {alone_ms / (read_ms + reduce_ms):7.2f}     (goal: at least 0.8)")
    print("thrust, % off at each command       ", ", ".join(f"{u}: {error:+.2f}" for u, error in errors.items()))


if __name__ == "__main__":
    main()
