"""Check that the gyro turns as the attitude of the same log does: this shows axes and signs, and needs no motors."""

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, rejection
from cfid.flight.rows import AXES, ROW_S, Flight

Array = npt.NDArray[np.float64]

_SMOOTHED_ROWS = 10  # the attitude's rows are noisy, and may come at 30 Hz
_FEWEST_ROWS = 500
_ALIKE = 0.5  # the least correlation of interest; public logs have 0.7 to 0.9
_MORE_ALIKE = 0.2  # the least excess of the correlation over that with the axis of the same name


def turning_findings(flight: Flight) -> list[Finding]:
    """Reject a flight whose gyro and attitude turn about different axes, or opposite ways; none without attitude."""
    both = turning_of(flight)
    if both is None:
        return []
    alike = _correlations(*both)
    faults = []
    for axis, row in zip(AXES, alike, strict=True):
        place = int(np.argmax(np.abs(row)))
        if abs(row[place]) > _ALIKE and abs(row[place]) > row[AXES.index(axis)] + _MORE_ALIKE:
            way = "as" if row[place] > 0 else "against"
            faults.append(f"about {axis} {way} the attitude about {AXES[place]}")
    if not faults:
        return []
    text = f"the gyro turns {', '.join(faults)}: one of them has other axes than forward, left and up."
    return [rejection("flight-gyro-unlike-attitude", text).at(flight.name)]


def turning_of(flight: Flight) -> tuple[Array, Array] | None:
    """Return the smoothed rates (k, 3) of gyro and of attitude in the air in rad/s, without their means.

    Returns None where less than 5 s have both.
    """
    known = flight.airborne[1:] & flight.airborne[:-1]
    if flight.attitude is None or np.count_nonzero(known) < _FEWEST_ROWS:
        return None
    attitude = flight.attitude
    turned = attitude[1:] - attitude[:-1]
    w, vector = attitude[:-1, :1], attitude[:-1, 1:]
    # Twice the vector part of the quaternion's conjugate times its change is the rotation vector.
    of_attitude = 2 / ROW_S * (w * turned[:, 1:] - turned[:, :1] * vector - np.cross(vector, turned[:, 1:]))
    window = np.ones(_SMOOTHED_ROWS) / _SMOOTHED_ROWS

    def smoothed(values: Array) -> Array:
        smooth = np.column_stack([np.convolve(column, window, "same") for column in values.T])[known]
        return np.asarray(smooth - smooth.mean(axis=0))

    return smoothed((flight.rates[1:] + flight.rates[:-1]) / 2), smoothed(of_attitude)


def _correlations(rates: Array, of_attitude: Array) -> Array:
    """Return the correlations (3, 3) of the gyro's rates (k, 3), by row, with an attitude's (k, 3), by column."""
    sizes = [np.maximum(np.linalg.norm(one, axis=0), 1e-12) for one in (rates, of_attitude)]
    return np.asarray(rates.T @ of_attitude / np.outer(*sizes))
