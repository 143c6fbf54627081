"""Interprets a load cell's status word, for the two families of devices that speak RDT.

Sources. Net F/T: ATI's manual 9620-05-NET FT, section "System Status Code" (18.2 in revision 11), as the public client
github.com/netft decodes it from revision 23; the section itself was not at hand. Ethernet Axia: ATI's manual
9610-05-Ethernet Axia-09, section 4.8, table 4.7, which also states which bits are no errors; bit 7 from
9620-05-C-Ethernet Axia-02, section 5.5; bit 26 from public clients alone.
"""

from collections.abc import Mapping
from typing import Literal, NamedTuple

Family = Literal["netft", "axia"]

_ANY_ERROR = 31

_NETFT: Mapping[int, str] = {
    1: "its web server failed",
    2: "its own temperature is wrong",
    3: "its reference voltage or power supervision is wrong",
    4: "no data from the transducer",
    5: "supply of the analog board too low",
    6: "supply of the analog board too high",
    7: "artificial ground of the analog board out of range",
    8: "current through the gages too low",
    9: "current through the gages too high",
    10: "watchdog of the analog board",
    11: "flash memory failed",
    12: "EEPROM failed",
    13: "stack check failed",
    14: "watchdog",
    16: "a threshold is latched",
    17: "saturation, or the converter failed",
    18: "DeviceNet failed",
    19: "EtherNet/IP failed",
    20: "RDT failed",
    21: "CAN failed",
    22: "network failed",
    23: "the configuration does not fit the calibration",
    24: "a setting is not valid",
    25: "halted by errors of its configuration",
    26: "its program is damaged",
    27: "the link to the transducer failed",
    28: "the analog board failed",
    29: "the digital board failed",
    30: "processor or memory failed",
}
_AXIA: Mapping[int, str] = {
    0: "temperature out of range",
    1: "supply voltage out of range",
    2: "broken gage",
    3: "busy with a change of its settings, which may touch readings for a moment",
    5: "an error of another kind",
    7: "calibration not accessible",
    16: "a monitored condition is latched",
    26: "a gage is near its limit",
    27: "a gage is out of range",
    28: "simulated error",
    29: "calibration checksum error",
    30: "force or torque out of range",
}
_WARNINGS: Mapping[Family, frozenset[int]] = {"netft": frozenset({16}), "axia": frozenset({3, 16, 26, 28})}


class Status(NamedTuple):
    """What a status word reports: faults, which invalidate the readings, and warnings, which do not."""

    faults: tuple[str, ...]
    warnings: tuple[str, ...]


def family_of(product: str) -> Family:
    """Return the family of a box with this product name."""
    return "axia" if "axia" in product.lower() else "netft"


def read_status(word: int, family: Family) -> Status:
    """Return the faults and warnings of a status word, none for a healthy 0.

    A bit that no source names is a fault, reported by its number. Bit 31 only summarizes the others: alone, it is a
    fault without a name.
    """
    names = _NETFT if family == "netft" else _AXIA
    bits = [bit for bit in range(_ANY_ERROR) if word >> bit & 1]
    sentences = {bit: names.get(bit, f"status bit {bit}") for bit in bits}
    faults = tuple(sentences[bit] for bit in bits if bit not in _WARNINGS[family])
    warnings = tuple(sentences[bit] for bit in bits if bit in _WARNINGS[family])
    if word >> _ANY_ERROR & 1 and not bits:
        faults = ("an error without a name",)
    return Status(faults, warnings)
