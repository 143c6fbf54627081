"""What is found about a result: a code, how severe it is, which quantities it concerns, and a sentence."""

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal

Severity = Literal["note", "warning", "rejection"]

SEVERITIES: tuple[Severity, ...] = ("note", "warning", "rejection")


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A rejection takes away the quantities that it concerns, a warning stays beside them, a note is information.

    `code` is a row of docs/reference/findings.md. `quantities` are keys, or patterns of keys such as `swing.*`; a
    finding without any concerns the whole result. `text` is one sentence or a few: what was found, with the numbers,
    the limit, and what to do.
    """

    code: str
    severity: Severity
    text: str
    quantities: tuple[str, ...] = ()

    def concerns(self, key: str) -> bool:
        """Return whether a quantity is one of those that it concerns."""
        return not self.quantities or any(fnmatchcase(key, pattern) for pattern in self.quantities)


def note(code: str, text: str, *quantities: str) -> Finding:
    """Return what the reader of a result should know, and which changes nothing about it."""
    return Finding(code=code, severity="note", text=text, quantities=quantities)


def warning(code: str, text: str, *quantities: str) -> Finding:
    """Return what may be wrong with quantities that are given all the same."""
    return Finding(code=code, severity="warning", text=text, quantities=quantities)


def rejection(code: str, text: str, *quantities: str) -> Finding:
    """Return why quantities are not given."""
    return Finding(code=code, severity="rejection", text=text, quantities=quantities)


def texts(findings: Iterable[Finding], *severities: Severity) -> tuple[str, ...]:
    """Return the sentences of some severities, each once."""
    return tuple(dict.fromkeys(finding.text for finding in findings if finding.severity in severities))


def rejected(findings: Iterable[Finding], keys: Iterable[str]) -> dict[str, str]:
    """Return which quantities are rejected, and why: of some, and those that a rejection names."""
    against = [finding for finding in findings if finding.severity == "rejection"]
    named = (key for finding in against for key in finding.quantities if "*" not in key)
    reasons = {key: [finding.text for finding in against if finding.concerns(key)] for key in (*keys, *named)}
    return {key: " ".join(dict.fromkeys(said)) for key, said in reasons.items() if said}
