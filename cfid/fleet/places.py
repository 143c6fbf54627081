"""Find campaigns by folders, globs, an index or addresses, and fetch the needed files to this computer."""

import asyncio
import glob
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from cfid.console.messages import printable
from cfid.errors import CfidError, ConfigError, DataError
from cfid.records.choose import is_glob
from cfid.records.files import RIG_FILE, RUN_FILE, RUNS_FOLDER, check_regular

_ADDRESS = re.compile(r"[A-Za-z][\w+.-]*://")
_NAME = re.compile(r"[A-Za-z0-9_+-][A-Za-z0-9_.+ -]*")  # of a file that another computer lists: no path, not hidden
_SHOWN = 100  # characters of an invalid name that a message quotes
_SILENT_S = 20.0
_LOOK_S = 1.0  # between checks of how much has arrived
_LISTED_S = 30.0  # for the whole list of a folder, which may arrive slowly
_LARGEST_INDEX = 1 << 24  # bytes
_LARGEST_TEXT, _LARGEST_RECORDING = 1 << 26, 1 << 33  # bytes; the latter holds the rows of a day
_MOST_FILES = 2000  # in a folder: a run has about ten, and a campaign has a few hundred fits
_SLOWEST_BPS = 1000.0  # bytes per second, slower than any network usable for recordings


@dataclass(frozen=True, kw_only=True)
class Place:
    """A readable campaign: its folder on this computer, and a function that fetches a run into it by its name.

    `address` replaces the folder in messages and sources; it is "" for a campaign on this computer.
    """

    folder: Path
    address: str
    bring_run: Callable[[str], None]

    def named(self, text: str) -> str:
        """Return a text with the campaign's address in place of the local folder."""
        return text.replace(str(self.folder), self.address) if self.address else text


def is_address(word: str) -> bool:
    """Return whether a word is an address for fsspec, such as `https://lab.example/c1`, and not a folder."""
    return _ADDRESS.match(word) is not None


def campaigns(
    words: Sequence[str], index: str | None = None, *, addresses: bool = True
) -> tuple[list[str], list[CfidError]]:
    """Return the campaigns of folders, globs, addresses and an index, each once, and the faults of other words.

    An index is a text file or the address of one, with a folder, glob or address on each line, relative to the index.
    Without `addresses`, each address is a fault, and no server is contacted. Raises CfidError if no campaign is found.
    """
    given = [*words, *([] if index is None else _listed(index))]
    if not given:
        raise ConfigError("no campaign is given: name folders or globs, or an index with `index`.")
    found, faults = dict[str, None](), list[CfidError]()
    for word in dict.fromkeys(given):
        try:
            if is_address(word) and not addresses:
                raise DataError(
                    f"{word}: only `cfid fleet fit` takes addresses: refit the campaign, and compare the results here."
                )
            found |= dict.fromkeys(_matching(word))
        except CfidError as error:
            faults.append(error)
    if not found:
        raise type(faults[0])("\n  ".join(printable(str(one)) for one in faults))
    return list(found), faults


@contextmanager
def at_hand(campaign: str) -> Iterator[Place]:
    """Make a campaign readable here: fetch one from another computer to a temporary folder, without its runs.

    Raises CfidError when the campaign cannot be read.
    """
    if not is_address(campaign):
        yield Place(folder=Path(campaign), address="", bring_run=lambda _: None)
        return
    with _faults(campaign):
        files, root = _files_at(campaign)
    with tempfile.TemporaryDirectory(prefix="cfid-fleet-") as temporary:
        folder = Path(temporary).resolve() / "campaign"  # a name from the server might lead elsewhere

        def bring(name: str, only: Sequence[str] | None = None) -> None:
            there, here = f"{root}/{name}" if name else root, folder / name
            with _faults(f"{campaign}/{name}"):
                here.mkdir(parents=True, exist_ok=True)
                for path, file in _listing(files, there):
                    if only is None or file in only:
                        largest = _LARGEST_RECORDING if name.startswith(RUNS_FOLDER) else _LARGEST_TEXT
                        with _faults("/".join(filter(None, (campaign, name, file)))):
                            _fetch(files, path, here / file, largest)

        def bring_run(name: str) -> None:
            if not (folder / RUNS_FOLDER / name).exists():
                bring(f"{RUNS_FOLDER}/{name}")
                if not (folder / RUNS_FOLDER / name / RUN_FILE).exists():
                    raise DataError(f"{campaign}/{RUNS_FOLDER}/{name}: not a run: it has no {RUN_FILE}.")

        bring("", [RIG_FILE])
        bring("fits")
        yield Place(folder=folder, address=campaign, bring_run=bring_run)


