"""Write a report's file atomically, and never over a file of another origin.

Every report contains one mark, `cfid VERSION report HASH`. The hash is that of the file with zeros in place of the
hash, so that an edited report no longer counts as a file of cfid.
"""

import hashlib
import re
from pathlib import Path

from cfid.records.files import check_regular, write_files
from cfid.version import __version__

_ZEROS = "0" * 64
MARK = f"cfid {__version__} report {_ZEROS}"  # a renderer writes this once
_MARK = re.compile(rb"(cfid [\w.+-]+ report )([0-9a-f]{64})")


def write_report(path: Path, text: str, *, force: bool = False) -> None:
    """Write a rendered report with its mark; bytes of names that are not UTF-8 become question marks.

    Raises ConfigError when a file of that name is not an unchanged report of cfid and `force` is not set, or when the
    folder cannot be written.
    """
    content = text.encode("utf-8", "replace")
    digest = hashlib.sha256(content).hexdigest().encode()
    sealed = _MARK.sub(lambda mark: mark[1] + digest, content, count=1)
    write_files({path: sealed}, force=force, is_replaceable=_is_ours)


def _is_ours(path: Path) -> bool:
    """Return whether a file is an unchanged report. Raises OSError for an unreadable file, a pipe or a device."""
    check_regular(path)
    content = path.read_bytes()
    mark = _MARK.search(content)
    if mark is None:
        return False
    unsealed = content[: mark.start(2)] + _ZEROS.encode() + content[mark.end(2) :]
    return hashlib.sha256(unsealed).hexdigest().encode() == mark[2]
