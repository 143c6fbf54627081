"""What stands beside an identified transfer function: the thesis' calculation and results, and the thrust map."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cfid.console.inputs import Workplace

if TYPE_CHECKING:
    from cfid.transfer.thesis import ThesisFit

_TYPICAL = 0.1  # of the slope, by which a static gain may be off before it is worth a word


@dataclass(frozen=True, kw_only=True)
class Beside:
    """Lines for a person, figures for --json, and what is to be said."""

    lines: tuple[str, ...] = ()
    quality: Mapping[str, Any]
    warnings: tuple[str, ...] = ()


def thesis_beside(fit: "ThesisFit | str", gain_n: float, lag_s: float | None) -> str:
    """Return what C.2.5 makes of the same runs, and how far off it is."""
    if isinstance(fit, str):
        return f"as the thesis calculates: nothing: {fit}"
    return (
        f"as the thesis calculates, latency left out: {_against(fit.static_gain_n, fit.time_constant_s, gain_n, lag_s)}"
    )


def compared(name: str | None, gain_n: float, lag_s: float | None) -> Beside:
    """Compare a static gain and a time constant with one of the thesis' published functions, if one is named."""
    from cfid.transfer.model import EQ_3_15, EQ_3_16

    if name is None:
        return Beside(quality={})
    published = EQ_3_15 if name == "eq3.15" else EQ_3_16
    gain, lag = published.static_gain_n, published.lags_s[0]
    return Beside(
        lines=(f"({name.removeprefix('eq')}) of the thesis: {_against(gain, lag, gain_n, lag_s)}",),
        quality={name: {"static_gain_n": gain, "time_constant_s": lag}},
    )


def map_slope(workplace: Workplace, gain_n: float, *, command: float) -> Beside:
    """Compare a static gain with the slope of the campaign's thrust map at the sine's middle, if it has one."""
    slope = _slope(workplace, command)
    if slope is None:
        return Beside(quality={"thrust_map_slope_n": None})
    off = gain_n / slope - 1
    warning = (
        f"the static gain is {100 * off:+.0f} % off the thrust map's slope: are channel, arm and --yaw-deg those of "
        "the rig, and is the battery as full as for the map?"
    )
    return Beside(
        lines=(f"slope of the thrust map at {command:.0f}: {slope:.4g} N; the static gain is {100 * off:+.2f} % off",),
        quality={"thrust_map_slope_n": slope, "static_gain_off_slope": off},
        warnings=(warning,) if abs(off) > _TYPICAL else (),
    )


def _slope(workplace: Workplace, command: float) -> float | None:
    from cfid.records.parameters import load_sections

    if workplace.campaign is None:
        return None
    section = load_sections(workplace.campaign.parameters_file).get("thrust")
    poly = None if section is None else section.parameters.get("motor.thrust_poly")
    if poly is None:
        return None
    order = len(poly.value) - 1
    return float(
        sum(value * (order - place) * command ** (order - place - 1) for place, value in enumerate(poly.value[:-1]))
    )


def _against(other_gain_n: float, other_lag_s: float | None, gain_n: float, lag_s: float | None) -> str:
    """Return another gain and time constant, and how far they are off ours."""
    told = f"static gain {other_gain_n:.4g} N ({100 * (other_gain_n / gain_n - 1):+.1f} %)"
    if other_lag_s is None or lag_s is None:
        return f"{told}, no decay that makes a time constant"
    return f"{told}, time constant {1e3 * other_lag_s:.2f} ms ({100 * (other_lag_s / lag_s - 1):+.1f} %)"
