"""What a box says of itself in the status words of its records, and which of it ends a run."""

import numpy as np
import numpy.typing as npt

from cfid.rig.recorder import Say
from cfid.wire.rdt_status import Family, read_status


class StatusWatch:
    """Reads status words as they come. Two records in a row have to agree: nothing else guards a word's bits."""

    def __init__(self, *, where: str, family: Family, say: Say) -> None:
        """Take how to call the box, and whose table of bits holds."""
        self.said: set[str] = set()
        self._where, self._family, self._say = where, family, say
        self._last = np.zeros(1, np.uint32)

    def fault(self, status: npt.NDArray[np.uint32]) -> str:
        """Say each warning once; return what ends the run, empty for nothing."""
        words = np.concatenate((self._last, status))
        self._last = status[-1:]
        agreed = int(np.bitwise_or.reduce(words[1:] & words[:-1]))
        if not agreed:
            return ""
        read = read_status(agreed, self._family)
        for warning in read.warnings:
            if warning not in self.said:
                self.said.add(warning)
                self._say(f"{self._where}: {warning} (status {agreed:#010x}); no fault: the recording goes on")
        if not read.faults:
            return ""
        return f"{self._where}: {', '.join(read.faults)}: the readings from there on are not forces."
