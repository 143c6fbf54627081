"""Write a report's file atomically, and never over a file of another origin.

Every report contains one mark, `cfid VERSION report HASH`. The hash is that of the file with zeros in place of the
hash, so that an edited report no longer counts as a file of cfid.
"""

import hashlib
import re
from pathlib import Path

from cfid.errors import ConfigError
from cfid.records.files import check_regular, refuse_kept, write_whole
from cfid.version import __version__

_LARGEST = 1 << 28  # bytes; no report is as large as this
_ZEROS = "0" * 64
MARK = f"cfid {__version__} report {_ZEROS}"  # a renderer writes this once
_MARK = re.compile(rb"(cfid [\w.+-]+ report )([0-9a-f]{64})")


def write_report(path: Path, text: str, *, force: bool = False) -> None:
    """Write a rendered report with its mark; bytes of names that are not UTF-8 become question marks.

    Raises ConfigError when a file of that name is not an unchanged report of cfid and `force` is not set, or when the
    folder cannot be written.
    """
    content = _sealed(text.encode("utf-8", "replace"))
    try:
        if path.is_symlink() and not path.exists() and not force:
            raise ConfigError(f"{path}: is a link to a file that does not exist. Use `force` to make that file.")
        ours = path.exists() and _is_ours(path)
        if not ours:
            refuse_kept(path)
        if path.exists() and not ours and not force:
            raise ConfigError(
                f"{path}: exists already, and is not an unchanged report of cfid. Use `force` to replace it, or "
                "`out` to write elsewhere."
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    except OSError as error:
        raise ConfigError(
            f"{path}: no report can be written there: {error.strerror}. Use `out` for another file."
        ) from None


def _sealed(content: bytes) -> bytes:
    found = hashlib.sha256(content).hexdigest()
    return _MARK.sub(lambda mark: mark[1] + found.encode(), content, count=1)


def _is_ours(path: Path) -> bool:
    """Return whether a file is an unchanged report. Raises OSError for an unreadable file, a pipe or a device."""
    check_regular(path)
    content = path.read_bytes() if path.stat().st_size <= _LARGEST else b""
    mark = _MARK.search(content)
    if mark is None:
        return False
    unsealed = content[: mark.start(2)] + _ZEROS.encode() + content[mark.end(2) :]
    return hashlib.sha256(unsealed).hexdigest().encode() == mark[2]
