"""The note on a fact of the rig that neither an option nor a rig.toml stated."""


def assumed(what: str, setting: str) -> str:
    """Return the note; `what` is the fact with its value and its verb, and `setting` overrides the fact."""
    return f"{what} assumed, as in version 0.1: no rig.toml stated it when this was recorded. `{setting}` overrides it."
