"""The sentences of a fit's findings."""

from typing import Any

from cfid.findings import texts


def rejections(found: Any) -> tuple[str, ...]:
    return texts(found.findings, "rejection")


def remarks(found: Any) -> tuple[str, ...]:
    return texts(found.findings, "warning", "note")
