"""The parameters of a fit, each with standard uncertainty, unit and origin, and their covariances."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from cfid.quantities.registry import find
from cfid.quantities.values import Number, numbers, shape_error
from cfid.records.covariances import Covariance, common_fault, covariance_fault, numbers_of
from cfid.records.files import RUNS_FOLDER

Value = Any  # a number, nested lists of numbers, or a list of rows (dicts): what TOML and JSON share


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A value with its standard uncertainty of the same shape (None where there is none) and its unit.

    An unknown number inside either is None or nan; files have null for both.
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
    `simulated` is whether any of its recordings is of a simulated rig, wherever it lies.
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
    simulated: bool = False


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
    stds = (number for number in numbers_of("", parameter.std) if isinstance(number, int | float))
    return ".std: should not be below zero" if any(number < 0 for number in stds) else ""
