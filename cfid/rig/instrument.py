"""What every instrument of a recording is: it samples on its own, and its rows are taken in blocks."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from twisted.internet.defer import CancelledError, Deferred

from cfid.errors import DeviceError
from cfid.records.run import DeviceRecord
from cfid.rig.hardware import Hardware, SerialPort
from cfid.rig.progress import Reading

Say = Callable[[str], None]

_PERIODS = 4  # without data, which are no gap at any rate


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
    """A device that samples on its own and keeps its rows until they are taken; it serves one recording at a time.

    `record` is its description in run.toml. One that is `eventful` may have no rows; any other without rows is a fault.
    `reading` is what the live line shows of it. It is `whole` once it has recorded all that a procedure requested, so
    that the run may end.
    """

    name: str
    record: DeviceRecord
    eventful = False
    reading: Reading | None = None
    whole = False
    _hardware: Hardware

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

    def block(
        self, rows: Sequence[tuple[Any, ...]] = (), lost: int | None = 0, *, fault: str = "", status: str = ""
    ) -> Block:
        """Return rows, each of which begins with its time on the monotonic clock, as a block."""
        if not rows:
            return Block(tuple(np.empty(0) for _ in self.record.columns), lost, fault, status)
        times_s, *values = (np.array(column) for column in zip(*rows, strict=True))
        return Block((self._hardware.unix_times_s(times_s), *values), lost, fault, status)


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
        was_gap = first_s - self.received_s > max(0.25, _PERIODS * self._period_s)
        if was_gap and reason:
            begin_s, end_s = self._hardware.unix_times_s(np.array([self.received_s, first_s])).tolist()
            stood_s = now_s - self.received_s - self.seconds
            stood = {"stood_s": round(stood_s, 3)} if stood_s > 0 else {}
            self.gaps.append({"from_s": begin_s, "to_s": end_s, "reason": reason, **stood})
        self.received_s, self._awake_s = now_s, self._hardware.awake_s()
        return was_gap


class PortInstrument(Instrument):
    """An instrument on a port of its own. A `patient` one whose plug was pulled is looked for until it is back."""

    def __init__(self, where: str, *, say: Say = lambda _: None, patient: bool) -> None:
        """Take the port's path; nothing is opened yet."""
        self._where, self._say, self._patient = where, say, patient
        self._port: SerialPort | None = None

    def _begin(self, hardware: Hardware, *, period_s: float) -> None:
        """Open the port for a recording, and listen to a device that sends at this period. Raises DeviceError."""
        self._hardware = hardware
        self._silence = Silence(hardware, period_s=period_s)
        self._gone_s: float | None = None
        self._refused = ""  # why the port was not opened again when it was last tried
        self._away_s = 0.0  # without data before the port was opened again, since the last data
        self._searching: Deferred[None] | None = None
        self._stopped = False
        self._port = self._open()

    @abstractmethod
    def _open(self) -> SerialPort:
        """Open the port. Raises DeviceError."""

    @abstractmethod
    def received(self, data: bytes) -> None:
        """Take the bytes that the port received."""

    async def _reopen(self) -> SerialPort:
        """Open the port again, perhaps another one, after its lock has moved there. Raises DeviceError."""
        return self._open()

    def _go_on(self) -> None:
        """Continue on the port that is back."""

    def disconnected(self) -> None:
        """Note that the plug was pulled, and look for the device until it is back."""
        self._port = None
        if self._stopped or self._gone_s is not None:
            return
        self._gone_s = self._hardware.seconds()
        if self._patient:
            self._say(f"{self._where}: unplugged; waiting for {self._shown} to come back")
            self._searching = Deferred.fromCoroutine(self._search())
            self._searching.addErrback(lambda failure: failure.trap(CancelledError))

    @property
    def _shown(self) -> str:
        return f"the {self.name}"

    async def _search(self) -> None:
        while self._gone_s is not None:
            await self._hardware.sleep(0.5)
            try:
                self._port = await self._reopen()
            except DeviceError as error:
                self._refused = str(error)
                continue
            gone_s, self._gone_s = self._hardware.seconds() - self._gone_s, None
            self._away_s += self._silence.seconds
            self._say(f"{self._where}: the {self.name} is back after {gone_s:.1f} s")
            self._silence.end("unplugged" if self.begun else "")
            self._go_on()

    async def stop(self) -> None:
        """Expect nothing more of the device."""
        self._stopped = True
        if self._searching is not None:
            self._searching.cancel()

    def _end_silence(self) -> bool:
        """Note a silence at the end, and return whether there is one; nothing is missed before the first data."""
        return self.begun and self._silence.end("silent at the end" if self._gone_s is None else "unplugged")

    def _refuse_gone(self) -> None:
        """Raise DeviceError where the device is gone at the end."""
        if self._gone_s is not None and self._patient:
            raise DeviceError(
                f"{self._where}: unplugged {self._hardware.seconds() - self._gone_s:.0f} s before the end, and not "
                f"back. {self._refused}".rstrip()
            )

    def close(self) -> None:
        """Close the port."""
        self._stopped = True
        if self._port is not None:
            port, self._port = self._port, None
            port.close()
