"""Reject what a platform cannot have: quantities that were found, and numbers that were typed or read."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from cfid.findings import Finding, rejection
from cfid.quantities.plausible import implausible, out_of_range
from cfid.quantities.quantity import Range
from cfid.records.parameters import Parameter, plain
from cfid.records.rig_file import Rig

_OTHERWISE = 'For another kind of body write platform = "other" under [vehicle] in rig.toml.'


class Given(NamedTuple):
    """A number that was typed or read, with its name, plausible range and the range's unit."""

    name: str
    number: float
    expected: Range
    unit: str


def implausible_quantities(quantities: Mapping[str, Parameter], rig: Rig | None) -> tuple[Finding, ...]:
    """Return a rejection for each quantity outside what the rig's platform can have."""
    if _any_body(rig):
        return ()
    faults = {key: implausible(key, plain(found.value)) for key, found in quantities.items()}
    return tuple(rejection("implausible", f"{fault} {_OTHERWISE}", key) for key, fault in faults.items() if fault)


def implausible_inputs(given: Iterable[Given], rig: Rig | None, *resting: str) -> tuple[Finding, ...]:
    """Return a rejection of the quantities that rest on each number outside what the rig's platform can have."""
    if _any_body(rig):
        return ()
    faults = (out_of_range(f"the {one.name} is implausible", one.number, one.expected, one.unit) for one in given)
    return tuple(rejection("implausible-input", f"{fault} {_OTHERWISE}", *resting) for fault in faults if fault)


def _any_body(rig: Rig | None) -> bool:
    return rig is not None and rig.vehicle.platform == "other"
