"""Model gain, lags and lead of a motor with rotor, as frequency response, coefficients and time series.

There are two forms. "hold" is the plant K (1 + s lead)/(1 + s lag)... behind a zero-order hold: a command takes effect
from its sample on, so H(z) = b1 z^-1/(1 - a1 z^-1). "thesis" is eq. 3.10 as eq. 3.15 uses it, b0/(1 - a1 z^-1): the
force at a sample includes the effect of that sample's command, so for the same plant its delay is longer by one sample.
Gain and lags are the same.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from cfid.lazy import later
from cfid.transfer.sines.alignment import held
from cfid.transfer.sines.plan import SAMPLE_S

_lfilter = later("scipy.signal", "lfilter")  # importing scipy.signal takes as long as a fit

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
Form = Literal["hold", "thesis"]

_ALIKE = 1e-4  # lags closer than this are moved apart, with the same sum of exponentials


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """Static gain in N per unit of the command, one or two lags, and a lead, 0 for none."""

    static_gain_n: float
    lags_s: tuple[float, ...]
    lead_s: float = 0.0

    @classmethod
    def of_coefficients(cls, b0: float, a1: float, *, sample_s: float = SAMPLE_S) -> "Dynamics":
        """Return the dynamics of b0/(1 - a1 z^-1), in either form."""
        return cls(static_gain_n=static_gain(b0, a1), lags_s=(time_constant_s(a1, sample_s=sample_s),))

    def response(self, omega_rad_s: Array, *, sample_s: float = SAMPLE_S, form: Form = "hold") -> Complex:
        """Return force over samples u[n] at frequencies (n,), without delay.

        In form "hold" it is the response of the force itself at any instant, with the hold's attenuation by sinc; in
        form "thesis" it is that of the force at the samples.
        """
        if form == "hold":
            laplace = 1j * omega_rad_s
            half = omega_rad_s * sample_s / 2
            plant = self.static_gain_n * (1 + laplace * self.lead_s) * np.sinc(half / np.pi) * np.exp(-1j * half)
            for lag_s in self.lags_s:
                plant = plant / (1 + laplace * lag_s)
            return np.asarray(plant)
        numerator, denominator = self.coefficients(sample_s=sample_s, form=form)
        return evaluate(numerator, denominator, omega_rad_s * sample_s)

    def coefficients(self, *, sample_s: float = SAMPLE_S, form: Form = "hold") -> tuple[Array, Array]:
        """Return numerator and denominator in rising powers of z^-1, the denominator with its leading 1."""
        poles = np.exp(-sample_s / np.array(self._apart()))
        denominator = np.ones(1)
        for pole in poles:
            denominator = np.convolve(denominator, [1.0, -pole])
        if form == "thesis":
            lead = self.lead_s / sample_s
            numerator = self.static_gain_n * np.prod(1 - poles) * np.array([1 + lead, -lead])
            return (numerator if lead else numerator[:1]), denominator
        direct, parts = self._parts()
        numerator = direct * denominator
        for place, (part, pole) in enumerate(zip(parts, poles, strict=True)):
            others = np.ones(1)
            for other in np.delete(poles, place):
                others = np.convolve(others, [1.0, -other])
            numerator[1:] += part * (1 - pole) * others
        return numerator, denominator

    def step_response(self, time_s: Array) -> Array:
        """Return the force (n,) in N per unit of the command at times (n,) since a step."""
        direct, parts = self._parts()
        after = np.maximum(time_s, 0.0)
        rising = sum(part * -np.expm1(-after / lag_s) for part, lag_s in zip(parts, self._apart(), strict=True))
        return np.asarray((direct + rising) * (time_s >= 0))

    def simulate(self, commands: Array, time_s: Array, *, sample_s: float = SAMPLE_S, form: Form = "hold") -> Array:
        """Return the exact force (n,) at times (n,) since sample 0, starting from rest; commands (N,) are held.

        In form "thesis" the plant is the same and responds to each command one sample earlier.
        """
        since_s = time_s if form == "hold" else time_s + sample_s
        level = held(commands, since_s, sample_s=sample_s)
        place = np.clip(np.floor(since_s / sample_s + 1e-9), 0, len(commands)).astype(np.intp)
        elapsed_s = np.maximum(since_s - place * sample_s, 0.0)
        direct, parts = self._parts()
        force = direct * level
        for part, lag_s in zip(parts, self._apart(), strict=True):
            begun = _states(commands, math.exp(-sample_s / lag_s))[place]
            force += part * (level + (begun - level) * np.exp(-elapsed_s / lag_s))
        return np.asarray(force)

    def _apart(self) -> tuple[float, ...]:
        if len(self.lags_s) > 1 and abs(self.lags_s[0] / self.lags_s[1] - 1) < _ALIKE:
            middle_s = (self.lags_s[0] + self.lags_s[1]) / 2
            return middle_s * (1 + _ALIKE / 2), middle_s * (1 - _ALIKE / 2)
        return self.lags_s

    def _parts(self) -> tuple[float, list[float]]:
        """Split the plant into a direct part and one first-order part for each lag."""
        lags = self._apart()
        parts = []
        for place, lag_s in enumerate(lags):
            others = [1 - other / lag_s for at, other in enumerate(lags) if at != place]
            parts.append(self.static_gain_n * (1 - self.lead_s / lag_s) / math.prod(others))
        direct = self.static_gain_n * self.lead_s / lags[0] if len(lags) == 1 else 0.0
        return direct, parts


@dataclass(frozen=True, kw_only=True, eq=False)
class DifferenceEquation:
    """Any H(z) of eq. 3.10 by its coefficients in rising powers of z^-1, the denominator with its leading 1.

    It gives the force at the samples, in either form; between samples, the force is interpolated linearly.
    """

    numerator: Array
    denominator: Array

    def response(self, omega_rad_s: Array, *, sample_s: float = SAMPLE_S, form: Form = "thesis") -> Complex:
        """Return force at the samples over samples u[n] at frequencies (n,), in either form."""
        return evaluate(self.numerator, self.denominator, omega_rad_s * sample_s)

    def simulate(self, commands: Array, time_s: Array, *, sample_s: float = SAMPLE_S, form: Form = "thesis") -> Array:
        """Return the force (n,) at times (n,) since sample 0, starting from rest; commands (N,) are followed by 0."""
        last = max(len(commands), math.ceil(float(time_s.max()) / sample_s)) + 1
        force = _lfilter(self.numerator, self.denominator, np.append(commands, np.zeros(last - len(commands))))
        return np.asarray(np.interp(time_s, sample_s * np.arange(-1, last), np.append(0.0, force)))


def static_gain(b0: float, a1: float) -> float:
    """Return the static gain of b0/(1 - a1 z^-1), in units of b0."""
    return b0 / (1 - a1)


def time_constant_s(a1: float, *, sample_s: float = SAMPLE_S) -> float:
    """Return the continuous time constant whose decay over a sample is a1."""
    return -sample_s / math.log(a1)


def evaluate(numerator: Array, denominator: Array, omega_rad: Array) -> Complex:
    """Return H of eq. 3.11 at frequencies (n,) in rad per sample, coefficients in rising powers of z^-1."""
    delayed = np.exp(-1j * omega_rad)
    over, under = (np.polynomial.polynomial.polyval(delayed, part) for part in (numerator, denominator))
    return np.asarray(over / under)


def _states(commands: Array, decay: float) -> Array:
    """Return the state of a lag at each sample and at the end (N + 1,)."""
    state, states = 0.0, [0.0]
    for command in commands.tolist():
        state = command + (state - command) * decay
        states.append(state)
    return np.array(states)


EQ_3_15 = Dynamics.of_coefficients(6.0705967e-8, 0.9745210)
EQ_3_16 = Dynamics.of_coefficients(7.2345374e-8, 0.9695404)
