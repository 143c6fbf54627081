"""Who holds a device: one process at a time, and the next is told which."""

import contextlib
import fcntl
import os
import re
import time
from pathlib import Path
from typing import Self

from cfid.errors import DeviceError

# The same for all users, whatever temporary folder each has: a lock in a folder of one's own holds nobody off.
# The variable is for tests, and for computers where this folder is not shared.
_FOLDER = "/tmp/cfid-locks"
_FOLDER_VARIABLE = "CFID_LOCKS"

_VEHICLES = ("radio___", "usb___", "udp___")  # how the locks of their addresses begin
_LOOK_S = 0.05  # far longer than it takes to look who holds a device, which locks it too
_AGAIN_S = 0.005


class DeviceLock:
    """A device held by this process until it is released, or the process ends in whatever way."""

    def __init__(self, handle: int) -> None:
        """Take over a locked file; `take` makes one."""
        self._handle: int | None = handle

    @classmethod
    def take(cls, device: str, *, holder: str) -> Self:
        """Hold a device, named by where it is; `holder` says to others what for.

        Raises DeviceError that says who holds it.
        """
        handle = _open(device)
        if not _locked(handle):
            said = _said(handle)
            os.close(handle)
            raise DeviceError(f"{device} is held by {said}. End that first.")
        os.truncate(handle, 0)
        os.pwrite(handle, f"process {os.getpid()} ({holder})".encode(), 0)
        return cls(handle)

    def release(self) -> None:
        """Let others have it."""
        if self._handle is not None:
            handle, self._handle = self._handle, None
            os.truncate(handle, 0)
            os.close(handle)

    def __enter__(self) -> Self:
        """Return the lock itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release it."""
        self.release()


def holder_of(device: str) -> str:
    """Return who else holds a device, empty if nobody does. Raises DeviceError when that cannot be found out."""
    handle = _open(device)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        said = _said(handle)
        return "" if said.startswith(f"process {os.getpid()} ") else said
    finally:
        os.close(handle)
    return ""


def holder_process(device: str) -> int | None:
    """Return the id of the other process that holds a device, None if nobody else does.

    Raises DeviceError when that cannot be found out.
    """
    match = re.match(r"process (\d+) ", holder_of(device))
    return int(match[1]) if match else None


def vehicles_held() -> list[str]:
    """Return names of the vehicles that other processes hold, however they were found."""
    folder = Path(os.environ.get(_FOLDER_VARIABLE) or _FOLDER)
    names = [path.name for path in folder.glob("*") if path.name.startswith(_VEHICLES)]
    return [name for name in names if holder_process(name) is not None]


def _locked(handle: int) -> bool:
    """Lock a file for this process alone; somebody who only looks who holds it is waited for."""
    end_s = time.monotonic() + _LOOK_S
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except OSError:
            if time.monotonic() > end_s:
                return False
        time.sleep(_AGAIN_S)


def _open(device: str) -> int:
    """Open the device's lock file, which every user of this computer shares and nobody deletes."""
    folder = Path(os.environ.get(_FOLDER_VARIABLE) or _FOLDER)
    name = "".join(letter if letter.isalnum() or letter in ".-" else "_" for letter in device)
    try:
        with contextlib.suppress(FileExistsError):
            folder.mkdir()
            folder.chmod(0o1777)
        return _opened(folder / name)
    except OSError as error:
        raise DeviceError(f"{folder / name}: the device's lock cannot be opened: {error.strerror}.") from None


def _opened(path: Path) -> int:
    flags = os.O_RDWR | os.O_NOFOLLOW
    try:
        return os.open(path, flags)  # Linux refuses to create what is there in a shared folder and another user's
    except FileNotFoundError:
        handle = os.open(path, flags | os.O_CREAT, 0o666)
    with contextlib.suppress(OSError):  # another user made it just now
        os.fchmod(handle, 0o666)
    return handle


def _said(handle: int) -> str:
    return os.pread(handle, 200, 0).decode("utf-8", "replace") or "another process"
