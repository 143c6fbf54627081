"""Judge a sine as soon as it is recorded: whether its reports came, and whether the load cell feels it."""

import numpy as np

from cfid.errors import FitError
from cfid.records.run import Run
from cfid.records.tables.wrench import LOADCELL
from cfid.transfer.sines.alignment import align
from cfid.transfer.sines.data import read_sines

_CLEAR = 5.0  # standard uncertainties of an amplitude


def verdict(run: Run) -> str:
    """Say how clearly the load cell feels a sine. Raises DataError or FitError where it does not, or reports lack."""
    axes = run.header.devices[LOADCELL].columns
    sines = read_sines([run], channel="arm" if {"Tx", "Ty"} <= set(axes) else "Fz")
    (played,) = align(sines.runs).runs
    if not played.sine.periods:
        return f"a constant command, thrust {1e3 * played.force_n.mean():.1f} mN."
    during = (played.time_s > 0) & (played.time_s < played.duration_s)
    force_n, phase = played.force_n[during], played.frequency_rad_s * played.time_s[during]
    columns = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)], axis=1)
    found = np.linalg.lstsq(columns, force_n, rcond=None)[0]
    amplitude_n = float(np.hypot(found[1], found[2]))
    std_n = float((force_n - columns @ found).std() * np.sqrt(2 / len(force_n)))
    if amplitude_n < _CLEAR * std_n:
        raise FitError(
            f"the load cell does not feel it: {1e3 * amplitude_n:.2g} mN at its frequency, noise {1e3 * std_n:.2g} mN. "
            "Is it this motor's channel? A larger amplitude or a slower sine is felt."
        )
    return f"{1e3 * amplitude_n:.3g} mN at its frequency, {amplitude_n / std_n:.0f} times the noise there."
