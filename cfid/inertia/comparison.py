"""The test body: its inertia from the drawing against its inertia from swings (section 2.6)."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.estimate.propagation import Input, contributions
from cfid.records.rig_file import TestBody
from cfid.swing.axis_inertias import AxisInertias, axis_inertia, from_cuboids

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class BodyComparison:
    """One axis of table 2.5: both inertias about the parallel axis through the centre of mass.

    `error_std` is the standard uncertainty of the relative error; the mass, which both inertias share, counts once.
    """

    axis: str
    calculated_kg_m2: float
    calculated_std_kg_m2: float
    measured_kg_m2: float
    measured_std_kg_m2: float
    error_std: float

    @property
    def error(self) -> float:
        """Relative error of the measured inertia, as table 2.5 prints it: negative below the drawing."""
        return (self.measured_kg_m2 - self.calculated_kg_m2) / self.calculated_kg_m2

    @property
    def deviations(self) -> float:
        """How many standard uncertainties lie between the two inertias; infinite where none is known."""
        return abs(self.error) / self.error_std if self.error_std > 0 else np.inf


def compare(body: TestBody, axis_inertias: AxisInertias) -> list[BodyComparison]:
    """Compare calculated and measured inertia for each swing."""
    edges = _edges(body)
    inputs = (*axis_inertias.inputs, *edges)
    mass = next(i for i, given in enumerate(inputs) if given.name == "mass")

    def both(values: Array) -> Array:
        swung = axis_inertias.evaluate(values[: -len(edges)])
        drawn = from_cuboids(body.cuboids, mass_kg=float(values[mass]), scale=values[-len(edges) :].reshape(-1, 3))
        calculated = np.array([axis_inertia(drawn.inertia_kg_m2, direction) for direction in swung.direction])
        return np.stack([calculated, swung.about_centre_kg_m2, swung.about_centre_kg_m2 / calculated])

    count = len(axis_inertias.swings)
    values = both(np.array([given.value for given in inputs]))
    moved = contributions(lambda v: both(v).ravel(), inputs).reshape(3, count, -1)
    std = np.sqrt(np.sum(moved**2, axis=2))
    return [
        BodyComparison(
            axis=swing.axis,
            calculated_kg_m2=float(values[0, i]),
            calculated_std_kg_m2=float(std[0, i]),
            measured_kg_m2=float(values[1, i]),
            measured_std_kg_m2=float(std[1, i]),
            error_std=float(std[2, i]),
        )
        for i, swing in enumerate(axis_inertias.swings)
    ]


def _edges(body: TestBody) -> list[Input]:
    """Return the scale of every cuboid's edges as uncertain inputs, in the order of their sizes."""
    return [
        Input(name=f"edge {i}{j}", group="lengths", value=1.0, std=body.length_std_mm / size)
        for i, cuboid in enumerate(body.cuboids)
        for j, size in enumerate(cuboid.size_mm)
    ]
