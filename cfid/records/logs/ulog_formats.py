"""Count a ULog file's fields before a library creates one for each element of each array."""

import re
from pathlib import Path

from cfid.errors import DataError

_MOST_FIELDS = 200_000  # of all subscriptions together; an autopilot's logs have a few thousand
_DEEPEST = 8  # formats inside formats
_FIELD = re.compile(r"(?P<type>[^\[ ]*)(?:\[(?P<count>[^\]]*))?")


class FieldCount:
    """The number of fields in the subscriptions of a log."""

    def __init__(self, path: Path) -> None:
        """Start with no fields of a file."""
        self._path = path
        self._formats: dict[str, str] = {}
        self._known: dict[str, int] = {}
        self._fields = 0

    def define(self, content: bytes) -> None:
        """Add a format, `name:type field;type[count] field`."""
        name, _, fields = content.decode(errors="replace").partition(":")
        self._formats[name] = fields
        self._known = {}

    def subscribe(self, content: bytes) -> None:
        """Add a subscription: instance, number, a format's name. Raises DataError where there are too many fields."""
        self._fields += self._of(content[3:].decode(errors="replace"))
        if self._fields > _MOST_FIELDS:
            raise DataError(f"{self._path}: not readable as a ULog file: it states more than {_MOST_FIELDS} fields.")

    def _of(self, name: str, depth: int = 0) -> int:
        """Return how many fields a format has, including those of formats inside it."""
        if name not in self._formats:
            return 1
        if depth > _DEEPEST:
            return _MOST_FIELDS + 1
        if name not in self._known:
            fields = (_FIELD.match(field) for field in self._formats[name].split(";"))
            self._known[name] = sum(_times(one["count"]) * self._of(one["type"], depth + 1) for one in fields if one)
        return self._known[name]


def _times(count: str | None) -> int:
    try:
        return max(int(count or 1), 1)
    except ValueError:
        return 1
