"""Read and write parameters.toml: a campaign's parameters with standard uncertainty, unit and origin.

The file has one section per fit; a fit replaces its own section only. It has a format number: an older format is
read, and the next fit writes the current one; a newer format is refused.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from cfid.errors import ConfigError, DataError
from cfid.quantities.registry import find
from cfid.quantities.values import Number, numbers, shape_error
from cfid.records.covariances import Covariance, common_fault, covariance_fault
from cfid.records.files import RUNS_FOLDER, check_format, first_fault, locked_folder, read_toml, toml_bytes, write_toml

FORMAT = 2  # format 1 had no format number, covariances, common causes or rejections
_FORMAT_KEY = "format"
_BY_FORCE = "an older cfid rejected this fit, and kept it nevertheless."

Value = Any  # a number, nested lists of numbers, or a list of rows (dicts): what TOML and JSON share


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A value with its standard uncertainty of the same shape (None where there is none) and its unit.

    An unknown number inside either is None or nan; parameters.toml stores both as nan.
    """

    value: Value
    std: Value = None
    unit: str = ""

    def as_json(self) -> dict[str, Value]:
        """Return plain lists and numbers; a number that is not finite becomes None."""
        return {"value": plain(self.value), "std": plain(self.std), "unit": self.unit}

    def numbers(self, key: str) -> Iterator[Number]:
        """Yield the parameter's numbers one by one, named by its key as in `cfid.quantities`."""
        return numbers(key, plain(self.value), plain(self.std))


@dataclass(frozen=True)
class Source:
    """A file that a result came from, and the hash of its content."""

    path: str
    sha256: str

    @property
    def run(self) -> str:
        """The name of the campaign's run in which the file lies, "" for a file outside all runs."""
        parts = Path(self.path).parts
        return parts[1] if parts[:1] == (RUNS_FOLDER,) and len(parts) > 1 else ""


@dataclass(frozen=True, kw_only=True)
class Section:
    """The results of one fit.

    `covariance` covers numbers of the parameters; a parameter in none of its matrices has independent numbers. For
    each cause that the fit shares with others, `common` has the change of parameters per standard uncertainty of the
    cause, in the order of `numbers_of`; the parameters' uncertainties include it. `accepted` is false when a quantity
    that the fit is for was rejected. `rejected` has the reason for each rejected parameter; such a parameter is
    present only where it was kept nevertheless. `rig` is what rig.toml stated at the time about what the fit rests on,
    under rig.toml's keys; `facts` are numbers under such keys that the fit took from its recordings or from an option.
    `suspects` are the mounts whose recordings contradict each other or those of other mounts, or the single run that
    contradicts the others. `runs` has a checksum of what run.toml stated for each of the fit's runs in the campaign.
    """

    method: str
    found: datetime
    cfid_version: str
    accepted: bool
    sources: tuple[Source, ...]
    parameters: Mapping[str, Parameter]
    covariance: tuple[Covariance, ...] = ()
    common: Mapping[str, Mapping[str, list[float]]] = field(default_factory=dict)
    rejected: Mapping[str, str] = field(default_factory=dict)
    rig: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, float] = field(default_factory=dict)
    suspects: tuple[str, ...] = ()
    runs: Mapping[str, str] = field(default_factory=dict)


def runs_of(sources: Iterable[Source]) -> tuple[str, ...]:
    """Return the names of the campaign's runs in which sources lie, each once."""
    return tuple(dict.fromkeys(source.run for source in sources if source.run))


def plain(value: Any) -> Value:
    """Turn arrays and tuples into lists, NumPy scalars into numbers, and numbers that are not finite into None."""
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
    """Read parameters.toml; a campaign without a fit has no such file.

    Raises DataError when the file is invalid.
    """
    return _sections(path, _load(path))


def rewritten(path: Path) -> bytes | None:
    """Return the file in the current format, None where it has that already or does not exist. Raises DataError."""
    if not path.exists() or read_toml(path, DataError).get(_FORMAT_KEY) == FORMAT:
        return None
    sections = _sections(path, _load(path))
    return toml_bytes({_FORMAT_KEY: FORMAT} | {name: _table(section) for name, section in sorted(sections.items())})


def store_section(path: Path, name: str, section: Section) -> None:
    """Replace one section of parameters.toml atomically; the others are unchanged.

    Raises DataError when the file is invalid, ConfigError when it cannot be written; the file is then unchanged.
    """
    change_section(path, name, lambda _: section)


