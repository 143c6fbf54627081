"""Compare a static gain and a time constant with those of the thrust map, of the thesis method, and of the thesis."""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from cfid.findings import Finding, warning
from cfid.records.result import Dependent
from cfid.transfer.model import EQ_3_15, EQ_3_16

Published = Literal["eq3.15", "eq3.16"]

_LARGEST_OFF_SLOPE = 0.1  # of the thrust map's slope: the largest difference of a static gain without a warning


_GAIN, _LAG = "tf.static_gain_n", "tf.time_constant_s"


class GainAndLag(NamedTuple):
    """A static gain in N, and a time constant in s, which is None without a decay."""

    gain_n: float
    lag_s: float | None

    def text(self, ours: "GainAndLag") -> str:
        """Return both values, each with its difference from ours."""
        gain = f"static gain {self.gain_n:.4g} N ({100 * (self.gain_n / ours.gain_n - 1):+.1f} %)"
        if self.lag_s is None or ours.lag_s is None:
            return f"{gain}, no decay that makes a time constant"
        return f"{gain}, time constant {1e3 * self.lag_s:.2f} ms ({100 * (self.lag_s / ours.lag_s - 1):+.1f} %)"


@dataclass(frozen=True)
class Comparison:
    """The values that a static gain and a time constant are compared with.

    `slope_n` is the thrust map's slope in N at `command`, the middle of the sines; `published` names a function of the
    thesis.
    """

    slope_n: float | None
    command: float
    published: Published | None

    def merits(self, ours: GainAndLag) -> dict[str, Any]:
        """Return the figures of the comparison."""
        found: dict[str, Any] = {"thrust_map_slope_n": self.slope_n}
        if self.slope_n is not None:
            found["static_gain_off_slope"] = Dependent(ours.gain_n / self.slope_n - 1, _GAIN)
        other = self.other
        named = {} if other is None else {self.published: other}
        return {
            **found,
            "compared": {
                name: {"static_gain_n": own.gain_n, "time_constant_s": own.lag_s} for name, own in named.items()
            },
        }

    def findings(self, ours: GainAndLag) -> tuple[Finding, ...]:
        """Return a warning where the static gain differs from the slope of the thrust map."""
        off = 0.0 if self.slope_n is None else ours.gain_n / self.slope_n - 1
        if abs(off) <= _LARGEST_OFF_SLOPE:
            return ()
        text = (
            f"the static gain is {100 * off:+.0f} % off the thrust map's slope (limit {100 * _LARGEST_OFF_SLOPE:.0f} "
            "%): are channel, arm and yaw those of the rig, and is the battery as full as for the map?"
        )
        return (warning("gain-off-map-slope", text, _GAIN),)

    def lines(self, ours: GainAndLag) -> list[Dependent]:
        """Return the comparison as text."""
        lines = []
        if self.slope_n is not None:
            off = ours.gain_n / self.slope_n - 1
            slope = f"slope of the thrust map at {self.command:.0f}: {self.slope_n:.4g} N"
            lines.append(Dependent(f"{slope}; the static gain is {100 * off:+.2f} % off", _GAIN))
        if self.other is not None and self.published is not None:
            lines.append(compared(f"({self.published.removeprefix('eq')}) of the thesis: {self.other.text(ours)}"))
        return lines

    @property
    def other(self) -> GainAndLag | None:
        """The published function's static gain and time constant."""
        if self.published is None:
            return None
        plant = EQ_3_15 if self.published == "eq3.15" else EQ_3_16
        return GainAndLag(plant.static_gain_n, plant.lags_s[0])


def compared(line: str) -> Dependent:
    """Return a line that compares a static gain and a time constant with ours."""
    return Dependent(line, _GAIN, _LAG)
