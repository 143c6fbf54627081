"""Check forces in wind and the models fitted to them."""

import math

import numpy as np
import numpy.typing as npt

from cfid.drag.estimation import DragFit
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import CROSS, CROSS_MENDED
from cfid.findings import Finding, note, rejection, warning

Array = npt.NDArray[np.float64]

UNEXPLAINED_LIMIT = 0.5  # sum of squared errors over sum of squared forces

_DRIVEN = 0.2  # cosine between all forces and all velocities, the limit
_ACROSS = 0.5  # the same across velocities: 30 degrees if there is no noise
# The part of v_x + v_y, in squares, that |v_xy| has to leave unexplained for the two to be distinguished.
_APART = 0.01

_CROSS_KEY = "drag.cross_coupling_kg_per_rad"
_KEYS = {"simple": "drag.simple_kg_per_rad", "cross": _CROSS_KEY, "complex": "drag.complex.*"}


def quantities_of(name: str) -> tuple[str, str]:
    """Return the patterns of all keys that the model `simple`, `cross` or `complex` provides."""
    return _KEYS[name], f"drag.*.{name}"


def force_findings(experiments: DragExperiments) -> tuple[Finding, ...]:
    """Reject forces that cannot be drag, for example due to a wrong yaw, azimuth or sign."""
    return (*_driving(experiments), *_across(experiments))


def fit_findings(name: str, fit: DragFit, experiments: DragExperiments) -> tuple[Finding, ...]:
    """Return the findings about the fit of the model `simple`, `cross` or `complex`."""
    return (*_unexplained(name, fit, experiments), *(_kappa_4(fit, experiments) if name == "cross" else ()))


def resolves_kappa_4(experiments: DragExperiments) -> bool:
    """Return whether the winds distinguish a force in v_x + v_y from one in |v_xy|, which requires two azimuths."""
    x, y, _ = experiments.velocity_mps.T * experiments.speed_sum_rad_s
    signed, unsigned = x + y, np.hypot(x, y)
    squares = float(signed @ signed) * float(unsigned @ unsigned)
    return bool(squares > 0 and 1 - float(signed @ unsigned) ** 2 / squares > _APART)


def _driving(experiments: DragExperiments) -> list[Finding]:
    found = []
    for axes, part in (("x and y", slice(0, 2)), ("z", slice(2, 3))):
        force, velocity = experiments.force_n[:, part], experiments.velocity_mps[:, part]
        if np.sum(force * velocity) > _DRIVEN * np.linalg.norm(force) * np.linalg.norm(velocity):
            text = (
                f"along {axes} the forces have the direction of the vehicle's motion relative to the air, and would "
                "drive it: check yaw, azimuth, angle and the signs of force and velocity."
            )
            found.append(rejection("drag-drives", text, "drag.*"))
    return found


def _across(experiments: DragExperiments) -> list[Finding]:
    """Reject forces in x and y that point across the wind."""
    force, against = experiments.force_n[:, :2], -experiments.velocity_mps[:, :2]
    along = float(np.sum(force * against))
    leftward = float(np.sum(against[:, 0] * force[:, 1] - against[:, 1] * force[:, 0]))
    if abs(leftward) <= _ACROSS * np.linalg.norm(force) * np.linalg.norm(against):
        return []
    degrees = math.degrees(math.atan2(leftward, along))
    text = (
        f"in x and y the forces point {abs(degrees):.0f} degrees {'left' if degrees > 0 else 'right'} of the wind "
        "that should cause them: check yaw and azimuth."
    )
    return [rejection("drag-across-wind", text, "drag.*")]


def _unexplained(name: str, fit: DragFit, experiments: DragExperiments) -> list[Finding]:
    part = fit.sse_n2 / float(np.sum(experiments.force_n**2))
    if part <= UNEXPLAINED_LIMIT:
        return []
    text = (
        f"the {name} model leaves {100 * part:.0f} % of the forces' sum of squares unexplained (limit "
        f"{100 * UNEXPLAINED_LIMIT:.0f} %)."
    )
    return [rejection("drag-unexplained", text, *quantities_of(name))]


def _kappa_4(fit: DragFit, experiments: DragExperiments) -> list[Finding]:
    found = []
    if fit.model is CROSS_MENDED:
        text = (
            "the cross-coupling model is the mended one: kappa_4, twice in the third row, multiplies |v_xy|, so the "
            "matrix times v is not its force."
        )
        found.append(note("drag-kappa4-mended", text, _CROSS_KEY))
    if not resolves_kappa_4(experiments):
        text = (
            "all side winds came from one azimuth (or two that look alike): kappa_4, the force in z from flying "
            "sideways, holds for that direction alone. Turn the vehicle or the wind generator and record again."
        )
        found.append(warning("drag-kappa4-one-azimuth", text, _CROSS_KEY))
    if fit.model is CROSS and abs(fit.value[2, 0]) > 2 * fit.std[2, 0]:
        text = (
            "kappa_4 as in equation 4.7 lifts when flying one way and sinks when flying the other, which no rotor does "
            "(section 4.5): the mended model takes |v_xy|."
        )
        found.append(warning("drag-kappa4-sign", text, _CROSS_KEY))
    return found