def _matching(word: str) -> list[str]:
    """Return the campaigns that a word names; a glob matches only folders and broken links.

    Raises CfidError for a glob that matches nothing or cannot be resolved.
    """
    found = _addresses(word) if is_address(word) else _folders(word)
    if not found:
        raise ConfigError(f"{word}: no folder matches.")
    return found


def _folders(word: str) -> list[str]:
    try:
        if not is_glob(word) or Path(word).exists():
            return [os.path.realpath(word)]  # works with a loop of links
        matches = sorted(glob.glob(word))  # noqa: PTH207 - Path.glob takes no absolute pattern
        return [os.path.realpath(one) for one in matches if Path(one).is_dir() or not Path(one).exists()]
    except (OSError, ValueError) as error:  # the name may be too long or contain a zero byte
        raise ConfigError(f"{word[:_SHOWN]}: is no folder: {error}.") from None


def _addresses(word: str) -> list[str]:
    if not is_glob(word):
        return [word.rstrip("/")]
    with _faults(word):
        files, root = _files_at(word)
        found = [files.unstrip_protocol(one) for one in sorted(files.glob(root, **_patience(files)))]
        return [one for one in found if files.isdir(one, **_patience(files))]


def _listed(index: str) -> list[str]:
    """Return the lines of an index, relative ones resolved from its folder; a line that begins with # is a comment."""
    if is_address(index):
        with _faults(index), tempfile.TemporaryDirectory(prefix="cfid-fleet-") as temporary:
            files, path = _files_at(index)
            here = Path(temporary) / "index"
            _fetch(files, path, here, _LARGEST_INDEX)
            content = here.read_bytes()
    else:
        try:
            check_regular(Path(index))
            with Path(index).open("rb") as file:
                content = file.read(_LARGEST_INDEX)
        except OSError as error:
            raise DataError(f"{index}: cannot be read: {error.strerror}.") from None
    try:
        lines = [line.strip() for line in content.decode("utf-8-sig").splitlines()]
    except UnicodeDecodeError as error:
        raise DataError(
            f"{index}: byte {error.start + 1} is not UTF-8 text: it should be a list of campaigns."
        ) from None
    start = f"{index.rpartition('/')[0]}/" if is_address(index) else ""
    wanted = [line for line in lines if line and not line.startswith("#")]
    return [line if is_address(line) else start + line if start else str(Path(index).parent / line) for line in wanted]


def _files_at(address: str) -> tuple[Any, str]:
    """Return the file system of an address and the path in it. Raises whatever the file system raises."""
    try:
        from fsspec.core import url_to_fs  # noqa: PLC0415 - an extra
    except ImportError:
        raise ConfigError(f"{address}: fsspec is not installed here: pip install 'cfid[fleet]'.") from None
    files, root = url_to_fs(address, **_limits(address))
    return files, str(root).rstrip("/")


def _fetch(files: Any, path: str, here: Path, largest: int) -> None:
    """Fetch a file of at most `largest` bytes. Raises ValueError if it is larger or arrives too slowly."""
    arriving = Arriving(largest)
    if not getattr(files, "async_impl", False):
        files.get_file(path, str(here), callback=arriving)
        return
    from fsspec.asyn import sync  # noqa: PLC0415 - an extra

    async def watched() -> None:
        fetched = asyncio.ensure_future(files._get_file(path, str(here), callback=arriving))
        try:
            while not (await asyncio.wait({fetched}, timeout=_LOOK_S))[0]:
                arriving.check_pace()  # also checks what precedes the file itself
            await fetched
        finally:
            fetched.cancel()

    sync(files.loop, watched)


