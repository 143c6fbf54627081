"""Counts in sentences, in the singular and the plural."""


def counted(count: int, one: str, many: str = "") -> str:
    """Return a count with its noun, as in `1 run` and `3 runs`; `many` is a plural that is not formed with an s."""
    return f"{count} {one if count == 1 else many or f'{one}s'}"
