"""Simulates the swing rig: true bodies and mounts are drawn, hang, are released by hand, turn an axis and are recorded.

Axis inertias and distances are computed here independently of the analysis, which can be judged by them.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from cfid.errors import ConfigError
from cfid.records.rig_file import Cuboid, Mount, Rig
from cfid.sim.imu import Hanging
from cfid.sim.plants import DroppingWeight, HandRelease, Motion, Pendulum, TwoThreads, drop, swing
from cfid.sim.stepping import Array
from cfid.units import MM

CUBE_M, CUBE_ARM_M = 0.019, 0.002
FRICTION_SPREAD = 0.1  # between mounts; the thesis' fits vary as much (table 2.3)

PERIOD_S = 20.0
RELEASES = 16
DROPS = 4

_STEP_S = 2e-3
_STEADIED_S = 0.35  # ends before any hand of `draw_release` lifts
_WOUND_UP_S = 4.0
_FALLS_AFTER_S = 4.5


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
    return replace(
        truth,
        mass_kg=truth.mass_kg + mass_kg,
        centre_of_mass_m=truth.centre_of_mass_m + np.asarray(centre_of_mass_m),
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
    towards = math.radians(std_deg) * rng.standard_normal(2) @ across
    return np.asarray(Rotation.from_rotvec(np.cross(nominal, towards)).apply(nominal))


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


def pendulum(truth: Truth, mount_name: str) -> Pendulum:
    """Hang the body on one of its axes (thesis eq. 2.2 and 2.3).

    The axis inertia is u'Iu + m r^2, the gravity moment m g r, with r the distance of the centre of mass from
    the axis.
    """
    mount = truth.mounts[mount_name]
    distance_m = np.linalg.norm(np.cross(truth.centre_of_mass_m - mount.point_m, mount.direction))
    about_centre = mount.direction @ truth.inertia_kg_m2 @ mount.direction
    of_cube = truth.fixture_kg * (CUBE_M**2 / 6 + CUBE_ARM_M**2)
    below_kg_m = truth.mass_kg * distance_m + truth.fixture_kg * CUBE_ARM_M
    return Pendulum(
        axis_inertia_kg_m2=float(about_centre + truth.mass_kg * distance_m**2 + of_cube),
        gravity_moment_nm=float(truth.gravity_mps2 * below_kg_m),
        **asdict(mount.friction),
    )


def two_threads(truth: Truth, mount_name: str) -> TwoThreads | None:
    """Hang the body on the threads of one of its mounts, None for an axis."""
    mount = truth.mounts[mount_name]
    if mount.threads_m is None:
        return None
    above, below, length = mount.threads_m
    return TwoThreads(
        inertia_kg_m2=float(mount.direction @ truth.inertia_kg_m2 @ mount.direction),
        mass_kg=truth.mass_kg,
        gravity_mps2=truth.gravity_mps2,
        above_m=above,
        below_m=below,
        length_m=length,
        viscous_nms_per_rad=mount.friction.viscous_nms_per_rad,
        coulomb_nm=mount.friction.coulomb_nm,
        quadratic_nms2_per_rad2=mount.friction.quadratic_nms2_per_rad2,
    )


def hanging(truth: Truth, mount_name: str) -> Hanging:
    """Return how the body hangs in one of its mounts; the sensors sit at the origin of the body frame."""
    mount = truth.mounts[mount_name]
    if mount.threads_m is None:
        below = truth.centre_of_mass_m - mount.point_m
        below = below - (below @ mount.direction) * mount.direction
        down, sensor_m = below / np.linalg.norm(below), -mount.point_m
    else:
        down, sensor_m = -mount.direction, -truth.centre_of_mass_m
    return Hanging(axis=mount.direction, down=down, sensor_m=sensor_m, gravity_mps2=truth.gravity_mps2)


def draw_release(rng: np.random.Generator, *, angle_deg: tuple[float, float] = (20, 70)) -> HandRelease:
    """Draw a hand that deflects to either side, by an angle between the two limits."""
    return HandRelease(
        angle_rad=math.radians(rng.uniform(*angle_deg)) * rng.choice((-1, 1)),
        wait_s=rng.uniform(0.4, 0.8),
        lift_s=rng.uniform(0.5, 0.9),
        hold_s=rng.uniform(0.5, 1.2),
        tremor_hz=rng.uniform(8, 12),  # of a healthy hand
        tremor_phase_rad=rng.uniform(0, 2 * math.pi),
    )


class Axis:
    """An axis that repeats motions of PERIOD_S each, from time zero on; before that it stands still.

    A few experiments are integrated beforehand, all at once, so that nothing is left to integrate while a device has to
    answer.

    Each motion starts at zero. At its start the angle that the previous motion left returns to zero within `return_s`,
    as smoothly as by hand: the pendulum is steadied, or the line wound up.
    """

    def __init__(self, motion: Motion, *, return_s: float, offset_rad: float, eccentricity_rad: float = 0.0) -> None:
        """Take k motions (n, k) in equal steps; the encoder's zero and eccentricity are those of EncoderModel."""
        self._angles = motion.angle_rad.T.tolist()  # lists: reading single numbers from them is faster
        self._speeds = motion.speed_rad_per_s.T.tolist()
        self._step_s = float(motion.time_s[1] - motion.time_s[0])
        self._return_s = return_s
        self._offset_rad = offset_rad
        self._eccentricity_rad = eccentricity_rad

    def angle_at(self, time_s: float) -> float:
        """Return the angle in rad that the encoder sees: the cubic through the two nearest steps, plus its error."""
        angle_rad = self._turned(time_s) + self._offset_rad
        return angle_rad + self._eccentricity_rad * math.sin(angle_rad)

    def motion_at(self, time_s: float) -> tuple[float, float, float]:
        """Return angle, speed and acceleration of the body itself, in rad, rad/s and rad/s^2."""
        half_s = self._step_s / 4
        before, angle_rad, after = (self._turned(time_s + shift_s) for shift_s in (-half_s, 0.0, half_s))
        return angle_rad, (after - before) / (2 * half_s), (after - 2 * angle_rad + before) / half_s**2

    def _turned(self, time_s: float) -> float:
        turn, into_s = divmod(max(time_s, 0.0), PERIOD_S)
        which = int(turn) % len(self._angles)
        angle_rad = _between(self._angles[which], self._speeds[which], into_s / self._step_s, self._step_s)
        if turn and into_s < self._return_s:
            left_rad = self._angles[which - 1][-1]  # of the last motion, if this is the first again
            angle_rad += left_rad * _smooth(1 - into_s / self._return_s)
        return angle_rad


