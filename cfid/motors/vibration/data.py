"""Windows of a load cell's record in which rotors vibrate, and the rotors' speeds there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.estimate.signals import without_spikes
from cfid.estimate.staircase import LAGS, Point
from cfid.findings import Finding, joined, note, texts, warning
from cfid.motors.data import channels_of
from cfid.motors.vibration.estimation import FEWEST, RotorSpeed, rotor_speed
from cfid.recordings.wrench import AXES, WrenchRecord

Array = npt.NDArray[np.float64]

_SCREENED_S, _FEWEST = 0.2, 16  # screened for spikes at once: seconds, and samples at least


@dataclass(frozen=True, kw_only=True)
class Rotors:
    """Facts about the vibration: rotors that ran (None: as the run states), blades, hum, and the range of speeds."""

    number: int | None = None
    blades: int = 2
    mains_hz: float | None = None
    expected_rad_per_s: tuple[float, float] | None = None


def quiet_channels(record: WrenchRecord) -> Array:
    """Return the measured channels (n, k) of a record without spikes, since a single spike hides a rotor's lines.

    Raises DataError for a record too short to have a rate.
    """
    if len(record.time_s) < _FEWEST:
        raise DataError(f"{counted(len(record.time_s), 'sample is', 'samples are')} too few for a rotor speed.")
    rate_hz = (len(record.time_s) - 1) / float(record.time_s[-1] - record.time_s[0])
    length = max(round(_SCREENED_S * rate_hz), _FEWEST)
    measured = [AXES.index(axis) for axis in record.axes]
    return without_spikes(channels_of(record).T[measured], length=length).T


class VibrationRecord:
    """A record of the load cell in which rotors vibrate, and before which they are at rest until `rest_s`.

    Lines that are there at rest, such as hum of the mains, are no rotor's.
    """

    def __init__(self, record: WrenchRecord, rotors: Rotors, *, rest_s: float = 0.0) -> None:
        """Remove the spikes."""
        self._time_s, self._rotors = record.time_s, rotors
        self._channels = quiet_channels(record)
        rest = self._channels[: np.searchsorted(record.time_s, rest_s)]
        self._rest = rest if len(rest) >= FEWEST else None

    def speed_in(self, begin_s: float, end_s: float, *, rotors: int) -> RotorSpeed:
        """Return the speed in a window; `rotors` is how many ran there, unless their number was given."""
        first, last = np.searchsorted(self._time_s, (begin_s, end_s))
        return rotor_speed(
            time_s=self._time_s[first:last],
            wrench=self._channels[first:last],
            expected_rad_per_s=self._rotors.expected_rad_per_s,
            blades=self._rotors.blades,
            rotors=self._rotors.number or rotors,
            mains_hz=self._rotors.mains_hz,
            rest_wrench=self._rest,
        )

    def speed_of_step(self, point: Point, *, rotors: int = 1) -> RotorSpeed:
        """Return the speed in a step's window, after twice as many time constants as for the step's mean thrust.

        The transient of the step affects phases for longer than a mean, and would pass for a second rotor. `rotors` is
        how many ran where the step does not state which.
        """
        begin_s = min(point.begin_s + LAGS * point.lag_s, (point.begin_s + point.end_s) / 2)
        return self.speed_in(begin_s, point.end_s, rotors=len(point.motors) or rotors)


def speeds_from_vibration(
    points: Sequence[Point], record: WrenchRecord, rotors: Rotors, *, motors: int | None, rest_s: float
) -> tuple[Array, Array, tuple[Finding, ...]]:
    """Return speeds and standard uncertainties (p,) from vibration in the windows, NaN where a speed is rejected.

    `motors` is how many ran where the points do not state which; until `rest_s`, none did.
    """
    vibration = VibrationRecord(record, rotors, rest_s=rest_s)
    found = [vibration.speed_of_step(point, rotors=motors or 1) for point in points]
    speed, std = (
        np.array([getattr(one, name) if one.accepted else np.nan for one in found])
        for name in ("speed_rad_per_s", "std_rad_per_s")
    )
    left_out = tuple(
        warning(
            "speed-step-left-out",
            f"command {point.command}: {joined(texts(one.findings, 'rejection'))} Its speed is left out.",
            "motor.speed_poly",
        ).at(record.name)
        for point, one in zip(points, found, strict=True)
        if not one.accepted
    )
    text = "no tachometer: the rotors' speed is estimated from the load cell's vibration."
    return speed, std, (note("speed-from-vibration", text, "motor.speed_poly").at(record.name), *left_out)
