"""Recordings of a wind tunnel and their index, in the formats of the thesis' logger and an operator's spreadsheet."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from cfid.records.rig_file import RigFacts, Tachometer, WindStand
from tests.drag.wind_tunnel import COMMANDS, SHOWN_RPM, Air, SimpleAir, Tunnel, Wind, record

BEGIN_S = 1_763_712_345.0
RATE_HZ, DURATION_S = 400.0, 6.0
EQ_4_8 = np.array([-9.1785e-7, -9.1785e-7, -10.311e-7])
STILL = Wind(float("nan"), 0.0, 0.0)
WINDS = (Wind(0.0, 2.9, 3.1), Wind(48.4, 2.4, 2.6), Wind(48.4, 3.9, 4.1), Wind(77.9, 3.4, 3.6))
DRIVEN = (20000, 40000)
# C.3.1 of the thesis.
MOUNT = RigFacts(wind=WindStand(yaw_deg=45.0, azimuth_deg=math.degrees(0.4967)), tachometer=Tachometer(markers=2))
HEAD = ("command", "angle_deg", "wind_min_mps", "wind_max_mps", "tach_rpm", "loadcell")

Row = dict[str, str]


@dataclass
class WindFolder:
    """The rows of an index, which a test may spoil before they are written."""

    folder: Path
    rows: list[Row] = field(default_factory=list)

    def row(self, command: int, wind: Wind) -> Row:
        return next(row for row in self.rows if row["loadcell"] == name_of(command, wind))

    def write(self, *, head: Sequence[str] = HEAD) -> Path:
        index = self.folder / "wind.csv"
        lines = [",".join(head), *(",".join(row.get(name, "") for name in head) for row in self.rows)]
        index.write_text("\n".join(lines) + "\n")
        return index


def name_of(command: int, wind: Wind) -> str:
    place = "still" if wind.max_mps == 0 else f"{wind.angle_deg:g}_{wind.max_mps:g}_{wind.azimuth_rad:.1f}"
    return f"{place}_{command}.csv"


def recorded(
    folder: Path,
    *,
    winds: Sequence[Wind] = WINDS,
    commands: Sequence[int] = (0, *DRIVEN),
    air: Air | None = None,
    seed: int = 3,
) -> WindFolder:
    """Record all commands without wind, then in each wind, and return the folder with its rows."""
    rng, tunnel = np.random.default_rng(seed), Tunnel(air=air or SimpleAir(kg_per_rad=EQ_4_8.tolist()))
    found = WindFolder(folder)
    for wind in (STILL, *winds):
        for command in commands:
            time_s, counts = record(tunnel, wind, command=command, rng=rng, duration_s=DURATION_S, rate_hz=RATE_HZ)
            table = pd.DataFrame(counts, columns=[f"{axis}_counts" for axis in ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")])
            table.insert(0, "t", np.round(BEGIN_S + time_s, 6))
            table.to_csv(folder / name_of(command, wind), index=False)
            found.rows.append(_row(command, wind))
    return found


def _row(command: int, wind: Wind) -> Row:
    windy = wind.max_mps > 0
    return {
        "command": str(command),
        "angle_deg": f"{wind.angle_deg:g}" if windy else "",
        "wind_min_mps": f"{wind.min_mps:g}",
        "wind_max_mps": f"{wind.max_mps:g}",
        "tach_rpm": f"{np.interp(command, COMMANDS, SHOWN_RPM):g}" if windy else "",
        "azimuth_deg": f"{math.degrees(wind.azimuth_rad):.4f}" if windy else "",
        "loadcell": name_of(command, wind),
    }


Spoil = Callable[[WindFolder], object]
