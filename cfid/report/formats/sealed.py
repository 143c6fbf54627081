"""A report's file: whole or not at all, and never over what cfid did not make.

Every report carries one mark, `cfid VERSION report HASH`. The hash is of the file with zeros in its place, so that a
report somebody has edited since is no longer cfid's.
"""

import hashlib
import re
from pathlib import Path

from cfid import __version__
from cfid.errors import ConfigError
from cfid.records.files import write_whole

_ZEROS = "0" * 64
MARK = f"cfid {__version__} report {_ZEROS}"  # what a renderer writes, once
_MARK = re.compile(rb"(cfid [\w.+-]+ report )([0-9a-f]{64})")


def write_report(path: Path, text: str, *, force: bool = False) -> None:
    """Write a rendered report with its mark; of a name that is no UTF-8 each odd byte becomes a question mark.

    Raises ConfigError when a file of that name is not a report as cfid made it and `force` was not said, or when the
    folder cannot be written.
    """
    content = _sealed(text.encode("utf-8", "replace"))
    try:
        if path.exists() and not force and not _is_ours(path.read_bytes()):
            raise ConfigError(
                f"{path}: is there already, and not as cfid made it. Say --force to replace it, or --out FILE to write "
                "elsewhere."
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    except OSError as error:
        raise ConfigError(f"{path}: no report can be written there: {error.strerror}.") from None


def _sealed(content: bytes) -> bytes:
    found = hashlib.sha256(content).hexdigest()
    return _MARK.sub(lambda mark: mark[1] + found.encode(), content, count=1)


def _is_ours(content: bytes) -> bool:
    mark = _MARK.search(content)
    if mark is None:
        return False
    unsealed = content[: mark.start(2)] + _ZEROS.encode() + content[mark.end(2) :]
    return hashlib.sha256(unsealed).hexdigest().encode() == mark[2]
