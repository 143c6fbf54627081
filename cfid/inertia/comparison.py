"""The test body: its inertia from the drawing against its inertia from swings (section 2.6)."""

import math
from typing import Any, NamedTuple

import numpy as np
from uncertainties import nominal_value, std_dev

from cfid.records.rig_file import TestBody
from cfid.swing.body import AxisInertias, from_cuboids, uncertain
from cfid.units import MM


class BodyComparison(NamedTuple):
    """One axis of table 2.5: both inertias about the parallel axis through the centre of mass, uncertain numbers.

    The mass, which both inertias share, counts once in the uncertainty of their difference.
    """

    axis: str
    calculated_kg_m2: Any
    measured_kg_m2: Any

    @property
    def error(self) -> Any:
        """The relative error of the measured inertia, as table 2.5 prints it: negative below the drawing."""
        return self.measured_kg_m2 / self.calculated_kg_m2 - 1

    @property
    def deviations(self) -> float:
        """How many standard uncertainties lie between the two inertias; infinite where none is known."""
        error = self.error
        return float(abs(nominal_value(error)) / std_dev(error)) if std_dev(error) > 0 else math.inf


def compare(body: TestBody, axes: AxisInertias) -> list[BodyComparison]:
    """Compare calculated and measured inertia for each swing."""
    mass = axes.shared.get("mass", body.mass_kg)
    edges = [
        [MM * uncertain(size, body.length_std_mm, "lengths") for size in cuboid.size_mm] for cuboid in body.cuboids
    ]
    drawn = from_cuboids(body.cuboids, mass_kg=mass, sizes_m=np.array(edges, dtype=object)).inertia_kg_m2
    swings = zip(axes.swings, axes.direction, axes.about_centre_kg_m2, strict=True)
    return [BodyComparison(swing.axis, along @ drawn @ along, measured) for swing, along, measured in swings]
