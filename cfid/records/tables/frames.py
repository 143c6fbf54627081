"""Return a device's rows of a run as a data frame, in SI units, with one time base for all devices of the run."""

import numpy as np
from pandas import DataFrame

from cfid.errors import DataError
from cfid.recordings.read import read_recording
from cfid.recordings.vehicle import read_rows
from cfid.recordings.wrench import LOADCELL, wrench_of
from cfid.records.run import Run
from cfid.records.tables.angle import ENCODER, Reading, read_angle


def frame(run: Run, device: str) -> DataFrame:
    """Return a device's rows over `t`, in seconds from the first row of any device of the run.

    The encoder has `angle_rad`, the load cell `fx_n` to `tz_nm` (frame of the cell), the others their own columns.
    Raises DataError when the run has no such device, or a file is invalid.
    """
    began_s = [float(read_rows(run, name).time_s[0]) for name, record in run.header.devices.items() if record.rows != 0]
    if not began_s:
        raise DataError(f"{run.folder}: none of its devices has rows: nothing was recorded.")
    zero_s = min(began_s)
    if device == ENCODER:
        angle = read_angle(run.folder, Reading())
        return DataFrame({"t": angle.time_s + angle.begin_s - zero_s, "angle_rad": angle.angle_rad})
    if device == LOADCELL:
        cell = wrench_of(read_recording(run.folder))
        names = ("fx_n", "fy_n", "fz_n", "tx_nm", "ty_nm", "tz_nm")
        columns = np.hstack([cell.force_n, cell.torque_nm]).T
        return DataFrame({"t": cell.time_s + (cell.begin_s or 0.0) - zero_s, **dict(zip(names, columns, strict=True))})
    rows = read_rows(run, device)
    return DataFrame({"t": rows.time_s - zero_s, **rows.columns})
