"""Mean readings of the load cell from runs of `cfid log loadcell` with a known load."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.estimate.propagation import covariance_of_weights
from cfid.estimate.signals import quiet_mean
from cfid.findings import Finding
from cfid.loadcell.estimation import Loads, applied_wrench, place_error
from cfid.motors.data import channels_of
from cfid.recordings.read import read_recording
from cfid.recordings.wrench import AXES, wrench_of
from cfid.records.parameters import Source
from cfid.records.rig_file import RigFacts
from cfid.records.run import Pull, Run, read_run, run_at
from cfid.units import MM

Array = npt.NDArray[np.float64]

_GRAM = 1e-3  # kg


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadedRun:
    """The mean reading (6,) of a run in N and N m, without any earlier calibration, under a known load.

    Axes that the load cell does not measure are nan.
    """

    name: str
    weight_kg: float
    pull: Pull
    at_m: Array
    at_std_m: float | None
    weight_std_kg: float
    reading: Array
    std: Array
    source: Source
    findings: tuple[Finding, ...]
    rig: RigFacts

    def load(self, gravity_mps2: float) -> Array:
        """Return the load (6,) in N and N m."""
        return applied_wrench(weight_n=gravity_mps2 * self.weight_kg, pull=self.pull, at_m=self.at_m)


def read_load(run: Run | Path | str) -> LoadedRun:
    """Read a run with its label. Raises DataError for one that does not state how the cell was loaded."""
    if not isinstance(run, Run):
        if run_at(Path(run)) is None:
            raise DataError(f"{run}: no run folder: record the loads with `cfid log loadcell`, `pull` and `weight`.")
        run = read_run(Path(run))
    label = run.header.label
    if label.pull is None:
        raise DataError(
            f"{run.folder}: does not state along which of its axes gravity points: record it with `pull`, as in -z."
        )
    record = wrench_of(read_recording(run.folder))
    gain = np.array(run.header.rig.loadcell.gain or np.ones(6))  # of an earlier calibration
    channels = channels_of(record, flip_fz=bool(run.header.rig.loadcell.flip_fz))
    wrench = np.nan_to_num(channels.T * gain[:, np.newaxis])
    rate_hz = (len(record.time_s) - 1) / float(record.time_s[-1] - record.time_s[0])
    mean = quiet_mean(wrench, rate_hz=rate_hz)
    return LoadedRun(
        name=record.name,
        weight_kg=_GRAM * (label.weight_g or 0.0),
        pull=label.pull,
        at_m=MM * np.array(label.at_mm or (0.0, 0.0, 0.0)),
        at_std_m=None if label.at_std_mm is None else MM * label.at_std_mm,
        weight_std_kg=_GRAM * (label.weight_std_g or 0.0),
        reading=np.where([axis in record.axes for axis in AXES], mean.value, np.nan),
        std=mean.std,
        source=record.source,
        findings=record.findings,
        rig=run.header.rig,
    )


def loads_of(runs: Sequence[LoadedRun], *, gravity_mps2: float, at_std_m: float) -> Loads:
    """Return all runs' loads and readings, with the uncertainty of their weights and places.

    `at_std_m` is the standard uncertainty of places that state none.
    """
    load = np.array([run.load(gravity_mps2) for run in runs])
    places = [at_std_m if run.at_std_m is None else run.at_std_m for run in runs]
    of_place = [place_error(load=one, std_m=std) for one, std in zip(load, places, strict=True)]
    weight, std = np.array([(run.weight_kg, run.weight_std_kg) for run in runs]).T
    relative = np.divide(1.0, weight, out=np.zeros(len(runs)), where=weight > 0)
    return Loads(
        load=load,
        reading=np.array([run.reading for run in runs]),
        std=np.hypot([run.std for run in runs], of_place),
        of_weights=covariance_of_weights(weight, std) * np.outer(relative, relative),
        orientation=np.unique([run.pull for run in runs], return_inverse=True)[1].reshape(-1),
    )
