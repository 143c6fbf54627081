"""Locks devices: one process of this computer at a time holds a device, and any other learns which process that is.

A lock is a socket bound to the device's name in Linux's abstract namespace. The kernel lets one process bind a name,
whatever its user, and frees it when that process ends. No file is involved that a user could plant, link, fill or own.
A holder is found in the kernel's records, and signals go to that process and no other.
"""

import hashlib
import os
import pwd
import re
import signal
import socket
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Self
from urllib.parse import quote, unquote, urlsplit

from cfid.errors import DeviceError

# Tests, and separate rigs that share a computer, set this variable to have lock names of their own.
_SET_VARIABLE = "CFID_LOCKS"
_VEHICLES = ("radio://", "usb://", "udp://")
_LONGEST = 100  # of the 107 bytes that a name may have
_LISTENING = re.compile(r"[0-9a-f]+: [0-9A-F]+ [0-9A-F]+ 00010000 0001 01 +(?P<inode>\d+) @(?P<name>.+)")
_SOCKETS = Path("/proc/net/unix")

# What requests a holder's end. The page's button first sends a signal of its own, so that the run names it, then the
# usual one, for a holder that was started with the first one ignored; of several requests the first counts.
END_SIGNALS = (signal.SIGTERM,)
BUTTON_SIGNALS = (signal.SIGUSR1, signal.SIGTERM)

_PROCESSES = Path("/proc")
_CREDENTIALS = struct.Struct("3i")  # process, user and group of a peer
_START_FIELD = 19  # of /proc/PID/stat, counted from the state after the name
_SHOWN_CHARACTERS = 40

_DEFAULT_CHANNEL, _DEFAULT_RATE, _DEFAULT_ADDRESS = "2", "2M", "E7E7E7E7E7"
_RATES = ("250K", "1M", "2M")


@dataclass(frozen=True)
class Holder:
    """A process that holds a lock's socket; `process` is 0 where the kernel does not show it to this user.

    `is_ours` means that it may be signalled: a cfid of this user that has the socket open, as the kernel reports.
    """

    process: int
    user: int
    inode: int
    started: int = 0  # in the kernel's ticks since it was booted
    program: str = ""
    is_ours: bool = False

    def __str__(self) -> str:
        """Return the process's number, its program and, where it is another user's, its owner."""
        if not self.process:
            return "another user's process"
        whose = "" if self.user == os.geteuid() else f" of {_user_name(self.user)}"
        return f"process {self.process}{f' ({self.program})' if self.program else ''}{whose}"

    @property
    def is_suspended(self) -> bool:
        """Whether the process was stopped, by SIGSTOP or Ctrl-Z, and cannot react."""
        return (_stat(self.process) or ["X"])[0] in ("T", "t")

    @property
    def holds(self) -> bool:
        """Whether this very process still has the lock's socket open."""
        stat = _stat(self.process)
        return bool(stat and int(stat[_START_FIELD]) == self.started and _has_open(self.process, self.inode))

    def send(self, *numbers: signal.Signals) -> bool:
        """Send signals to the process if it is ours and still holds the lock, never to one that reuses its number.

        Return whether they were sent. The check follows the opening of the handle, so that it concerns the process
        behind the handle; if that process is dead, the signal reaches none.
        """
        if not self.is_ours:
            return False
        try:
            handle = os.pidfd_open(self.process)
        except OSError:  # it is gone, or this kernel is older than 5.3
            return False
        try:
            if not self.holds:
                return False
            for number in numbers:
                signal.pidfd_send_signal(handle, number)
        except OSError:
            return False
        finally:
            os.close(handle)
        return True

    def wait_for_release(self, within_s: float) -> bool:
        """Wait until the process has released the lock; return False when it still holds the lock after `within_s`."""
        end_s = time.monotonic() + within_s
        while self.holds:
            if time.monotonic() > end_s:
                return False
            time.sleep(0.01)
        return True


def _holder_of_name(name: str, inode: int) -> Holder | None:
    """Return the process that holds the abstract socket of this name; None if none does.

    `inode` is the socket's number in /proc/net/unix, 0 where that is uncertain: the names of other sockets may contain
    lines that look like its own. A connection identifies the listening process, whose open files show that it still
    listens.
    """
    if inode and _has_open(os.getpid(), inode):
        return _described(os.getpid(), inode)
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(f"\0{name}")
        except BlockingIOError:  # it is held, and its queue of connections is full
            return Holder(0, -1, inode)
        except OSError:
            return None
        process, user, _ = _CREDENTIALS.unpack(
            probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        )
    if user == os.geteuid() and _has_open(process, inode):
        return _described(process, inode)
    return Holder(process, user, inode, program=_program(process))


def _described(process: int, inode: int) -> Holder:
    stat, program = _stat(process), _program(process)
    python = Path(_read_link(f"/proc/{process}/exe")).name.startswith(("python", "pypy"))
    return Holder(
        process,
        os.geteuid(),
        inode,
        started=int(stat[_START_FIELD]) if stat else 0,
        program=program,
        is_ours=python and "cfid" in _command_line(process),
    )


