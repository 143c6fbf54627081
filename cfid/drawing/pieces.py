"""Draw only the start and the end of a long record, which would be one dark bar as a whole."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

Array = npt.NDArray[np.float64]

MANY_PERIODS = 25
_SHOWN_PERIODS = 5


class Piece(NamedTuple):
    """A panel's axes and the samples that they show."""

    axes: Axes
    samples: slice


def pieces(page: Figure, grid: GridSpec, row: int, time_s: Array, *, period_s: float) -> list[Piece]:
    """Return axes for a whole record (n,), or a pair of axes for its first and its last periods.

    They fill one row of a grid with two columns. The pair shares a vertical axis; the second has no labels of its own.
    """
    if time_s[-1] - time_s[0] <= MANY_PERIODS * period_s:
        return [Piece(page.add_subplot(grid[row, :]), slice(None))]
    left = page.add_subplot(grid[row, 0])
    right = page.add_subplot(grid[row, 1], sharey=left)
    right.tick_params(labelleft=False, left=False)
    right.spines.left.set_linestyle((0, (2, 3)))
    shown = _SHOWN_PERIODS * period_s
    early = int(np.searchsorted(time_s, time_s[0] + shown, side="right"))
    late = int(np.searchsorted(time_s, time_s[-1] - shown))
    return [Piece(left, slice(None, early)), Piece(right, slice(late, None))]
