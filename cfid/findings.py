"""Findings about a result: each has a code, a severity, the quantities it concerns, and a sentence."""

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal

Severity = Literal["note", "warning", "rejection"]

SEVERITIES: tuple[Severity, ...] = ("note", "warning", "rejection")


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A rejection removes the quantities that it concerns, a warning is printed with them, a note is information.

    `code` is a row of docs/reference/findings.md. `quantities` are keys, or patterns of keys such as `swing.*`; a
    finding without any concerns the whole result. `text` is one sentence or a few: what was found, with the numbers,
    the limit, and the next step.
    """

    code: str
    severity: Severity
    text: str
    quantities: tuple[str, ...] = ()

    def concerns(self, key: str) -> bool:
        """Return whether it concerns a quantity."""
        return not self.quantities or any(fnmatchcase(key, pattern) for pattern in self.quantities)


def note(code: str, text: str, *quantities: str) -> Finding:
    """Return a note: information that does not change the result."""
    return Finding(code=code, severity="note", text=text, quantities=quantities)


def warning(code: str, text: str, *quantities: str) -> Finding:
    """Return a warning about quantities that are given nevertheless."""
    return Finding(code=code, severity="warning", text=text, quantities=quantities)


def rejection(code: str, text: str, *quantities: str) -> Finding:
    """Return a rejection, the reason why quantities are not given."""
    return Finding(code=code, severity="rejection", text=text, quantities=quantities)


def texts(findings: Iterable[Finding], *severities: Severity) -> tuple[str, ...]:
    """Return the sentences of the findings of some severities, each once."""
    return tuple(dict.fromkeys(finding.text for finding in findings if finding.severity in severities))


def rejected(findings: Iterable[Finding], keys: Iterable[str]) -> dict[str, str]:
    """Return the rejected quantities with their reasons: among `keys`, and those that a rejection names."""
    against = [finding for finding in findings if finding.severity == "rejection"]
    named = (key for finding in against for key in finding.quantities if "*" not in key)
    reasons = {key: [finding.text for finding in against if finding.concerns(key)] for key in (*keys, *named)}
    return {key: " ".join(dict.fromkeys(found)) for key, found in reasons.items() if found}
