"""The test body: its inertia from the drawing against its inertia from swings (section 2.6)."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.analysis.axis_inertias import AxisInertias, SwungBody
from cfid.analysis.bodies import axis_inertia, from_cuboids
from cfid.analysis.uncertainty import Input, contributions
from cfid.campaign import MM, TestBody

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One axis of table 2.5: both inertias about the parallel axis through the centre of mass."""

    axis: str
    calculated_kg_m2: float
    calculated_std_kg_m2: float
    measured_kg_m2: float
    measured_std_kg_m2: float

    @property
    def error(self) -> float:
        """Relative error of the measured inertia, without its sign, as table 2.5 prints it."""
        return abs(self.measured_kg_m2 - self.calculated_kg_m2) / self.calculated_kg_m2

    @property
    def error_std(self) -> float:
        """One standard deviation of the relative error; its parts are independent but for the mass."""
        return float(np.hypot(self.measured_std_kg_m2, self.calculated_std_kg_m2) / self.calculated_kg_m2)

    @property
    def deviations(self) -> float:
        """How many standard deviations lie between the two; infinite where none is known."""
        spread = np.hypot(self.measured_std_kg_m2, self.calculated_std_kg_m2)
        return abs(self.measured_kg_m2 - self.calculated_kg_m2) / spread if spread > 0 else np.inf


def swung_test_body(body: TestBody) -> SwungBody:
    """Return the test body as something that swings, its centre of mass from the drawing."""
    centre = from_cuboids(body.cuboids, mass_kg=body.mass_kg).centre_m
    return SwungBody(
        mass_kg=body.mass_kg,
        mass_std_kg=body.mass_std_kg,
        centre_m=centre,
        centre_std_m=np.full(3, MM * body.length_std_mm / 2),
        mounts=body.mounts,
    )


def compare(body: TestBody, axis_inertias: AxisInertias) -> list[Comparison]:
    """Compare calculated and measured inertia for every swing."""
    evaluated = axis_inertias.evaluate(axis_inertias.values)
    moved = contributions(lambda v: axis_inertias.evaluate(v).about_centre_kg_m2, axis_inertias.inputs)
    measured_std = np.sqrt(np.sum(moved**2, axis=1))
    calculated, calculated_std = _calculated(body, evaluated.direction)
    return [
        Comparison(
            axis=swing.axis,
            calculated_kg_m2=float(calculated[i]),
            calculated_std_kg_m2=float(calculated_std[i]),
            measured_kg_m2=float(evaluated.about_centre_kg_m2[i]),
            measured_std_kg_m2=float(measured_std[i]),
        )
        for i, swing in enumerate(axis_inertias.swings)
    ]


def _calculated(body: TestBody, directions: Array) -> tuple[Array, Array]:
    sizes = np.array([cuboid.size_mm for cuboid in body.cuboids])
    inputs = [Input(name="mass", group="mass", value=body.mass_kg, std=body.mass_std_kg)]
    for i, row in enumerate(sizes):
        for j, size in enumerate(row):
            inputs.append(Input(name=f"edge {i}{j}", group="lengths", value=1.0, std=body.length_std_mm / size))

    def inertias(values: Array) -> Array:
        drawn = from_cuboids(body.cuboids, mass_kg=float(values[0]), scale=values[1:].reshape(sizes.shape))
        return np.array([axis_inertia(drawn.inertia_kg_m2, direction) for direction in directions])

    moved = contributions(inertias, inputs)
    return inertias(np.array([given.value for given in inputs])), np.sqrt(np.sum(moved**2, axis=1))
