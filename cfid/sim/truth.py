"""Draws true bodies and mounts around the nominal values of rig.toml; nothing moves here."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError
from cfid.records.rig_file import Cuboid, Mount, Rig
from cfid.sim.stepping import Array
from cfid.units import MM

CUBE_M, CUBE_ARM_M = 0.019, 0.002
FRICTION_SPREAD = 0.1  # between mounts; the thesis' fits vary as much (table 2.3)


@dataclass(frozen=True, kw_only=True)
class TrueFriction:
    """The friction of a swing.

    With these defaults, a Crazyflie released at 50 degrees about x has fallen below 10 degrees after eight periods
    and shows 14 peaks above 1 degree, like the thesis' (section 2.4.4, table 2.3). The last three are as in Pendulum.
    """

    viscous_nms_per_rad: float = 1.5e-5
    coulomb_nm: float = 4e-5
    quadratic_nms2_per_rad2: float = 2e-8
    spring_nm_per_rad: float = 0.0
    stribeck_nm: float = 0.0
    ripple_nm: float = 0.0


OF_THREADS = TrueFriction(viscous_nms_per_rad=3e-6, coulomb_nm=0.0, quadratic_nms2_per_rad2=2e-7)  # air alone


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueMount:
    """A true axis: a point on it (3,), its unit direction (3,), and its friction.

    Two threads instead have distances above and below, and a length; the point is then the centre of mass.
    """

    point_m: Array
    direction: Array
    friction: TrueFriction
    threads_m: tuple[float, float, float] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """A true body: centre of mass (3,), inertia matrix about it (3, 3), mounts by name.

    A cube of `fixture_kg` swings on each axis too, with edges of CUBE_M and its centre CUBE_ARM_M below the axis
    (C.1.7).
    """

    mass_kg: float
    gravity_mps2: float
    centre_of_mass_m: Array
    inertia_kg_m2: Array
    mounts: Mapping[str, TrueMount]
    fixture_kg: float = 0.0


def draw_truth(
    rig: Rig,
    *,
    inertia_kg_m2: npt.ArrayLike,
    rng: np.random.Generator,
    friction: TrueFriction = TrueFriction(),
) -> Truth:
    """Draw a vehicle whose measured values, with their standard deviations, are those of the rig.

    `inertia_kg_m2` (3, 3) is taken as it is. A mount is one physical axis: its `direction` counts, and
    `distance_direction` is ignored.
    """
    vehicle = rig.vehicle
    return Truth(
        mass_kg=rng.normal(vehicle.mass_kg, vehicle.mass_std_kg),
        gravity_mps2=_draw_gravity(rig, rng=rng),
        centre_of_mass_m=MM * rng.normal(vehicle.centre_of_mass_mm, vehicle.centre_of_mass_std_mm),
        inertia_kg_m2=np.asarray(inertia_kg_m2, dtype=np.float64),
        mounts=_draw_mounts(rig.mounts, friction=friction, rng=rng),
    )


def draw_testbody(
    rig: Rig,
    *,
    rng: np.random.Generator,
    gravity_mps2: float | None = None,
    friction: TrueFriction = TrueFriction(),
) -> Truth:
    """Draw the test body: edges vary by `length_std_mm`, centre of mass and inertia follow from them.

    Give the vehicle's `gravity_mps2` to swing both at one place; else gravity is drawn too. Raises
    ConfigError for a rig without test body.
    """
    body = rig.testbody
    if body is None:
        raise ConfigError("rig.toml: testbody: expected a table with mass_kg and cuboids, found none.")
    mass_kg = rng.normal(body.mass_kg, body.mass_std_kg)
    sizes_m = MM * np.array([rng.normal(cuboid.size_mm, body.length_std_mm) for cuboid in body.cuboids])
    centre_of_mass_m, inertia_kg_m2 = _of_cuboids(body.cuboids, sizes_m=sizes_m, mass_kg=mass_kg)
    return Truth(
        mass_kg=mass_kg,
        gravity_mps2=_draw_gravity(rig, rng=rng) if gravity_mps2 is None else gravity_mps2,
        centre_of_mass_m=centre_of_mass_m,
        inertia_kg_m2=inertia_kg_m2,
        mounts=_draw_mounts(body.mounts, friction=friction, rng=rng),
    )


def with_errors(
    truth: Truth,
    *,
    mass_kg: float,
    centre_of_mass_m: npt.ArrayLike,
    fixture_kg: float,
    tilt_deg: float,
    rng: np.random.Generator,
) -> Truth:
    """Return the body with a mass and a centre of mass that are off by these amounts, and with a fixture.

    Each axis tilts by two normal angles of standard deviation `tilt_deg`, about the directions across it.
    """
    mounts = truth.mounts
    if tilt_deg:
        mounts = {
            name: replace(mount, direction=_tilted(mount.direction, tilt_deg, rng=rng))
            for name, mount in mounts.items()
        }
    centre_m = truth.centre_of_mass_m + np.asarray(centre_of_mass_m)
    return replace(
        truth,
        mass_kg=truth.mass_kg + mass_kg,
        centre_of_mass_m=centre_m,
        fixture_kg=fixture_kg,
        mounts=mounts,
    )


def _draw_gravity(rig: Rig, *, rng: np.random.Generator) -> float:
    return rng.normal(rig.site.gravity_mps2, rig.site.gravity_std_mps2)


def _draw_mounts(
    mounts: Mapping[str, Mount], *, friction: TrueFriction, rng: np.random.Generator
) -> dict[str, TrueMount]:
    return {
        name: TrueMount(
            point_m=mount.point_m + MM * rng.normal(0, mount.point_std_mm) @ np.array(mount.point_axes),
            direction=_draw_direction(mount, rng=rng),
            friction=_draw_friction(OF_THREADS if mount.threads else friction, rng=rng),
            threads_m=_draw_threads(mount, rng=rng),
        )
        for name, mount in mounts.items()
    }


def _draw_threads(mount: Mount, *, rng: np.random.Generator) -> tuple[float, float, float] | None:
    if mount.threads is None:
        return None
    above, below, length = rng.normal(*mount.threads.lengths_m)
    off = 2 * rng.normal(0.0, mount.threads.centre_std_mm) / mount.threads.below_mm
    as_in_the_middle = math.sqrt(1 - off**2)  # threads closer by this factor turn a body back as much
    return as_in_the_middle * above, as_in_the_middle * below, length


def _draw_direction(mount: Mount, *, rng: np.random.Generator) -> Array:
    """Tilt the nominal direction about two axes perpendicular to it."""
    return _tilted(np.array(mount.direction) / np.linalg.norm(mount.direction), mount.direction_std_deg, rng=rng)


def _tilted(nominal: Array, std_deg: float, *, rng: np.random.Generator) -> Array:
    across = np.linalg.svd(nominal[np.newaxis])[2][1:]  # (2, 3): spans the plane perpendicular to it
    tilt_rad = math.radians(std_deg) * rng.standard_normal(2)
    angle_rad = np.linalg.norm(tilt_rad)
    return np.asarray(np.cos(angle_rad) * nominal + np.sinc(angle_rad / np.pi) * (tilt_rad @ across))


def _draw_friction(typical: TrueFriction, *, rng: np.random.Generator) -> TrueFriction:
    viscous, coulomb, quadratic = rng.lognormal(0, FRICTION_SPREAD, 3)
    return replace(
        typical,
        viscous_nms_per_rad=typical.viscous_nms_per_rad * viscous,
        coulomb_nm=typical.coulomb_nm * coulomb,
        quadratic_nms2_per_rad2=typical.quadratic_nms2_per_rad2 * quadratic,
    )


def _of_cuboids(cuboids: Iterable[Cuboid], *, sizes_m: Array, mass_kg: float) -> tuple[Array, Array]:
    """Return centre of mass (3,) and inertia matrix (3, 3) about it of boxes of one material, sizes (n, 3)."""
    centres_m = MM * np.array([cuboid.centre_mm for cuboid in cuboids])
    volumes = sizes_m.prod(axis=1)
    masses_kg = mass_kg * volumes / volumes.sum()
    centre_of_mass_m = masses_kg @ centres_m / mass_kg
    # The matrix of second moments of mass; the inertia matrix is its trace less itself.
    arms_m = centres_m - centre_of_mass_m
    moments = np.diag(masses_kg @ sizes_m**2) / 12 + (arms_m.T * masses_kg) @ arms_m
    return centre_of_mass_m, np.trace(moments) * np.eye(3) - moments
