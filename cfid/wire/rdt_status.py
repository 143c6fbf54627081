"""What the bits of a load cell's status word say, for the two families that speak RDT."""

from collections.abc import Mapping
from typing import Literal, NamedTuple

Family = Literal["netft", "axia"]

_ANY_ERROR = 31
_LATCHED_THRESHOLD = 16

# Manual of the Net F/T (9610-05-1022), table of system status bits; bits 0 to 14 are those of the board that
# digitises the gages. What is not named there is told by its number.
_NETFT: Mapping[int, str] = {
    0: "watchdog reset of the gage board",
    1: "the gage board's converter check is too high",
    2: "the gage board's converter check is too low",
    3: "the gage board's artificial ground is out of range",
    4: "supply voltage too high",
    5: "supply voltage too low",
    6: "bad active calibration",
    7: "the gage board's EEPROM failed",
    8: "configuration invalid",
    11: "sensor too hot",
    12: "sensor too cold",
    14: "CAN bus error",
    16: "a threshold is latched",
    17: "saturation, or the converter failed",
}
# Manual of the Ethernet Axia (9610-05-Ethernet Axia), section 4.8.
_AXIA: Mapping[int, str] = {
    0: "temperature out of range",
    1: "supply voltage out of range",
    2: "broken gage",
    3: "busy",
    5: "hardware or stack error",
    16: "a monitored condition is latched",
    26: "a gage is near its limit",
    27: "a gage is out of range",
    28: "simulated error",
    29: "calibration checksum error",
    30: "force or torque out of range",
}
_WARNINGS: Mapping[Family, frozenset[int]] = {
    "netft": frozenset({_LATCHED_THRESHOLD}),
    "axia": frozenset({_LATCHED_THRESHOLD, 26}),
}


class Status(NamedTuple):
    """What a status word says: faults that spoil the readings, and warnings that do not."""

    faults: tuple[str, ...]
    warnings: tuple[str, ...]


def read_status(word: int, family: Family) -> Status:
    """Return the sentences of a status word; both empty for a healthy 0.

    Bit 31 only sums up the others: alone, it is a fault without a name.
    """
    names = _NETFT if family == "netft" else _AXIA
    bits = [bit for bit in range(_ANY_ERROR) if word >> bit & 1]
    said = {bit: names.get(bit, f"status bit {bit}") for bit in bits}
    faults = tuple(said[bit] for bit in bits if bit not in _WARNINGS[family])
    warnings = tuple(said[bit] for bit in bits if bit in _WARNINGS[family])
    if word >> _ANY_ERROR & 1 and not bits:
        faults = ("an error without a name",)
    return Status(faults, warnings)
