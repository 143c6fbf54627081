"""Compute the inertia about the axis of one swing from its frequency and the body's mass and distance."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.estimate.propagation import contributions
from cfid.findings import Finding, note
from cfid.quantities.registry import Platform
from cfid.records.parameters import Parameter
from cfid.records.plausibility import implausible_inputs
from cfid.records.rig_file import Rig
from cfid.swing.axis_inertias import AxisInertias, MountedSwing, Surroundings, SwungBody
from cfid.swing.collocation import Coefficients
from cfid.swing.plausibility import given_numbers, moment_fault

INERTIA = "swing.axis_inertia_kg_m2"
_DAMPING = {
    "swing.viscous_nms_per_rad": "viscous_per_s",
    "swing.coulomb_nm": "coulomb_per_s2",
    "swing.quadratic_nms2_per_rad2": "quadratic_per_rad",
}
_STIFFNESS = (
    "a cable or a bearing whose pull grows as gravity's shows in no single swing, and under a gyro no spring does: 1 % "
    "of it makes the inertia 1 % too low. Swing about the same axis at a second distance."
)


@dataclass(frozen=True, kw_only=True)
class InertiaAbout:
    """The inertia about the mounting axis and about the parallel one through the centre of mass, and their distance."""

    about_axis_kg_m2: float
    about_centre_kg_m2: float
    about_centre_std: float
    distance_m: float
    budget: str
    quantities: Mapping[str, Parameter]


def inertia_about(
    values: Coefficients, std: Coefficients, body: SwungBody, mount: str, around: Surroundings
) -> InertiaAbout:
    """Return the inertia about the axis of a body's mount, from the swing's coefficients and their uncertainties."""
    measured = MountedSwing(axis=mount, value=values.natural_frequency_squared_s2, std=std.natural_frequency_squared_s2)
    axis_inertias = AxisInertias([measured], body, around)

    def both(inputs: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        one = axis_inertias.evaluate(inputs)
        return np.concatenate([one.about_axis_kg_m2, one.about_centre_kg_m2])

    inertia, about_centre = map(float, both(axis_inertias.values))
    parts = contributions(both, axis_inertias.inputs)
    inertia_std, centre_std = map(float, np.linalg.norm(parts, axis=1))
    groups = [given.group for given in axis_inertias.inputs]
    shares = {group: np.linalg.norm(parts[0][[one == group for one in groups]]) for group in dict.fromkeys(groups)}
    quantities = {INERTIA: Parameter(value=inertia, std=inertia_std or None)}
    for key, name in _DAMPING.items():
        ratio, ratio_std = getattr(values, name), getattr(std, name)
        torque_std = math.hypot(ratio_std * inertia, ratio * inertia_std)
        quantities[key] = Parameter(value=ratio * inertia, std=torque_std or None)
    return InertiaAbout(
        about_axis_kg_m2=inertia,
        about_centre_kg_m2=about_centre,
        about_centre_std=centre_std,
        distance_m=float(axis_inertias.evaluate(axis_inertias.values).distance_m[0]),
        budget="standard uncertainty of the inertia: "
        + ", ".join(f"{group} {100 * abs(share / inertia):.2g} %" for group, share in shares.items() if share),
        quantities=quantities,
    )


def findings_about(body: SwungBody, inertia: InertiaAbout, rig: Rig | None, platform: Platform) -> tuple[Finding, ...]:
    """Return what is implausible in the given numbers or in the inertia, and what one swing cannot show.

    `platform` is that of the vehicle, if that swung.
    """
    resting = tuple(inertia.quantities)
    return (
        *implausible_inputs(given_numbers(body, filter(None, [inertia.distance_m]), platform), rig, *resting),
        *moment_fault(
            "this swing", inertia.about_axis_kg_m2, inertia.about_centre_kg_m2, inertia.about_centre_std, *resting
        ),
        *([note("swing-stiffness-unseen", _STIFFNESS, INERTIA)] if inertia.distance_m else []),
    )
