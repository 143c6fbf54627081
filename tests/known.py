"""A count of losses that has to be known."""


def known(count: int | None) -> int:
    """Return a count; fail where it is unknown."""
    assert count is not None, "unknown"
    return count
