"""The files of a campaign: names, atomic writes, locks, and TOML with a sentence for every fault."""

import contextlib
import errno
import hashlib
import os
import re
import secrets
import stat
import tomllib
from collections.abc import Callable, Iterator, Mapping
from io import FileIO
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from cfid.errors import CfidError, ConfigError, DataError

RIG_FILE, PARAMETERS_FILE = "rig.toml", "parameters.toml"
RUNS_FOLDER, RUN_FILE = "runs", "run.toml"
FITS_FOLDER = "fits"

_BEGINNING = 50  # characters of a name, at most four bytes each: a file's name has at most 255 bytes
_LARGEST = 1 << 26  # bytes
# Only arrays have a line that ends after "[" or a comma: what is written for their ends, beginnings and middles.
_IN_ARRAYS = (
    (re.compile(r",\n *(?=\])"), ""),
    (re.compile(r"\[\n +"), "["),
    (re.compile(r",\n +"), ", "),
)


def write_whole(path: Path, content: bytes, *, synced: bool = True) -> None:
    """Write a file atomically: a crash leaves the old content or the new one, never a part.

    A power cut does so too where the file is `synced`, which takes the disk some time.

    The temporary file is in the same folder, since a rename is atomic only within one file system. Its name cannot be
    predicted, so that nobody can plant a link there. An existing file keeps its permissions, and a symbolic link stays
    a link. Raises OSError, also for a pipe or a device, which the file would replace.
    """
    path = resolved(path)
    with contextlib.suppress(FileNotFoundError):
        check_regular(path)
    if path.is_dir():  # the root has no name from which a temporary one could be made
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    temporary = path.with_name(f".{path.name[:_BEGINNING]}.{secrets.token_hex(8)}.tmp")
    try:
        with temporary.open("xb") as file:
            with contextlib.suppress(FileNotFoundError):
                temporary.chmod(stat.S_IMODE(path.stat().st_mode))
            file.write(content)
            file.flush()
            if synced:
                os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):  # the first error is the one to report
            temporary.unlink(missing_ok=True)
        raise
    if synced:
        _sync_folder(path.parent)


def resolved(path: Path) -> Path:
    """Return a path without links. Raises OSError for a loop of them, also before Python 3.13."""
    try:
        return path.resolve()
    except RuntimeError:
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP)) from None


def write_new(path: Path, content: bytes) -> None:
    """Write a file that does not exist yet; where that fails, as on a full disk, no part of it is left behind.

    Raises FileExistsError, where the existing file stays as it is, or any other OSError.
    """
    with path.open("xb") as file:
        try:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        except BaseException:
            with contextlib.suppress(OSError):  # the first error is the one to report
                path.unlink()
            raise
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Flush a folder's names to the disk, where the system can, so that a rename survives a power cut."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def check_regular(path: Path) -> None:
    """Raise OSError for a path whose reading may never end: a pipe, a terminal, a device."""
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError(errno.EINVAL, "a pipe or a device, where a file is expected")


def read_small(path: Path) -> bytes:
    """Return the content of a file that people or cfid write. Raises OSError, also for a file of more than 64 MB."""
    check_regular(path)
    with path.open("rb") as file:
        content = file.read(_LARGEST + 1)
    if len(content) > _LARGEST:
        raise OSError(errno.EFBIG, f"more than {_LARGEST >> 20} MB, where a small file is expected")
    return content


def refuse_kept(path: Path) -> None:
    """Raise ConfigError for a file in a fits folder, or an existing rig.toml, parameters.toml or file of a run.

    These cannot be made again. Links are followed, as they are when a file is written. Raises OSError where one cannot
    be followed.
    """
    target, named = resolved(path), Path(os.path.normpath(path.absolute()))
    folders = {folder for place in (target, named) for folder in place.parents}
    of_fits = any(folder.name == FITS_FOLDER and (folder.parent / RIG_FILE).exists() for folder in folders)
    of_run = target.name in (RIG_FILE, PARAMETERS_FILE) or (target.parent / RUN_FILE).exists()
    if target.exists() and (of_fits or of_run):
        raise ConfigError(f"{path}: nothing replaces what a campaign keeps of its runs and fits. Name another file.")
    if of_fits:
        raise ConfigError(f"{path}: that folder takes the campaign's fits alone. Name another.")


def write_files(
    contents: Mapping[Path, bytes], *, force: bool = False, is_replaceable: Callable[[Path], bool] = lambda _: False
) -> None:
    """Write files whole, or none of them where one exists that is not replaceable and `force` is not set.

    Raises ConfigError, also for a file that a campaign keeps, and where one cannot be written.
    """
    try:
        for path, content in contents.items():
            if path.is_file() and (is_replaceable(path) or path.read_bytes() == content):
                continue
            refuse_kept(path)
            if (path.exists() or path.is_symlink()) and not force:
                raise ConfigError(
                    f"{path}: exists already, with other content. Nothing was written: use `force` to replace it, or "
                    "`out` to write elsewhere."
                )
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, content)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}. Use `out` to write elsewhere.") from None