def swinging(body: Pendulum | TwoThreads, *, rng: np.random.Generator, eccentricity_rad: float = 0.0) -> Axis:
    """Return the axis of a pendulum, or of a body on threads, that a hand deflects and releases every PERIOD_S.

    Each release differs; after RELEASES of them, about five minutes, they repeat.
    """
    releases = [draw_release(rng) for _ in range(RELEASES)]
    bodies = [body] * RELEASES
    motion = swing(bodies, releases, duration_s=PERIOD_S, step_s=_STEP_S, store_every=1)
    offset_rad = rng.uniform(0, 2 * math.pi)
    return Axis(motion, return_s=_STEADIED_S, offset_rad=offset_rad, eccentricity_rad=eccentricity_rad)


def dropping(weights: Sequence[DroppingWeight], *, rng: np.random.Generator, eccentricity_rad: float = 0.0) -> Axis:
    """Return the axis that falling weights turn, one after the other; the line is wound up again before each."""
    motion = drop(weights, duration_s=PERIOD_S, wait_s=_FALLS_AFTER_S, step_s=_STEP_S)
    offset_rad = rng.uniform(0, 2 * math.pi)
    return Axis(motion, return_s=_WOUND_UP_S, offset_rad=offset_rad, eccentricity_rad=eccentricity_rad)


def resting(*, offset_rad: float) -> Axis:
    """Return an axis on which nothing hangs."""
    still = Motion(time_s=np.array([0.0, PERIOD_S]), angle_rad=np.zeros((2, 1)), speed_rad_per_s=np.zeros((2, 1)))
    return Axis(still, return_s=_STEADIED_S, offset_rad=offset_rad)


def _between(angles: list[float], speeds: list[float], steps: float, step_s: float) -> float:
    """Return the cubic Hermite polynomial between the two samples around `steps`."""
    i = min(int(steps), len(angles) - 2)
    x = steps - i
    rise = angles[i + 1] - angles[i]
    begin, end = speeds[i] * step_s - rise, rise - speeds[i + 1] * step_s
    return angles[i] + x * (rise + (1 - x) * ((1 - x) * begin + x * end))


def _smooth(x: float) -> float:
    """Return the path of minimum jerk from 0 to 1 at `x`."""
    return x * x * x * (10 + x * (6 * x - 15))
