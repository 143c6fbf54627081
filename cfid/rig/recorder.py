"""Records several instruments into one run: rows every 50 ms, synced to the disk every second; knows no device."""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from twisted.internet.base import DelayedCall
from twisted.internet.defer import Deferred
from twisted.python.failure import Failure

from cfid.errors import CfidError, DeviceError, StopError
from cfid.records.progress import RunProgress
from cfid.records.run_writer import RunWriter
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Instrument
from cfid.rig.progress import Progress

BLOCK_S = 0.05
SYNC_S = 1.0

Notice = Callable[[str, Sequence[Any]], None]  # examines an instrument's new rows


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
    """Keeps all rows in memory, or none where only the procedure counts."""

    def __init__(self, *, keep: bool = True) -> None:
        """Start without rows."""
        self._keep = keep
        self._blocks: dict[str, list[Sequence[Any]]] = {}
        self._lost: dict[str, int | None] = {}
        self._facts: dict[str, Mapping[str, Any]] = {}

    def append(self, device: str, columns: Sequence[Any]) -> None:
        """Keep one block."""
        if self._keep:
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


class Recorder:
    """Records instruments into a sink."""

    def __init__(
        self,
        instruments: Sequence[Instrument],
        sink: RunWriter | Memory,
        hardware: Hardware,
        *,
        show: Callable[["Recorder"], None],
        notice: Notice = lambda name, columns: None,
        for_s: float | None = None,
        tare_s: float = 0.0,
    ) -> None:
        """Take the instruments and the sink; `show` is called after every block, `notice` with all new rows.

        `for_s` is how long the recording is to last, where that is known; everything is at rest for `tare_s` at first.
        """
        self.progress = {instrument.name: Progress(instrument.reading) for instrument in instruments}
        self.for_s = for_s
        self._tare_s = tare_s
        self._instruments, self._sink, self._hardware = instruments, sink, hardware
        self._show, self._notice = show, notice
        self._begun_s = hardware.seconds()
        self._next_block: DelayedCall | None = None
        self._syncing = False
        self._suspended_s = 0.0
        self._done: Deferred[None] = Deferred()

    @property
    def now_s(self) -> float:
        """The time on the monotonic clock."""
        return self._hardware.seconds()

    @property
    def seconds(self) -> float:
        """How long the recording has lasted so far."""
        return self.now_s - self._begun_s

    async def record(self, begin: Callable[[], Deferred[None]]) -> None:
        """Record until the Deferred of `begin` fires or something fails; then stop every device, in order.

        What a device sent before it stopped is written in every case. Raises the first failure with the others in its
        message: DeviceError or DataError, unless the program itself is faulty.
        """
        self._begun_s = self._hardware.seconds()
        self._suspended_s = self._hardware.suspended_s()
        failed: list[Exception] = []
        begun: Deferred[None] | None = None
        started: list[Instrument] = []
        try:
            for instrument in self._instruments:
                instrument.start(self._hardware)
                started.append(instrument)
            self._write_blocks(0)
            if not self._done.called:  # a device that is at fault at once ends the recording before anything turns
                begun = begin()
                begun.addCallbacks(self._finish, self._failed)
            await self._done
        except Exception as error:
            failed.append(error)
        if begun is not None:
            begun.cancel()
        failed += await self._stop(started)
        if failed:
            raise _together(failed)

    def _finish(self, _: object) -> None:
        if not self._done.called:
            self._done.callback(None)

    def _failed(self, failure: Failure) -> None:
        if failure.value is not None:
            self._fail(failure.value)

    def _fail(self, error: BaseException) -> None:
        if not self._done.called:
            self._done.errback(error)

    def _write_blocks(self, count: int) -> None:
        """Write the new rows, and schedule the next block on a grid that a slow disk does not shift."""
        try:
            self._hardware.awake_s()
            self._check_awake()
            for instrument in self._instruments:
                self._write(instrument)
            self._show(self)
        except Exception as error:
            self._fail(error)
            return
        if count and count % round(SYNC_S / BLOCK_S) == 0:
            self._sync()
        now_s = self.seconds
        later = max(count + 1, int(now_s / BLOCK_S) + 1)
        self._next_block = self._hardware.later(max(later * BLOCK_S - now_s, 0), self._write_blocks, later)

    def _check_awake(self) -> None:
        """Raise DeviceError after a suspend, which times of samples leave out while motion goes on."""
        slept_s = self._hardware.suspended_s() - self._suspended_s
        if slept_s > 0.5:
            raise DeviceError(
                f"the computer was suspended for {slept_s:.1f} s during the recording, and no sample was taken then: "
                "the rows until then are kept. Keep the computer awake while it records."
            )

    def _write(self, instrument: Instrument) -> None:
        block = instrument.take()
        if block.lost != 0:
            self._sink.count_lost(instrument.name, block.lost)
        if len(block.columns[0]):
            self._sink.append(instrument.name, block.columns)
            self._notice(instrument.name, block.columns)
        at_rest = self.seconds < self._tare_s
        self.progress[instrument.name].add(block, self._hardware.seconds(), at_rest=at_rest)
        if block.fault:
            raise DeviceError(block.fault)

    def _sync(self) -> None:
        """Sync rows to the disk on another thread, never twice at once."""
        if self._syncing:
            return
        self._syncing = True

        def synced(_: object) -> None:
            self._syncing = False

        progress = RunProgress(
            left_s=None if self.for_s is None else max(self.for_s - self.seconds, 0.0),
            devices={name: device.counts for name, device in self.progress.items()},
        )
        self._hardware.in_thread(lambda: self._sink.sync(progress)).addBoth(synced)

    async def _stop(self, started: Sequence[Instrument]) -> list[Exception]:
        """Stop every device, even if others fail, and write their last rows; return the failures."""
        if self._next_block is not None and self._next_block.active():
            self._next_block.cancel()
        failed: list[Exception] = []
        for instrument in started:
            with _noted(failed):
                await instrument.stop()
            with _noted(failed):
                self._write(instrument)
            with _noted(failed):
                instrument.close()
            with _noted(failed):
                self._sink.describe(instrument.name, instrument.facts())
        return failed


def _together(failed: list[Exception]) -> Exception:
    """Return the first failure, with the others in its message; a StopError comes first, as motors may still run."""
    first, *later = sorted(failed, key=lambda error: not isinstance(error, StopError))
    others = "\n".join(dict.fromkeys(str(e) for e in later if isinstance(e, CfidError) and str(e) != str(first)))
    if not others:
        return first
    if isinstance(first, CfidError):
        return type(first)(f"{first}\n{others}")
    first.add_note(others)
    return first


@contextlib.contextmanager
def _noted(failed: list[Exception]) -> Iterator[None]:
    try:
        yield
    except Exception as error:
        failed.append(error)
