"""How much each uncertain input moves what the swings give."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.estimate.propagation import Input, contributions
from cfid.inertia.directions import matrix_rows
from cfid.swing.axis_inertias import AxisInertias

Array = npt.NDArray[np.float64]

UNKNOWNS = 6
_OF_MOUNTS = ("mount distances", "axis directions")  # groups of inputs


class Moved(NamedTuple):
    """How much each input's standard uncertainty moves what is measured: (n, i), (n, i) and (n, 6, i)."""

    about_axis: Array
    about_centre: Array
    rows: Array

    def hung_anew(self, inputs: Sequence[Input], share: float) -> "Moved":
        """Return these effects plus a share of each mount's effect on a swing, as inputs of that swing alone."""
        mounts = [i for i, given in enumerate(inputs) if given.group in _OF_MOUNTS]
        alone = np.eye(len(self.about_centre))
        return Moved(*(_beside(part, share * part[..., mounts], alone) for part in self))


def _beside(part: Array, own: Array, alone: Array) -> Array:
    """Return columns (n, ..., i), then those of `own` (n, ..., m), each for one swing alone: (n, ..., i + n m)."""
    each = np.einsum("ij,i...m->i...jm", alone, own)
    return np.concatenate([part, each.reshape(*part.shape[:-1], -1)], axis=-1)


def moved_by_inputs(axis_inertias: AxisInertias) -> Moved:
    """Return how much each input's standard uncertainty moves the inertias and the rows of the swings."""

    def outputs(values: Array) -> Array:
        found = axis_inertias.evaluate(values)
        rows = matrix_rows(found.direction)
        return np.concatenate([found.about_axis_kg_m2, found.about_centre_kg_m2, rows.ravel()])

    count = len(axis_inertias.swings)
    columns = contributions(outputs, axis_inertias.inputs)
    return Moved(columns[:count], columns[count : 2 * count], columns[2 * count :].reshape(count, UNKNOWNS, -1))
