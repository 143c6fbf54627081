"""Records several instruments into one run: rows every 50 ms, synced to the disk every second; knows no device."""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from twisted.internet.base import DelayedCall
from twisted.internet.defer import Deferred
from twisted.internet.task import deferLater
from twisted.internet.threads import deferToThreadPool
from twisted.python.failure import Failure

from cfid.errors import CfidError, DeviceError, StopError
from cfid.records.progress import RunProgress
from cfid.rig.clock import suspended_s
from cfid.rig.progress import Progress

BLOCK_S = 0.05
SYNC_S = 1.0
_LONGEST_SLEEP_S = 0.5

Say = Callable[[str], None]


class Block(NamedTuple):
    """An instrument's data since the last block: columns (n,), samples lost, and a fault that ends the run.

    `lost` is None from when on it is unknown how many are, as where a device states neither a rate nor a clock.
    `status` is what the live line shows in place of values.
    """

    columns: Sequence[npt.NDArray[Any]]
    lost: int | None = 0
    fault: str = ""
    status: str = ""


class Instrument(Protocol):
    """A device that samples on its own and keeps its rows until they are taken."""

    name: str

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of its file: `t` in Unix seconds, then raw values."""

    def start(self) -> None:
        """Begin to sample."""

    def take(self) -> Block:
        """Return the new rows. Raises DeviceError when no more data arrive."""

    async def stop(self) -> None:
        """End the sampling and make sure that it ended; rows until then can still be taken."""

    def close(self) -> None:
        """Release ports and locks. May be called in any state, and twice."""

    def facts(self) -> Mapping[str, Any]:
        """Return what goes into run.toml at the end."""


class Sink(Protocol):
    """Takes rows, as a run's writer does."""

    def append(self, device: str, columns: Sequence[Any]) -> None:
        """Write one block. Raises DataError when it does not fit."""

    def count_lost(self, device: str, samples: int | None) -> None:
        """Count samples that are missing; None for an unknown number, after which the count stays unknown."""

    def describe(self, device: str, facts: Mapping[str, Any]) -> None:
        """Add facts about a device."""

    def sync(self, progress: RunProgress) -> None:
        """Sync the rows to the disk, and publish the progress."""


class Recorder:
    """Records instruments into a sink, None for motors driven by hand. `loop` is Twisted's, or its Clock in a test."""

    def __init__(
        self, instruments: Sequence[Instrument], run: Sink | None, *, loop: Any, show: Callable[[], None]
    ) -> None:
        """Take the instruments and the sink; `show` is called after every block."""
        self.progress = {instrument.name: Progress() for instrument in instruments}
        self.began_s = loop.seconds()
        self.for_s: float | None = None  # how long the recording is to last, where that is known
        self.tare_s = 0.0  # how long everything is at rest at first
        self._instruments = instruments
        self._run = run
        self._loop = loop
        self._show = show
        self._next_block: DelayedCall | None = None
        self._syncing = False
        self._suspended_s = 0.0
        self._done: Deferred[None] = Deferred()

    @property
    def seconds(self) -> float:
        """How long the recording has lasted so far."""
        return float(self._loop.seconds() - self.began_s)

    async def record(self, begin: Callable[[], Deferred[None]]) -> None:
        """Record until the Deferred of `begin` fires or something fails; then stop every device, in order.

        What a device sent before it stopped is written in every case. Raises the first failure with the others in its
        message: DeviceError or DataError, unless the program itself is faulty.
        """
        self.began_s = self._loop.seconds()
        self._suspended_s = suspended_s()
        failed: list[Exception] = []
        begun: Deferred[None] | None = None
        try:
            for instrument in self._instruments:
                instrument.start()
            self._write_blocks(0)
            if not self._done.called:  # a device that is at fault at once ends the recording before anything turns
                begun = begin()
                begun.addCallbacks(self._finish, self._failed)
            await self._done
        except Exception as error:
            failed.append(error)
        if begun is not None:
            begun.cancel()
        failed += await self._stop()
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
            self._check_awake()
            for instrument in self._instruments:
                self._write(instrument)
            self._show()
        except Exception as error:
            self._fail(error)
            return
        if count and count % round(SYNC_S / BLOCK_S) == 0:
            self._sync()
        now_s = self._loop.seconds() - self.began_s
        later = max(count + 1, int(now_s / BLOCK_S) + 1)
        self._next_block = self._loop.callLater(max(later * BLOCK_S - now_s, 0), self._write_blocks, later)

    def _check_awake(self) -> None:
        """Raise DeviceError after a suspend, which times of samples leave out while motion goes on."""
        slept_s = suspended_s() - self._suspended_s
        if slept_s > _LONGEST_SLEEP_S:
            raise DeviceError(
                f"the computer was suspended for {slept_s:.1f} s during the recording, and no sample was taken then: "
                "the rows until then are kept. Keep the computer awake while it records."
            )

    def _write(self, instrument: Instrument) -> None:
        block = instrument.take()
        if block.lost != 0 and self._run is not None:
            self._run.count_lost(instrument.name, block.lost)
        if len(block.columns[0]) and self._run is not None:
            self._run.append(instrument.name, block.columns)
        at_rest = self.seconds < self.tare_s
        self.progress[instrument.name].add(block, self._loop.seconds(), at_rest=at_rest)
        if block.fault:
            raise DeviceError(block.fault)

    def _sync(self) -> None:
        """Sync rows to the disk on another thread, never twice at once."""
        if self._run is None or self._syncing or not hasattr(self._loop, "getThreadPool"):
            return
        self._syncing = True

        def synced(_: object) -> None:
            self._syncing = False

        progress = RunProgress(
            left_s=None if self.for_s is None else max(self.for_s - self.seconds, 0.0),
            devices={name: progress.counts for name, progress in self.progress.items()},
        )
        deferToThreadPool(self._loop, self._loop.getThreadPool(), self._run.sync, progress).addBoth(synced)

    async def _stop(self) -> list[Exception]:
        """Stop every device, even if others fail, and write their last rows; return the failures."""
        if self._next_block is not None and self._next_block.active():
            self._next_block.cancel()
        failed: list[Exception] = []
        for instrument in self._instruments:
            with _noted(failed):
                await instrument.stop()
            with _noted(failed):
                self._write(instrument)
            with _noted(failed):
                instrument.close()
            with _noted(failed):
                if self._run is not None:
                    self._run.describe(instrument.name, instrument.facts())
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


def sleep(loop: Any, seconds: float) -> Deferred[None]:
    """Return a Deferred that fires after `seconds` of the loop's time."""
    return deferLater(loop, seconds, lambda: None)


def no_rows(columns: int) -> tuple[npt.NDArray[np.float64], ...]:
    """Return the columns of a block without rows."""
    return tuple(np.empty(0) for _ in range(columns))
