"""The fits folder of a campaign: every fit with its parameters, quality, findings and figures.

parameters.toml has one fit of each kind, for programs that need numbers; this folder keeps all of them, for the report
and to compare repeated fits.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError
from pydantic_core import from_json

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, rejection, warning
from cfid.records.files import check_format, check_regular, locked_folder, read_small, write_whole
from cfid.records.parameters import Section, plain, section_fault, with_current_keys

FORMAT = 3  # format 1 had no format number, and sentences without codes; format 2 had no options


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A fit: its section's name, its command and its results; the figures' paths are relative to the campaign.

    `quality` and `findings` are those of --json, `lines` the further lines of the terminal output. `options` are the
    command's options that differ from their defaults, by name; None where they are unknown.
    """

    name: str
    command: str
    section: Section
    quality: Mapping[str, Any]
    findings: tuple[Finding, ...] = ()
    lines: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()
    options: Mapping[str, Any] | None = None

    @property
    def hashes(self) -> frozenset[str]:
        """The hashes of the fit's sources: two fits with the same set are of the same measurement."""
        return frozenset(source.sha256 for source in self.section.sources)


def keep_fit(folder: Path, fit: Fit) -> Path:
    """Write a fit to a new file and return its path.

    A file name that is not UTF-8 gets a question mark for each invalid byte, so that the fit stays readable.
    Raises ConfigError when the folder cannot be written.
    """
    stem = f"{fit.section.found:%Y-%m-%d_%H%M%S}_{fit.name}"
    try:
        folder.mkdir(exist_ok=True)
        with locked_folder(folder):
            number = 1
            while (path := folder / f"{stem}{f'-{number}' if number > 1 else ''}.json").exists():
                number += 1
            write_whole(path, _as_json(fit))
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}.") from None
    return path


def rewritten(path: Path) -> bytes | None:
    """Return a fit's file in the current format, None where it is current. Raises DataError when it cannot be read."""
    content = _as_json(_read(path))
    try:
        return None if f'"format": {FORMAT}'.encode() in path.read_bytes()[:40] else content
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None


def _as_json(fit: Fit) -> bytes:
    content = {"format": FORMAT} | plain(asdict(fit)) | {"findings": [one.as_json() for one in fit.findings]}
    text = json.dumps(content, indent=1, allow_nan=False, default=_text, ensure_ascii=False)
    return text.encode("utf-8", "replace")


def list_fits(folder: Path) -> list[Fit | DataError]:
    """Return all fits of a campaign, oldest first; an unreadable one as its error."""
    found: list[Fit | DataError] = []
    for path in sorted(folder.glob("*.json"), key=lambda path: path.stem):
        try:
            found.append(_read(path))
        except DataError as error:
            found.append(error)
    return found


def in_force(fits: Iterable[Fit], sections: Mapping[str, Section]) -> dict[str, Fit]:
    """Return, by section, the fit whose numbers parameters.toml has, else the last one; `fits` has the oldest first."""

    def is_held(fit: Fit) -> bool:
        held = sections.get(fit.name)
        return held is not None and (held.found, held.sources) == (fit.section.found, fit.section.sources)

    return {fit.name: fit for fit in sorted(fits, key=is_held)}


@cache
def _validator() -> TypeAdapter[Fit]:
    """Return the validator of fits, cached since creating it takes longer than validating a file."""
    return TypeAdapter(Fit)


def _read(path: Path) -> Fit:
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
    """Return a file's content with current keys. Raises DataError for its format, ValueError for invalid JSON."""
    check_regular(path)
    content = from_json(read_small(path))
    if not isinstance(content, dict):
        return content
    check_format(path, content.pop("format", 1), newest=FORMAT)
    findings = [
        *(rejection("of-an-older-version", text) for text in content.pop("doubts", [])),
        *(warning("of-an-older-version", text) for text in content.pop("warnings", [])),
    ]
    return content | {
        "section": with_current_keys(content.get("section")),
        "findings": _with_sentences(content.get("findings")) or findings,
    }


def _with_sentences(findings: Any) -> Any:
    """Return a file's findings as the class has them: `text`, which names all places, becomes `sentence`."""
    if not isinstance(findings, list) or not all(isinstance(one, dict) for one in findings):
        return findings
    return [{"sentence" if key == "text" else key: value for key, value in one.items()} for one in findings]


def _text(value: Any) -> str:
    return str(value) if isinstance(value, Path) else str(value.isoformat())
