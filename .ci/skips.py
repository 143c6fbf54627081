"""Count the skips in pytest's short summaries by what they are for. Fails on one that has no good reason.

Usage: python .ci/skips.py LOG...
"""

import re
import sys
from collections import Counter
from pathlib import Path

NOT_INSTALLED = Path(".venv/not-installed")
GOOD_REASONS = {
    "for hardware": r"is plugged in",
    "for absent data": r"(is|are) not here",
    "for what this user or kernel may not do": r"only root|no right|no loopback address|no sockets here",
}


def kind_of(reason: str, not_installed: list[str]) -> str | None:
    """Return what a test was skipped for, None if that is no good reason."""
    if any(re.search(rf"\b{name}\b", reason) for name in not_installed):
        return "for what cannot be installed here"
    return next((kind for kind, pattern in GOOD_REASONS.items() if re.search(pattern, reason)), None)


def main(logs: list[str]) -> None:
    """Print the counts, and exit with 1 if there is another skip."""
    not_installed = NOT_INSTALLED.read_text(encoding="utf-8").split() if NOT_INSTALLED.exists() else []
    counts, others = Counter[str](), []
    for log in logs:
        text = Path(log).read_text(encoding="utf-8")
        for count, what in re.findall(r"^SKIPPED \[(\d+)\] (.*)$", text, re.MULTILINE):
            kind = kind_of(what, not_installed)
            counts[kind or "for other reasons"] += int(count)
            if kind is None:
                others.append(what)
    sys.stdout.write("skipped: " + (", ".join(f"{count} {kind}" for kind, count in counts.items()) or "none") + "\n")
    if others:
        sys.exit("\n".join(["these tests have to run here:", *others]))


if __name__ == "__main__":
    main(sys.argv[1:])
