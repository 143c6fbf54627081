"""The folder of refitted campaigns, with a manifest that lets an interrupted fleet continue.

Each campaign is a folder that commands accept like any other. The folder gets its name when it is complete and the
manifest names it, so that a crash leaves no incomplete campaign. Nothing is replaced.
"""

import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

from cfid.errors import ConfigError, DataError
from cfid.fleet.places import is_address
from cfid.fleet.refit import Refitted
from cfid.records.files import FITS_FOLDER, RIG_FILE, RUN_FILE, RUNS_FOLDER, check_regular, read_small, write_new
from cfid.version import __version__

MANIFEST = "manifest.jsonl"
_HALF = ".half-"  # beginning of the name of an incomplete folder
_LARGEST = 1 << 26  # bytes of a manifest
_LONGEST = 200  # characters of a folder's name; file systems take 255 bytes, and an address may be longer
FORMAT = 1


class Results:
    """A folder of refitted campaigns; `done` contains the manifest's row of each campaign, by its folder or address."""

    def __init__(self, folder: Path, done: Mapping[str, Mapping[str, Any]], taken: set[str]) -> None:
        """Continue a folder in which some campaigns are done and some names are taken."""
        self.folder, self.done = folder, dict(done)
        self._taken, self._names, self._states = taken, dict[str, str](), dict[str, str]()

    def name(self, campaigns: Sequence[str]) -> None:
        """Name the folders of campaigns that are not done, in the given order, since they may end in any order."""
        for campaign in campaigns:
            if campaign not in self.done:
                self._names[campaign] = self._free_name(campaign)
                self._taken.add(self._names[campaign])
                self._states[campaign] = _state(campaign)

    def changed(self, campaigns: Iterable[str]) -> list[str]:
        """Return the done campaigns whose rig.toml, fits or labels of runs have changed since."""
        done = [(one, self.done[one].get("state")) for one in campaigns if one in self.done]
        return [one for one, state in done if state and state != _state(one)]

    def keep(self, campaign: str, refitted: Refitted) -> Mapping[str, Any]:
        """Write a named campaign to its folder and its row to the manifest; return the row. Raises ConfigError."""
        name = self._names[campaign]
        row = {
            "campaign": campaign,
            "folder": name,
            "state": self._states[campaign],
            "processor_s": round(refitted.processor_s, 3),
            "fits": [
                {
                    "name": fit.name,
                    "done": not fit.fault,
                    "moved_in_std": fit.moved,
                    "most_moved": fit.most,
                    "text": " ".join(filter(None, (fit.fault, *fit.notes))),
                }
                for fit in refitted.fits
            ],
        }
        with _faults(self.folder / name):
            half = Path(tempfile.mkdtemp(prefix=_HALF, dir=self.folder))  # its name is not predictable
            half.chmod(0o777 & ~_umask())
            for file, content in refitted.files.items():
                path = half / file
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            self._append(row)
            half.rename(self.folder / name)
        self.done[campaign] = row
        return row

    def _append(self, row: Mapping[str, Any]) -> None:
        with (self.folder / MANIFEST).open("ab") as file:
            file.write(_line(row))
            file.flush()
            os.fsync(file.fileno())

    def _free_name(self, campaign: str) -> str:
        stem = re.sub(r"[^A-Za-z0-9_+-][^A-Za-z0-9_.+-]*", "-", PurePosixPath(campaign).name)[:_LONGEST] or "campaign"
        number = 1
        while (name := f"{stem}-{number}" if number > 1 else stem) in self._taken:
            number += 1
        return name


def _state(campaign: str) -> str:
    """Return a hash of what determines a refit besides the recordings, for a campaign on this computer, else ""."""
    if is_address(campaign):
        return ""
    found = hashlib.sha256()
    folder = Path(campaign)
    for pattern in (RIG_FILE, f"{FITS_FOLDER}/*", f"{RUNS_FOLDER}/*/{RUN_FILE}"):
        with suppress(OSError):  # the refit reports unreadable files
            for path in sorted(folder.glob(pattern)):
                found.update(path.relative_to(folder).as_posix().encode("utf-8", "surrogateescape"))
                found.update(hashlib.sha256(read_small(path)).digest())
    return found.hexdigest()


