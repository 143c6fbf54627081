"""What the live line knows of each instrument: rows, rate, losses, silence, and the values that an operator reads."""

from collections import deque
from collections.abc import Callable
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cfid.records.progress import Counts

if TYPE_CHECKING:
    from cfid.rig.instrument import Block

_SHOWN_POINTS = 40
_RATE_BLOCKS = 20  # over which the rate is averaged
_SILENT_S, _USUAL_PAUSES = 0.5, 4  # without a row, and this many usual pauses: the values shown are then old


class Progress:
    """An instrument's progress: rows, rate, losses and values without their time, in bounded memory.

    `first` and `latest` are the first and the last row, `mean` is the mean of the last block, and `tare` that of the
    rows at rest; each is () while it has no row. `trace` has the values read in the last blocks. `silent_s` is how long
    no row has come, 0 where that is usual.
    """

    def __init__(self, reading: "Reading | None" = None) -> None:
        """Take what the live line shows of the instrument; no row has come."""
        self.rows = 0
        self.lost: int | None = 0
        self.status = ""
        self.reading = reading
        self.first: tuple[float, ...] = ()
        self.latest: tuple[float, ...] = ()
        self.mean: tuple[float, ...] = ()
        self.tare: tuple[float, ...] = ()
        self.silent_s = 0.0
        self._received_s: float | None = None
        self._rows_at_rest = 0
        self.trace: deque[float] = deque(maxlen=_SHOWN_POINTS)
        self._blocks: deque[tuple[float, int]] = deque(maxlen=_RATE_BLOCKS)
        self._pauses: deque[float] = deque(maxlen=_RATE_BLOCKS)  # between blocks with rows

    def add(self, block: "Block", now_s: float, *, at_rest: bool = False) -> None:
        """Take note of a block; one of an instrument `at_rest` counts towards its tare."""
        rows = len(block.columns[0])
        self.rows += rows
        self.lost = None if self.lost is None or block.lost is None else self.lost + block.lost
        self.status = block.status
        self._blocks.append((now_s, rows))
        self._note_silence(now_s, rows)
        if rows:
            self.first = self.first or tuple(float(column[0]) for column in block.columns[1:])
            self.latest = tuple(float(column[-1]) for column in block.columns[1:])
            self.mean = tuple(float(np.mean(column)) for column in block.columns[1:])
        if rows and at_rest:
            self._rows_at_rest += rows
            share = rows / self._rows_at_rest
            before = self.tare or self.mean
            self.tare = tuple(old + share * (new - old) for old, new in zip(before, self.mean, strict=True))
        if rows:
            self.trace.append(self.latest[0] if self.reading is None else self.reading.value(self))

    def _note_silence(self, now_s: float, rows: int) -> None:
        if self._received_s is None:
            self._received_s = now_s
        if rows:
            if self.latest:
                self._pauses.append(now_s - self._received_s)
            self._received_s = now_s
        silent_s = now_s - self._received_s
        usual_s = median(self._pauses) if self._pauses else 0.0
        self.silent_s = silent_s if silent_s > max(_SILENT_S, _USUAL_PAUSES * usual_s) else 0.0

    @property
    def counts(self) -> Counts:
        """The instrument's counts for the progress file and the live line."""
        return Counts(rows=self.rows, lost=None if self.lost is None else int(self.lost), rate_hz=self.rate_hz)

    @property
    def rate_hz(self) -> float:
        """Rows per second over the last blocks."""
        if len(self._blocks) < 2:
            return 0.0
        spent_s = self._blocks[-1][0] - self._blocks[0][0]
        return sum(rows for _, rows in list(self._blocks)[1:]) / spent_s if spent_s > 0 else 0.0


class Reading(NamedTuple):
    """What an operator reads of an instrument: a number, and the form in which it is shown, as `{:5.1f} deg`."""

    value: Callable[[Progress], float]
    form: str

    def of(self, progress: Progress) -> str:
        """Return the number as text."""
        return self.form.format(self.value(progress))