def lies_in(folder: Path, path: Path) -> bool:
    """Return whether a path lies in a folder, following all links; False for a zero byte in it, or a loop of links."""
    try:
        return path.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):
        return False


def sha256_of(path: Path) -> str:
    """Return the hash of a file's content, which is read piece by piece. Raises DataError when it cannot be read."""
    try:
        check_regular(path)
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None


def write_toml(path: Path, content: Mapping[str, Any]) -> None:
    """Write a TOML file atomically. Raises OSError."""
    write_whole(path, toml_bytes(content))


def toml_bytes(content: Mapping[str, Any]) -> bytes:
    """Return a TOML file's bytes, with each array on one line.

    A file name that is not UTF-8 gets a question mark for each invalid byte, so that the file stays readable.
    """
    text = tomli_w.dumps(content)
    for pattern, written in _IN_ARRAYS:
        text = pattern.sub(written, text)
    return text.encode("utf-8", "replace")


def check_format(path: Path, found: Any, *, newest: int, oldest: int = 1) -> None:
    """Raise DataError for a format that is not a whole number from the oldest to the newest that this cfid reads."""
    if not isinstance(found, int) or isinstance(found, bool) or found < oldest:
        raise DataError(f"{path}: format: should be a whole number from {oldest} to {newest}.")
    if found > newest:
        raise DataError(
            f"{path}: has format {found}, written by a newer cfid; this one reads formats up to {newest}. Update cfid."
        )


@contextlib.contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Lock a folder against other cfid processes while a file is read, changed and written back.

    Systems without such a lock (Windows, some network drives) run without it. Raises OSError when the folder does not
    exist.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def held(path: Path) -> FileIO:
    """Create a file and lock it until it is closed; the kernel closes it, however this process ends.

    Systems without such a lock leave it unlocked. Raises OSError.
    """
    file = FileIO(path, "xb")
    with contextlib.suppress(ImportError, OSError):
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return file


def is_held(path: Path) -> bool:
    """Return whether a process has locked a file; also False where that is unknown, as on some network drives."""
    try:
        import fcntl

        check_regular(path)
        with FileIO(path) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except (ImportError, OSError):
        return False
    return False


def read_toml(path: Path, error: type[CfidError]) -> dict[str, Any]:
    """Read a TOML file, with or without a byte order mark.

    Raises FileNotFoundError when it is missing, which callers treat differently, and `error` for any other fault.
    """
    try:
        return tomllib.loads(read_small(path).decode("utf-8-sig"))
    except FileNotFoundError:
        raise
    except OSError as fault:
        raise error(f"{path}: cannot be read: {fault.strerror}.") from None
    except UnicodeDecodeError as fault:
        raise error(f"{path}: byte {fault.start + 1} is not UTF-8 text: save it as UTF-8.") from None
    except RecursionError:
        raise error(f"{path}: invalid TOML: nested too deeply.") from None
    except ValueError as fault:  # TOMLDecodeError, and numbers that are too long for Python
        raise error(f"{path}: invalid TOML: {fault}. Correct it there.") from None


def first_fault(error: ValidationError, content: Mapping[str, Any]) -> str:
    """Return a sentence about the first invalid key of a TOML file's content."""
    # A misspelt key gives two errors, an unknown key and a missing one; the unknown key is the more useful one.
    faults = sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
    first = faults[0]
    key = _key(first, content)
    if first["type"] == "extra_forbidden":
        return f"{key}: there is no such key. Is it misspelt, or in the wrong table?"
    if first["type"] == "missing":
        return f"{key} is missing."
    # A value with a union type has an error for each type.
    reasons = [_reason(fault["type"], fault["msg"]) for fault in faults if _key(fault, content) == key]
    verb = "should be " if first["msg"].startswith("Input should be ") else ""
    shown = "" if isinstance(first["input"], Mapping | list) else f", not {_short(repr(first['input']))}"
    return f"{f'{key}: ' * bool(first['loc'])}{verb}{' or '.join(reasons)}{shown}."


def _key(fault: Mapping[str, Any], content: Mapping[str, Any]) -> str:
    """Return the key as written in the file: without pydantic's names for the types of a union."""
    known: list[str] = []
    here: Any = content
    for part in fault["loc"]:
        if not isinstance(here, Mapping | list):
            break
        there = dict(here) if isinstance(here, Mapping) else dict(enumerate(here))
        if part in there or (fault["type"] == "missing" and part == fault["loc"][-1]):
            known.append(str(part))
            here = there.get(part)
    key = ".".join(known) or "(top)"
    return key if key.isprintable() else repr(key)  # a newline in it would make the rest look like a line of cfid's own


def _reason(kind: str, message: str) -> str:
    if kind in ("dict_type", "model_type", "dataclass_type"):
        return "a table"
    return message.removeprefix("Value error, ").removeprefix("Input should be ").replace("tuple", "list")


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:40]}..."
