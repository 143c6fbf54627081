"""A fit of angles that a test made, without a file."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.recordings.angle import AngleRecord
from cfid.records.parameters import Source
from cfid.records.run import Label
from cfid.swing.estimation import SwingFit, fit_swing
from cfid.swing.window import swing_in

Array = npt.NDArray[np.float64]


def fitted(time_s: Array, angle_rad: Array) -> SwingFit:
    record = AngleRecord(
        path=Path("one.csv"), source=Source("one.csv", ""), label=Label(), time_s=time_s, angle_rad=angle_rad,
        findings=(),
    )  # fmt: skip
    return fit_swing(swing_in(record))
