"""Finds the process that holds a lock, from the kernel's records, and signals that process and no other."""

import contextlib
import os
import pwd
import signal
import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_PROCESSES = Path("/proc")
_CREDENTIALS = struct.Struct("3i")  # process, user and group of a peer
_START_FIELD = 19  # of /proc/PID/stat, counted from the state after the name
_SHOWN_CHARACTERS = 40
_POLL_S = 0.01


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

    def wait_until_it_lets_go(self, within_s: float) -> bool:
        """Wait until the process has released the lock; return False when it still holds the lock after `within_s`."""
        end_s = time.monotonic() + within_s
        while self.holds:
            if time.monotonic() > end_s:
                return False
            time.sleep(_POLL_S)
        return True


def found_holder(name: str, inode: int) -> Holder | None:
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
            process = next((found for found in _own_processes() if _has_open(found, inode)), 0)
            return _described(process, inode) if process else Holder(0, -1, inode)
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


def _own_processes() -> Iterator[int]:
    """Yield the processes of this user."""
    for folder in _PROCESSES.iterdir():
        if folder.name.isdigit():
            with contextlib.suppress(OSError):
                if folder.stat().st_uid == os.geteuid():
                    yield int(folder.name)


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
