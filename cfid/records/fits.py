"""The fits folder of a campaign: every fit with its parameters, quality, findings and figures, each in its own file.

Files are numbered by a counter of the campaign, which gives their order, and none is ever overwritten. A fit that was
withdrawn stays, with a file beside it that marks it. A fit that was rejected, or that gave no result, is kept too,
without numbers, and a value that `cfid set` stored is kept as a fit of its own.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError
from pydantic_core import from_json

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding
from cfid.records.files import check_format, check_regular, locked_folder, read_small, write_new, write_whole
from cfid.records.parameters import Section, plain, section_fault

FORMAT = 4  # format 3 had no counter and no revision; its files are ordered by their times
_OLDEST = 3
BY_HAND = "set"  # the name of values measured by hand
WITHDRAWN = ".withdrawn"  # ends the name of the file that marks a fit
_NUMBERED = re.compile(r"(\d{4,})_")


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A fit: its section's name, its command and its results; the figures' paths are relative to the campaign.

    `number` is its place in the campaign's order, and `stem` the name of its file without ending. `revision` is that of
    its method when it was made. `quality` and `findings` are those of --json, `lines` the further lines of the terminal
    output. `options` are the command's options that differ from their defaults, by name; None where they are unknown.
    """

    name: str
    command: str
    section: Section
    quality: Mapping[str, Any]
    findings: tuple[Finding, ...] = ()
    lines: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()
    options: Mapping[str, Any] | None = None
    revision: int = 1
    number: int = 0
    stem: str = ""

    @property
    def hashes(self) -> frozenset[str]:
        """The hashes of the fit's sources: two fits with the same set are of the same measurement."""
        return frozenset(source.sha256 for source in self.section.sources)

    @property
    def recordings(self) -> frozenset[str]:
        """The names of the fit's runs, and the paths of its other files."""
        return frozenset(source.run or source.path for source in self.section.sources)

    @property
    def order(self) -> tuple[int, datetime, str]:
        """What fits are ordered by: the counter; fits without one come first, by their times."""
        return self.number, self.section.found, self.stem


def keep_fit(folder: Path, fit: Fit) -> Fit:
    """Write a fit to a new file, and return it with its number and the stem of the file.

    A file name that is not UTF-8 gets a question mark for each invalid byte, so that the fit stays readable.
    Raises ConfigError when the folder cannot be written.
    """
    try:
        folder.mkdir(exist_ok=True)
        with locked_folder(folder):
            used = [int(found[1]) for path in folder.iterdir() if (found := _NUMBERED.match(path.name))]
            number = max(used, default=0) + 1
            kept = replace(fit, number=number, stem=f"{number:04d}_{fit.name.replace(' ', '_')}")
            write_whole(path_of(folder, kept), _as_json(kept))
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}.") from None
    return kept


def path_of(folder: Path, fit: Fit) -> Path:
    """Return the path of a kept fit."""
    return folder / f"{fit.stem}.json"


def list_fits(folder: Path) -> list[Fit | DataError]:
    """Return all fits of a campaign in their order, withdrawn ones too; unreadable ones, at the end, as errors."""
    fits: list[Fit] = []
    faults: list[DataError] = []
    for path in sorted(folder.glob("*.json")):
        try:
            fits.append(read_fit(path))
        except DataError as error:
            faults.append(error)
    return [*sorted(fits, key=lambda fit: fit.order), *faults]


def withdraw(folder: Path, fit: Fit) -> None:
    """Mark a fit as withdrawn. Raises ConfigError when it is marked already, or when the mark cannot be written."""
    mark = folder / f"{fit.stem}{WITHDRAWN}"
    try:
        write_new(mark, f"{datetime.now(UTC).isoformat(timespec='seconds')}\n".encode())
    except FileExistsError:
        raise ConfigError(f"{fit.stem}: was withdrawn before. Delete {mark} to take it back.") from None
    except OSError as error:
        raise ConfigError(f"{mark}: cannot be written: {error.strerror}.") from None


def is_withdrawn(folder: Path, fit: Fit) -> bool:
    """Return whether a fit was withdrawn."""
    return (folder / f"{fit.stem}{WITHDRAWN}").exists()


def _as_json(fit: Fit) -> bytes:
    content = {"format": FORMAT} | plain(asdict(fit))
    del content["stem"]
    text = json.dumps(content, indent=1, allow_nan=False, default=_text, ensure_ascii=False)
    return text.encode("utf-8", "replace")


def _text(value: Any) -> str:
    return str(value) if isinstance(value, Path) else str(value.isoformat())


@cache
def _validator() -> TypeAdapter[Fit]:
    """Return the validator of fits, cached since creating it takes longer than validating a file."""
    return TypeAdapter(Fit)


def read_fit(path: Path) -> Fit:
    """Read the file of a kept fit. Raises DataError when it is invalid."""
    try:
        fit = _validator().validate_python(_content(path))
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None
    except ValidationError as error:  # a ValueError, too
        first = error.errors()[0]
        fault = f"{'.'.join(map(str, first['loc'])) or 'the file'}: {first['msg']}"
    except ValueError as error:
        fault = str(error)
    else:
        fault = section_fault(fit.section)
        if not fault:
            return fit
    raise DataError(f"{path}: invalid: {fault}. Delete it and fit again.")


def _content(path: Path) -> Any:
    """Return a file's content. Raises DataError for its format, ValueError for invalid JSON."""
    check_regular(path)
    content = from_json(read_small(path))
    if not isinstance(content, dict):
        return content
    check_format(path, content.pop("format", None), oldest=_OLDEST, newest=FORMAT)
    if isinstance(findings := content.get("findings"), list):
        content["findings"] = [
            {"sentence" if key == "text" else key: value for key, value in finding.items()}  # as version 0.2 wrote it
            if isinstance(finding, dict)
            else finding
            for finding in findings
        ]
    return content | {"stem": path.stem}
