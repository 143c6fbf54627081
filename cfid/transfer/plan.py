"""Plan sines that are played on board (eq. 3.6), and choose which of them `cfid log sine` plays in a sweep."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.estimate.battery_endurance import Held
from cfid.records.run import Run
from cfid.units import MOTORS
from cfid.wire.app import LARGEST_COMMAND, MIDDLE, SAMPLES_PER_S, SineRequest, omega_of

SAMPLE_S = 1 / SAMPLES_PER_S
PLANNED = "planned"  # in run.toml: the l of all sines of the series

CUTOFF_HZ = 12.5  # upper limit of the thesis' fits, in both series, and of `cfid tf identify`

_ROUNDING = 1e-3  # the fraction by which a frequency may exceed the cut-off
_COUNT = 24
_FEWEST_PERIODS = 2  # a single one cannot be distinguished from a drift
_NEAR = 0.1  # of a frequency: a divisor of N within this distance replaces it


@dataclass(frozen=True, kw_only=True)
class Sine:
    """u[n] = A cos(2 pi l n/N) + B for n from 0 to N - 1 (eq. 3.6), on one motor, 1 to 4, or on all, 0.

    `periods` is l, `samples` N, `amplitude` A and `middle` B; `series` names the series that it belongs to.
    """

    periods: int
    samples: int
    amplitude: float
    motor: int = 1
    middle: float = MIDDLE
    series: str | None = None

    @classmethod
    def of_run(cls, kind: str, requested: Mapping[str, Any]) -> "Sine":
        """Return the sine that run.toml states. Raises DataError when it is a run of something else."""
        missing = [key for key in ("l", "n", "amplitude", "motor") if not isinstance(requested.get(key), int)]
        if missing:
            raise DataError(f"a run of {kind}, no sine: its run.toml states no {', '.join(missing)} of a sine.")
        periods, samples = requested["l"], requested["n"]
        if not 0 <= 2 * periods <= samples or samples < 1:
            raise DataError(f"its run.toml states l = {periods} and n = {samples}, which is no sine.")
        series = requested.get("series")
        return cls(
            periods=periods,
            samples=samples,
            amplitude=requested["amplitude"],
            motor=requested["motor"],
            series=None if series is None else str(series),
        )

    def to_run(self) -> dict[str, Any]:
        """Return the entries of run.toml for this sine."""
        series = {} if self.series is None else {"series": self.series}
        return {"l": self.periods, "n": self.samples, "amplitude": self.amplitude, "motor": self.motor, **series}

    def request(self) -> SineRequest:
        """Return the request to the vehicle."""
        return SineRequest(self.motor, int(self.amplitude), omega_of(self.periods, self.samples), self.samples)

    def held(self, lasts_s: float) -> list[Held]:
        """Return the commands that draw current in a run of `lasts_s` seconds: about the middle one, and the pauses."""
        played_s = self.samples * SAMPLE_S
        motors = 1 if self.motor else len(MOTORS)
        return [Held(int(self.middle), motors, played_s), Held(0, 0, max(lasts_s - played_s, 0.0))]

    @property
    def hz(self) -> float:
        """The frequency, in Hz."""
        return SAMPLES_PER_S * self.periods / self.samples

    @property
    def omega_rad(self) -> float:
        """The frequency Omega_l, in rad per sample."""
        return 2 * np.pi * self.periods / self.samples

    def is_above(self, cutoff_hz: float) -> bool:
        """Return whether a fit up to a frequency leaves this sine out."""
        return self.hz > cutoff_hz * (1 + _ROUNDING)

    @property
    def half_period_s(self) -> float:
        """The nominal time between crossings; the whole run for l = 0."""
        return self.samples * SAMPLE_S / max(2 * self.periods, 1)

    def commands(self) -> npt.NDArray[np.float64]:
        """Return the samples (N,) as the vehicle plays them: truncated to integers and clipped."""
        angle = 2 * np.pi * (self.periods * np.arange(self.samples) % self.samples) / self.samples
        # Rounded so that a crossing at a sample has exactly the middle value, as on board.
        exact = np.round(self.amplitude * np.cos(angle) + self.middle, 6)
        return np.clip(np.trunc(exact), 0, LARGEST_COMMAND)


@dataclass(frozen=True, kw_only=True)
class SineSweep:
    """Sines of l periods each, with common N and A of eq. 3.6, on one motor after the other; motor 0 is all four.

    Each of several motors has a series of its own. `text` states the origin of the l.
    """

    periods: tuple[int, ...]
    samples: int
    amplitude: int = 20000
    motors: tuple[int, ...] = (1,)
    series: str | None = None
    text: str = ""

    @classmethod
    def of_run(cls, run: Run) -> "SineSweep":
        """Return the sines of the series that a run belongs to, on its motor, as its run.toml states them.

        A run without a list of sines is a series of its own. Raises DataError for a run of another kind.
        """
        own = Sine.of_run(run.header.kind, run.header.requested)
        planned = run.header.requested.get(PLANNED)
        known = isinstance(planned, list) and all(isinstance(one, int) for one in planned)
        return cls(
            periods=tuple(planned) if planned and known else (own.periods,),
            samples=own.samples,
            amplitude=int(own.amplitude),
            motors=(own.motor,),
            series=own.series,
        )

    @property
    def sines(self) -> list[Sine]:
        """The sines in the order in which they are played."""
        return [
            Sine(periods=l, samples=self.samples, amplitude=self.amplitude, motor=motor, series=self._series_of(motor))
            for motor in self.motors
            for l in self.periods  # noqa: E741
        ]

    def _series_of(self, motor: int) -> str | None:
        if len(self.motors) == 1:
            return self.series
        return "_".join(filter(None, [self.series, f"motor{motor}" if motor else "all"]))


def missing_sines(sweep: SineSweep, runs: Iterable[Run], *, simulated: bool, excluded: bool = False) -> list[Sine]:
    """Return the sines without a usable run; simulated runs count for a simulated rig only.

    Above the cut-off, a complete run suffices, because a rotor hardly follows. With `excluded`, an excluded complete
    run suffices for any sine.
    """
    complete = [run for run in runs if run.header.simulated == simulated and run.header.state == "complete"]

    def is_there(sine: Sine) -> bool:
        counts = sine.is_above(CUTOFF_HZ)
        return any(
            (excluded if run.header.excluded else counts or run.usable)
            for run in complete
            if {name: value for name, value in run.header.requested.items() if name != PLANNED} == sine.to_run()
        )

    return [sine for sine in sweep.sines if not is_there(sine)]


def above_cutoff(sines: Iterable[Sine], cutoff_hz: float = CUTOFF_HZ) -> str:
    """Return a sentence on the sines that a fit up to a frequency leaves out, "" for none."""
    above = dict.fromkeys(f"{sine.hz:g}" for sine in sines if sine.is_above(cutoff_hz))
    return f"{', '.join(above)} Hz: above the cut-off of {cutoff_hz:g} Hz" if above else ""


_RECONSTRUCTED = "reconstructed by table 3.1's number of l, their range and growing steps;"

_SLOW = (*range(16), *range(20, 51, 5))

THESIS_FIRST = SineSweep(
    periods=(*_SLOW, *range(55, 101, 5), 110, 150, 200, 300, 400, 500, 750, 1000, 1500, 2000),
    samples=4000,
    series="first",
    text=f"{_RECONSTRUCTED} only 0 to 15 and 20 to 100 by 5 stand in the thesis' code.",
)
THESIS_SECOND = SineSweep(
    periods=(*_SLOW, *range(60, 101, 10), *range(120, 201, 20), 300, 400, 500, 750, 1000, 2000, 4000),
    samples=8000,
    motors=(3,),
    series="second",
    text=f"{_RECONSTRUCTED} none stands in the thesis' code.",
)


def log_spaced(samples: int) -> SineSweep:
    """Return about twenty sines, evenly spaced in the logarithm of frequency, from two periods up to 12.5 Hz.

    A nearby divisor of N is preferred: whole periods then fill whole samples, and the spectrum does not leak. Every
    second frequency comes first, in rising order; the others follow in falling order: if frequency rose with time, a
    discharging battery would look like a time constant (decision 10).
    """
    most = max(int(samples * CUTOFF_HZ / SAMPLES_PER_S), _FEWEST_PERIODS)
    divisors = [l for l in range(1, most + 1) if samples % l == 0]  # noqa: E741
    periods = set()
    for place in range(_COUNT):
        wanted = _FEWEST_PERIODS * (most / _FEWEST_PERIODS) ** (place / (_COUNT - 1))
        nearest = min(divisors, key=lambda l: abs(math.log(l / wanted)))  # noqa: E741
        near = abs(math.log(nearest / wanted)) <= _NEAR
        periods.add(max(nearest if near else round(wanted), _FEWEST_PERIODS))
    rising = sorted(periods)
    text = f"{counted(len(periods), 'sine')}, evenly over the logarithm of frequency up to {CUTOFF_HZ:g} Hz."
    return SineSweep(periods=(*rising[::2], *rising[1::2][::-1]), samples=samples, text=text)
