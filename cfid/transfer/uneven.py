"""Detect a motor that slows down more slowly than it speeds up, from the second harmonic of its sines.

With rates r (1 + e) up and r (1 - e) down, a speed that follows a sine gets a second harmonic, in quadrature to that of
the thrust, which is proportional to the square of the speed. Its mean rises by 2 e / pi of the amplitude by which it
lags behind the command, and the thrust of the sine rises with it: more at high frequencies, as with a shorter time
constant.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cfid.estimate.linear import fit_linear
from cfid.findings import Finding, warning
from cfid.transfer.frequency_response import Response
from cfid.transfer.model import Complex

_LARGEST_IN_STD = 3.0
_LEAST = 0.05  # of the rate: a smaller difference does not matter
_FEWEST = 3


class Uneven(NamedTuple):
    """The relative excess e of the upward rate over the mean rate, and the part that it adds to each response (n,)."""

    part: float
    std: float
    raised: Complex

    @property
    def ratio(self) -> float:
        """The downward time constant over the upward one."""
        return (1 + self.part) / (1 - self.part)

    def findings(self, keys: Sequence[str]) -> list[Finding]:
        """Return a warning about quantities `keys` of a linear transfer function."""
        text = (
            f"the sines' second harmonic shows a motor whose time constant is {self.ratio:.2f} times as long downwards "
            "as upwards: no linear transfer function follows it, and the standard uncertainties contain by how much it "
            "misses. `cfid fit dynamics` gives both time constants."
        )
        return [warning("transfer-uneven-lag", text, *keys)]


def uneven_rates(responses: Sequence[Response], *, lag_s: float) -> Uneven | None:
    """Return the unevenness in second harmonics of responses (n,) with a time constant, None if there is none."""
    if len(responses) < _FEWEST:
        return None
    lagged = lag_s * np.array([own.frequency_rad_s for own in responses])
    size = np.abs([own.value for own in responses])
    second = np.array([own.second for own in responses])
    std = np.array([own.std for own in responses]) / size
    of_rates = -4 / (3 * math.pi) * lagged / (1 + 2j * lagged)
    rows = np.vstack([np.stack([size, of_rates.real], axis=1), np.stack([0 * size, of_rates.imag], axis=1)])
    weight = 1 / np.tile(std, 2)
    found = fit_linear(rows * weight[:, np.newaxis], np.append(second.real, second.imag) * weight, noise_known=False)
    (bent, part), part_std = found.values.tolist(), float(found.std[1])
    if abs(part) < max(_LARGEST_IN_STD * part_std, _LEAST) or abs(part) >= 1:
        return None
    return Uneven(part, part_std, part * 8 / math.pi * lagged * bent * size + 0j)
