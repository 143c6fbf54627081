"""Judge a recording of the load cell as soon as it ends: its noise and its drift."""

import numpy as np

from cfid.errors import DataError
from cfid.records.run import Run
from cfid.records.tables.wrench import WrenchReading, read_wrench

_FEWEST = 100


def verdict(run: Run) -> str:
    """Say what the vertical force was, how noisy and how steady. Raises DataError for too few samples."""
    record = read_wrench(run.folder, WrenchReading())
    force_n = record.force_n[:, 2]
    if len(force_n) < _FEWEST:
        raise DataError(f"{len(force_n)} samples are too few (at least {_FEWEST}).")
    tenth = len(force_n) // 10
    drift_n = float(force_n[-tenth:].mean() - force_n[:tenth].mean())
    noise_n = float(np.diff(force_n).std() / np.sqrt(2))
    return (
        f"Fz {1e3 * force_n.mean():.1f} mN, noise {1e3 * noise_n:.2g} mN from sample to sample, "
        f"{1e3 * drift_n:+.2g} mN from the first tenth to the last."
    )
