"""Holds a simulated run as a recording would: devices with columns and values, and the operator's label."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

Column = npt.NDArray[Any]

WRENCH_COLUMNS = ("t", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "rdt_sequence", "ft_sequence", "status")
PAUSE_S = 20.0  # of an operator between two runs
_INTERNAL_HZ = 7000


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedDevice:
    """One device's file: its columns, the first of them times (n,) in s from the run's beginning, and its scales."""

    columns: tuple[str, ...]
    values: tuple[Column, ...]
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class SimulatedRun:
    """One recording with its request (`requested`) and the label that an operator would give it.

    The next run begins `next_after_s` after this one did.
    """

    kind: str
    next_after_s: float
    devices: Mapping[str, SimulatedDevice]
    requested: Mapping[str, Any] = field(default_factory=dict)
    body: Literal["crazyflie", "testbody", "fixture"] | None = None
    axis: str | None = None
    weight_g: float | None = None


def wrench_device(
    time_s: Column, counts: Column, *, rate_hz: float, counts_per_n: float, counts_per_nm: float
) -> SimulatedDevice:
    """Return a load cell's file of counts (n, 6) at times (n,), all of them healthy and none lost."""
    number = np.arange(1, len(time_s) + 1)
    return SimulatedDevice(
        columns=WRENCH_COLUMNS,
        values=(time_s, *counts.astype(np.int64).T, number, round(_INTERNAL_HZ / rate_hz) * number, 0 * number),
        facts={"counts_per_n": counts_per_n, "counts_per_nm": counts_per_nm},
    )
