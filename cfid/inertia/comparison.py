"""The test body: its inertia from the drawing against its inertia from swings (section 2.6)."""

from dataclasses import dataclass

import numpy as np
from uncertainties import nominal_value, std_dev

from cfid.records.rig_file import TestBody
from cfid.swing.body import AxisInertias, from_cuboids, uncertain
from cfid.units import MM


@dataclass(frozen=True, kw_only=True)
class BodyComparison:
    """One axis of table 2.5: both inertias about the parallel axis through the centre of mass.

    `error` is the relative error of the measured inertia, as table 2.5 prints it: negative below the drawing. In its
    standard uncertainty, the mass, which both inertias share, counts once.
    """

    axis: str
    calculated_kg_m2: float
    calculated_std_kg_m2: float
    measured_kg_m2: float
    measured_std_kg_m2: float
    error: float
    error_std: float

    @property
    def deviations(self) -> float:
        """How many standard uncertainties lie between the two inertias; infinite where none is known."""
        return abs(self.error) / self.error_std if self.error_std > 0 else np.inf


def compare(body: TestBody, axes: AxisInertias) -> list[BodyComparison]:
    """Compare calculated and measured inertia for each swing."""
    mass = axes.shared.get("mass", body.mass_kg)
    edges = [
        [MM * uncertain(size, body.length_std_mm, "lengths") for size in cuboid.size_mm] for cuboid in body.cuboids
    ]
    drawn = from_cuboids(body.cuboids, mass_kg=mass, sizes_m=np.array(edges, dtype=object)).inertia_kg_m2
    comparisons = []
    for swing, direction, measured in zip(axes.swings, axes.direction, axes.about_centre_kg_m2, strict=True):
        calculated = direction @ drawn @ direction
        error = measured / calculated - 1
        comparisons.append(
            BodyComparison(
                axis=swing.axis,
                calculated_kg_m2=float(nominal_value(calculated)),
                calculated_std_kg_m2=float(std_dev(calculated)),
                measured_kg_m2=float(nominal_value(measured)),
                measured_std_kg_m2=float(std_dev(measured)),
                error=float(nominal_value(error)),
                error_std=float(std_dev(error)),
            )
        )
    return comparisons
