"""A transfer function from command to thrust: its coefficients, what follows from them, and its simulation.

A command takes effect from its sample on, so H(z) = b1 z^-1/(1 - a1 z^-1) for a plant K/(1 + s lag) behind a zero-order
hold. The thesis (eq. 3.10, as eq. 3.15 uses it) has the same H(z) without its factor z^-1, and a delay longer by a
sample: the force at a sample includes the effect of that sample's command. Gain and lags are the same. A plant with a
lead responds at once.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.lazy import later
from cfid.records.parameters import Parameter
from cfid.transfer.plan import SAMPLE_S

_cont2discrete = later("scipy.signal", "cont2discrete")  # importing scipy.signal takes as long as a fit
_lfilter = later("scipy.signal", "lfilter")

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

_LONGEST_S = 10.0  # the largest delay, of either sign


@dataclass(frozen=True, kw_only=True, eq=False)
class TransferFunction:
    """H(z) by its coefficients in rising powers of z^-1, the denominator with its leading 1, and its delay in s.

    `delay_s` counts from the average report of a command, `after_quickest_s` from the fastest, where that is known.
    `delay_std_s` is the standard uncertainty of the delay in use.
    """

    numerator: Array
    denominator: Array
    sample_s: float = SAMPLE_S
    delay_s: float = 0.0
    delay_std_s: float = 0.0
    after_quickest_s: float | None = None

    @classmethod
    def of_lags(
        cls, gain_n: float, lags_s: Iterable[float], *, lead_s: float = 0.0, sample_s: float = SAMPLE_S
    ) -> "TransferFunction":
        """Return K (1 + s lead)/((1 + s lag) ...) behind a zero-order hold."""
        lagging = np.ones(1)
        for lag_s in lags_s:
            lagging = np.convolve(lagging, [lag_s, 1.0])
        numerator, denominator, _ = _cont2discrete(([lead_s, 1.0] if lead_s else [1.0], lagging), sample_s, "zoh")
        return cls(numerator=gain_n * np.ravel(numerator), denominator=denominator, sample_s=sample_s)

    @classmethod
    def of_coefficients(
        cls, numerator: Sequence[float], denominator: Sequence[float], *, delay_s: float = 0.0
    ) -> "TransferFunction":
        """Return H(z) from coefficients of z^0, z^-1, ... Raises ConfigError for coefficients that no motor has."""
        if not len(denominator) or denominator[0] != 1:
            raise ConfigError(f"denominator {_text(denominator)}: should begin with its leading 1.")
        if not any(numerator):
            raise ConfigError(f"numerator {_text(numerator)}: gives no thrust at any command: one should not be zero.")
        if not np.all(np.isfinite([*numerator, *denominator])):
            raise ConfigError(f"coefficients {_text([*numerator, *denominator])}: should be finite numbers.")
        if np.max(np.abs(np.roots(denominator)), initial=0.0) >= 1:
            raise ConfigError(f"denominator {_text(denominator)}: never settles, which no motor does: is a sign wrong?")
        if not abs(delay_s) <= _LONGEST_S:
            raise ConfigError(f"delay_s {delay_s:g}: should be from {-_LONGEST_S:g} to {_LONGEST_S:g} s.")
        return cls(numerator=np.array(numerator), denominator=np.array(denominator), delay_s=delay_s)

    @classmethod
    def of_quantities(cls, quantities: Mapping[str, Parameter]) -> "TransferFunction":
        """Return the identified function, with its delay.

        Raises DataError for a missing quantity, and for coefficients that no motor has.
        """
        try:
            numerator, denominator, average = (
                quantities[f"tf.{key}"] for key in ("numerator", "denominator", "delay_s")
            )
        except KeyError as error:
            raise DataError(f"there is no {error.args[0]}: identify the transfer function again.") from None
        quickest = quantities.get("tf.delay_after_quickest_s")
        average_s = math.nan if average.value is None else average.value
        try:
            function = cls.of_coefficients(numerator.value, denominator.value, delay_s=average_s)
        except ConfigError as error:
            raise DataError(f"{error} Identify the transfer function again.") from None
        return replace(
            function,
            delay_std_s=(average if quickest is None else quickest).std or 0.0,
            after_quickest_s=None if quickest is None else quickest.value,
        )

    @property
    def static_gain_n(self) -> float:
        """The force over a constant command."""
        return float(self.numerator.sum() / self.denominator.sum())

    @property
    def time_constant_s(self) -> float | None:
        """The time constant of the slowest pole; None where that pole is no decay."""
        pole = float(np.max(np.abs(np.roots(self.denominator)), initial=0.0))
        return -self.sample_s / math.log(pole) if 0 < pole < 1 else None

    def response(self, omega_rad_s: Array) -> Complex:
        """Return force at the samples over samples u[n] (eq. 3.11) at frequencies (n,), without delay."""
        delayed = np.exp(-1j * omega_rad_s * self.sample_s)
        over, under = (np.polynomial.polynomial.polyval(delayed, own) for own in (self.numerator, self.denominator))
        return np.asarray(over / under)

    def simulate(self, commands: Array, time_s: Array) -> Array:
        """Return the force (n,) at times (n,) since sample 0, from rest; commands (N,) are followed by 0.

        Between samples, the force is interpolated linearly.
        """
        last = max(len(commands), math.ceil(float(time_s.max()) / self.sample_s)) + 1
        force = _lfilter(self.numerator, self.denominator, np.append(commands, np.zeros(last - len(commands))))
        return np.asarray(np.interp(time_s, self.sample_s * np.arange(-1, last), np.append(0.0, force)))

    @property
    def text(self) -> str:
        """H(z) in rising powers of z^-1."""
        return f"({_polynomial(self.numerator)}) / ({_polynomial(self.denominator)})"


def _polynomial(coefficients: Array) -> str:
    terms = [
        f"{value:+.7g}" + (f" z^-{power}" if power else "")
        for power, value in enumerate(coefficients.tolist())
        if value != 0
    ]
    return " ".join(terms).removeprefix("+").replace(" +", " + ").replace(" -", " - ") or "0"


def _text(coefficients: Sequence[float]) -> str:
    return ",".join(f"{value:g}" for value in coefficients)


EQ_3_15 = TransferFunction(numerator=np.array([6.0705967e-8]), denominator=np.array([1, -0.9745210]))
EQ_3_16 = TransferFunction(numerator=np.array([7.2345374e-8]), denominator=np.array([1, -0.9695404]))