def _has_open(process: int, inode: int) -> bool:
    """Return whether a process has the socket with this inode open, as far as this user may see; none has inode 0."""
    if not inode:
        return False
    target = f"socket:[{inode}]"
    try:
        with os.scandir(f"/proc/{process}/fd") as handles:
            return any(_read_link(handle.path) == target for handle in handles)
    except OSError:  # it ended just now
        return False


def _stat(process: int) -> list[str] | None:
    """Return the fields of /proc/PID/stat after the name, from the state on; None without such a process."""
    try:
        return (_PROCESSES / str(process) / "stat").read_text(errors="replace").rpartition(")")[2].split()
    except OSError:
        return None


def _command_line(process: int) -> str:
    try:
        return (_PROCESSES / str(process) / "cmdline").read_bytes()[:4096].decode(errors="replace")
    except OSError:
        return ""


def _program(process: int) -> str:
    """Return the command line as it would be typed, for display: only printable characters, and shortened."""
    arguments = _command_line(process).rstrip("\0").split("\0")
    place = next((i for i, word in enumerate(arguments) if _is_entry(word)), None)
    typed = ["cfid", *arguments[place + 1 :]] if place is not None else [Path(arguments[0]).name]
    shown = "".join(letter if letter.isprintable() else " " for letter in " ".join(typed))
    return shown if len(shown) <= _SHOWN_CHARACTERS else f"{shown[:_SHOWN_CHARACTERS]}..."


def _is_entry(word: str) -> bool:
    return word == "cfid.cli.main" or Path(word).name == "cfid" or word.endswith("cfid/cli/main.py")


def _read_link(path: str) -> str:
    try:
        return str(Path(path).readlink())
    except OSError:
        return ""


def _user_name(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return f"user {user}"


class DeviceLock:
    """A device held by this process until it is released, or the process ends in whatever way."""

    def __init__(self, device: str) -> None:
        """Hold a device, named by its address or port in any spelling. Raises DeviceError naming the holder."""
        self._socket, self._device = _bound(device), resolved(device)

    def move(self, device: str) -> None:
        """Hold another device instead, as where a plug comes back as another port. Raises DeviceError as the first."""
        if resolved(device) != self._device:
            bound = _bound(device)
            self.release()
            self._socket, self._device = bound, resolved(device)

    def release(self) -> None:
        """Release the device."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def __enter__(self) -> Self:
        """Return the lock itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the device on leaving the context."""
        self.release()


def _bound(device: str) -> socket.socket | None:
    """Return a socket bound to a device's name; None where no process is kept out. Raises DeviceError."""
    if sys.platform != "linux":  # which alone has abstract names
        return None
    bound = socket.socket(socket.AF_UNIX)
    try:
        bound.bind(f"\0{_name(device)}")
        bound.listen()
    except OSError:
        bound.close()
        holder = find_holder(device) or "another process"
        raise DeviceError(f"{device} is held by {holder}. End that first.") from None
    return bound


def find_holder(device: str) -> Holder | None:
    """Return the process that holds a device, which may be this one; None if none does."""
    name = _name(device)
    inodes = [inode for held, inode in _held() if held == name]
    return _holder_of_name(name, inodes[0] if len(inodes) == 1 else 0)


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


def resolved(device: str) -> str:
    """Return the address of a vehicle or the path of a port as the kernel or cflib resolves it.

    Anything else, and an address that cannot be resolved, is returned unchanged.
    """
    scheme, separator, rest = device.partition("://")
    try:
        if separator and scheme == "udp":
            return _udp(device)
        if separator and scheme == "radio":
            return _radio(device)
        if separator and scheme == "usb":
            return f"usb://{int(rest)}"
    except (OSError, ValueError):
        return device
    return os.path.realpath(device) if device.startswith("/") else device


def _udp(device: str) -> str:
    """Return the address that the kernel would connect to: `localhost`, `127.1` and `0.0.0.0` are all 127.0.0.1."""
    where = urlsplit(device)
    with socket.socket(type=socket.SOCK_DGRAM) as probe:
        probe.connect((where.hostname or "", where.port or 0))
        host, port = probe.getpeername()
    return f"udp://{host}:{port}"


def _radio(device: str) -> str:
    """Fill in cflib's defaults, channel 2, 2 Mbit/s, address E7E7E7E7E7, and drop the query, which locates nothing."""
    where = urlsplit(device)
    channel, rate, address, *_ = [*where.path.strip("/").split("/"), "", "", ""]
    dongle = str(int(where.netloc)) if where.netloc.isdigit() else where.netloc.upper()
    return (
        f"radio://{dongle}/{int(channel or _DEFAULT_CHANNEL)}/{rate if rate in _RATES else _DEFAULT_RATE}/"
        f"{(address or _DEFAULT_ADDRESS).upper():0>10}"
    )
