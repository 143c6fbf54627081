"""Files of sine runs from the simulated bench: an index with shared load-cell files, and run folders."""

import json
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from cfid.records.files import RIG_FILE
from cfid.records.rig_file import LoadCellMount, RigFacts
from cfid.records.run import Run
from tests.lab import made_run, run_cfid
from tests.offline.sine_bench import Bench, LinearTruth, SimulatedSine, simulate_sines

Said = subprocess.CompletedProcess[str]

GAIN_N, LAG_S = 2.3828e-6, 0.0775  # near eq. 3.15
TRUTH = LinearTruth(static_gain_n=GAIN_N, time_constant_s=LAG_S, vibration_n=0.02)
CELL = ["t", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]
USUAL = Bench(rate_hz=500)
THESIS_MOUNT = RigFacts(loadcell=LoadCellMount(yaw_deg=-45.0, arm_mm=46.0))
PERIODS = (0, 1, 2, 5, 10, 20, 30, 50, 75, 100)


class Here:
    """Run `cfid tf` in a folder.

    The files that an index lists are recorded on the thesis' rig, where no rig.toml states another.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __call__(self, *words: object) -> Said:
        if "--index" in words and not (self._folder / RIG_FILE).is_file():
            words = (*words, "--geometry", "thesis")
        return run_cfid(["tf", *words], self._folder)

    def json(self, *words: object, code: int = 0) -> dict[str, Any]:
        ended = self(*words, "--json")
        assert ended.returncode == code, ended.stderr
        content: dict[str, Any] = json.loads(ended.stdout)
        return content


def sines(
    periods: Sequence[int] = PERIODS,
    *,
    truth: LinearTruth = TRUTH,
    samples: int = 2000,
    seed: int = 0,
    bench: Bench = USUAL,
) -> list[SimulatedSine]:
    return simulate_sines(truth, periods=periods, samples=samples, rng=np.random.default_rng(seed), bench=bench)


def write_index(
    folder: Path,
    series: dict[str, list[SimulatedSine]],
    *,
    stamped: bool = True,
    name: str = "index.csv",
    cells: int = 2,
) -> Path:
    """Write every series with its load-cell files, and the index of all; rows of an unnamed series name no series."""
    rows = []
    for label, runs in series.items():
        files = [len(runs) * number // cells for number in range(cells + 1)]
        for number in range(cells):
            write_cell(folder / f"cell{label}_{number}.csv", runs[files[number] : files[number + 1]])
        for place, run in enumerate(runs):
            number = int(np.searchsorted(files, place, side="right")) - 1
            crossings = folder / f"crossings{label}_{run.periods}.csv"
            write_crossings(crossings, run, stamped=stamped)
            row = [run.periods, run.samples, run.amplitude, run.motor, f"cell{label}_{number}.csv", crossings.name]
            rows.append([*row, label] if label else row)
    head = ["l", "n", "amplitude", "motor", "loadcell", "crossings", "series"][: len(rows[0])]
    pd.DataFrame(rows, columns=head).to_csv(folder / name, index=False)
    return folder / name


def write_cell(path: Path, runs: Sequence[SimulatedSine]) -> None:
    rows = np.vstack([np.column_stack([run.time_s, run.counts]) for run in runs])
    axes = [f"{axis}_counts" for axis in CELL[1:]]
    frame = pd.DataFrame(rows, columns=["t", *axes]).astype(dict.fromkeys(axes, np.int64))
    frame.to_csv(path, index=False, float_format="%.6f")


def write_crossings(path: Path, run: SimulatedSine, *, stamped: bool = True) -> None:
    columns = {"t": run.report_host_s, "thrust_rec": run.report_command.astype(int)}
    if stamped:
        columns |= {"sample": run.report_sample.astype(int), "vehicle_us": run.report_vehicle_us.astype(int)}
        columns["report"] = np.arange(len(run.report_host_s))
    pd.DataFrame(columns).to_csv(path, index=False, float_format="%.6f")


def write_run(folder: Path, run: SimulatedSine, *, series: str | None = None, facts: RigFacts = THESIS_MOUNT) -> Run:
    """Write a run folder in the form of `cfid log sine`."""
    requested = {"l": run.periods, "n": run.samples, "amplitude": run.amplitude, "motor": run.motor}
    crossings = {
        "thrust_rec": run.report_command,
        "sample": run.report_sample,
        "vehicle_us": run.report_vehicle_us,
        "report": np.arange(len(run.report_host_s)),
    }
    counts = {**dict(zip(CELL[1:], run.counts.T, strict=True)), "status": 0 * run.time_s}
    return made_run(
        folder,
        f"sine_l{run.periods}",
        {
            "crossings": {"t": run.report_host_s, **{name: one.astype(np.int64) for name, one in crossings.items()}},
            "loadcell": {"t": run.time_s, **{name: one.astype(np.int64) for name, one in counts.items()}},
        },
        facts_of={"loadcell": {"counts_per_n": 1e6, "counts_per_nm": 1e6}},
        started=datetime.fromtimestamp(run.time_s[0], UTC),
        facts=facts,
        requested=requested if series is None else {**requested, "series": series},
    )
