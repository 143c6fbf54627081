"""Records readings that the operator types at motor commands."""

import numpy as np

from cfid.records.run import DeviceRecord
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Block, Instrument


class Readings(Instrument):
    """Readings in a column named `value`; `t` is when a reading was typed.

    A row with `withdrawn` 1 repeats the row that it withdraws, which is already on disk.
    """

    name = "readings"
    eventful = True

    def __init__(self, value: str) -> None:
        """Take the name of the column of readings."""
        columns = ("t", "command", value, "withdrawn")
        self.record = DeviceRecord.model_validate({"file": "readings.csv", "columns": columns, "typed": True})
        self.is_whole = False  # set once all requested readings are there
        self._rows: list[tuple[float, int, float, int]] = []
        self._kept: list[tuple[int, float]] = []

    @property
    def whole(self) -> bool:
        """Whether all requested readings are there, and the run may end."""
        return self.is_whole

    def start(self, hardware: Hardware) -> None:
        """Wait for readings."""
        self._hardware = hardware

    def add(self, command: int, value: float) -> None:
        """Note a reading at a command."""
        self._kept.append((command, value))
        self._rows.append((self._hardware.seconds(), command, value, 0))

    @property
    def values(self) -> list[float]:
        """The readings that were not withdrawn, in order."""
        return [value for _, value in self._kept]

    @property
    def commands(self) -> list[int]:
        """The commands of `values`."""
        return [command for command, _ in self._kept]

    def withdraw(self) -> tuple[int, float] | None:
        """Withdraw the last reading; return its command and its value, None where there is none."""
        if not self._kept:
            return None
        command, value = self._kept.pop()
        self._rows.append((self._hardware.seconds(), command, value, 1))
        return command, value

    def take(self) -> Block:
        """Return the readings typed since the last call."""
        if not self._rows:
            return self.no_rows()
        rows, self._rows = self._rows, []
        times_s, *values = (np.array(column) for column in zip(*rows, strict=True))
        return Block((self._hardware.clock.unix_s(times_s), *values))
