"""What the live line knows and shows of each instrument, in widths that do not change from row to row."""

import math
from collections import deque
from collections.abc import Callable
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cfid.records.progress import Counts
from cfid.wire.rls import turns_of

if TYPE_CHECKING:
    from cfid.rig.instrument import Block

_RATE_BLOCKS = 20  # over which the rate is averaged


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
        self.trace: deque[float] = deque(maxlen=40)
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
        self.silent_s = silent_s if silent_s > max(0.5, 4 * usual_s) else 0.0  # the values shown are then old

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


def degrees(counts_per_turn: float | str) -> Reading:
    """Return the angle of an encoder's latest row from its first, when a pendulum hangs still, within half a turn.

    The encoder's own zero may lie anywhere.
    """

    def angle(encoder: Progress) -> float:
        latest, first = turns_of(np.array([encoder.latest[0], encoder.first[0]]), counts_per_turn).turns
        return float((360 * (latest - first) + 180) % 360 - 180)

    return Reading(angle, "{:z6.1f} deg")


def vertical_force(counts_per_n: float) -> Reading:
    """Return a load cell's vertical force, above its tare where there is one."""
    return Reading(lambda cell: 1e3 * _above_tare(cell, 2) / counts_per_n, "Fz {:z4.0f} mN")


def first_force(name: str) -> Reading:
    """Return the first force or torque of a load cell that sends lines, above its tare where there is one."""
    unit = "mN" if name.startswith("F") else "mNm"
    return Reading(lambda cell: 1e3 * _above_tare(cell, 0), f"{name} {{:z5.0f}} {unit}")


def displayed(unit: str) -> Reading:
    """Return the number that a hand-held instrument showed last."""
    return Reading(lambda instrument: instrument.latest[0], f"{{:6.0f}} {unit}")


def turning() -> Reading:
    """Return the rate of rotation in the latest row of the inertial log."""
    return Reading(lambda gyro: math.hypot(*gyro.latest[1:4]), "{:5.0f} deg/s")


def volts(place: int) -> Reading:
    """Return the battery's voltage, which has a given place in the vehicle's log."""
    return Reading(lambda vehicle: vehicle.latest[place], "{:.2f} V")


def _above_tare(cell: Progress, place: int) -> float:
    """Return the last block's mean less the tare: a mean, since a motor's vibration is larger than most loads."""
    return cell.mean[place] - (cell.tare[place] if cell.tare else 0.0)
