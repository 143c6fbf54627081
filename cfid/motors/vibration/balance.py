"""The balance of propellers: the line that a rotor makes at its own frequency, relative to its thrust."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.staircase import FZ, Point, reduce_staircase
from cfid.findings import joined, texts
from cfid.motors.vibration.estimation import rotor_speed

Array = npt.NDArray[np.float64]

_FX, _FY = 0, 1


@dataclass(frozen=True, kw_only=True)
class Balance:
    """Thrust at one command of some motors, and the largest amplitude in Fx and Fy at a rotor's frequency.

    `reason` states why no balance is known; the numbers are NaN then.
    """

    motors: tuple[int, ...]
    thrust_n: float
    line_n: float
    speed_rad_per_s: float
    reason: str = ""

    @property
    def ratio(self) -> float:
        """Amplitude of the line relative to the thrust of one rotor."""
        return self.line_n / (abs(self.thrust_n) / len(self.motors))


def balances(*, time_s: Array, wrench: Array, command_time_s: Array, commands: Array) -> list[Balance]:
    """Return the balance of the rotors at each command.

    `time_s` (n,) and `wrench` (n, 6), Fx to Tz in N and Nm, begin with the motors off; `commands` (m, 4) hold from
    `command_time_s` (m,) on. Raises DataError for a record without a staircase.
    """
    reduced = reduce_staircase(time_s=time_s, channels=wrench, command_time_s=command_time_s, commands=commands)
    rest = wrench[time_s < command_time_s[np.argmax(commands.any(axis=1))]]
    return [_balance(point, time_s=time_s, wrench=wrench, rest=rest) for point in reduced.points]


def _balance(point: Point, *, time_s: Array, wrench: Array, rest: Array) -> Balance:
    motors, reason = point.motors, point.reason
    if not reason:
        first, last = np.searchsorted(time_s, (point.begin_s, point.end_s))
        try:
            found = rotor_speed(
                time_s=time_s[first:last], wrench=wrench[first:last], rotors=len(motors), rest_wrench=rest
            )
        except FitError as error:
            reason = str(error)
        else:
            reason = joined(texts(found.findings, "rejection"))
    if reason:
        return Balance(motors=motors, thrust_n=math.nan, line_n=math.nan, speed_rad_per_s=math.nan, reason=reason)
    lines = [
        float(np.hypot(*rotor.amplitude[rotor.harmonics.index(1), [_FX, _FY]]))
        for rotor in found.rotors
        if 1 in rotor.harmonics
    ]
    return Balance(
        motors=motors,
        thrust_n=float(point.mean[FZ]),
        line_n=max(lines, default=0.0),
        speed_rad_per_s=found.speed_rad_per_s,
    )
