"""Files that are there whole or not at all, and TOML files read with a sentence for every fault."""

import contextlib
import os
import stat
import sys
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.errors import CfidError

if TYPE_CHECKING:
    from pydantic import ValidationError


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that a crash leaves the old content or the new one, never a part.

    The temporary file lies beside it, since a rename is atomic only within one file system. A file that is there
    keeps its permissions, and a link to it stays one. Raises OSError.
    """
    path = path.resolve()
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            with contextlib.suppress(FileNotFoundError):
                temporary.chmod(stat.S_IMODE(path.stat().st_mode))
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_toml(path: Path, content: Mapping[str, Any]) -> None:
    """Write a TOML file whole. Raises OSError."""
    write_whole(path, toml_bytes(content))


def toml_bytes(content: Mapping[str, Any]) -> bytes:
    """Return a TOML file's bytes.

    A file name that is no UTF-8 keeps a question mark for each odd byte, so that the file stays readable.
    """
    import tomli_w

    return tomli_w.dumps(content).encode("utf-8", "replace")


@contextlib.contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold off other processes that ask for the same, while a file is read, changed and written back.

    Where the system has no such lock (Windows, some network drives) nothing is held off. Raises OSError when
    there is no such folder.
    """
    if sys.platform == "win32":
        yield
        return
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def read_toml(path: Path, error: type[CfidError]) -> dict[str, Any]:
    """Read a TOML file, as editors on any system leave it.

    Raises FileNotFoundError, which means different things to different readers, and for anything else `error`.
    """
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except FileNotFoundError:
        raise
    except OSError as fault:
        raise error(f"{path}: cannot be read: {fault.strerror}.") from None
    except UnicodeDecodeError as fault:
        raise error(f"{path}: byte {fault.start + 1} is no UTF-8 text: save it as UTF-8.") from None
    except RecursionError:
        raise error(f"{path}: no valid TOML: nested too deeply.") from None
    except ValueError as fault:  # TOMLDecodeError, and numbers that are too long for Python
        raise error(f"{path}: no valid TOML: {fault}. Repair it there.") from None


def first_fault(error: "ValidationError", content: Mapping[str, Any]) -> str:
    """Say which key of a TOML file's content a model found wrong first, and what is wrong with it."""
    # A misspelt key is unknown, and the one that was meant is missing: the first of the two says more.
    faults = sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
    first = faults[0]
    key = _key(first["loc"], content)
    if first["type"] == "extra_forbidden":
        return f"{key}: there is no such key. Is it misspelt, or in the wrong table?"
    if first["type"] == "missing":
        return f"{key}: is missing."
    # A value that may be of several kinds has a fault for each.
    reasons = [_reason(fault["type"], fault["msg"]) for fault in faults if _key(fault["loc"], content) == key]
    verb = "should be " if first["msg"].startswith("Input should be ") else ""
    shown = "" if isinstance(first["input"], Mapping | list) else f", not {_short(repr(first['input']))}"
    return f"{key}: {verb}{' or '.join(reasons)}{shown}."


def _key(place: tuple[int | str, ...], content: Mapping[str, Any]) -> str:
    """Return the key as it stands in the file: without pydantic's names for the kinds that a value may have."""
    known: list[str] = []
    here: Any = content
    for part in place:
        if not isinstance(here, Mapping | list):
            break
        known.append(str(part))
        there = dict(here) if isinstance(here, Mapping) else dict(enumerate(here))
        here = there.get(part)
    return ".".join(known) or "(top)"


def _reason(kind: str, message: str) -> str:
    if kind in ("dict_type", "model_type", "dataclass_type"):
        return "a table"
    return message.removeprefix("Value error, ").removeprefix("Input should be ").replace("tuple", "list")


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:40]}..."
