"""Read the speeds of a thrust stand's sensors: find dead sensors, and average the others."""

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.large import empty, parts
from cfid.records.tables.column_units import spelt
from cfid.records.tables.speed_units import PER_SECOND
from cfid.records.tables.stand_columns import Found
from cfid.records.tables.table import Array

_TURNING_RAD_S = 100.0  # faster than any rotor that stands, slower than any that flies
_LEAST_THRUST = 0.05  # of the largest: above it, a rotor turns
_DRIVEN_THRUST = 0.01  # of the largest, above the load cell's reading at rest: from there on, a driven rotor turns
_FEWEST_AT_REST, _NOISE_STD = 5, 5.0  # rows that show a load cell's noise, and how far it reaches
_OF_NORMAL = 0.67449  # median of the absolute values of normal noise, over its standard deviation


def speeds_of(
    found: Found, command: Array, thrust_n: Array | None, *, settled: bool
) -> tuple[Array | None, tuple[str, ...]]:
    """Return speeds (n, s) with nan for a sensor that shows 0 while rotors turn, and a note.

    Rotors turn where another sensor or the thrust shows it or, in a table of settled points, where a sensor showed it
    at a command that was no larger.
    """
    columns = found.get("speeds_rad_s")
    if columns is None:
        return None, ()
    value = columns.value
    fastest = value.max(axis=1, initial=0.0, where=np.isfinite(value))
    if settled and np.isfinite(command).all():
        fastest = np.array([fastest[command <= one].max() for one in command])
    turning = fastest > _TURNING_RAD_S
    if thrust_n is not None and columns.head.kind == "motor" and np.isfinite(thrust_n).any():
        turning |= _has_thrust(thrust_n, command)
    notes = [
        f"'{name}' is taken as the rotor's speed, which it is where the stand's program knew the motor's poles."
        for name in columns.names
        if "electrical" in name.lower()
    ]
    notes += [
        f"'{name}' is read in turns per second, as 1/s of a speed: write rad/s into its header where it is that."
        for name in columns.names
        if columns.head.factor != 1.0 and PER_SECOND.search(spelt(name))
    ]
    for name, speed in zip(columns.names, value.T, strict=True):
        dead = (speed == 0) & turning
        speed[dead] = np.nan
        if count := int(np.count_nonzero(dead)):
            notes.append(
                f"'{name}' shows 0 in {counted(count, 'row')} in which rotors turn: its sensor is dead there, "
                "the values are "
                "missing."
            )
    return value, tuple(notes)


def _has_thrust(thrust_n: Array, command: Array) -> npt.NDArray[np.bool_]:
    """Return the rows (n,) in which the thrust shows that a rotor turns; a load cell may be untared, or drift."""
    largest = float(np.nanmax(thrust_n))
    if np.isnan(command).all():
        return np.asarray(thrust_n > _LEAST_THRUST * largest)
    at_rest = thrust_n[(command == 0) & np.isfinite(thrust_n)]
    level, reach = 0.0, _DRIVEN_THRUST * largest
    if len(at_rest) >= _FEWEST_AT_REST:
        level = float(np.median(at_rest))
        reach = max(reach, _NOISE_STD * float(np.median(np.abs(at_rest - level))) / _OF_NORMAL)
    return np.asarray((command != 0) & (thrust_n > level + reach))


def mean_of_known(values: Array, power: int = 1) -> Array:
    """Return the mean, or the power mean, of the known values in each row (n,), nan where none is known."""
    if values.shape[1] == 1:
        return values[:, 0]
    found = empty(len(values))
    for part in parts(len(values)):
        known = np.isfinite(values[part])
        with np.errstate(invalid="ignore"):
            mean = np.sum(np.where(known, values[part], 0.0) ** power, axis=1) / known.sum(axis=1)
        found[part] = mean ** (1 / power)
    return found