@contextmanager
def results_in(folder: Path, *, changes: Mapping[str, str]) -> Iterator[Results]:
    """Make the folder, or continue one of the same version and options; lock it against other commands meanwhile.

    Raises ConfigError if the folder contains anything else, or if another command is writing to it.
    """
    others = {f"set {name}": value for name, value in sorted(changes.items()) if name != "method"}
    method = changes.get("method", "as kept")
    head = {"format": FORMAT, "cfid_version": __version__, "method": method, **others}
    with _faults(folder):
        file = _manifest(folder, head)
    with file:
        with _faults(folder):
            results = _begun(file, folder, head)
        yield results  # errors of the caller are no faults of the folder


@contextmanager
def _faults(folder: Path) -> Iterator[None]:
    """Turn an OSError into a ConfigError that names the folder."""
    try:
        yield
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror or error}.") from None


def _manifest(folder: Path, head: Mapping[str, Any]) -> BinaryIO:
    """Open the manifest of a folder, and make it if it does not exist. Raises OSError, ConfigError."""
    path = folder / MANIFEST
    folder.mkdir(parents=True, exist_ok=True)
    if path.is_symlink():
        raise ConfigError(f"{path}: is a link: give a new folder.")
    if not path.exists():
        if any(folder.iterdir()):
            raise ConfigError(f"{folder}: is not empty, and has no {MANIFEST}: give a new folder.")
        write_new(path, _line(head))
    check_regular(path)
    return path.open("r+b")


def _begun(file: BinaryIO, folder: Path, head: Mapping[str, Any]) -> Results:
    """Return the results in an open manifest; remove what a crash left. Raises OSError, ConfigError, DataError."""
    path = folder / MANIFEST
    _lock(file.fileno(), folder)
    content = file.read(_LARGEST + 1)
    if len(content) > _LARGEST:
        raise ConfigError(f"{path}: is larger than {_LARGEST >> 20} MB: give a new folder.")
    rows = list(_rows(content, path))
    if not rows or rows[0] != head:
        was = rows[0] if rows else "no first line"
        raise ConfigError(f"{path}: was begun with {_said(was)}, now {_said(head)}: give a new folder.")
    file.truncate(content.rfind(b"\n") + 1)  # removes a line that a crash cut
    for left in folder.glob(f"{_HALF}*"):
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
    done = {row["campaign"]: row for row in rows[1:] if (folder / row["folder"]).is_dir()}
    return Results(folder, done, {entry.name for entry in folder.iterdir()})


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def _rows(content: bytes, path: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows up to a line that was cut. Raises DataError for a line that is not a row."""
    lines = content.splitlines(keepends=True)
    for number, line in enumerate(lines, 1):
        if not line.endswith(b"\n"):
            return
        try:
            row = json.loads(line)
            fits = isinstance(row, dict) and (number == 1 or _is_row(row))
        except (ValueError, RecursionError):
            fits = False
        if not fits:
            raise DataError(f"{path}:{number}: is no row of a manifest: give a new folder.")
        yield row


def _is_row(row: Mapping[str, Any]) -> bool:
    """Return whether `keep` may have written a row, whose folder must be directly in this folder."""
    texts = [row.get("campaign"), row.get("folder")]
    fits = row.get("fits")
    if not isinstance(fits, list) or not all(isinstance(text, str) for text in texts):
        return False
    if Path(row["folder"]).name != row["folder"] or not isinstance(row.get("processor_s"), int | float):
        return False
    return all(isinstance(fit, dict) and _is_fit(fit) for fit in fits)


def _is_fit(fit: Mapping[str, Any]) -> bool:
    moved = fit.get("moved_in_std")
    texts = (fit.get("name"), fit.get("most_moved"), fit.get("text"))
    known = moved is None or (isinstance(moved, int | float) and not isinstance(moved, bool))
    return isinstance(fit.get("done"), bool) and known and all(isinstance(text, str) for text in texts)


def _line(row: Mapping[str, Any]) -> bytes:
    return json.dumps(row, allow_nan=False).encode() + b"\n"


def _said(head: Any) -> str:
    return ", ".join(f"{key} {value}" for key, value in head.items()) if isinstance(head, dict) else str(head)


def _lock(handle: int, folder: Path) -> None:
    """Lock the folder for this process, if the system has such locks. Raises ConfigError."""
    try:
        import fcntl  # noqa: PLC0415 - POSIX alone
    except ImportError:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ConfigError(f"{folder}: another `cfid fleet fit` writes there: wait until it has ended.") from None
    except OSError:
        return  # some network drives have no locks
