"""Reads a Net F/T's settings from its web pages, and its single readings over TCP port 49151."""

import math
import re
from collections.abc import Mapping
from html import unescape
from typing import NamedTuple
from urllib.parse import urlencode

from cfid.wire.layout import Layout
from cfid.wire.rdt_status import Family, family_of

DEFAULT_ADDRESS = "192.168.1.1"
CONFIGURATION_PATH = "/netftapi2.xml"
FASTEST_HZ = 7000

NEWTONS: Mapping[str, float] = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "klbf": 4448.2216152605, "kgf": 9.80665}
NEWTON_METRES: Mapping[str, float] = {
    "Nm": 1.0,
    "Nmm": 1e-3,
    "kNm": 1e3,
    "lbfin": 0.1129848290276167,
    "lbfft": 1.3558179483314004,
    "kgfcm": 0.0980665,
}

_TAG = re.compile(r"<([A-Za-z]\w*)>([^<>]*)</\1>")

READ_FORCES = bytes(20)  # READFT: command 0, all else zero, so that nothing is biased
READING_BYTES = 16


class Settings(NamedTuple):
    """The box' active configuration, in its own units; `rate_hz` and `buffer_size` are those of RDT."""

    product: str
    firmware: str
    configuration: str
    calibration_serial: str
    counts_per_force: float
    counts_per_torque: float
    force_unit: str
    torque_unit: str
    ranges: tuple[float, ...]
    bias: tuple[float, ...]
    rdt_enabled: bool
    rate_hz: int
    buffer_size: int

    @property
    def family(self) -> Family:
        """The family of devices, which decides the table of status bits."""
        return family_of(self.product)

    @property
    def counts_per_n(self) -> float:
        """Counts per newton."""
        return self.counts_per_force / NEWTONS[self.force_unit]

    @property
    def counts_per_nm(self) -> float:
        """Counts per newton metre."""
        return self.counts_per_torque / NEWTON_METRES[_torque_unit(self.torque_unit)]


class LoadReading(NamedTuple):
    """A single reading over TCP: the upper 16 bits of the status word, and Fx to Tz in the box' scaled counts."""

    status: int
    values: tuple[int, ...]


_READING = Layout(">HH6h", lambda status, *values: LoadReading(status, values), mark=(0x1234,))


def active_configuration(xml: str) -> int:
    """Return the index of the configuration in use. Raises ValueError when the page does not state it."""
    return _whole(_tags(xml), "setcfgsel", least=0)


def configuration_query(index: int) -> str:
    """Return the path and query that requests a configuration."""
    return f"{CONFIGURATION_PATH}?{urlencode({'index': index})}"


def rate_query(*, rate_hz: int, buffer_size: int) -> str:
    """Return the path and query that enables RDT and sets its rate and buffer size."""
    return "/comm.cgi?" + urlencode({"comrdte": 1, "comrdtrate": rate_hz, "comrdtbsiz": buffer_size})


def read_settings(xml: str) -> Settings:
    """Read the page of the active configuration. Raises ValueError naming what is missing or wrong."""
    tags = _tags(xml)
    force_unit, torque_unit = _text(tags, "scfgfu"), _text(tags, "scfgtu")
    if force_unit not in NEWTONS:
        raise ValueError(f"forces are in the unknown unit '{force_unit}' (known: {', '.join(NEWTONS)})")
    if _torque_unit(torque_unit) not in NEWTON_METRES:
        raise ValueError(f"torques are in the unknown unit '{torque_unit}' (known: {', '.join(NEWTON_METRES)})")
    settings = Settings(
        product=_text(tags, "prodname"),
        firmware=tags.get("mfgdigver", ""),
        configuration=tags.get("cfgnam", ""),
        calibration_serial=tags.get("cfgcalsn", ""),
        counts_per_force=_number(tags, "cfgcpf"),
        counts_per_torque=_number(tags, "cfgcpt"),
        force_unit=force_unit,
        torque_unit=torque_unit,
        ranges=_six(tags, "cfgmr"),
        bias=_six(tags, "setbias"),
        rdt_enabled=tags.get("comrdte", "Enabled").lower() in ("enabled", "1", "on"),
        rate_hz=_whole(tags, "comrdtrate", least=1),
        buffer_size=_whole(tags, "comrdtbsiz", least=1),
    )
    for name, unit, counts in (("cfgcpf", "N", settings.counts_per_n), ("cfgcpt", "N m", settings.counts_per_nm)):
        if not 1e-3 <= counts <= 1e12:  # boxes have 200 to 1e8
            raise ValueError(f"<{name}> is '{_text(tags, name)}', {counts:g} counts per {unit}, as no load cell has")
    return settings


def read_reading(data: bytes) -> LoadReading:
    """Read the answer to READ_FORCES. Raises ValueError for anything else."""
    reading = _READING.decode(data)
    if reading is None:
        raise ValueError(f"{len(data)} bytes that are no reading: {data[:8].hex(' ')} ...")
    return reading


def encode_reading(reading: LoadReading) -> bytes:
    """Return a reading's 16 bytes."""
    return _READING.encode(reading.status, *reading.values)


def _tags(xml: str) -> dict[str, str]:
    """Return the page's plain tags; the page is flat, and everything else in it is ignored.

    Texts are cut at 80 characters, which no meaningful text of a box reaches.
    """
    return {name: unescape(text).strip()[:80] for name, text in _TAG.findall(xml)}


def _text(tags: Mapping[str, str], name: str) -> str:
    if name not in tags:
        raise ValueError(f"<{name}> is missing")
    return tags[name]


def _number(tags: Mapping[str, str], name: str) -> float:
    text = _text(tags, name)
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"<{name}> is '{text}', no number") from None


def _whole(tags: Mapping[str, str], name: str, *, least: int) -> int:
    value = _number(tags, name)
    if not (value >= least and value.is_integer()):
        raise ValueError(f"<{name}> is {value:g}, not a whole number from {least}")
    return int(value)


def _six(tags: Mapping[str, str], name: str) -> tuple[float, ...]:
    """Return six finite numbers, or none for a page without them, which is no reason to reject a box."""
    texts = re.split(r"[;,\s]+", tags.get(name, "").strip())
    try:
        numbers = tuple(float(text) for text in texts)
    except ValueError:
        return ()
    return numbers if len(numbers) == 6 and all(map(math.isfinite, numbers)) else ()


def _torque_unit(text: str) -> str:
    return text.replace("-", "").replace(" ", "")