class Arriving:
    """Watch a file that another computer sends, as a callback of fsspec; stop it if it is too large or too slow."""

    def __init__(self, largest: int, *, clock: Callable[[], float] = time.monotonic) -> None:
        """Start with zero bytes; `largest` is in bytes, `clock` in seconds."""
        self._largest, self._clock = largest, clock
        self._began_s, self._bytes = clock(), 0

    def set_size(self, size: int | None) -> None:
        """Ignore the size that the server states, which may be wrong."""

    def relative_update(self, count: int) -> None:
        """Count bytes that have arrived. Raises ValueError if they are too many or too slow."""
        self._bytes += count
        if self._bytes > self._largest:
            raise ValueError(f"it sends more than {self._largest >> 20} MB, where a smaller file is expected")
        self.check_pace()

    def check_pace(self) -> None:
        """Raise ValueError if data arrives more slowly than over any usable network."""
        spent_s = self._clock() - self._began_s
        if spent_s > _SILENT_S and self._bytes < _SLOWEST_BPS * spent_s:
            raise ValueError(f"it sent {self._bytes} bytes in {spent_s:.0f} s (limit {_SLOWEST_BPS:g} a second)")


def _limits(address: str) -> dict[str, Any]:
    """Return options that cause an error if a server stays silent for long or sends an endless list."""
    if not address.lower().startswith(("http://", "https://")):
        return {}
    import aiohttp  # noqa: PLC0415 - comes with the extra

    class ShortPage(aiohttp.ClientResponse):
        """A page that is read as a whole, such as the list of a folder; a file arrives in parts."""

        async def read(self) -> bytes:
            """Return the page. Raises ValueError if it is larger than any list."""
            page = bytearray()
            async for part in self.content.iter_chunked(1 << 16):
                page += part
                if len(page) > _LARGEST_INDEX:
                    raise ValueError(f"it sends a list of more than {_LARGEST_INDEX >> 20} MB")
            self._body = bytes(page)
            return self._body

    limit = aiohttp.ClientTimeout(sock_connect=_SILENT_S, sock_read=_SILENT_S)
    return {"client_kwargs": {"timeout": limit, "response_class": ShortPage}}


def _patience(files: Any) -> dict[str, float]:
    """Return the setting that stops a folder's list that takes too long, if the file system has such a setting."""
    return {"timeout": _LISTED_S} if getattr(files, "async_impl", False) else {}


def _listing(files: Any, folder: str) -> list[tuple[str, str]]:
    """Return the paths of a folder's files, each with its name; names that lead elsewhere are left out.

    Raises DataError for more files than any folder of a campaign contains.
    """
    paths = [one["name"] for one in files.ls(f"{folder}/", detail=True, **_patience(files)) if one["type"] == "file"]
    named = [(path, PurePosixPath(unquote(path) if is_address(path) else path).name) for path in paths]
    own = [(path, name) for path, name in named if _NAME.fullmatch(name)]
    if len(own) > _MOST_FILES:
        raise DataError(f"{folder}: {len(own)} files in one folder (limit {_MOST_FILES}): no campaign's is so full.")
    return own


@contextmanager
def _faults(place: str) -> Iterator[None]:
    """Turn any error of a file system, whatever its library, into a DataError."""
    try:
        yield
    except (ConfigError, DataError):
        raise
    except Exception as error:
        reason = str(error) or type(error).__name__
        if isinstance(error, FileNotFoundError) and str(error) in place:  # aiohttp's error names only the address
            reason = "no such file or folder is there"
        if isinstance(error, TimeoutError) and not str(error):  # fsspec's error has no text
            reason = f"it did not answer within {_LISTED_S:.0f} s"
        raise DataError(f"{place}: cannot be read: {reason.splitlines()[0].rstrip('.')}.") from None
