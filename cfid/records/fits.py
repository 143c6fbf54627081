"""Every fit of a campaign as it was delivered: what it found, how sure it was, which figures it drew.

parameters.toml has the last of each kind, for programs that want numbers; here all of them stay, for a report and to
see how a quantity repeats.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, rejection, warning
from cfid.records.files import alone_in, write_whole
from cfid.records.parameters import Section, as_of_now, bent, plain

FORMAT = 2  # 1, which had no number, had sentences without codes


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A fit by the name of its section, the command that made it, and its words; figures' paths from the campaign on.

    `quality` and `findings` are what --json prints under these names, `lines` is what a person read besides.
    """

    name: str
    command: str
    section: Section
    quality: Mapping[str, Any]
    findings: tuple[Finding, ...] = ()
    lines: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()

    @property
    def hashes(self) -> frozenset[str]:
        """Those of its sources: two fits that share all of them are one measurement."""
        return frozenset(source.sha256 for source in self.section.sources)


def keep_fit(folder: Path, fit: Fit) -> Path:
    """Write a fit into a file of its own, never over another, and return its path.

    A file name that is no UTF-8 keeps a question mark for each odd byte, so that the fit stays readable.
    Raises ConfigError when the folder cannot be written.
    """
    stem = f"{fit.section.found:%Y-%m-%d_%H%M%S}_{fit.name}"
    try:
        folder.mkdir(exist_ok=True)
        with alone_in(folder):
            number = 1
            while (path := folder / f"{stem}{f'-{number}' if number > 1 else ''}.json").exists():
                number += 1
            write_whole(path, _as_json(fit))
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}.") from None
    return path


def rewritten(path: Path) -> bytes | None:
    """Return a fit's file in the format of today, None where it has it. Raises DataError when it cannot be read."""
    fit = _read(path)
    content = _as_json(fit)
    return None if f'"format": {FORMAT}'.encode() in path.read_bytes()[:40] else content


def _as_json(fit: Fit) -> bytes:
    content = {"format": FORMAT} | plain(asdict(fit))
    text = json.dumps(content, indent=1, allow_nan=False, default=_text, ensure_ascii=False)
    return text.encode("utf-8", "replace")


def list_fits(folder: Path) -> list[Fit | DataError]:
    """Return all fits of a campaign, the oldest first, those that cannot be read as the error that says why."""
    found: list[Fit | DataError] = []
    for path in sorted(folder.glob("*.json"), key=lambda path: path.stem):
        try:
            found.append(_read(path))
        except DataError as error:
            found.append(error)
    return found


def _read(path: Path) -> Fit:
    from pydantic import TypeAdapter, ValidationError

    try:
        fit = TypeAdapter(Fit).validate_python(_content(path))
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None
    except ValidationError as error:  # a ValueError, too
        first = error.errors()[0]
        fault = f"{'.'.join(map(str, first['loc'])) or 'the file'}: {first['msg']}"
    except ValueError as error:
        fault = str(error)
    else:
        fault = bent(fit.section)
        if not fault:
            return fit
    raise DataError(f"{path}: not as cfid writes it: {fault}. Delete it and fit again.")


def _content(path: Path) -> Any:
    """Return a file's content with the keys of today. Raises DataError for a newer format, ValueError for no JSON."""
    from pydantic_core import from_json

    content = from_json(path.read_bytes())
    if not isinstance(content, dict):
        return content
    if isinstance(found := content.pop("format", 1), int) and found > FORMAT:
        raise DataError(
            f"{path}: has format {found}, written by a newer cfid; this one reads formats up to {FORMAT}. Update cfid."
        )
    old = [(rejection, content.pop("doubts", [])), (warning, content.pop("warnings", []))]
    findings = [finding("of-an-older-version", text) for finding, said in old for text in said]
    return content | {
        "section": as_of_now(content.get("section")),
        "findings": content.get("findings") or findings,
    }


def _text(value: Any) -> str:
    return str(value.isoformat())
