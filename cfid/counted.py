"""Counts in sentences, in the singular and the plural."""


def counted(count: int, one: str, many: str = "") -> str:
    """Return a count and what is counted: `1 run`, `3 runs`, or `many` where an s does not make the plural of `one`."""
    return f"{count} {one if count == 1 else many or f'{one}s'}"
