"""Simulates a six-axis load cell: wrench to counts and a status word, with bias, drift, noise and limits."""

import numpy as np
import numpy.typing as npt

from cfid.records.rig_file import Number, Positive, RigTable, Spread
from cfid.sim.stepping import Array
from cfid.sim.wander import Wander

WARM_UP_S = 60.0
BIAS_WANDER_S = 60.0
SATURATED = 0x80020000  # bit 31, any error, and bit 17

Six = tuple[Number, Number, Number, Number, Number, Number]
SixSpreads = tuple[Spread, Spread, Spread, Spread, Spread, Spread]
SixPositive = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
SixSixes = tuple[Six, Six, Six, Six, Six, Six]
Counts = npt.NDArray[np.int32]


class LoadCellTruth(RigTable):
    """A cell like ATI's Mini40 SI-20-1. Six numbers are Fx, Fy, Fz in N and Tx, Ty, Tz in Nm.

    `bias` is its reading unloaded, `drift_per_s` the bias' growth, `noise_std` the standard deviation of a sample. Its
    x axis lies `yaw_deg` left of the vehicle's, and the rotors' wrenches are turned by that angle. With `flip_fz` Fz
    and Tz count downwards.

    Calibration errors: each axis reads too much by its `gain_error`; axis i also shows `crosstalk` [i][j] of axis j,
    as fractions of their ranges (its diagonal has no effect). From the first reading on the cell warms up with the
    time constant WARM_UP_S: it reads too little, by up to `warm_up`. Its bias wanders with the standard deviation
    `bias_wander`, a fraction of the ranges, correlated over BIAS_WANDER_S.
    """

    bias: Six = (0.35, -0.22, 1.4, 0.004, -0.007, 0.002)
    drift_per_s: Six = (2e-5, -1e-5, 5e-5, 1e-7, 2e-7, -1e-7)
    noise_std: SixSpreads = (0.01, 0.01, 0.02, 2e-4, 2e-4, 2e-4)
    ranges: SixPositive = (20.0, 20.0, 60.0, 1.0, 1.0, 1.0)
    counts_per_n: Positive = 1e6
    counts_per_nm: Positive = 1e6
    yaw_deg: Number = -45.0
    flip_fz: bool = False
    gain_error: Six = (0.0,) * 6
    crosstalk: SixSixes = ((0.0,) * 6,) * 6
    warm_up: Number = 0.0
    bias_wander: Spread = 0.0

    @property
    def counts_per_unit(self) -> Array:
        """Counts of one N or Nm on each axis (6,)."""
        return np.repeat([self.counts_per_n, self.counts_per_nm], 3)

    @property
    def response(self) -> Array:
        """What the cell shows (6 rows) per component of a wrench (6 columns): without errors, the identity matrix."""
        ranges = np.array(self.ranges)
        others = (1 - np.eye(6)) * np.array(self.crosstalk) * np.outer(ranges, 1 / ranges)
        return np.asarray(np.diag(1 + np.array(self.gain_error)) + others)


class SimulatedLoadCell:
    """A cell that is read at increasing times; its drift starts with the first reading."""

    def __init__(self, truth: LoadCellTruth, rng: np.random.Generator) -> None:
        """Start without a software bias."""
        self.truth = truth
        self.software_bias = np.zeros(6, np.int64)
        self._rng = rng
        self._scale = truth.counts_per_unit * (np.array([1, 1, -1, 1, 1, -1]) if truth.flip_fz else 1)
        self._unloaded = np.array(truth.bias)
        self._drift_per_s, self._noise_std, self._ranges = map(
            np.array, (truth.drift_per_s, truth.noise_std, truth.ranges)
        )
        self._first_s: float | None = None
        self._response = truth.response
        self._wander: Wander | None = None
        if truth.bias_wander:
            std = truth.bias_wander * self._ranges
            self._wander = Wander(std, correlation_s=BIAS_WANDER_S, rng=rng.spawn(1)[0])

    def read(self, time_s: Array, wrench: Array) -> tuple[Counts, npt.NDArray[np.uint32]]:
        """Return counts (n, 6) and status words (n,) of a wrench (n, 6) in N and Nm at times (n,)."""
        if self._first_s is None:
            self._first_s = float(time_s[0])
        elapsed_s = (time_s - self._first_s)[:, np.newaxis]
        noise = self._noise_std * self._rng.standard_normal(wrench.shape)
        warm = 1 - self.truth.warm_up * np.exp(-elapsed_s / WARM_UP_S)
        felt = wrench @ self._response.T * warm + self._unloaded + self._drift_per_s * elapsed_s + noise
        if self._wander is not None:
            felt += self._wander.at(elapsed_s[:, 0])
        beyond = (np.abs(felt) >= self._ranges).any(axis=1)
        shown = np.clip(felt, -self._ranges, self._ranges)
        counts = np.rint(shown * self._scale).astype(np.int64) - self.software_bias
        return counts.astype(np.int32), np.where(beyond, np.uint32(SATURATED), np.uint32(0))

    def set_bias(self, counts: npt.ArrayLike) -> None:
        """Subtract counts (6,) from each reading from now on."""
        self.software_bias = np.asarray(counts, np.int64)

    def overload(self) -> None:
        """Load Fz beyond its range from now on."""
        self._unloaded[2] = 2 * self._ranges[2]
