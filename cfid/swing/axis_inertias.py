"""Convert natural frequencies to inertias about parallel axes through the centre of mass, with all uncertain inputs.

This follows section 2.5: I_a = m g r / W, then I_G = I_a - m r^2. On two threads, I_G = m g a b / (h W) directly, where
a and b are the threads' distances from the vertical, above and below, and h is their height. Mass, gravity, centre of
mass and mounts are uncertain inputs; inputs that several swings share stay shared, and so correlate the results.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError
from cfid.estimate.propagation import Input
from cfid.records.rig_file import Cuboid, Fixture, Mount, TestBody, ThreadPair, Vector
from cfid.units import MM

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class MountedSwing:
    """A measurement about one mount: a natural frequency squared, or an axis inertia that is already known.

    `value` is in s^-2 when `known` is false, else in kg m^2. `seen` states whether a gyro showed the axis of rotation.
    `name` is that of the recording.
    """

    axis: str
    value: float
    std: float
    name: str = ""
    known: bool = False
    seen: bool = False


@dataclass(frozen=True, kw_only=True)
class SwungBody:
    """A body that swings: mass, centre of mass (3,) with standard uncertainties, and its mounts by name."""

    mass_kg: float
    mass_std_kg: float
    centre_m: Array
    centre_std_m: Array
    mounts: Mapping[str, Mount]


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Gravity and the empty fixture; if that was swung, its own natural frequency squared or axis inertia."""

    gravity_mps2: float
    gravity_std_mps2: float
    fixture: Fixture | None = None
    fixture_swing: MountedSwing | None = None


