"""A device of a run: its description in run.toml, and how a loop opens it."""

from collections.abc import Callable
from dataclasses import dataclass

from cfid.records.run import DeviceRecord
from cfid.rig.clock import HostClock
from cfid.rig.loop import Loop
from cfid.rig.progress import Reading
from cfid.rig.recorder import Instrument

Open = Callable[[Loop, HostClock], Instrument]


@dataclass(frozen=True, kw_only=True)
class Device:
    """A device that was checked and locked: its description in run.toml, and how a loop opens it.

    An `eventful` device may have no rows; any other device without rows is a fault. `reading` is what the live line
    shows of it.
    """

    record: DeviceRecord
    open: Open
    eventful: bool = False
    reading: Reading | None = None
