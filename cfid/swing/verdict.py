"""Judge a swing as soon as it is recorded, by the same fit that is used later."""

import math

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError, FitError
from cfid.findings import joined, texts
from cfid.recordings.angle import angle_record
from cfid.recordings.stamps import CLOCK_CODES
from cfid.records.rig_file import EncoderScale
from cfid.records.run import Run
from cfid.swing.body import rig_around, threads_of
from cfid.swing.pendulum import NO_THREADS
from cfid.swing.result import estimate

Array = npt.NDArray[np.float64]

_STILL_S, _BEFORE_S = 2.0, 0.3
_MOVED_DEG = 4.0  # within _BEFORE_S: dry friction does not stop such a fast pendulum at once, but slows it down before


def verdict(run: Run) -> str:
    """State how accurate a recorded swing is. Raises DataError or FitError where it is unusable."""
    record = angle_record(run)
    _check_end(record.time_s, record.angle_rad)
    rig = rig_around([record], None)
    mount = None if rig is None else rig.mounts.get(record.label.axis or "")
    threads = NO_THREADS if rig is None else threads_of(mount, rig.site.gravity_mps2)
    fitted = estimate(record, threads, EncoderScale() if rig is None else rig.encoder, method="default")
    swing = fitted.window
    if not fitted.merits["accepted"]:
        of_clock = (one for one in record.findings if one.code in CLOCK_CODES)
        raise FitError(joined([*texts(fitted.findings, "rejection"), *texts(of_clock, "warning")]))
    if swing is None:
        raise DataError(f"{record.path}: holds no angle over time.")
    degrees = math.degrees(float(np.max(np.abs(swing.peak_angle_rad))))
    line = (
        f"{counted(swing.peaks_used, 'peak')} from {degrees:.0f} degrees, {1e3 * fitted.merits['rms']:.2g} mrad off "
        "the pendulum."
    )
    return joined([line, *texts(swing.findings, "warning")])


def of_no_mount(run: Run) -> str:
    """State the angle of a recording without a mount or weight. Raises DataError where it did not turn."""
    turned_deg = math.degrees(float(np.ptp(angle_record(run).angle_rad)))
    if not turned_deg:
        raise DataError("the angle never changes: is the sensor connected, and did the body turn?")
    return (
        f"turned over {turned_deg:.3g} degrees. No fit takes it by itself: `cfid fit swing` does with its name and its "
        "`axis`, where it is a swing."
    )


def _check_end(time_s: Array, angle_rad: Array) -> None:
    """Raise DataError where the angle (n,) at times (n,) stops suddenly in the middle of a swing, and stays.

    A body that turned over the top is not judged here: its fit reports that.
    """
    changes = np.flatnonzero(np.diff(angle_rad))
    if not len(changes) or np.ptp(angle_rad) > 2 * math.pi:
        return
    last = changes[-1] + 1
    still_s, before = time_s[-1] - time_s[last], angle_rad[time_s >= time_s[last] - _BEFORE_S]
    moved_deg = math.degrees(float(np.ptp(before)))
    if still_s >= _STILL_S and moved_deg >= _MOVED_DEG:
        raise DataError(
            f"the angle does not change in the last {still_s:.1f} s, and moved by {moved_deg:.0f} degrees in the "
            f"{_BEFORE_S:g} s before (limit {_MOVED_DEG:g}): the encoder froze, or something held the pendulum."
        )
