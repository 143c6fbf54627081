"""Findings about a result: each has a code, a severity, the quantities it concerns, and a sentence."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, Literal, TypeVar

Severity = Literal["note", "warning", "rejection"]
Error = TypeVar("Error", bound=Exception)

SEVERITIES: tuple[Severity, ...] = ("note", "warning", "rejection")

# Of what readers find in recordings: the severity of each code, and its sentence with the values that it needs.
CODES: dict[str, tuple[Severity, str]] = {
    "angle-jumps": (
        "warning",
        "the angle jumps by more than a quarter of a turn in {count} of {rows} samples (first: line "
        "{line}); whole turns may be miscounted from there on.",
    ),
    "angle-outliers": (
        "warning",
        "{count} of {rows} readings of the angle lie off those around them and are left out (first: line {line}).",
    ),
    "angle-words-failed": (
        "warning",
        "{count} of {rows} words fail the check of a 13-bit encoder and are left out (first: line {line}).",
    ),
    "column-empty": ("warning", "'{name}' holds no number: it is not used."),
    "columns-unused": ("warning", "not used: {names}."),
    "columns-with-gaps": (
        "note",
        "columns of which some rows have no number are devices of their own, with the rows that have one: {names}.",
    ),
    "columns-without-number": ("note", "left out, since they hold no number: {names}."),
    "decimal-comma": ("note", "numbers are read with decimal commas."),
    "esc-range-assumed": ("warning", "pulse widths are read as `esc_us` {low:g},{high:g}, commands 0 to {full}."),
    "file-read": (
        "note",
        "{rows} rows {step_ms:.4g} ms apart, angle from column '{column}', from {low_deg:.1f} to "
        "{high_deg:.1f} degrees.",
    ),
    "force-hung": (
        "warning",
        "{count} of {rows} samples repeat the one before for long (first at {first_s:.4g} s): the load "
        "cell hung. Record the sines of that time again.",
    ),
    "force-outliers": (
        "warning",
        "{count} of {rows} samples lie off those around them, or far beyond all others, and are left out "
        "(first at {first_s:.4g} s).",
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
        "{axis} repeats one value in {count} of {rows} samples (first at {first_s:.4g} s), which are "
        "left out: the load cell's wire, or its reading, failed.",
    ),
    "forces-described": ("note", "above its columns the file states {lines}."),
    "gyro-axis": ("note", "the gyro turned about ({x:+.3f}, {y:+.3f}, {z:+.3f}) of the body frame."),
    "gyro-clock-undecided": (
        "rejection",
        "nothing shows whether the log's microseconds run at 84/85 of real time, which would make an "
        "inertia 2.4 % wrong. Import it again with `clock` 84/85 or true.",
    ),
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
    "log-bytes-behind": (
        "warning",
        "a whole log of {rows} records, whose CRC32 matches, ends at byte {end} of {size}: what is behind is not used.",
    ),
    "log-clock": ("note", "the vehicle's microseconds are read at {clock} of their rate: {why}."),
    "log-clock-unknown": (
        "warning",
        "the log does not show whether its microseconds are true or run at 84/85 of real time, as on a "
        "Crazyflie 2.x with firmware up to 2026.08: they are read as true. Import it with `clock` true "
        "or 84/85.",
    ),
    "log-commands": ("note", "commands are {first} to {last}, as far as the log shows them."),
    "log-cut": ("warning", "the log was cut: it ends within a record, and what followed is missing."),
    "log-damaged": (
        "warning",
        "its CRC32 does not match, or bytes are damaged: the {rows} records before byte {end} of {size} are used.",
    ),
    "log-dropouts": ("warning", "{count} dropouts, of {lost_s:.3f} s together."),
    "log-frames-left-out": ("warning", "log {log}: {count} frames do not follow from those before: left out."),
    "log-motors": ("note", "motors have the Crazyflie's numbers: m1 to m4 are {own}, by {why}."),
    "log-of-several": (
        "note",
        "{count} flights are in it: flight {log}, of {rows} rows, is read, and not {others}. Import another by `log`.",
    ),
    "log-outputs-left-out": (
        "warning",
        "{count} outputs of motors are beyond full throttle, which damaged bytes alone show: left out.",
    ),
    "log-parts-damaged": ("warning", "parts of the file are damaged, and left out."),
    "log-sensor-hung": (
        "warning",
        "{name}: {count} of {rows} rows left out in which it repeats one value while the vehicle moves "
        "(the first {at_s:.4g} s after its begin): it hung, or was not read.",
    ),
    "log-time-back": (
        "warning",
        "{event}: time goes back, or a stamp is damaged, at record {row} of {rows}: reading stops there, "
        "at byte {end}. Was the clock set, or are two recordings in one file?",
    ),
    "log-times-left-out": (
        "warning",
        "{count} rows with a time that is not between those of the neighbours are left out.",
    ),
    "log-units-by-names": ("note", "columns with the firmware's names and no unit are read in the firmware's units."),
    "log-values-left-out": (
        "warning",
        "{name}: {count} values that cannot be, the first {first:.4g}{unit} (limits {least:g} and "
        "{most:g}{unit}), are left out.",
    ),
    "rate-assumed": ("warning", "a record over time without a time column: {rate_hz:g} Hz is assumed (`rate_hz`)."),
    "recording-cut": ("warning", "the run was cut{or_grows}; the rows on disk are used."),
    "recording-failed": ("warning", "the run failed ({reason}); the recorded rows are used."),
    "recording-simulated": ("warning", "recorded on the simulated rig."),
    "rows-changed": ("warning", "{recorded} recorded, but {file} has {rows}: the file was changed since."),
    "rows-settled": ("warning", "rows are {step_s:.2g} s apart: each is taken as a settled point."),
    "rows-without-command": ("warning", "{count} of {rows} rows without a command are left out (first: line {line})."),
    "rows-without-number": (
        "warning",
        "{count} of {rows} rows lack a number of {names} and are left out (first: line {line}).",
    ),
    "samples-lost": ("warning", "{samples} lost while recording."),
    "samples-lost-unknown": ("warning", "how many samples are missing is unknown."),
    "samples-not-taken": ("warning", "{samples} never taken ({achieved}): the device or this computer was slow."),
    "series-left-out": ("warning", "left out: {fault}"),
    "sign-turned": ("warning", "'{name}' falls as the motor is driven harder: its sign is changed."),
    "speed-chosen": ("warning", "the speed is '{name}', not 0 in {rows} rows; '{other}' is not used."),
    "speed-electrical": (
        "warning",
        "'{name}' is taken as the rotor's speed, which it is where the stand's program knew the motor's poles.",
    ),
    "speeds-dead": (
        "warning",
        "'{name}' shows 0 in {rows} in which rotors turn: its sensor is dead there, the values are missing.",
    ),
    "speeds-disagree": (
        "warning",
        "'{first}' is {ratio:.3g} times '{second}': '{name}' is taken. The electrical one is right where "
        "the stand's program knew the motor's poles; `columns` names it.",
    ),
    "speeds-zero": ("warning", "'{first}' and '{second}' are 0 throughout: no speed is used."),
    "stamps-no-clock": (
        "warning",
        "the column of stamps is no steady clock in microseconds, it went {device_s:.4g} s in "
        "{here_s:.4g} s: the device was restarted, or counts another unit (if milliseconds, name it device_ms in "
        "rig.toml). Times are those of arrival, which a busy computer makes late.",
    ),
    "stamps-wrong": (
        "warning",
        "{count} of {rows} rows whose stamp is off that of the rows around are left out (first: line "
        "{line}): did the line lose a letter? Send a checksum with it.",
    ),
    "stand-of-motors": (
        "warning",
        "{names}, of {motors}: {divided}. Where another number of motors ran, give `motors`.",
    ),
    "time-gaps": (
        "warning",
        "{gaps} without rows, the longest of {longest_s:.4g} s after line {line} ({at_s:.4g} s); rows "
        "are usually {usual_ms:.3g} ms apart.",
    ),
    "time-repeats": ("warning", "{count} of {rows} rows repeat the time of the previous one."),
    "time-replaced": ("note", "the times in '{name}' are not used: rows are {rate_hz:g} Hz apart by `rate_hz`."),
    "time-sorted": ("warning", "time goes back in {count} of {rows} rows: rows are sorted by it."),
    "values-impossible": (
        "warning",
        "left out: {values} of '{name}' that cannot be (first: {first:g} in line {line}).",
    ),
    "values-missing": ("warning", "'{name}' is no number in {count} of {rows} rows (first: line {line})."),
    "values-off": ("warning", "left out: {values} of '{name}' off those around (first: {first:g} in line {line})."),
    "values-stuck": (
        "warning",
        "left out: {values} of '{name}' that repeat one while the command changes (first: {first:g} in line {line}).",
    ),
    "weight-by-gravity": ("warning", "'{name}' is a weight: grams by {gravity:g} m/s^2."),
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


def explained(error: Error, findings: Iterable[Finding]) -> Error:
    """Return an error with its possible causes as notes: the warnings and rejections among findings."""
    for text in texts(findings, "warning", "rejection"):
        error.add_note(text)
    return error


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
