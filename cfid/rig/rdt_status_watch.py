"""Watches the status words of a box' records: reports warnings, and returns the faults that end a run."""

import numpy as np
import numpy.typing as npt

from cfid.rig.recorder import Say
from cfid.wire.rdt_status import Family, read_status


class StatusWatch:
    """Reads status words as they arrive. Two records in a row have to agree: nothing else protects a word's bits."""

    def __init__(self, *, where: str, family: Family, say: Say) -> None:
        """Take the box' name for messages, and its family, which decides the table of bits."""
        self.reported: set[str] = set()
        self._where, self._family, self._say = where, family, say
        self._last = np.zeros(1, np.uint32)

    def fault(self, status: npt.NDArray[np.uint32]) -> str:
        """Report each warning once; return the fault that ends the run, empty for none."""
        words = np.concatenate((self._last, status))
        self._last = status[-1:]
        agreed = int(np.bitwise_or.reduce(words[1:] & words[:-1]))
        if not agreed:
            return ""
        read = read_status(agreed, self._family)
        for warning in read.warnings:
            if warning not in self.reported:
                self.reported.add(warning)
                self._say(f"{self._where}: {warning} (status {agreed:#010x}); not a fault: the recording goes on")
        if not read.faults:
            return ""
        return f"{self._where}: {', '.join(read.faults)}: the readings from here on are not forces."
