"""Drag experiments as a table: one row a command and wind, whoever measured and reduced it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

UNSTATED_WIND_STD = 0.05  # relative, where nobody said how far the wind's readings spread

_LARGEST = 1e6  # of any column, in its unit: beyond, squares of it overflow, and no vehicle has it
_SAME = 1e-6  # in m/s: velocities closer than this are those of one wind setting


@dataclass(frozen=True, kw_only=True)
class DragExperiments:
    """Experiments (n,) with turning rotors in wind, forces and velocities (n, 3) in the body frame.

    `velocity_mps` is that of the vehicle relative to the air. `setting` numbers the wind settings from 0: all
    experiments of one share the error of its wind speed, of relative deviation `wind_relative_std`.
    `force_std_n` is one deviation of each force's own noise, `reference_std_n` that of the reference subtracted from
    it, which all experiments at its command share. Where `noise_known` is false both are relative weights only.
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

    @property
    def wind_mps(self) -> Array:
        """The wind's speed (n,)."""
        return np.asarray(np.linalg.norm(self.velocity_mps, axis=1))

    @property
    def settings(self) -> int:
        """How many wind settings there are."""
        return int(self.setting.max()) + 1

    def at(self, rows: npt.NDArray[np.bool_]) -> "DragExperiments":
        """Return some of the experiments, their settings numbered anew."""
        return DragExperiments(
            command=self.command[rows],
            angle_deg=self.angle_deg[rows],
            velocity_mps=self.velocity_mps[rows],
            speed_sum_rad_s=self.speed_sum_rad_s[rows],
            force_n=self.force_n[rows],
            force_std_n=self.force_std_n[rows],
            reference_std_n=self.reference_std_n[rows],
            noise_known=self.noise_known,
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
    """Take forces (n, 3) that somebody has reduced already; rows of standing rotors or without wind are left out.

    Such a table says nothing of noise: all forces count alike, half of the variance being the reference's, which
    was subtracted at the same command. Rows of equal velocity (n, 3) make one wind setting.

    Raises DataError when columns differ in length, hold what is no number, or leave nothing to fit.
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
    if not used.any():
        raise DataError("no row has both wind and turning rotors: without them there is no drag.")
    columns = {name: values[used] for name, values in given.items()}
    rounded = np.rint(columns["velocity_mps"] / _SAME)
    return DragExperiments(
        **columns,
        force_std_n=np.ones((int(used.sum()), 3)),
        reference_std_n=np.ones((int(used.sum()), 3)),
        noise_known=False,
        setting=np.unique(rounded, axis=0, return_inverse=True)[1].reshape(-1),
        wind_relative_std=np.full(int(used.sum()), wind_relative_std),
    )


def _check(given: dict[str, Array]) -> None:
    count = len(given["command"])
    for name, values in given.items():
        expected = (count, 3) if name in {"velocity_mps", "force_n"} else (count,)
        if values.shape != expected:
            raise DataError(f"{name} has the shape {values.shape}, {expected} was expected, as of the commands.")
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            raise DataError(f"row {bad[0, 0] + 1} of {name} is no number: complete the row or leave it out.")
        wrong = np.argwhere((np.abs(values) > _LARGEST) | ((values < 0) & (name == "speed_sum_rad_s")))
        if len(wrong):
            raise DataError(f"row {wrong[0, 0] + 1} of {name} is {values[tuple(wrong[0])]:g}: no vehicle has that.")
