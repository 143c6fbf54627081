"""Rotor speeds in the windows of a load cell's record: heard in its vibration, and as the vehicle told them."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.console.lists import span
from cfid.console.messages import note
from cfid.console.options import positive
from cfid.errors import DataError

if TYPE_CHECKING:
    from cfid.estimate.staircase import Point
    from cfid.motors.vibration.estimation import RotorSpeed
    from cfid.records.run import Run
    from cfid.records.tables.wrench import WrenchRecord

_ROTOR = "Rotor"
_SCREENED_S, _FEWEST = 0.2, 16  # for spikes, at once


@dataclass(frozen=True, kw_only=True)
class RotorOptions:
    """What vibrates."""

    rotors: Annotated[
        int | None, typer.Option(min=1, max=4, help="Rotors that ran; a run knows it.", rich_help_panel=_ROTOR)
    ] = None
    blades: Annotated[int, typer.Option(min=1, max=6, help="Blades of a propeller.", rich_help_panel=_ROTOR)] = 2
    mains_hz: Annotated[float | None, typer.Option(help="Hum to leave out, 50 or 60.", rich_help_panel=_ROTOR)] = None
    expect: Annotated[
        str | None,
        typer.Option(metavar="FROM:TO", help="Speeds to look for, in rad/s.", rich_help_panel=_ROTOR),
    ] = None

    @property
    def expected_rad_s(self) -> tuple[float, float] | None:
        """The speeds to look for. Raises ConfigError for what is no range."""
        if self.expect is None:
            return None
        low, high = span(self.expect, "--expect", unit="rad/s", example="400:3500")
        return positive(low, "--expect"), high


def quiet_channels(record: "WrenchRecord") -> Any:
    """Return the channels (n, 6) of a record without spikes: one drowns a rotor's lines.

    Raises DataError for a record too short to have a rate.
    """
    import numpy as np

    from cfid.estimate.signals import without_spikes

    if len(record.time_s) < _FEWEST:
        raise DataError(f"{record.path}: {len(record.time_s)} samples tell no rotor speed.")
    rate_hz = (len(record.time_s) - 1) / float(record.time_s[-1] - record.time_s[0])
    rows = np.column_stack([record.force_n, record.torque_nm]).T
    return without_spikes(rows, length=max(round(_SCREENED_S * rate_hz), _FEWEST)).T


class Ear:
    """Listens to a record of the load cell."""

    def __init__(self, record: "WrenchRecord", options: RotorOptions) -> None:
        """Take the spikes off."""
        self._time_s, self._options = record.time_s, options
        self._channels = quiet_channels(record)

    def hear(self, begin_s: float, end_s: float, *, rotors: int) -> "RotorSpeed":
        """Return the speed in a window in which so many rotors ran, unless the options say how many."""
        import numpy as np

        from cfid.motors.vibration.estimation import rotor_speed

        first, last = np.searchsorted(self._time_s, (begin_s, end_s))
        return rotor_speed(
            time_s=self._time_s[first:last],
            wrench=self._channels[first:last],
            expected_rad_per_s=self._options.expected_rad_s,
            blades=self._options.blades,
            rotors=self._options.rotors or rotors,
            mains_hz=self._options.mains_hz,
        )

    def hear_step(self, point: "Point", *, rotors: int) -> "RotorSpeed":
        """Return the speed in a step's window, from twice as many time constants on as its mean of thrust takes.

        Phases tell what is left of the step longer than a mean does: it would pass for a second rotor.
        """
        from cfid.estimate.windows import LAGS

        begin_s = min(point.begin_s + LAGS * point.lag_s, (point.begin_s + point.end_s) / 2)
        return self.hear(begin_s, point.end_s, rotors=len(point.motors) or rotors)

    def hear_steps(self, points: "Sequence[Point]", *, rotors: int = 1) -> "list[RotorSpeed]":
        """Return the speed in each step's window; so many rotors ran where the steps do not know it."""
        if sys.stderr.isatty():
            note(f"listening to {len(points)} windows, some seconds each.")
        return [self.hear_step(point, rotors=rotors) for point in points]


def told_speeds(run: "Run", points: "Sequence[Point]", began_s: float) -> Any:
    """Return the mean speed in rad/s that the vehicle told of the rotors that ran in each window, None if it told none.

    Windows count from `began_s`, Unix time.
    """
    import numpy as np

    from cfid.estimate.staircase import mean_beside
    from cfid.records.tables.vehicle import VEHICLE_LOG, holds, read_rows, told_speeds_rad_s

    if not holds(run, VEHICLE_LOG):
        return None
    rows = read_rows(run, VEHICLE_LOG)
    told, time_s = told_speeds_rad_s(rows), rows.time_s - began_s
    if not all(motor in told for point in points for motor in point.motors):
        return None
    return np.array([np.mean([mean_beside([p], time_s, told[motor])[0] for motor in p.motors]) for p in points])


def heard_speeds(
    points: "Sequence[Point]", record: "WrenchRecord", options: RotorOptions, *, motors: int | None
) -> tuple[Any, Any, tuple[str, ...]]:
    """Return speeds and deviations (p,) heard in the windows, NaN where none is believed, and what is to be said.

    So many `motors` ran where the points do not know it.
    """
    import numpy as np

    heard = Ear(record, options).hear_steps(points, rotors=motors or 1)
    speed, std = (
        np.array([getattr(one, name) if one.believed else np.nan for one in heard])
        for name in ("speed_rad_per_s", "std_rad_per_s")
    )
    doubted = tuple(
        f"{record.name}: command {point.command}: {' '.join(one.doubts)} Its speed is left out."
        for point, one in zip(points, heard, strict=True)
        if not one.believed
    )
    said = f"{record.name}: no tachometer: the rotors' speed is heard in the load cell's vibration."
    return speed, std, (said, *doubted)
