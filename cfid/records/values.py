"""Which numbers count: those of one section among several with a quantity, and a stored fit's beside a new one's."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from cfid.quantities.registry import is_of_the_run
from cfid.records.parameters import Parameter, Section

_CLEARLY = 2.0  # a standard uncertainty that grew by more than this factor is clearly larger


class FoundParameter(NamedTuple):
    """A parameter, its section of parameters.toml, and whether its fit rejected it."""

    name: str
    section: Section
    parameter: Parameter
    rejected: bool


def find_parameter(sections: Mapping[str, Section], key: str) -> FoundParameter | None:
    """Return a parameter from the latest section in which it is accepted, else the latest; None if none has it."""
    holding = [
        FoundParameter(name, section, section.parameters[key], key in section.rejected)
        for name, section in sections.items()
        if key in section.parameters
    ]
    return max(holding, key=lambda one: (not one.rejected, one.section.found, one.name), default=None)


def lost_by(new: Section, stored: Section) -> str:
    """Return what would be lost if a new fit replaced a stored one, in words that follow "this one"; "" for nothing.

    An accepted fit of the same recordings and more loses nothing, whatever its numbers are: it knows more.
    """
    if not stored.accepted:
        return ""
    if not new.accepted:
        return "was rejected"
    recordings, before = ({source.run or source.path for source in one.sources} for one in (new, stored))
    if before <= recordings:
        return ""
    keys = [key for key in stored.parameters if key not in stored.rejected and not is_of_the_run(key)]
    missing = [key for key in keys if key not in new.parameters or key in new.rejected]
    larger = []
    for key in (key for key in keys if key not in missing):
        numbers, old = ([*one.parameters[key].numbers(key)] for one in (new, stored))
        pairs = zip(numbers, old, strict=True) if len(numbers) == len(old) else ()  # else of another form
        times = max(((one.std or math.inf) / was.std for one, was in pairs if was.std), default=0.0)
        if times > _CLEARLY:
            larger.append(f"{key} ({f'{times:.2g} times' if times < math.inf else 'unknown'})")
    parts = (("lacks", missing), ("has larger standard uncertainties of", larger))
    return " and ".join(f"{what} {', '.join(of)}" for what, of in parts if of)
