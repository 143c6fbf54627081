"""Six swings to a matrix as a whole process, against importing numpy, scipy.optimize and pandas."""

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from cfid.records.rig_file import load_rig, new_rig_text
from cfid.sim.encoder import EncoderModel
from cfid.sim.rig import draw_truth, record_swings
from cfid.sim.truth_file import INERTIA_KG_M2

RUNS = 9


def write_swings(folder: Path) -> list[str]:
    rig_file = folder / "rig.toml"
    rig_file.write_text(new_rig_text())
    rng = np.random.default_rng(3)
    rig = load_rig(rig_file)
    truth = draw_truth(rig, inertia_kg_m2=INERTIA_KG_M2, rng=rng)
    words = []
    for axis, recording in record_swings(truth, rig.mounts, rng=rng, encoder=EncoderModel()).items():
        path = folder / f"{axis}.csv"
        rows = np.column_stack([recording.time_s, recording.counts])
        np.savetxt(path, rows, fmt=("%.6f", "%d"), delimiter=",", header="t,phi", comments="")
        words.append(f"{axis}={path}")
    return [*words, "--geometry", str(rig_file)]


def seconds(*command: str) -> float:
    begin = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begin


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        words = write_swings(Path(folder))
        ours, theirs = [], []
        for _ in range(RUNS):
            ours.append(seconds(sys.executable, "-m", "cfid.cli.main", "fit", "inertia", *words, "--json"))
            theirs.append(seconds(sys.executable, "-c", "import numpy, scipy.optimize, pandas"))
    ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    print(f"cfid fit inertia, six swings             {statistics.median(ours):6.3f} s (median of {RUNS})")
    print(f"import numpy, scipy.optimize, pandas     {statistics.median(theirs):6.3f} s")
    print(f"ratio                                    {ratio:6.2f}   (goal: at most 2)")


if __name__ == "__main__":
    main()
