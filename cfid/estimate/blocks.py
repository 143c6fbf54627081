"""Average blocks of samples: this thins a record without aliasing fast changes. Needs only NumPy."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def block_means(value: Array, *, length: int) -> Array:
    """Return the means of consecutive blocks of `length` samples along the last axis, without an incomplete one."""
    blocks = value.shape[-1] // length
    cut = value[..., : blocks * length].reshape(*value.shape[:-1], blocks, length)
    return np.asarray(cut @ np.full(length, 1 / length))
