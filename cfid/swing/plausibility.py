"""Check that a body and its inertia are possible: mass, centre of mass, distance, inertia."""

import math
from collections.abc import Iterable, Iterator

from cfid.findings import Finding, rejection
from cfid.quantities.registry import Platform, Range, range_of
from cfid.records.plausibility import Given
from cfid.swing.axis_inertias import SwungBody

BEYOND_STD = 4.0  # a larger error in a body's inertia is not noise

_DISTANCE = Range(5e-4, 0.3, "a mount lies within the arms of a vehicle of 1 kg")
_CENTRE = Range(-0.3, 0.3, "it lies between the rotors")
_LEAST_STD = 0.01  # of the axis inertia, assumed for numbers without an uncertainty


def given_numbers(body: SwungBody, distances_m: Iterable[float], platform: Platform = "crazyflie") -> Iterator[Given]:
    """Yield the mass, the centre of mass and the distances (n,) of a body that swings, with their plausible ranges.

    `platform` is that of a vehicle, whose mass has a narrower range than any other body's.
    """
    mass = range_of("mass_kg", platform)
    if mass is not None:
        yield Given("mass", body.mass_kg, mass, "kg")
    for axis, value in zip("xyz", body.centre_m, strict=True):
        yield Given(f"centre of mass' {axis}", float(value), _CENTRE, "m")
    for distance_m in dict.fromkeys(distances_m):
        yield Given("distance from the axis to the centre of mass", distance_m, _DISTANCE, "m")


def moment_fault(
    what: str, about_axis_kg_m2: float, about_centre_kg_m2: float, std_kg_m2: float, *resting: str
) -> tuple[Finding, ...]:
    """Return a rejection where an inertia about the centre of mass is negative or smaller than its uncertainty.

    A negative value within 4 standard uncertainties, each of at least 1 % of the axis inertia, may be noise or a bob on
    a thread: it is rejected only where its uncertainty is known.
    """
    allowed = BEYOND_STD * math.hypot(std_kg_m2, _LEAST_STD * about_axis_kg_m2)
    if about_centre_kg_m2 < -allowed:
        text = (
            f"{what}: the inertia about the centre of mass would be {about_centre_kg_m2:.3g} kg m^2, which no body "
            "has. Check mass, distance and gravity."
        )
        return (rejection("inertia-negative", text, *resting),)
    if std_kg_m2 > 0 and about_centre_kg_m2 < std_kg_m2:
        text = (
            f"{what}: the inertia about the centre of mass, {about_centre_kg_m2:.3g} kg m^2, is smaller than its "
            f"standard uncertainty, {std_kg_m2:.3g}. Swing nearer to the centre of mass; check mass and distance."
        )
        return (rejection("inertia-below-uncertainty", text, *resting),)
    return ()
