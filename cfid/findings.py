"""Findings about a result: each has a code, a severity, the quantities it concerns, and a sentence."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, Literal

Severity = Literal["note", "warning", "rejection"]

SEVERITIES: tuple[Severity, ...] = ("note", "warning", "rejection")

# Of what readers find in recordings: the severity of each code, and its sentence with the values that it needs.
CODES: dict[str, tuple[Severity, str]] = {
    "crossing-impossible": (
        "warning",
        "{count} of {rows} reports whose command is not 0 to 65535 are left out (first: {value:g} in line {line}).",
    ),
    "crossing-repeated": (
        "warning",
        "{count} of {rows} reports that repeat the one before are left out (first: {value:g} in line {line}).",
    ),
    "decimal-comma": ("note", "numbers are read with decimal commas."),
    "device-restarted": (
        "warning",
        "the stamps start anew {times} (first: line {line}): the device was restarted. Times on both sides are joined "
        "by when rows arrived.",
    ),
    "force-hung": (
        "warning",
        "{count} of {rows} samples repeat the one before for long (first at {first_s:.4g} s): the load cell hung. "
        "Record the sines of that time again.",
    ),
    "force-impossible": (
        "warning",
        "{count} of {rows} rows with a value that no load cell measures are left out (first: {value:.9g} in line "
        "{line}).",
    ),
    "force-outliers": (
        "warning",
        "{count} of {rows} samples lie off those around them, or far beyond all others, and are left out (first at "
        "{first_s:.4g} s).",
    ),
    "force-scale-assumed": (
        "warning",
        "counts are read as {counts:.0f} a unit: state `counts_per_n` and `counts_per_nm` where it is another.",
    ),
    "force-status": (
        "warning",
        "{count} of {rows} samples have a status that is not 0 (first: line {line}): {meaning}.",
    ),
    "force-stuck": (
        "warning",
        "{axis} repeats one value in {count} of {rows} samples (first at {first_s:.4g} s), which are left out: the "
        "load cell's wire, or its reading, failed.",
    ),
    "forces-described": ("note", "above its columns the file states {lines}."),
    "index-unused": ("warning", "not used: column {names}; it may have {known}."),
    "last-line-cut": ("warning", "the last line was cut (it has no end) and is left out."),
    "last-line-unended": (
        "warning",
        "the last line has no end: it is used, but if the file was cut there, its last number may lack digits.",
    ),
    "lines-left-out": (
        "warning",
        "{count} of {rows} lines have no number or too many fields and are left out (first: line {line}).",
    ),
    "ping-impossible": (
        "warning",
        "{count} of {rows} round trips that no answer takes are left out (first: {value:.9g} s in line {line}).",
    ),
    "ping-stamp-off": (
        "warning",
        "{count} of {rows} answers whose stamp is off the vehicle's clock are left out (first: {value:.9g} in line "
        "{line}).",
    ),
    "recording-cut": ("warning", "the run was cut{or_grows}; the rows on disk are used."),
    "recording-failed": ("warning", "the run failed ({reason}); the recorded rows are used."),
    "recording-simulated": ("warning", "recorded on the simulated rig."),
    "rows-changed": ("warning", "{recorded} recorded, but {file} has {rows}: the file was changed since."),
    "rows-without-number": (
        "warning",
        "{count} of {rows} rows lack a number of {names} and are left out (first: line {line}).",
    ),
    "samples-lost": ("warning", "{samples} lost while recording."),
    "samples-lost-unknown": ("warning", "how many samples are missing is unknown."),
    "samples-not-taken": (
        "warning",
        "{samples} never taken ({achieved}): the device or this computer was slow.",
    ),
    "stamps-in-ms": (
        "warning",
        "the column of stamps is no clock in microseconds, it went {device_s:.4g} s in {here_s:.4g} s: it counts "
        "milliseconds, name it device_ms in rig.toml. Times are those of arrival, which a busy computer makes late.",
    ),
    "stamps-no-clock": (
        "warning",
        "the column of stamps is no steady clock in microseconds, it went {device_s:.4g} s in {here_s:.4g} s: it "
        "jumps, or counts another unit. Times are those of arrival, which a busy computer makes late.",
    ),
    "stamps-wrong": (
        "warning",
        "{count} of {rows} rows whose stamp is off that of the rows around are left out (first: line {line}): did the "
        "line lose a letter? Send a checksum with it.",
    ),
    "time-gaps": (
        "warning",
        "{gaps} without rows, the longest of {longest_s:.4g} s after line {line} ({at_s:.4g} s); rows are usually "
        "{usual_ms:.3g} ms apart.",
    ),
    "time-repeats": ("warning", "{count} of {rows} rows repeat the time of the previous one."),
    "time-replaced": ("note", "the times in '{name}' are not used: rows are {rate_hz:g} Hz apart by `rate_hz`."),
    "time-sorted": ("warning", "time goes back in {count} of {rows} rows: rows are sorted by it."),
}

_MOST_NAMES = 2  # of places that a sentence names
_WORD = re.compile(r"(?!cfid)(?:a|[a-z]{2,})(?=[ ,'])")  # an ordinary word, not a name or a symbol


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A rejection, which removes the quantities that it concerns, a warning, which is printed with them, or a note.

    `code` is a row of docs/reference/findings.md. `quantities` are keys, or patterns of keys such as `swing.*`; a
    finding without quantities concerns the whole result. `sentence` is one sentence or a few: what was found, with the
    numbers, the limit, and the next step. `where` names the files, runs, commands or mounts that the finding is about,
    if any.
    """

    code: str
    severity: Severity
    sentence: str
    quantities: tuple[str, ...] = ()
    where: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The sentence after its places: up to two places by name; of more, the first and the number of the others."""
        if len(self.where) > _MOST_NAMES:
            return f"{self.where[0]} and {len(self.where) - 1} more: {self.sentence}"
        return f"{', '.join(self.where)}: {self.sentence}" if self.where else self.sentence

    def at(self, place: str) -> "Finding":
        """Return the finding with `place` as its only place."""
        return replace(self, where=(place,))

    def as_json(self) -> dict[str, Any]:
        """Return the finding's object in --json."""
        return {"code": self.code, "severity": self.severity, "quantities": self.quantities, "text": self.text}

    def concerns(self, key: str) -> bool:
        """Return whether the finding concerns a quantity."""
        return not self.quantities or any(fnmatchcase(key, pattern) for pattern in self.quantities)


