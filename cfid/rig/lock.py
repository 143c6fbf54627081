"""Who holds a device: one process at a time, and the next is told which."""

import contextlib
import os
import sys
import tempfile
from pathlib import Path
from typing import Self

from cfid.errors import DeviceError


class DeviceLock:
    """A device held by this process until it is released, or the process ends in whatever way.

    Where the system has no such lock (Windows) nothing is held.
    """

    def __init__(self, handle: int | None) -> None:
        """Take over a locked file; `take` makes one."""
        self._handle = handle

    @classmethod
    def take(cls, device: str, *, holder: str) -> Self:
        """Hold a device, named by where it is; `holder` says to others what for.

        Raises DeviceError that says who holds it.
        """
        if sys.platform == "win32":
            return cls(None)
        import fcntl

        handle = _open(device)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            said = _said(handle)
            os.close(handle)
            raise DeviceError(f"{device} is held by {said}. End that first.") from None
        os.truncate(handle, 0)
        os.pwrite(handle, f"process {os.getpid()} ({holder})".encode(), 0)
        return cls(handle)

    def release(self) -> None:
        """Let others have it."""
        if self._handle is not None:
            handle, self._handle = self._handle, None
            os.close(handle)

    def __enter__(self) -> Self:
        """Return the lock itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release it."""
        self.release()


def holder_of(device: str) -> str:
    """Return who else holds a device, empty if nobody does."""
    if sys.platform == "win32":
        return ""
    import fcntl

    handle = _open(device)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        said = _said(handle)
        return "" if said.startswith(f"process {os.getpid()} ") else said
    finally:
        os.close(handle)
    return ""


def _open(device: str) -> int:
    """Open the device's lock file, which every user of this computer shares and nobody deletes."""
    folder = Path(tempfile.gettempdir()) / "cfid-locks"
    name = "".join(letter if letter.isalnum() or letter in ".-" else "_" for letter in device)
    try:
        with contextlib.suppress(FileExistsError):
            folder.mkdir()
            folder.chmod(0o1777)
        handle = _opened(folder / name)
    except OSError as error:
        raise DeviceError(f"{folder / name}: the device's lock cannot be opened: {error.strerror}.") from None
    return handle


def _opened(path: Path) -> int:
    flags = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0)
    try:
        return os.open(path, flags)  # Linux refuses to create what is there in a shared folder and another user's
    except FileNotFoundError:
        handle = os.open(path, flags | os.O_CREAT, 0o666)
    with contextlib.suppress(OSError):  # another user made it just now
        os.fchmod(handle, 0o666)
    return handle


def _said(handle: int) -> str:
    return os.pread(handle, 200, 0).decode("utf-8", "replace") or "another process"
