"""Rigid bodies from numbers: cuboids to mass, centre and inertia, axes to distances and axis inertias."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.records.campaign import Cuboid, Vector
from cfid.units import MM

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class MassProperties:
    """Mass, centre of mass (3,) and inertia matrix (3, 3) about the centre of mass, in the body frame."""

    mass_kg: float
    centre_m: Array
    inertia_kg_m2: Array


def axis_inertia(inertia_kg_m2: Array, direction: Vector | Array) -> float:
    """Return the inertia about an axis through the same point, eq. 2.2 with the matrix' own entries: u' I u."""
    unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    return float(unit @ inertia_kg_m2 @ unit)


def axis_distance(centre_m: Array, point_m: Vector | Array, direction: Vector | Array) -> float:
    """Return the distance of a point from the line through `point_m` along `direction` (C.1.7)."""
    along = np.asarray(direction, dtype=float)
    return float(np.linalg.norm(np.cross(centre_m - np.asarray(point_m), along)) / np.linalg.norm(along))


def from_cuboids(cuboids: Sequence[Cuboid], *, mass_kg: float, scale: Array | None = None) -> MassProperties:
    """Return the mass properties of boxes of one density (eq. 2.21 and 2.3, C.1.5).

    `scale`, shape (boxes, 3), stretches the edges; it serves to try how much a length matters.
    """
    sizes = MM * np.array([cuboid.size_mm for cuboid in cuboids])
    sizes = sizes if scale is None else sizes * scale
    centres = MM * np.array([cuboid.centre_mm for cuboid in cuboids])
    masses = mass_kg * np.prod(sizes, axis=1) / np.prod(sizes, axis=1).sum()
    centre = masses @ centres / mass_kg
    inertia = np.zeros((3, 3))
    for mass, size, offset in zip(masses, sizes, centres - centre, strict=True):
        squares = size**2
        own = np.diag(mass / 12 * (squares.sum() - squares))
        inertia += own + mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return MassProperties(mass_kg=mass_kg, centre_m=centre, inertia_kg_m2=inertia)