def note(code: str, sentence: str, *quantities: str) -> Finding:
    """Return a note: information that does not change the result."""
    return Finding(code=code, severity="note", sentence=sentence, quantities=quantities)


def warning(code: str, sentence: str, *quantities: str) -> Finding:
    """Return a warning about quantities that remain in the result."""
    return Finding(code=code, severity="warning", sentence=sentence, quantities=quantities)


def rejection(code: str, sentence: str, *quantities: str) -> Finding:
    """Return a rejection: the reason why quantities are removed from the result."""
    return Finding(code=code, severity="rejection", sentence=sentence, quantities=quantities)


def finding(code: str, *quantities: str, **values: Any) -> Finding:
    """Return the finding of a code in `CODES`, with the values that its sentence needs."""
    severity, sentence = CODES[code]
    return Finding(code=code, severity=severity, sentence=sentence.format(**values), quantities=quantities)


def of_recording(name: str, notes: Iterable[str | Finding]) -> tuple[Finding, ...]:
    """Return what the reader of a recording found, at its name; texts become warnings."""
    return tuple((warning("recording", note) if isinstance(note, str) else note).at(name) for note in notes)


def merged(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return each finding once, in the original order; a finding made in several places names all of them."""
    places: dict[Finding, dict[str, None]] = {}
    for finding in findings:
        places.setdefault(replace(finding, where=()), {}).update(dict.fromkeys(finding.where))
    return tuple(replace(finding, where=tuple(names)) for finding, names in places.items())


def texts(findings: Iterable[Finding], *severities: Severity) -> tuple[str, ...]:
    """Return the texts of the findings with the given severities, each once."""
    return tuple(dict.fromkeys(finding.text for finding in merged(findings) if finding.severity in severities))


def begun(text: str) -> str:
    """Return a text for the beginning of a line: with a capital, unless its first word is a name or a symbol."""
    return text[0].upper() + text[1:] if _WORD.match(text) else text


def joined(sentences: Iterable[str]) -> str:
    """Return the sentences as one text, each sentence once."""
    first, *others = dict.fromkeys(sentences) or [""]
    return " ".join([first, *map(begun, others)])


def rejected(findings: Iterable[Finding], keys: Iterable[str]) -> dict[str, str]:
    """Return the rejected quantities with their reasons: those among `keys`, and those that a rejection names."""
    against = [finding for finding in findings if finding.severity == "rejection"]
    named = (key for finding in against for key in finding.quantities if "*" not in key)
    reasons = {key: [finding.text for finding in against if finding.concerns(key)] for key in (*keys, *named)}
    return {key: joined(found) for key, found in reasons.items() if found}
