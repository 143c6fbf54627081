"""Runs and files of a thrust stand, in the forms that `cfid log thrust` and the thesis' logger write."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.findings import texts
from cfid.records.rig_file import NONE_STATED, RigFacts
from cfid.records.run import Run
from cfid.sim.loadcell import LoadCellTruth
from cfid.sim.propulsion import BatteryTruth, RotorTruth
from tests.lab import made_run
from tests.offline.stand import StandRecord, simulate_stand, staircase_steps

Array = npt.NDArray[np.float64]

BEGIN_S = 1_763_712_345.0
COLUMNS = ("t", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "rdt_sequence", "ft_sequence", "status")


def climbed(
    commands: Sequence[int],
    *,
    motors: Sequence[int] = (1, 3),
    hold_s: float = 2.0,
    rest_s: float = 1.0,
    rate_hz: float = 1000.0,
    seed: int = 3,
    battery: BatteryTruth | None = None,
    rotors: RotorTruth | None = None,
    spikes_per_s: float = 0.2,
) -> StandRecord:
    """Return the stand's record of a staircase."""
    steps, duration_s = staircase_steps(commands, motors=motors, hold_s=hold_s, rest_s=rest_s)
    return simulate_stand(
        rotors=rotors or RotorTruth(),
        loadcell=LoadCellTruth(),
        battery=battery or BatteryTruth(),
        steps=steps,
        duration_s=duration_s,
        rate_hz=rate_hz,
        rng=np.random.default_rng(seed),
        spikes_per_s=spikes_per_s,
    )


def write_run(
    folder: Path,
    record: StandRecord,
    *,
    steps: Sequence[int],
    told_rpm: Array | None = None,
    facts: RigFacts = NONE_STATED,
    **more: Any,
) -> Run:
    """Write a record as a `cfid log thrust` run in the campaign `folder`, optionally with the rpm of motors 1 and 3."""
    rpm = () if told_rpm is None else told_rpm.T
    counts = np.rint(record.wrench * 1e6).astype(np.int64)
    number = np.arange(1, len(counts) + 1)
    forces = (BEGIN_S + record.time_s, *counts.T, number, 7 * number, record.status.astype(np.int64))
    motors = zip(("m1", "m2", "m3", "m4"), record.commands.astype(np.int64).T, strict=True)
    return made_run(
        folder,
        "thrust",
        {
            "commands": {"t": BEGIN_S + record.command_time_s, **dict(motors)},
            "loadcell": dict(zip(COLUMNS, forces, strict=True)),
            "crazyflie": {
                "t": BEGIN_S + record.tick_s,
                "vehicle_ms": np.rint(1e3 * record.tick_s).astype(np.int64),
                "pm.vbat": np.round(record.volts, 3),
                **dict(zip(("rpm.m1", "rpm.m3"), rpm, strict=False)),
            },
        },
        facts_of={"loadcell": {"counts_per_n": 1e6, "counts_per_nm": 1e6}},
        started=datetime(2026, 11, 21, tzinfo=UTC),
        facts=facts,
        requested={"steps": list(steps), **more},
    )


def write_thesis_file(path: Path, record: StandRecord) -> Path:
    """Write a record in the form of the thesis' logger: t and six columns of counts, which the first names."""
    counts = np.rint(record.wrench * 1e6).astype(np.int64)
    rows = [
        f"{t:.6f},{','.join(map(str, row))}" for t, row in zip(BEGIN_S + record.time_s, counts.tolist(), strict=True)
    ]
    path.write_text("\n".join(["t,Fx_counts,Fy,Fz,Tx,Ty,Tz", *rows]) + "\n")
    return path


def rejections(result: Any) -> tuple[str, ...]:
    """Return the sentences of the findings that reject."""
    return texts(result.findings, "rejection")
