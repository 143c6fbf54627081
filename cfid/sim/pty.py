"""Serves a simulated encoder interface on a pseudo-terminal, which a host opens like any serial port."""

import contextlib
import os
import tty
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twisted.internet.abstract import FileDescriptor
from twisted.internet.base import DelayedCall
from twisted.internet.posixbase import PosixReactorBase

from cfid.sim.e201 import Reply
from cfid.sim.faults import FaultySerial

_CONTINUOUS_EVERY_S = 1e-3
_LONGEST_READ = 4096
_ROUNDING_S = 1e-6


class DevicePort(ABC):
    """A device behind a serial port on any clock: its replies, its continuous output, its pulled plug.

    Each reply is sent after its delay, and after all earlier replies, since a serial line keeps its order.
    """

    def __init__(self, device: FaultySerial, *, clock: Any) -> None:
        """Open nothing yet; `clock` is the reactor, or a virtual clock."""
        self._device, self._clock = device, clock
        self._replies: deque[tuple[float, bytes]] = deque()
        self._timers: list[DelayedCall] = []

    def begin(self) -> None:
        """Plug the device in; from now on it sends by itself, and its plug may be pulled."""
        self.plug()
        if self._device.continuous:
            self._after(_CONTINUOUS_EVERY_S, self._continue)
        faults = self._device.faults
        if faults.unplug_after_s is not None:
            self._after(faults.unplug_after_s, self._pull)
            self._after(faults.unplug_after_s + faults.unplug_for_s, self.plug)

    def close(self) -> None:
        """Unplug the device for good."""
        for timer in self._timers:
            if timer.active():
                timer.cancel()
        self._timers = []
        self._pull()

    def received(self, data: bytes) -> None:
        """Take the bytes that the host wrote."""
        was_continuous = self._device.continuous
        self._send(self._device.received(data, self._clock.seconds()))
        if self._device.continuous and not was_continuous:
            self._after(_CONTINUOUS_EVERY_S, self._continue)

    @abstractmethod
    def plug(self) -> None:
        """Connect the device to the host."""

    @abstractmethod
    def unplug(self) -> None:
        """Disconnect it: a host that has it open sees a hang-up."""

    @abstractmethod
    def write(self, reply: bytes) -> None:
        """Send a reply to the host, if it is connected."""

    def _pull(self) -> None:
        self._replies.clear()
        self.unplug()

    def _send(self, replies: list[Reply]) -> None:
        """Take replies with their delays from now."""
        now_s = self._clock.seconds()
        for delay_s, reply in replies:
            due_s = max(now_s + delay_s, self._replies[-1][0] if self._replies else 0.0)
            self._replies.append((due_s, reply))
            if due_s > now_s:
                self._clock.callLater(due_s - now_s, self._send_due)
        self._send_due()

    def _send_due(self) -> None:
        while self._replies and self._replies[0][0] <= self._clock.seconds() + _ROUNDING_S:
            self.write(self._replies.popleft()[1])

    def _continue(self) -> None:
        if self._device.continuous:
            self._send(self._device.due(self._clock.seconds()))
            self._after(_CONTINUOUS_EVERY_S, self._continue)

    def _after(self, delay_s: float, act: Callable[[], None]) -> None:
        self._timers = [timer for timer in self._timers if timer.active()]
        self._timers.append(self._clock.callLater(delay_s, act))


class PtyPort(DevicePort):
    """A device on a terminal behind the symlink `name` in a folder, so that its path survives a pulled plug."""

    def __init__(self, device: FaultySerial, *, reactor: PosixReactorBase, folder: Path, name: str = "encoder") -> None:
        """Open nothing yet."""
        super().__init__(device, clock=reactor)
        self._reactor = reactor
        self._path = folder / name
        self._end: _DeviceEnd | None = None

    def open(self) -> Path:
        """Plug the device in; return its path, which stays the same after it was unplugged."""
        self.begin()
        return self._path

    def plug(self) -> None:
        """Open a terminal, and lead the path to it."""
        self._end = _DeviceEnd(self, self._reactor)
        self._end.startReading()
        self._path.unlink(missing_ok=True)
        self._path.symlink_to(self._end.host_path)

    def unplug(self) -> None:
        """Close the terminal."""
        self._path.unlink(missing_ok=True)
        if self._end is not None:
            self._end.stopReading()
            self._end.close()
            self._end = None

    def write(self, reply: bytes) -> None:
        """Send a reply to the host."""
        if self._end is not None:
            self._end.send(reply)


class _DeviceEnd(FileDescriptor):
    """The device's end of a raw terminal; it keeps the host's end open between two hosts."""

    def __init__(self, port: PtyPort, reactor: PosixReactorBase) -> None:
        super().__init__(reactor)  # type: ignore[arg-type]  # twisted does not declare that it is one
        self._port = port
        self._file, self._host_file = os.openpty()
        tty.setraw(self._host_file)
        os.set_blocking(self._file, False)
        self.host_path = os.ttyname(self._host_file)

    def fileno(self) -> int:
        return self._file

    def doRead(self) -> None:  # noqa: N802 (twisted's name)
        with contextlib.suppress(BlockingIOError):
            self._port.received(os.read(self._file, _LONGEST_READ))

    def send(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):  # a host that does not read loses bytes that do not fit
            os.write(self._file, data)

    def close(self) -> None:
        os.close(self._file)
        os.close(self._host_file)
