"""Leave out rows in which a sensor of three axes repeats one value while the vehicle moves: it hung or was not read."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.records.tables.repeated import repeated

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Timed = tuple[Array, Array]

_MOST = 0.5  # of a sensor's rows; where more repeat, it is logged that way


def without_hung(sensors: Mapping[str, Timed]) -> tuple[tuple[Timed, ...], tuple[str, ...]]:
    """Return times (n,) and values (n, 3) of two sensors without the rows in which an axis hung, and sentences on them.

    Where all axes of both repeat one value, the vehicle stands still in a simulator, and the rows stay.
    """
    axes = [_repeated(*timed) for timed in sensors.values()]
    still = [(time_s, one.all(axis=1).astype(float)) for (time_s, _), one in zip(sensors.values(), axes, strict=True)]
    found, notes = list[Timed](), list[str]()
    for (name, (time_s, values)), one, other in zip(sensors.items(), axes, still[::-1], strict=True):
        wrong = one.any(axis=1) & ~(one.all(axis=1) & (np.interp(time_s, *other) > 0))
        if np.mean(wrong) > _MOST:
            wrong[:] = False
        if wrong.any():
            notes.append(
                f"{name}: {counted(int(np.count_nonzero(wrong)), 'row')} of {len(wrong)} left out in which it repeats "
                f"one value while the vehicle moves (the first {time_s[np.argmax(wrong)] - time_s[0]:.4g} s after its "
                "begin): it hung, or was not read."
            )
        found.append((time_s[~wrong], values[~wrong]))
    return tuple(found), tuple(notes)


def _repeated(time_s: Array, values: Array) -> Mask:
    """Return where each axis of values (n, 3) at times (n,) repeats one value for long.

    Repeats at the end of an axis's range do not count: they were measured.
    """
    inside = np.abs(values) < np.abs(values).max(axis=0)
    return np.asarray(inside & np.column_stack([repeated(time_s, axis) for axis in values.T]))
