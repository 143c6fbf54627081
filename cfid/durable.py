"""Files that are there whole or not at all, and TOML files read with a sentence for every fault."""

import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.errors import CfidError

if TYPE_CHECKING:
    from pydantic import ValidationError


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that a crash leaves the old content or the new one, never a part.

    The temporary file lies beside it, since a rename is atomic only within one file system. Raises OSError.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_toml(path: Path, content: Mapping[str, Any]) -> None:
    """Write a TOML file whole. Raises OSError.

    A file name that is no UTF-8 keeps a question mark for each odd byte, so that the file stays readable.
    """
    import tomli_w

    write_whole(path, tomli_w.dumps(content).encode("utf-8", "replace"))


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
        raise error(f"{path}: no valid TOML: {fault}.") from None


def first_fault(error: "ValidationError", content: Mapping[str, Any]) -> str:
    """Return the key of the first fault that a model found in the content of a TOML file, and what is wrong."""
    fault = error.errors()[0]
    known, here = [], content
    for part in fault["loc"]:
        # The last parts of a key may be pydantic's names for the members of a union: they are not in the file.
        inside = part in here if isinstance(here, Mapping) else isinstance(here, list) and part in range(len(here))
        if not inside and fault["type"] != "missing":
            break
        known.append(str(part))
        here = here[part] if inside else {}  # type: ignore[index]
    key = ".".join(known) or "(top)"
    if fault["type"] == "missing":
        return f"{key}: is missing."
    if fault["type"] == "extra_forbidden":
        return f"{key}: there is no such key."
    return f"{key}: {fault['msg'].removeprefix('Value error, ')}, not {_shown(fault['input'])}."


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]}..."
