"""Take each reading of gyro and accelerometer once where a log repeats it in several rows, and report that.

Commands that a log repeats while its sensors continue are reported as well.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from cfid.estimate.held_readings import Readings, once_each
from cfid.findings import Finding, note, warning

Array = npt.NDArray[np.float64]
Timed = tuple[Array, Array]

GYRO, ACCELEROMETER = "gyro", "accelerometer"
_HELD_S = 0.003  # the longest time for which commands are held without a finding: drives have steps of 2 ms
# The quantities whose uncertainty contains the age.
_CONCERNED = {GYRO: "flight.delay_s", ACCELEROMETER: "flight.single_lag_s"}


def first_rows(sensors: Mapping[str, Timed]) -> tuple[tuple[Timed, ...], dict[str, Readings]]:
    """Return the times (k,) and values (k, 3) of those of the sensors' rows (n,) that have a new reading.

    The counts of rows and readings follow, by the sensor's name.
    """
    found, readings = list[Timed](), dict[str, Readings]()
    for name, (time_s, values) in sensors.items():
        counts, readings[name] = once_each(time_s, values)
        found.append((time_s[counts], values[counts]))
    return tuple(found), readings


def commands_apart_s(time_s: Array, command: Array, readings: Mapping[str, Readings]) -> float:
    """Return the usual time between commands (n,) in rows at times (n,).

    Where both the readings of a sensor and the commands are repeated, rows of the log were filled in, and the commands
    in between were not logged. If every row has a new reading of each sensor, it was the autopilot that held the
    commands.
    """
    if any(one.age_s for one in readings.values()):
        time_s = time_s[once_each(time_s, command)[0]]
    return float(np.median(np.diff(time_s)))


def commands_held_s(commands: Sequence[Timed], readings: Mapping[str, Readings]) -> float:
    """Return the time for which motors' commands (n,) are repeated while each row has a new reading, 0 if they are not.

    The log does not show whether the autopilot holds the commands or only the log does.
    """
    first_s = commands[0][0]
    # Commands in the same series of rows.
    alike = [values for time_s, values in commands if len(time_s) == len(first_s)]
    if any(one.age_s for one in readings.values()):
        return 0.0
    _, found = once_each(first_s, np.column_stack(alike))
    held_s = found.age_s * found.rows / max(found.read, 1)
    return held_s if held_s > _HELD_S else 0.0


def held_findings(held_s: float) -> list[Finding]:
    """Return a warning on commands that are repeated for this time, none for 0."""
    if not held_s:
        return []
    text = (
        f"commands are repeated for {1e3 * held_s:.2g} ms, while sensors go on. If the log alone holds them, and the "
        f"autopilot changes them more often, delays come out up to {1e3 * held_s / 2:.2g} ms short, and lags some per "
        f"cent long: the standard uncertainty of flight.delay_s contains {1e3 * held_s / 2 / math.sqrt(3):.2g} ms for "
        "that. Log every command."
    )
    return [warning("flight-commands-held", text, "flight.delay_s", "flight.rising_s", "flight.falling_s")]


def repeated_findings(readings: Mapping[str, Readings]) -> list[Finding]:
    """Return a note on repeated readings, by sensor; none where each row has its own."""
    held = {name: one for name, one in readings.items() if one.age_s}
    if not held:
        return []
    each = ", ".join(
        f"the {name}'s in about {rows / read:.2g} rows ({1 / row_s:.3g} rows a second show {read / rows / row_s:.3g})"
        for name, (rows, read, row_s) in held.items()
    )
    age_s = max(one.age_s for one in held.values())
    text = (
        f"readings are repeated: {each}. The first row of each counts, and may show it up to {1e3 * age_s:.3g} ms "
        f"late: the standard uncertainty of {' and '.join(_CONCERNED[name] for name in held)} contains "
        f"{1e3 * age_s / math.sqrt(3):.2g} ms for that."
    )
    return [note("flight-readings-repeated", text, *(_CONCERNED[name] for name in held))]
