"""What a campaign has found: parameters with deviation, unit and origin, in parameters.toml.

One section per fit; a later fit replaces its own section and touches no other.
"""

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import tomli_w

from cfid.durable import write_whole
from cfid.errors import DataError

Value = Any  # a number, nested lists of numbers, or a list of rows (dicts): what TOML and JSON share


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A value with one standard deviation of the same shape (None where there is none) and its unit."""

    value: Value
    std: Value = None
    unit: str = ""

    def as_json(self) -> dict[str, Value]:
        """Return plain lists and numbers; what is not finite becomes None."""
        return {"value": plain(self.value), "std": plain(self.std), "unit": self.unit}


@dataclass(frozen=True)
class Source:
    """A file that a result came from, and the hash of its content."""

    path: str
    sha256: str


@dataclass(frozen=True, kw_only=True)
class Section:
    """All that one fit found."""

    method: str
    found: datetime
    cfid_version: str
    believed: bool
    sources: tuple[Source, ...]
    parameters: Mapping[str, Parameter]


def plain(value: Any) -> Value:
    """Turn arrays and tuples into lists, NumPy scalars into numbers, and what is not finite into None."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def load_sections(path: Path) -> dict[str, Section]:
    """Read parameters.toml; a campaign that has found nothing yet has no such file.

    Raises DataError when the file cannot be understood.
    """
    if not path.exists():
        return {}
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        return {name: _section(table) for name, table in content.items()}
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise DataError(f"{path}: {error}") from None
    except (KeyError, TypeError, AttributeError) as error:
        raise DataError(f"{path}: not as cfid writes it ({error}). Move it away and fit again.") from None


def store_section(path: Path, name: str, section: Section) -> None:
    """Replace one section of parameters.toml, the file at once and whole."""
    sections = load_sections(path) | {name: section}
    content = {key: _table(value) for key, value in sorted(sections.items())}
    write_whole(path, tomli_w.dumps(content, multiline_strings=True).encode())


def _section(table: Mapping[str, Any]) -> Section:
    return Section(
        method=table["method"],
        found=table["found"],
        cfid_version=table["cfid_version"],
        believed=table["believed"],
        sources=tuple(Source(**source) for source in table["sources"]),
        parameters={name: Parameter(**parameter) for name, parameter in table["parameters"].items()},
    )


def _table(section: Section) -> dict[str, Any]:
    parameters = {name: _without_none(parameter.as_json()) for name, parameter in section.parameters.items()}
    return asdict(section) | {
        "sources": [asdict(source) for source in section.sources],
        "parameters": parameters,
    }


def _without_none(value: Value) -> Value:
    """TOML knows no null: an unknown key is left out, an unknown element of a list is written as nan."""
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    if isinstance(value, list):
        return [math.nan if item is None else _without_none(item) for item in value]
    return value
