"""Hold drag experiments as a table: one row for each command and wind, independent of how they were measured."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.findings import Finding, note
from cfid.records.parameters import Source
from cfid.records.rig_file import RigFacts

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

UNSTATED_WIND_STD = 0.05  # relative standard uncertainty, used if the spread of the wind's readings is not stated

# Limit of every column, in its unit: squares of larger values may overflow, and no vehicle has them.
_LARGEST = 1e6
_SAME = 1e-6  # in m/s: velocities closer than this are those of one wind setting


@dataclass(frozen=True, kw_only=True)
class DragExperiments:
    """Experiments (n,) with turning rotors in wind, forces and velocities (n, 3) in the body frame.

    `velocity_mps` is that of the vehicle relative to the air. `setting` numbers the wind settings from 0: all
    experiments of a setting share the error of its wind speed, with the relative standard uncertainty
    `wind_relative_std`. `force_std_n` is the standard uncertainty of each force's own noise, `reference_std_n` that of
    the reference subtracted from it, which all experiments at its command share. Where `noise_known` is false, both are
    only relative weights. `sources` are the files of the experiments, `rigs` the facts of their rigs; those among them
    in `tachometers` have measured rotor speeds. A table of forces has none.
    """

    command: Array
    angle_deg: Array
    velocity_mps: Array
    speed_sum_rad_s: Array
    force_n: Array
    force_std_n: Array
    reference_std_n: Array
    noise_known: bool
    setting: Indices
    wind_relative_std: Array
    findings: tuple[Finding, ...] = ()
    sources: tuple[Source, ...] = ()
    rigs: tuple[RigFacts, ...] = ()
    tachometers: tuple[RigFacts, ...] = ()

    @property
    def wind_mps(self) -> Array:
        """The wind's speed (n,)."""
        return np.asarray(np.linalg.norm(self.velocity_mps, axis=1))

    @property
    def settings(self) -> int:
        """The number of wind settings."""
        return int(self.setting.max()) + 1

    def at(self, rows: npt.NDArray[np.bool_]) -> "DragExperiments":
        """Return some of the experiments, with new numbers of their settings."""
        return replace(
            self,
            command=self.command[rows],
            angle_deg=self.angle_deg[rows],
            velocity_mps=self.velocity_mps[rows],
            speed_sum_rad_s=self.speed_sum_rad_s[rows],
            force_n=self.force_n[rows],
            force_std_n=self.force_std_n[rows],
            reference_std_n=self.reference_std_n[rows],
            setting=np.unique(self.setting[rows], return_inverse=True)[1],
            wind_relative_std=self.wind_relative_std[rows],
        )


def experiments_from_table(
    *,
    command: npt.ArrayLike,
    angle_deg: npt.ArrayLike,
    velocity_mps: npt.ArrayLike,
    speed_sum_rad_s: npt.ArrayLike,
    force_n: npt.ArrayLike,
    wind_relative_std: float = UNSTATED_WIND_STD,
) -> DragExperiments:
    """Return experiments of reduced forces (n, 3); rows with standing rotors or without wind are left out.

    Such a table states no noise: all forces count equally, and half of each variance is that of the reference, which
    was subtracted at the same command. Rows of equal velocity (n, 3) form one wind setting.

    Raises DataError when columns differ in length, contain a value that is not finite, or leave nothing to fit.
    """
    given = {
        "command": np.asarray(command, dtype=np.float64),
        "angle_deg": np.asarray(angle_deg, dtype=np.float64),
        "velocity_mps": np.asarray(velocity_mps, dtype=np.float64),
        "speed_sum_rad_s": np.asarray(speed_sum_rad_s, dtype=np.float64),
        "force_n": np.asarray(force_n, dtype=np.float64),
    }
    _check(given)
    windy = np.linalg.norm(given["velocity_mps"], axis=1) > _SAME
    used = windy & (given["speed_sum_rad_s"] > 0)
    count, left_out = int(used.sum()), int(np.sum(~used))
    if count == 0:
        raise DataError("no row has both wind and turning rotors: without them there is no drag.")
    columns = {name: values[used] for name, values in given.items()}
    rounded = np.rint(columns["velocity_mps"] / _SAME)
    findings = (
        [standing_left_out(f"{counted(left_out, 'row')} without wind or with standing rotors")] if left_out else []
    )
    return DragExperiments(
        **columns,
        force_std_n=np.ones((count, 3)),
        reference_std_n=np.ones((count, 3)),
        noise_known=False,
        setting=np.unique(rounded, axis=0, return_inverse=True)[1].reshape(-1),
        wind_relative_std=np.full(count, wind_relative_std),
        findings=(*findings, _without_noise(wind_relative_std)),
    )


def standing_left_out(what: str) -> Finding:
    """Return the note on runs or rows in which no rotor turns in wind."""
    return note("drag-standing-rotors", f"{what} contain no drag of rotors: not used.", "drag.*")


def _without_noise(wind_relative_std: float) -> Finding:
    text = (
        "a table of forces states no noise, which is estimated from the models' residuals; the relative standard "
        f"uncertainty of its winds is taken to be {100 * wind_relative_std:g} %."
    )
    return note("drag-table-without-noise", text, "drag.*")


def _check(given: dict[str, Array]) -> None:
    count = len(given["command"])
    for name, values in given.items():
        expected = (count, 3) if name in {"velocity_mps", "force_n"} else (count,)
        if values.shape != expected:
            raise DataError(f"{name} has the shape {values.shape}; {expected} was expected, as of the commands.")
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            raise DataError(f"row {bad[0, 0] + 1} of {name} is not a number: complete the row or leave it out.")
        wrong = np.argwhere((np.abs(values) > _LARGEST) | ((values < 0) & (name == "speed_sum_rad_s")))
        if len(wrong):
            raise DataError(f"row {wrong[0, 0] + 1} of {name} is {values[tuple(wrong[0])]:g}: no vehicle has that.")
