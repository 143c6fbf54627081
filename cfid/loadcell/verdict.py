"""Judge a recording of the load cell as soon as it ends: its noise and its drift."""

import numpy as np

from cfid.counted import counted
from cfid.errors import DataError
from cfid.records.run import Run
from cfid.records.tables.wrench import WrenchReading, read_wrench

_FEWEST = 100


def verdict(run: Run) -> str:
    """Say what the vertical force was, or the first axis, its noise and drift.

    Raises DataError for few samples, and for a force that never changes.
    """
    record = read_wrench(run.folder, WrenchReading())
    axis, shown = record.main_axis, 1e3 * record.values_of(record.main_axis)
    if len(shown) < _FEWEST:
        raise DataError(f"{counted(len(shown), 'sample is', 'samples are')} too few (at least {_FEWEST}).")
    if not np.ptp(shown):
        raise DataError(f"{axis} is {shown[0]:.6g} in all {len(shown)} samples: press on the cell and see it change.")
    tenth, unit = len(shown) // 10, "mN" if axis.startswith("F") else "mNm"
    drift = float(shown[-tenth:].mean() - shown[:tenth].mean())
    noise = float(np.diff(shown).std() / np.sqrt(2))
    return (
        f"{axis} {shown.mean():.1f} {unit}, noise {noise:.2g} {unit} from sample to sample, "
        f"{drift:+.2g} {unit} from the first tenth to the last."
    )
