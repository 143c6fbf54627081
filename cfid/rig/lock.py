"""Locks devices: one process of this computer at a time holds a device, and any other learns which process that is.

A lock is a socket bound to the device's name in Linux's abstract namespace. The kernel lets one process bind a name,
whatever its user, and frees it when that process ends. No file is involved that a user could plant, link, fill or own.
"""

import hashlib
import os
import re
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Self
from urllib.parse import quote, unquote

from cfid.errors import DeviceError
from cfid.rig.address import resolved
from cfid.rig.holder import Holder, found_holder

# Tests, and separate rigs that share a computer, set this variable to have lock names of their own.
_SET_VARIABLE = "CFID_LOCKS"
_VEHICLES = ("radio://", "usb://", "udp://")
_LONGEST = 100  # of the 107 bytes that a name may have
_LISTENING = re.compile(r"[0-9a-f]+: [0-9A-F]+ [0-9A-F]+ 00010000 0001 01 +(?P<inode>\d+) @(?P<name>.+)")
_SOCKETS = Path("/proc/net/unix")


class DeviceLock:
    """A device held by this process until it is released, or the process ends in whatever way."""

    def __init__(self, bound: socket.socket | None) -> None:
        """Take over a bound socket; `take` makes one."""
        self._bound = bound

    @classmethod
    def take(cls, device: str) -> Self:
        """Hold a device, named by its address or port in any spelling.

        Raises DeviceError naming the holder.
        """
        if sys.platform != "linux":  # which alone has abstract names: elsewhere no process is kept out
            return cls(None)
        bound = socket.socket(socket.AF_UNIX)
        try:
            bound.bind(f"\0{_name(device)}")
            bound.listen()
        except OSError:
            bound.close()
            who = find_holder(device) or "another process"
            raise DeviceError(f"{device} is held by {who}. End that first.") from None
        return cls(bound)

    def release(self) -> None:
        """Release the device."""
        if self._bound is not None:
            self._bound.close()
            self._bound = None

    def __enter__(self) -> Self:
        """Return the lock itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the device on leaving the context."""
        self.release()


def find_holder(device: str) -> Holder | None:
    """Return the process that holds a device, which may be this one; None if none does."""
    name = _name(device)
    inodes = [inode for held, inode in _held() if held == name]
    return found_holder(name, inodes[0] if len(inodes) == 1 else 0)


def holder_of(device: str) -> str:
    """Return the other process that holds a device, as text; empty if none does."""
    holder = find_holder(device)
    return "" if holder is None or holder.process == os.getpid() else str(holder)


def vehicles_held() -> list[str]:
    """Return the addresses of the vehicles that other processes hold."""
    return [device for device in vehicles_locked() if holder_of(device)]


def vehicles_locked() -> list[str]:
    """Return the addresses of the vehicles that processes hold, this one too, as the kernel lists their locks.

    It may be called repeatedly: it connects to no holder, whose queue of connections would fill up.
    """
    start = _start()
    devices = [unquote(name.removeprefix(start)) for name, _ in _held() if name.startswith(start)]
    return [device for device in devices if device.startswith(_VEHICLES)]


def _held() -> Iterator[tuple[str, int]]:
    """Yield the names locked on this computer, each with the inode of its socket."""
    try:
        lines = _SOCKETS.read_text(errors="replace").split("\n")
    except OSError:
        return
    for line in lines:
        found = _LISTENING.match(line)
        if found:
            yield found["name"], int(found["inode"])


def _name(device: str) -> str:
    """Return the one name of a device in any spelling; printable, so that /proc shows it unchanged."""
    name = _start() + quote(resolved(device), safe="/:")
    if len(name) > _LONGEST:
        digest = hashlib.sha256(name.encode()).hexdigest()
        name = f"{name[: _LONGEST - len(digest)]}{digest}"
    return name


def _start() -> str:
    """Return the common beginning of the names of all locks."""
    own_set = os.environ.get(_SET_VARIABLE, "")
    return f"cfid/{hashlib.sha256(own_set.encode()).hexdigest()[:12]}/" if own_set else "cfid/"
