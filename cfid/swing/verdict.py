"""Judge a swing as soon as it is recorded, by the fit that will take it."""

import math

import numpy as np

from cfid.errors import FitError
from cfid.findings import texts
from cfid.records.run import Run
from cfid.records.tables.angle import angle_record
from cfid.swing.collocation import NO_THREADS
from cfid.swing.data import rig_around, swing_in, threads_of
from cfid.swing.estimation import fit_swing


def verdict(run: Run) -> str:
    """Say what a recorded swing is good for. Raises DataError or FitError where it is good for nothing."""
    record = angle_record(run)
    rig = rig_around([record], None)
    mount = None if rig is None else rig.mounts.get(record.label.axis or "")
    swing = swing_in(record, NO_THREADS if rig is None else threads_of(mount, rig.site.gravity_mps2))
    fitted = fit_swing(swing)
    if not fitted.accepted:
        raise FitError(" ".join(texts(fitted.findings, "rejection")))
    degrees = math.degrees(float(np.max(np.abs(swing.peak_angle_rad))))
    frequency, std = fitted.coefficients.natural_frequency_squared_s2, fitted.std.natural_frequency_squared_s2
    return (
        f"{swing.peaks_used} peaks from {degrees:.0f} degrees, {1e3 * fitted.residual_rms_rad:.2g} mrad off the "
        f"pendulum, inertia known to {100 * std / frequency:.1g} % from the swing alone."
    )
