"""Compare an identified transfer function with a run that it was not identified from (figure 3.16)."""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.findings import Finding, rejection, warning
from cfid.lazy import later
from cfid.transfer.alignment import SineRun
from cfid.transfer.frequency_response import END_S, SETTLE_S, respond
from cfid.transfer.model import TransferFunction

Array = npt.NDArray[np.float64]

_gaussian_filter1d = later("scipy.ndimage", "gaussian_filter1d")  # only a verification needs it

OFF_LIMIT = 0.1  # of the sine: the largest difference of simulation and measurement beyond their uncertainty
SMOOTHED_HZ = 25.0  # twice the highest identified frequency, and far below any rotor's

_CERTAIN = 3.0  # standard uncertainties
_VAGUE = 0.1  # of the sine, one standard uncertainty

_STEP_S = 0.002
_GAUSS = math.sqrt(math.log(2)) / (2 * math.pi)  # standard deviation of a kernel that halves the power at 1 Hz


@dataclass(frozen=True, kw_only=True, eq=False)
class Verification:
    """Thrust about its mean (n,), measured and simulated, both smoothed in the same way, without transient and end.

    The means are left out, as a linear function does not determine them. `ratio` is the measured sine over the
    simulated one: the former is `gain_ratio` times as large, and later by `late_s`. Standard uncertainties are those of
    the ratio's size, and of its phase in rad, at `frequency_rad_s`.
    """

    name: str
    time_s: Array
    measured_n: Array
    simulated_n: Array
    ratio: complex
    gain_ratio_std: float
    phase_std_rad: float
    frequency_rad_s: float

    @property
    def residual_n(self) -> Array:
        """The measured minus the simulated thrust (n,) in N."""
        return self.measured_n - self.simulated_n

    @property
    def residual_rms_n(self) -> float:
        """The root mean square of the residual, in N."""
        return float(np.sqrt(np.mean(self.residual_n**2)))

    @property
    def fit_percent(self) -> float:
        """100 (1 - |y - yhat|/|y|), of thrust about its mean."""
        return float(100 * (1 - np.linalg.norm(self.residual_n) / np.linalg.norm(self.measured_n)))

    @property
    def gain_ratio(self) -> float:
        """The size of the measured sine relative to the simulated one."""
        return abs(self.ratio)

    @property
    def late_s(self) -> float:
        """The time by which the measured sine is later, in s."""
        return -cmath.phase(self.ratio) / self.frequency_rad_s

    @property
    def late_std_s(self) -> float:
        """The standard uncertainty of that time, in s."""
        return self.phase_std_rad / self.frequency_rad_s

    @property
    def off(self) -> float:
        """The difference between the measured and the simulated sine, relative to the simulated one."""
        return abs(self.ratio - 1)

    @property
    def off_std(self) -> float:
        """The standard uncertainty of `off`, in any direction."""
        return math.hypot(self.gain_ratio_std, self.gain_ratio * self.phase_std_rad)

    @property
    def accepted(self) -> bool:
        """Whether the transfer function describes the run, as far as the run's noise resolves it."""
        return self.off <= OFF_LIMIT + _CERTAIN * self.off_std

    @property
    def text(self) -> str:
        """The comparison as a line."""
        return (
            f"{self.name}: fit {self.fit_percent:.1f} %, residual {1e3 * self.residual_rms_n:.2g} mN rms; measured "
            f"{1e3 * self.late_s:+.2f} +- {1e3 * self.late_std_s:.2g} ms later and {self.gain_ratio:.4f} +- "
            f"{self.gain_ratio_std:.2g} times as large as simulated"
        )

    def findings(self, keys: Sequence[str]) -> tuple[Finding, ...]:
        """Return findings against the comparison with the quantities `keys`."""
        found = []
        if self.off_std > _VAGUE:
            text = f"{self.name}: is known to {100 * self.off_std:.0f} % of the sine only: it verifies little."
            found.append(warning("verification-vague", text, *keys))
        if not self.accepted:
            text = (
                f"{self.name}: the measured sine differs from the simulated one by {100 * self.off:.0f} % of it, "
                f"with a standard uncertainty of {100 * self.off_std:.1g} % (limit {100 * OFF_LIMIT:.0f} % and "
                f"{_CERTAIN:g} standard uncertainties). Check that rig and battery are those of the fit."
            )
            found.append(rejection("verification-differs", text, *keys))
        return tuple(found)


def verify_run(
    run: SineRun,
    function: TransferFunction,
    *,
    after_quickest_s: float,
    delay_std_s: float = 0.0,
) -> Verification:
    """Simulate the commands of a run (l from 1 on) through a transfer function, and compare.

    `after_quickest_s` is the delay after the quickest reports, `delay_std_s` its standard uncertainty in this run.
    Raises DataError for a run that is too short to be compared.
    """
    if run.duration_s < SETTLE_S + 2 * END_S + 2 / SMOOTHED_HZ:
        raise DataError(f"{run.name}: {run.duration_s:.1f} s are too short to be compared with a simulation.")
    in_run = replace(function, sample_s=run.sample_s)
    simulated = in_run.simulate(run.sine.commands(), run.time_s - after_quickest_s)
    time_s, smooth = _smoothed(run.time_s, np.stack([run.force_n, simulated]))
    kept = (time_s >= SETTLE_S) & (time_s <= run.duration_s - END_S)
    smooth = smooth[:, kept] - smooth[:, kept].mean(axis=1, keepdims=True)
    response = respond(
        run,
    )
    ratio = (
        response.value
        / respond(
            replace(run, force_n=simulated),
        ).value
    )
    size_std, phase_std = response.polar_std
    return Verification(
        name=run.name,
        time_s=time_s[kept],
        measured_n=smooth[0],
        simulated_n=smooth[1],
        ratio=ratio,
        gain_ratio_std=size_std / abs(response.value) * abs(ratio),
        phase_std_rad=math.hypot(phase_std, response.frequency_rad_s * delay_std_s),
        frequency_rad_s=response.frequency_rad_s,
    )


def _smoothed(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Return times (m,) and means of signals (k, n) over 2 ms, smoothed by a Gaussian kernel without shift (k, m)."""
    edges = np.arange(time_s[0], time_s[-1], _STEP_S)
    between = np.diff(time_s) * (values[:, 1:] + values[:, :-1]) / 2
    integral = np.concatenate([np.zeros((len(values), 1)), np.cumsum(between, axis=1)], axis=1)
    means = np.diff([np.interp(edges, time_s, own) for own in integral], axis=1) / _STEP_S
    return edges[:-1] + _STEP_S / 2, _gaussian_filter1d(means, _GAUSS / SMOOTHED_HZ / _STEP_S, mode="nearest")