def change_section(path: Path, name: str, change: Callable[[Section | None], Section]) -> None:
    """Replace one section by what `change` returns for it, or for None where it is new. Raises as `store_section`.

    The folder is locked meanwhile, so that no other cfid process writes the file.
    """
    try:
        with locked_folder(path.parent):
            content = _load(path)
            section = change(_sections(path, content).get(name))
            write_toml(path, {_FORMAT_KEY: FORMAT} | dict(sorted((content | {name: _table(section)}).items())))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}. It is unchanged.") from None


def _load(path: Path) -> dict[str, Any]:
    """Return the tables of the file, without its format number."""
    try:
        content = read_toml(path, DataError)
    except FileNotFoundError:
        return {}
    check_format(path, content.pop(_FORMAT_KEY, 1), newest=FORMAT)
    return {name: with_current_keys(table) for name, table in content.items()}


def with_current_keys(table: Any) -> Any:
    """Return a section with current keys; format 1 had `believed`, for all parameters at once."""
    if not isinstance(table, dict) or "believed" not in table:
        return table
    accepted = table.pop("believed")
    parameters = table.get("parameters", {})
    if accepted is False and isinstance(parameters, dict) and not table.get("rejected"):
        table["rejected"] = dict.fromkeys(parameters, _BY_FORCE)
    return table | {"accepted": accepted}


@cache
def _validator() -> TypeAdapter[dict[str, Section]]:
    """Return the validator of sections, cached since creating it takes longer than validating a file."""
    return TypeAdapter(dict[str, Section])


def _sections(path: Path, content: dict[str, Any]) -> dict[str, Section]:
    try:
        sections = _validator().validate_python(content)
    except ValidationError as error:
        fault = first_fault(error, content)
    else:
        faults = ((name, section_fault(section)) for name, section in sections.items())
        fault = next((f"{name}.{what}." for name, what in faults if what), "")
        if not fault:
            return sections
    raise DataError(f"{path}: invalid: {fault} Move it away and fit again.")


def section_fault(section: Section) -> str:
    """Return the first fault of a section that was read, in its time, shapes or covariances; "" where none is."""
    if section.found.tzinfo is None:
        return "found: should have a time zone"
    for key, parameter in section.parameters.items():
        if fault := _parameter_fault(key, parameter):
            return f"parameters.{key}{fault}"
    values = {key: parameter.value for key, parameter in section.parameters.items()}
    for number, covariance in enumerate(section.covariance):
        if fault := covariance_fault(covariance, values):
            return f"covariance {number + 1}: {fault}"
    for cause, effects in section.common.items():
        if fault := common_fault(effects, values):
            return f"common.{cause}: {fault}"
    return ""


def _parameter_fault(key: str, parameter: Parameter) -> str:
    """Return the fault of a parameter's shape, unit or standard uncertainty, "" where none is."""
    if fault := shape_error(key, parameter.value, parameter.std):
        return f": {fault}"
    known = find(key)
    if parameter.unit and known is not None and parameter.unit != known.unit:
        return f": its unit is {parameter.unit!r}, and has to be {known.unit!r}"
    return ".std: should not be below zero" if any(number < 0 for number in _numbers(parameter.std)) else ""


def _numbers(value: Value) -> Iterator[float]:
    if isinstance(value, list):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, int | float):
        yield value


def _table(section: Section) -> dict[str, Any]:
    more: dict[str, Any] = {
        "covariance": [{"of": list(c.of), "matrix": [list(row) for row in c.matrix]} for c in section.covariance],
        "common": {cause: dict(effects) for cause, effects in section.common.items()},
        "rejected": dict(section.rejected),
        "rig": plain(section.rig),
        "facts": dict(section.facts),
        "suspects": list(section.suspects),
        "runs": dict(section.runs),
    }
    return {
        "method": section.method,
        "found": section.found,
        "cfid_version": section.cfid_version,
        "accepted": section.accepted,
        "sources": [asdict(source) for source in section.sources],
        "parameters": {name: _row(parameter) for name, parameter in section.parameters.items()},
        **{key: value for key, value in more.items() if value},
    }


def _row(parameter: Parameter) -> dict[str, Any]:
    std = {} if parameter.std is None else {"std": _for_toml(parameter.std)}
    return {"value": _for_toml(parameter.value), **std, "unit": parameter.unit}


def _for_toml(value: Any) -> Value:
    """Convert like `plain`, but turn unknown numbers into nan: TOML has nan, but no null."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _for_toml(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_for_toml(item) for item in value]
    return math.nan if value is None else value
