"""From natural frequencies to inertias about parallel axes through the centre of mass, input by input.

The path of section 2.5: I_a = m g r / W, then I_G = I_a - m r^2. Mass, gravity, centre of mass and mounts
enter as uncertain inputs; those that several swings share stay shared, and so correlate the results.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from cfid.estimate.propagation import Input
from cfid.records.rig_file import Cuboid, Fixture, Mount, TestBody, Vector
from cfid.units import MM

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class MountedSwing:
    """What was measured about one mount: a natural frequency squared, or an axis inertia already known.

    `value` is in s^-2 when `known` is false, else in kg m^2.
    """

    axis: str
    value: float
    std: float
    known: bool = False


@dataclass(frozen=True, kw_only=True)
class SwungBody:
    """The body that swung: mass, centre of mass (3,) with standard uncertainties, its mounts by name."""

    mass_kg: float
    mass_std_kg: float
    centre_m: Array
    centre_std_m: Array
    mounts: Mapping[str, Mount]


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Gravity, and the empty fixture if it was swung: its own natural frequency squared or axis inertia."""

    gravity_mps2: float
    gravity_std_mps2: float
    fixture: Fixture | None = None
    fixture_swing: MountedSwing | None = None


@dataclass(frozen=True, kw_only=True)
class Evaluated:
    """One evaluation for all swings: inertias about the axis and the centre, distance, unit direction."""

    about_axis_kg_m2: Array
    about_centre_kg_m2: Array
    distance_m: Array
    direction: Array  # (n, 3)


@dataclass(frozen=True)
class AxisInertias:
    """The function from uncertain inputs to axis inertias, for one set of swings."""

    swings: Sequence[MountedSwing]
    body: SwungBody
    surroundings: Surroundings
    inputs: tuple[Input, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Collect the inputs once; their order is the order of the vectors that `evaluate` takes."""
        object.__setattr__(self, "inputs", tuple(_inputs(self.swings, self.body, self.surroundings)))

    @property
    def values(self) -> Array:
        """The inputs' values."""
        return np.array([given.value for given in self.inputs])

    def evaluate(self, values: Array) -> Evaluated:
        """Return the axis inertias for input values (i,)."""
        given = {known.name: float(value) for known, value in zip(self.inputs, values, strict=True)}
        mass, gravity = given["mass"], given["gravity"]
        centre = np.array([given[f"centre {c}"] for c in "xyz"])
        fixture_moment, fixture_inertia = self._fixture(given)
        about_axis, distances, directions = [], [], []
        for i, swing in enumerate(self.swings):
            mount = self.body.mounts[swing.axis]
            point, direction, along = _placed(mount, swing.axis, given)
            distance = axis_distance(centre, point, along)
            moment = mass * gravity * distance + fixture_moment
            measured = given[f"swing {i}"]
            total = measured if swing.known else moment / measured
            about_axis.append(total if swing.known else total - fixture_inertia)
            distances.append(distance)
            directions.append(direction)
        r, inertia = np.array(distances), np.array(about_axis)
        return Evaluated(
            about_axis_kg_m2=inertia,
            about_centre_kg_m2=inertia - mass * r**2,
            distance_m=r,
            direction=np.array(directions),
        )

    def _fixture(self, given: Mapping[str, float]) -> tuple[float, float]:
        """Return gravity moment and axis inertia of the empty fixture, which every swing carries along."""
        if self.surroundings.fixture is None or self.surroundings.fixture_swing is None:
            return 0.0, 0.0
        moment = given["fixture mass"] * given["gravity"] * given["fixture distance"]
        measured = given["fixture swing"]
        return moment, measured if self.surroundings.fixture_swing.known else moment / measured


def _inputs(swings: Sequence[MountedSwing], body: SwungBody, around: Surroundings) -> list[Input]:
    inputs = [
        Input(name="mass", group="mass", value=body.mass_kg, std=body.mass_std_kg),
        Input(name="gravity", group="gravity", value=around.gravity_mps2, std=around.gravity_std_mps2),
    ]
    for c, value, std in zip("xyz", body.centre_m, body.centre_std_m, strict=True):
        inputs.append(Input(name=f"centre {c}", group="centre of mass", value=float(value), std=float(std)))
    for axis in dict.fromkeys(swing.axis for swing in swings):
        mount = body.mounts[axis]
        for j, std in enumerate(mount.point_std_mm):
            inputs.append(Input(name=f"{axis} point {j}", group="mount distances", value=0.0, std=MM * std))
        for j in range(2):
            tilt = float(np.radians(mount.direction_std_deg))
            inputs.append(Input(name=f"{axis} tilt {j}", group="axis directions", value=0.0, std=tilt))
    for i, swing in enumerate(swings):
        inputs.append(Input(name=f"swing {i}", group="swing fits", value=swing.value, std=swing.std))
    if around.fixture is not None and around.fixture_swing is not None:
        hanging, swung = around.fixture, around.fixture_swing
        inputs += [
            Input(name="fixture mass", group="fixture", value=hanging.mass_kg, std=hanging.mass_std_kg),
            Input(
                name="fixture distance",
                group="fixture",
                value=MM * hanging.distance_mm,
                std=MM * hanging.distance_std_mm,
            ),
            Input(name="fixture swing", group="fixture", value=swung.value, std=swung.std),
        ]
    return inputs


def _placed(mount: Mount, axis: str, given: Mapping[str, float]) -> tuple[Array, Array, Array]:
    """Return the mount's point, direction and distance direction, moved by their errors."""
    shift = np.array([given[f"{axis} point {j}"] for j in range(3)])
    point = np.array(mount.point_m) + shift @ np.array(mount.point_axes)
    tilts = given[f"{axis} tilt 0"], given[f"{axis} tilt 1"]
    direction = _tilted(np.array(mount.direction, dtype=float), tilts)
    if mount.distance_direction is None:
        return point, direction, direction
    return point, direction, _tilted(np.array(mount.distance_direction, dtype=float), tilts)


def _tilted(direction: Array, tilts: tuple[float, float]) -> Array:
    """Return the unit vector turned by two small angles about two axes across it."""
    unit = direction / np.linalg.norm(direction)
    aside = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    aside /= np.linalg.norm(aside)
    moved = unit + tilts[0] * aside + tilts[1] * np.cross(unit, aside)
    return np.asarray(moved / np.linalg.norm(moved))


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