@dataclass(frozen=True, kw_only=True)
class Evaluated:
    """One evaluation for all swings: inertias about the axis and about the centre, distance and unit direction."""

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
    _mounts: "_Mounts" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Collect the inputs once; their order is that of the vectors that `evaluate` takes."""
        object.__setattr__(self, "inputs", tuple(_inputs(self.swings, self.body, self.surroundings)))
        object.__setattr__(self, "_mounts", _Mounts.of(self.swings, self.body, self.inputs))

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
        distance, direction = self._mounts.placed(values, centre)
        measured = values[self._mounts.swing]
        known = np.array([swing.known for swing in self.swings])
        on_axis = ~self._mounts.on_threads
        moment = mass * gravity * self._mounts.levers(values, distance) + on_axis * fixture_moment
        inertia = np.where(known, measured, moment / measured - on_axis * fixture_inertia)
        return Evaluated(
            about_axis_kg_m2=inertia,
            about_centre_kg_m2=inertia - mass * distance**2,
            distance_m=distance,
            direction=direction,
        )

    def _fixture(self, given: Mapping[str, float]) -> tuple[float, float]:
        """Return gravity moment and axis inertia of the empty fixture, which takes part in every swing."""
        swung = self.surroundings.fixture_swing
        if self.surroundings.fixture is None:
            return 0.0, 0.0
        mass, distance = given["fixture mass"], given["fixture distance"]
        moment = mass * given["gravity"] * distance
        if swung is None:
            return moment, mass * (given["fixture edge"] ** 2 / 6 + distance**2)
        return moment, given["fixture swing"] if swung.known else moment / given["fixture swing"]


class _Mounts(NamedTuple):
    """The mount of each swing: point (n, 3), axes of its coordinates (n, 3, 3), and unit vectors of its directions.

    `directions` (2, n, 3) are the directions for the inertia matrix and for the distance. `asides` (2, 2, n, 3) are,
    for each, the two perpendicular vectors along which it tilts. `points` (n, 3), `tilts` (n, 2), `threads` (n, 4) and
    `swing` (n,) are the indices of the inputs; those of threads apply where the body hangs `on_threads` (n,).
    """

    point_m: Array
    axes: Array
    directions: Array
    asides: Array
    points: npt.NDArray[np.intp]
    tilts: npt.NDArray[np.intp]
    on_threads: npt.NDArray[np.bool_]
    threads: npt.NDArray[np.intp]
    swing: npt.NDArray[np.intp]

    @classmethod
    def of(cls, swings: Sequence[MountedSwing], body: SwungBody, inputs: Sequence[Input]) -> "_Mounts":
        """Collect the mounts of all swings."""
        mounts = [body.mounts[swing.axis] for swing in swings]
        place = {given.name: i for i, given in enumerate(inputs)}
        pairs = [(mount.direction, mount.distance_direction or mount.direction) for mount in mounts]
        directions = np.array([[_unit(pair[k]) for pair in pairs] for k in range(2)]).reshape(2, -1, 3)
        asides = np.array([[_across(one) for one in row] for row in directions]).reshape(2, -1, 2, 3)
        return cls(
            point_m=np.array([mount.point_m for mount in mounts]).reshape(-1, 3),
            axes=np.array([mount.point_axes for mount in mounts]).reshape(-1, 3, 3),
            directions=directions,
            asides=asides.swapaxes(1, 2),
            points=_places(place, [[f"{swing.axis} point {j}" for j in range(3)] for swing in swings]).reshape(-1, 3),
            tilts=_places(place, [[f"{swing.axis} tilt {j}" for j in range(2)] for swing in swings]).reshape(-1, 2),
            on_threads=np.array([mount.threads is not None for mount in mounts], dtype=bool),
            threads=np.array(
                [[place.get(f"{swing.axis} thread {j}", 0) for j in range(4)] for swing in swings], dtype=np.intp
            ).reshape(-1, 4),
            swing=_places(place, [f"swing {i}" for i in range(len(swings))]),
        )

    def placed(self, values: Array, centre_m: Array) -> tuple[Array, Array]:
        """Return distances (n,) from the centre of mass and directions (n, 3), shifted by the input values."""
        point = self.point_m + np.einsum("nj,njk->nk", values[self.points], self.axes)
        tilt = values[self.tilts]
        moved = self.directions + tilt[:, 0, None] * self.asides[:, 0] + tilt[:, 1, None] * self.asides[:, 1]
        direction, along = moved / np.sqrt(np.einsum("knj,knj->kn", moved, moved))[..., None]
        offset = centre_m - point
        across = offset - np.einsum("nj,nj->n", offset, along)[:, None] * along
        distance = np.sqrt(np.einsum("nj,nj->n", across, across))
        return np.where(self.on_threads, 0.0, distance), direction

    def levers(self, values: Array, distance_m: Array) -> Array:
        """Return the levers (n,) of the weight: the distance, or a b / h for threads."""
        if not self.on_threads.any():
            return distance_m
        above, below, length, lost = values[self.threads].T
        height = np.sqrt(np.where(self.on_threads, length**2 - ((above - below) / 2) ** 2, 1.0))
        return np.where(self.on_threads, above * below * (1 - lost) / (4 * height), distance_m)


def _places(place: Mapping[str, int], names: Sequence[object]) -> npt.NDArray[np.intp]:
    found = np.vectorize(place.__getitem__, otypes=[np.intp])(names) if names else []
    return np.asarray(found, dtype=np.intp)


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
        for j, (value, std) in enumerate(_numbers(mount.threads) if mount.threads else ()):
            inputs.append(Input(name=f"{axis} thread {j}", group="threads", value=value, std=std))
        for j in range(2):
            tilt = float(np.radians(mount.direction_std_deg))
            inputs.append(Input(name=f"{axis} tilt {j}", group="axis directions", value=0.0, std=tilt))
    for i, swing in enumerate(swings):
        inputs.append(Input(name=f"swing {i}", group="swing fits", value=swing.value, std=swing.std))
    if around.fixture is not None:
        hanging, swung = around.fixture, around.fixture_swing
        on_axis = [one for one in swings if not one.known and body.mounts[one.axis].threads is None]
        if on_axis and swung is None and hanging.edge_mm is None:
            raise ConfigError(
                "[fixture] of rig.toml needs edge_mm, the edge of the cube, for the inertia of the fixture: add it, or "
                "swing the fixture alone and give that too (fixture=FILE of `cfid fit inertia`)."
            )
        inputs += [
            Input(name="fixture mass", group="fixture", value=hanging.mass_kg, std=hanging.mass_std_kg),
            Input(
                name="fixture distance",
                group="fixture",
                value=MM * hanging.distance_mm,
                std=MM * hanging.distance_std_mm,
            ),
            Input(
                name="fixture edge", group="fixture", value=MM * (hanging.edge_mm or 0.0), std=MM * hanging.edge_std_mm
            )
            if swung is None
            else Input(name="fixture swing", group="fixture", value=swung.value, std=swung.std),
        ]
    return inputs


def _numbers(threads: ThreadPair) -> list[tuple[float, float]]:
    """Return both distances, the length, and the loss by an offset centre, each with its standard uncertainty."""
    return [*zip(*threads.lengths_m, strict=True), threads.off_centre]


def _unit(vector: Vector) -> Array:
    return np.asarray(np.array(vector, dtype=float) / np.linalg.norm(vector))


def _across(unit: Array) -> Array:
    """Return two unit vectors (2, 3) perpendicular to a unit vector and to each other."""
    aside = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(unit, aside)])


def swung_test_body(body: TestBody) -> SwungBody:
    """Return the test body as a body that swings, with the centre of mass from the drawing."""
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
    """Return the inertia about an axis through the same point, u' I u: eq. 2.2 with the matrix' own entries."""
    unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    return float(unit @ inertia_kg_m2 @ unit)


def from_cuboids(cuboids: Sequence[Cuboid], *, mass_kg: float, scale: Array | None = None) -> MassProperties:
    """Return the mass properties of boxes of one density (eq. 2.21 and 2.3, C.1.5).

    `scale`, shape (boxes, 3), multiplies the edges, to find how much the result depends on a length.
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
