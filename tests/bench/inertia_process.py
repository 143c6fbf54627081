"""From six swings to a matrix in a whole process, against importing numpy, scipy.optimize and pandas.

The goal applies to the wall clock; processor time is printed too, because others may use the machine meanwhile.
"""

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from cfid.records.rig_file import load_rig, new_rig_text
from cfid.sim.swing import draw_truth
from cfid.sim.truth import INERTIA_KG_M2
from tests.offline.encoder import EncoderModel, record_swings

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


def seconds(*command: str) -> tuple[float, float]:
    """Return the seconds of a process by the wall clock and of processor time."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after, end = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    return end - begin, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        words = write_swings(Path(folder))
        ours, theirs = [], []
        for _ in range(RUNS):
            ours.append(seconds(sys.executable, "-m", "cfid.cli.main", "fit", "inertia", *words, "--json"))
            theirs.append(seconds(sys.executable, "-c", "import numpy, scipy.optimize, pandas"))
    for place, (clock, goal) in enumerate((("by the wall clock", "   (goal: at most 2)"), ("of processor time", ""))):
        own, other = [one[place] for one in ours], [one[place] for one in theirs]
        ratio = statistics.median(a / b for a, b in zip(own, other, strict=True))
        print(f"{clock}, medians of {RUNS}")
        print(f"cfid fit inertia, six swings             {statistics.median(own):6.3f} s")
        print(f"import numpy, scipy.optimize, pandas     {statistics.median(other):6.3f} s")
        print(f"ratio {clock}                  {ratio:6.2f}{goal}")


if __name__ == "__main__":
    main()
