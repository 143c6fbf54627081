"""The mean in a window set by hand, as the thesis took it (C.2.3). This module finds no window."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError

Array = npt.NDArray[np.float64]

_BIAS = slice(9, 60)  # MATLAB's 10:60


class ThesisMean(NamedTuple):
    """Mean of a window less the bias, the bias, and the window's first and last sample."""

    mean: float
    bias: float
    first: int
    last: int


def reduce_thesis(time_s: Array, channel: Array, *, from_s: float, to_s: float) -> ThesisMean:
    """Average a channel (n,) in a window set by hand, as prepare_data of C.2.3 does before halving it for two motors.

    The bias is Fz_raw(10:60), 51 samples from the tenth on. The window, in seconds since the first sample, begins with
    the last sample not after `from_s` and ends with the last not after `to_s`.

    Raises DataError where C.2.3 would find no index: for a window that is not within the record.
    """
    since_s = time_s - time_s[0]
    if len(since_s) < _BIAS.stop:
        raise DataError(f"the thesis' bias is that of samples 10 to 60; there are {len(since_s)}.")
    if not 0 <= from_s <= to_s < since_s[-1]:
        raise DataError(f"the window from {from_s:g} to {to_s:g} s is not within the record of {since_s[-1]:.4g} s.")
    first, last = (int(place) - 1 for place in np.searchsorted(since_s, (from_s, to_s), side="right"))
    bias = float(channel[_BIAS].mean())
    return ThesisMean(float(channel[first : last + 1].mean()) - bias, bias, first, last)
