"""Reduce a load cell's record of one command in wind to one mean force, less the tare.

The tare is taken with the wind on and the rotors standing, so that it also contains the force of the wind on the body
(section 4.4.3).
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.estimate.held_readings import rows_a_reading
from cfid.estimate.signals import quiet_mean
from cfid.estimate.staircase import Point, Words, reduce_single
from cfid.findings import Finding, note, warning

Array = npt.NDArray[np.float64]
Window = tuple[float, float]

_THESIS_TARE = 500  # samples, C.3.1, prepare_data
_FEWEST = 16  # the least samples of a window
_LOOKED_AT = 100_000  # the samples that are searched for repeated readings


class MeanForce(NamedTuple):
    """Mean force (3,) in the load cell's frame, N, with its standard uncertainty (3,), and its window."""

    force_n: Array
    std_n: Array
    window_s: Window
    findings: tuple[Finding, ...] = ()


def mean_force(
    *, time_s: Array, force_n: Array, command: int, status: Words | None = None, window_s: Window | None = None
) -> MeanForce:
    """Average forces (n, 3) at times (n,) where they are steady, less the tare before and, if there is one, after.

    A given window is used unchanged. Raises DataError or FitError when there is no tare before the command, when no
    command is found, or when nothing is steady.
    """
    found = reduce_single(time_s=time_s, channels=force_n, command=command, status=status, window=window_s)
    (point,) = found.steady()
    lacking = () if found.tare_after is not None else (_no_baseline_after(),)
    return of_point(point, findings=(*lacking, *_repeated(time_s, force_n)))


def of_point(point: Point, *, findings: tuple[Finding, ...] = ()) -> MeanForce:
    """Return a steady point of a staircase as a mean force; the point's first three channels are the forces."""
    return MeanForce(point.mean[:3], point.std_of_mean[:3], (point.begin_s, point.end_s), findings)


def mean_force_thesis(
    *, time_s: Array, force_n: Array, command: int, status: Words | None = None, window_s: Window | None = None
) -> MeanForce:
    """Average forces (n, 3) as prepare_data of C.3.1 does: over a given window, less the mean of the first 500 samples.

    Without a given window, the steady one is used. Raises DataError when the record or its window is too short.
    """
    if len(time_s) <= _THESIS_TARE:
        raise DataError(f"{len(time_s)} samples: the thesis takes its tare from the first {_THESIS_TARE}.")
    chosen = window_s or mean_force(time_s=time_s, force_n=force_n, command=command, status=status).window_s
    first, last = np.searchsorted(time_s, chosen)
    if last - first < _FEWEST:
        raise DataError(
            f"the window from {chosen[0]:g} to {chosen[1]:g} s has {last - first} samples; {_FEWEST} are needed."
        )
    rate_hz = (len(time_s) - 1) / float(time_s[-1] - time_s[0])
    tare, steady = force_n[:_THESIS_TARE], force_n[first:last]
    std = [quiet_mean(part.T, rate_hz=rate_hz).std for part in (tare, steady)]
    return MeanForce(steady.mean(axis=0) - tare.mean(axis=0), np.hypot(*std), chosen)


def _repeated(time_s: Array, force_n: Array) -> tuple[Finding, ...]:
    """Return a note where rows repeat the readings of the load cell: their scatter is then that of fewer readings."""
    rows = rows_a_reading(force_n[:_LOOKED_AT, 2])
    if rows == 1:
        return ()
    rate_hz = (len(time_s) - 1) / float(time_s[-1] - time_s[0])
    text = (
        f"each reading of the load cell is repeated in about {rows} rows: {rate_hz:.3g} rows a second show "
        f"{rate_hz / rows:.3g} readings. Each counts once."
    )
    return (note("drag-forces-repeated", text, "drag.*"),)


def _no_baseline_after() -> Finding:
    text = "no baseline follows the command, so the load cell's drift until then is unknown."
    return warning("no-baseline-after", text, "drag.*")
