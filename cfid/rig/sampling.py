"""Samples devices into memory for some seconds, without a run: what `cfid rig preflight` judges."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.records.progress import RunProgress
from cfid.rig.device import Device
from cfid.rig.log import Procedure, drive
from cfid.rig.loop import Loop
from cfid.rig.recorder import Recorder, sleep


@dataclass
class Sampled:
    """A device's rows as columns (n,), by their names, the samples that were lost (None: unknown), and its facts."""

    columns: dict[str, npt.NDArray[np.float64]] = field(default_factory=dict)
    lost: int | None = 0
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(self.columns["t"]) if self.columns else 0


class Memory:
    """Keeps all rows in memory; a sink of the recorder."""

    def __init__(self) -> None:
        """Start without rows."""
        self._blocks: dict[str, list[Sequence[Any]]] = {}
        self._lost: dict[str, int | None] = {}
        self._facts: dict[str, Mapping[str, Any]] = {}

    def append(self, device: str, columns: Sequence[Any]) -> None:
        """Keep one block."""
        self._blocks.setdefault(device, []).append(columns)

    def count_lost(self, device: str, samples: int | None) -> None:
        """Count samples that are missing."""
        before = self._lost.get(device, 0)
        self._lost[device] = None if samples is None or before is None else before + samples

    def describe(self, device: str, facts: Mapping[str, Any]) -> None:
        """Keep a device's facts."""
        self._facts[device] = facts

    def sync(self, progress: RunProgress) -> None:
        """Do nothing."""

    def sampled(self, device: str, names: Sequence[str]) -> Sampled:
        """Return what a device with these columns sent."""
        columns = [np.concatenate(column) for column in zip(*self._blocks.get(device, ()), strict=True)]
        named = dict(zip(names, (column.astype(np.float64) for column in columns), strict=True)) if columns else {}
        return Sampled(named, self._lost.get(device, 0), self._facts.get(device, {}))


def sample(
    devices: Sequence[Device],
    *,
    for_s: float,
    show: Callable[[Recorder], None],
    procedure: Procedure | None = None,
    stopped: Callable[[float], None] = lambda _: None,
    tare_s: float = 0.0,
) -> dict[str, Sampled]:
    """Sample devices for `for_s` seconds, or until a procedure as long as that ends; return each by its file's stem.

    The live line shows forces relative to those of the first `tare_s`.
    Raises DeviceError as a recording does, KeyboardInterrupt when a signal ended it; motors are stopped and checked.
    """
    memory, complete = Memory(), False

    async def until_done(there: Mapping[str, Any], loop: Loop) -> None:
        nonlocal complete
        await (sleep(loop, for_s) if procedure is None else procedure(there, loop))
        complete = True

    drive(devices, until_done, show=show, stopped=stopped, into=memory, lasts_s=for_s, tare_s=tare_s)
    if not complete:
        raise KeyboardInterrupt
    names = [device.record.file.removesuffix(".csv") for device in devices]
    return {name: memory.sampled(name, device.record.columns) for name, device in zip(names, devices, strict=True)}
