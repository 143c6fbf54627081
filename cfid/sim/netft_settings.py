"""Simulates a Net F/T's web pages: its configurations, rate and buffer. No records, no port."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit
from xml.sax.saxutils import escape

from cfid.sim.loadcell import LoadCellTruth
from cfid.wire.rdt import LONGEST_BUFFER

_UNBIASED = (0,) * 6


@dataclass(frozen=True, kw_only=True)
class Configuration:
    """One of the box' 16 configurations: counts per unit, units, ranges Fx to Tz in these units."""

    name: str
    calibration_serial: str = "FT12345"
    counts_per_force: int
    counts_per_torque: int
    force_unit: str
    torque_unit: str
    ranges: tuple[float, ...]


def configurations_of(truth: LoadCellTruth) -> tuple[Configuration, Configuration]:
    """Return a configuration in pounds, as delivered, and one in N and Nm with the cell's true scales.

    Applying the first while the second is active gives readings 4.4 times too large.
    """
    delivered = Configuration(
        name="Default",
        counts_per_force=1_000_000,
        counts_per_torque=1_000_000,
        force_unit="lbf",
        torque_unit="lbf-in",
        ranges=(5.0, 5.0, 15.0, 10.0, 10.0, 10.0),
    )
    metric = Configuration(
        name="Thrust stand",
        counts_per_force=round(truth.counts_per_n),
        counts_per_torque=round(truth.counts_per_nm),
        force_unit="N",
        torque_unit="Nm",
        ranges=truth.ranges,
    )
    return delivered, metric


class BoxSettings:
    """The settings of one box, which silently ignores invalid values, as the real one does."""

    def __init__(
        self,
        *,
        internal_hz: int,
        rate_hz: float,
        buffer_size: int,
        configurations: Sequence[Configuration],
        active: int,
        product: str = "Net F/T",
        firmware: str = "2.2.62",
    ) -> None:
        """Take the settings as they are at power-up; `active` is the index of the configuration in use."""
        self.internal_hz = internal_hz
        self.step = _step(internal_hz, rate_hz)
        self.buffer_size = buffer_size
        self.enabled = True
        self.bias_counts: tuple[int, ...] = _UNBIASED
        self.configurations = tuple(configurations)
        self.active = active
        self._product = product
        self._firmware = firmware

    @property
    def configuration(self) -> Configuration:
        """The configuration in use."""
        return self.configurations[self.active]

    def page(self, index: int | None, *, status: int) -> str:
        """Return netftapi2.xml for a configuration; without an index, or with one too large, for the active one."""
        known = index is not None and 0 <= index < len(self.configurations)
        shown = self.active if index is None or not known else index
        tags = self._tags(self.configurations[shown], status=status)
        lines = (f"<{name}>{escape(str(text))}</{name}>" for name, text in tags.items())
        return "\n".join(('<?xml version="1.0" encoding="UTF-8"?>', "<netft>", *lines, "</netft>", ""))

    def apply(self, path_and_query: str) -> bool:
        """Apply the setting in a request; return whether its page exists."""
        target = urlsplit(path_and_query)
        query = {name: values[-1] for name, values in parse_qs(target.query).items()}
        if target.path == "/comm.cgi":
            self._set_communication(query)
        elif target.path == "/setting.cgi":
            self._set_bias(query)
        else:
            return False
        return True

    def _set_communication(self, query: Mapping[str, str]) -> None:
        rate_hz = _whole(query.get("comrdtrate"))
        if rate_hz is not None and 1 <= rate_hz <= self.internal_hz:
            self.step = _step(self.internal_hz, rate_hz)
        buffer_size = _whole(query.get("comrdtbsiz"))
        if buffer_size is not None and 1 <= buffer_size <= LONGEST_BUFFER:
            self.buffer_size = buffer_size
        if query.get("comrdte") in ("0", "1"):
            self.enabled = query["comrdte"] == "1"

    def _set_bias(self, query: Mapping[str, str]) -> None:
        counts = [_whole(query.get(f"setbias{axis}")) for axis in range(6)]
        known = tuple(count for count in counts if count is not None)
        if len(known) == len(_UNBIASED):
            self.bias_counts = known

    def _tags(self, shown: Configuration, *, status: int) -> dict[str, object]:
        return {
            "runstat": f"{status:08X}",
            "prodname": self._product,
            "mfgdigver": self._firmware,
            "setcfgsel": self.active,
            "setbias": _joined(self.bias_counts),
            "cfgnam": shown.name,
            "cfgcalsn": shown.calibration_serial,
            "cfgcpf": shown.counts_per_force,
            "cfgcpt": shown.counts_per_torque,
            "scfgfu": shown.force_unit,
            "scfgtu": shown.torque_unit,
            "cfgmr": _joined(shown.ranges),
            "cfgtfx": _joined((0, 0, 0, 0, 0, 0)),
            "comrdte": "Enabled" if self.enabled else "Disabled",
            # Rounded down: setting the rate that is shown then changes nothing.
            "comrdtrate": self.internal_hz // self.step,
            "comrdtbsiz": self.buffer_size,
        }


def _step(internal_hz: int, rate_hz: float) -> int:
    """Return the internal samples from one record to the next: other rates become the next faster one that exists."""
    return int(internal_hz // rate_hz)


def _whole(text: str | None) -> int | None:
    try:
        return None if text is None else int(text)
    except ValueError:
        return None


def _joined(values: Sequence[float]) -> str:
    return ";".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)
