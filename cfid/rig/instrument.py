"""What every instrument of a recording is: it samples on its own, and its rows are taken in blocks."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.records.run import DeviceRecord
from cfid.rig.hardware import Hardware
from cfid.rig.progress import Reading

Say = Callable[[str], None]

_PAUSE_S, _PERIODS = 0.25, 4  # without data, which is a gap; at a slow rate, so many periods


class Block(NamedTuple):
    """An instrument's data since the last block: columns (n,), samples lost, and a fault that ends the run.

    `lost` is None from when on it is unknown how many are, as where a device states neither a rate nor a clock.
    `status` is what the live line shows in place of values.
    """

    columns: Sequence[npt.NDArray[Any]]
    lost: int | None = 0
    fault: str = ""
    status: str = ""


class Instrument(ABC):
    """A device that samples on its own and keeps its rows until they are taken; it serves one recording.

    `record` is its description in run.toml. One that is `eventful` may have no rows; any other without rows is a fault.
    `reading` is what the live line shows of it.
    """

    name: str
    record: DeviceRecord
    eventful = False
    reading: Reading | None = None

    @abstractmethod
    def start(self, hardware: Hardware) -> None:
        """Open its port and begin to sample. Raises DeviceError."""

    @abstractmethod
    def take(self) -> Block:
        """Return the new rows. Raises DeviceError when no more data arrive."""

    async def stop(self) -> None:  # noqa: B027 - many sample nothing that has to be ended
        """End the sampling and make sure that it ended; rows until then can still be taken."""

    def close(self) -> None:  # noqa: B027 - a vehicle's instruments share a link that another closes
        """Release its port. May be called twice."""

    def facts(self) -> Mapping[str, Any]:
        """Return what goes into run.toml at the end."""
        return {}

    @property
    def begun(self) -> bool:
        """Whether it has shown that it works, so that motors may start."""
        return True

    @property
    def whole(self) -> bool:
        """Whether it has recorded all that a procedure requested, so that the run may end."""
        return False

    def no_rows(self, lost: int | None = 0, *, fault: str = "", status: str = "") -> Block:
        """Return a block without rows."""
        return Block(tuple(np.empty(0) for _ in self.record.columns), lost, fault, status)


class Silence:
    """How long a device has sent nothing, without the time in which this program stood still, and the gaps of a run."""

    def __init__(self, hardware: Hardware, *, period_s: float) -> None:
        """Begin to listen to a device that sends at this period."""
        self.gaps: list[dict[str, float | str]] = []
        self._hardware, self._period_s = hardware, period_s
        self.received_s = hardware.seconds()
        self._awake_s = hardware.awake_s()

    @property
    def seconds(self) -> float:
        """How long nothing has come."""
        return self._hardware.awake_s() - self._awake_s

    def exceeds(self, usual_s: float) -> bool:
        """Return whether it is longer than a time, and than a few periods."""
        return self.seconds > max(usual_s, _PERIODS * self._period_s)

    def end(self, reason: str = "", *, first_s: float = math.inf) -> bool:
        """Note that data came, the first of it at `first_s`; return whether that ended a gap.

        run.toml states a gap with its reason, if it has one. `stood_s` of a gap is for how long this program stood
        still in it: suspended, or kept waiting.
        """
        now_s = self._hardware.seconds()
        first_s = min(first_s, now_s)
        was_gap = first_s - self.received_s > max(_PAUSE_S, _PERIODS * self._period_s)
        if was_gap and reason:
            begin_s, end_s = self._hardware.clock.unix_s(np.array([self.received_s, first_s])).tolist()
            stood_s = now_s - self.received_s - self.seconds
            stood = {"stood_s": round(stood_s, 3)} if stood_s > 0 else {}
            self.gaps.append({"from_s": begin_s, "to_s": end_s, "reason": reason, **stood})
        self.received_s, self._awake_s = now_s, self._hardware.awake_s()
        return was_gap
