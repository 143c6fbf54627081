"""The body that swings, and its inertias: from natural frequencies to axes through the centre of mass (section 2.5).

I_a = m g r / W, then I_G = I_a - m r^2. On two threads, I_G = m g a b / (h W) directly, where a and b are the threads'
distances from the vertical, above and below, and h is their height. All numbers are uncertain and carry their causes,
so that inertias that share the mass or a mount are correlated.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from uncertainties import nominal_value, ufloat
from uncertainties.umath import sqrt

from cfid.errors import ConfigError, check_positive
from cfid.findings import Finding, rejection
from cfid.quantities.registry import Platform, Range, range_of
from cfid.recordings.angle import AxisRecord
from cfid.recordings.gyro import ALIGNMENT_STD_RAD
from cfid.records.campaign import find_campaign
from cfid.records.plausibility import Given
from cfid.records.rig_file import Cuboid, Fixture, Mount, Rig, TestBody, Vector, thesis_rig
from cfid.swing.pendulum import NO_THREADS, Threads
from cfid.units import MM

Array = npt.NDArray[np.float64]
Uncertain = npt.NDArray[np.object_]  # numbers of the package uncertainties, or floats where they are exact

Measured = tuple[float | None, float | None]  # a number and its standard uncertainty, each None if not given

FIXTURE = "fixture"
BEYOND_STD = 4.0  # a larger error in a body's inertia is not noise
_APART_STD = 4.0  # between a stated direction and a gyro's: beyond, one of them is wrong
OF_MOUNTS = "mount distances", "axis directions", "threads"  # causes
_GIVEN = "given"  # the mount made from a distance that is given as a number
_DISTANCE = Range(5e-4, 0.3, "a mount lies within the arms of a vehicle of 1 kg")
_CENTRE = Range(-0.3, 0.3, "it lies between the rotors")
_LEAST_STD = 0.01  # of the axis inertia, assumed for numbers without an uncertainty
_WEIGHED = tuple(f"vehicle.{key}" for key in ("mass_kg", "mass_std_kg", "centre_of_mass_mm", "centre_of_mass_std_mm"))


@dataclass(frozen=True, kw_only=True)
class MountedSwing:
    """A measurement about one mount: a natural frequency squared, or an axis inertia that is already known.

    `value` is in s^-2 when `known` is false, else in kg m^2, and `std` what the swing alone leaves uncertain of it. The
    clock of `timed_by`, which other swings share, adds the relative `clock_std`. `name` is that of the recording.
    """

    axis: str
    value: float
    std: float
    clock_std: float = 0.0
    timed_by: str = "encoder"
    name: str = ""
    known: bool = False


@dataclass(frozen=True)
class KnownInertia:
    """A known inertia about a mount's axis, with its standard uncertainty."""

    mount: str
    value_kg_m2: float
    std_kg_m2: float = 0.0

    def __post_init__(self) -> None:
        """Check both numbers. Raises ConfigError."""
        check_positive(**{self.mount: self.value_kg_m2})
        if not 0 <= self.std_kg_m2 < float("inf"):
            raise ConfigError(f"{self.mount} {self.std_kg_m2:g}: a standard uncertainty is a number of zero or more.")


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


class AxisInertias(NamedTuple):
    """Swings (n,) of a body and what they give, all uncertain: inertias about the axes and about the parallel axes
    through the centre of mass, distances between the two, and unit vectors (n, 3) of the axes.

    `shared` are the causes by name that other fits may share.
    """  # fmt: skip

    swings: Sequence[MountedSwing]
    body: SwungBody
    about_axis_kg_m2: Uncertain
    about_centre_kg_m2: Uncertain
    distance_m: Uncertain
    direction: Uncertain
    shared: Mapping[str, Any]


def uncertain(value: float, std: float, cause: str) -> Any:
    """Return a number with a standard uncertainty by one cause, or the number itself where it is exact."""
    return ufloat(value, std, cause) if std else value


def numbers(values: Uncertain) -> Array:
    """Return the values without their uncertainties."""
    return np.asarray(np.vectorize(nominal_value, otypes=[float])(values))


def effects(values: Iterable[Any]) -> tuple[Array, tuple[Any, ...]]:
    """Return by how much each cause's standard uncertainty moves uncertain values (n,): (n, causes), and the causes."""
    slopes = [getattr(value, "derivatives", {}) for value in values]
    causes = tuple(dict.fromkeys(cause for slope in slopes for cause in slope))
    moved = [[slope.get(cause, 0.0) * cause.std_dev for cause in causes] for slope in slopes]
    return np.array(moved).reshape(len(slopes), len(causes)), causes


def budget(moved: Array, causes: Sequence[Any]) -> dict[str, Array]:
    """Add up effects (n, causes) in squares by the causes' tags; the largest comes first."""
    groups: dict[str, Array] = {}
    for cause, column in zip(causes, moved.T, strict=True):
        groups[cause.tag] = groups.get(cause.tag, 0.0) + column**2
    ordered = sorted(groups.items(), key=lambda item: -float(np.sum(item[1])))
    return {tag: np.sqrt(squares) for tag, squares in ordered if np.any(squares > 0)}


def axis_inertias(swings: Sequence[MountedSwing], body: SwungBody, around: Surroundings) -> AxisInertias:
    """Return the inertias of a body about the axes of its swings.

    A mount's errors are common to its swings. Raises ConfigError for a fixture whose inertia is not known.
    """
    mass = uncertain(body.mass_kg, body.mass_std_kg, "mass")
    gravity = uncertain(around.gravity_mps2, around.gravity_std_mps2, "gravity")
    centre = np.array(
        [
            uncertain(float(at), float(std), "centre of mass")
            for at, std in zip(body.centre_m, body.centre_std_m, strict=True)
        ],
        dtype=object,
    )
    on_axis = [swing for swing in swings if not swing.known and body.mounts[swing.axis].threads is None]
    fixture_moment, fixture_inertia = _fixture(around, gravity) if on_axis else (0.0, 0.0)
    names = [swing.axis for swing in swings]
    placed = {name: _placed(body.mounts[name], centre) for name in dict.fromkeys(names)}
    clocks = {name: ufloat(0.0, 1.0, f"clock of the {name}") for name in {swing.timed_by for swing in swings}}
    about_axis, about_centre, distances, directions = [], [], [], []
    for swing in swings:
        distance, lever, direction = placed[swing.axis]
        value = uncertain(swing.value, swing.std, "swing fits")
        if swing.clock_std:
            value = value * (1 + swing.clock_std * clocks[swing.timed_by])
        if swing.known:
            inertia = value
        elif swing in on_axis:
            inertia = (mass * gravity * lever + fixture_moment) / value - fixture_inertia
        else:
            inertia = mass * gravity * lever / value
        about_axis.append(inertia)
        about_centre.append(inertia - mass * distance**2)
        distances.append(distance)
        directions.append(direction)
    causes = {
        "mass": mass,
        "gravity": gravity,
        **{f"centre {axis}": at for axis, at in zip("xyz", centre, strict=True)},
    }
    return AxisInertias(
        swings=swings,
        body=body,
        about_axis_kg_m2=np.array(about_axis, dtype=object),
        about_centre_kg_m2=np.array(about_centre, dtype=object),
        distance_m=np.array(distances, dtype=object),
        direction=np.array(directions, dtype=object).reshape(-1, 3),
        shared={name: cause for name, cause in causes.items() if hasattr(cause, "std_dev")},
    )


def _placed(mount: Mount, centre_m: Uncertain) -> tuple[Any, Any, Uncertain]:
    """Return the distance of the centre of mass, the lever of its weight, and the direction of a mount's axis (3,)."""
    tilt = math.radians(mount.direction_std_deg)
    tilts = [uncertain(0.0, tilt, "axis directions") for _ in range(2)]
    direction = _tilted(mount.direction, tilts)
    if mount.threads is not None:
        lengths = [*zip(*mount.threads.lengths_m, strict=True), mount.threads.off_centre]
        above, below, length, lost = (uncertain(value, std, "threads") for value, std in lengths)
        height = sqrt(length**2 - ((above - below) / 2) ** 2)
        return 0.0, above * below * (1 - lost) / (4 * height), direction
    along = _tilted(mount.distance_direction or mount.direction, tilts)
    shifts = np.array([uncertain(0.0, MM * std, "mount distances") for std in mount.point_std_mm], dtype=object)
    offset = centre_m - np.array(mount.point_m) - shifts @ np.array(mount.point_axes)
    across = offset - (offset @ along) * along
    square = across @ across
    distance = sqrt(square) if nominal_value(square) > 0 else 0.0
    return distance, distance, direction


def _tilted(vector: Vector, tilts: Sequence[Any]) -> Uncertain:
    """Return the unit vector (3,) of a direction that is tilted to two sides."""
    unit = np.array(vector, dtype=float) / np.linalg.norm(vector)
    aside = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    aside /= np.linalg.norm(aside)
    moved = unit + tilts[0] * aside + tilts[1] * np.cross(unit, aside)
    return np.asarray(moved / sqrt(moved @ moved), dtype=object)


def _fixture(around: Surroundings, gravity: Any) -> tuple[Any, Any]:
    """Return gravity moment and axis inertia of the empty fixture, which takes part in every swing about an axis."""
    hanging, swung = around.fixture, around.fixture_swing
    if hanging is None:
        return 0.0, 0.0
    mass = uncertain(hanging.mass_kg, hanging.mass_std_kg, "fixture")
    distance = uncertain(MM * hanging.distance_mm, MM * hanging.distance_std_mm, "fixture")
    moment = mass * gravity * distance
    if swung is not None:
        value = uncertain(swung.value, swung.std, "fixture")
        return moment, value if swung.known else moment / value
    if hanging.edge_mm is None:
        raise ConfigError(
            "[fixture] of rig.toml needs edge_mm, the edge of the cube, for the inertia of the fixture: add it, or "
            "swing the fixture alone and give that too (fixture=FILE of `cfid fit inertia`)."
        )
    edge = uncertain(MM * hanging.edge_mm, MM * hanging.edge_std_mm, "fixture")
    return moment, mass * (edge**2 / 6 + distance**2)


def rig_around(records: Iterable[AxisRecord], rig: Rig | None) -> Rig | None:
    """Return the rig if it is given, else that of the campaign that contains the recordings, if any."""
    if rig is not None:
        return rig
    campaigns = (find_campaign(None, start=record.path.resolve().parent) for record in records)
    return next((campaign.rig for campaign in campaigns if campaign is not None), None)


def required_rig(records: Iterable[AxisRecord], rig: Rig | None) -> Rig:
    """Return the rig that `rig_around` finds. Raises ConfigError where there is none."""
    found = rig_around(records, rig)
    if found is None:
        raise ConfigError(
            "no rig.toml describes the body and its mounts: fit within a campaign (`cfid new`), or give `geometry` "
            "FILE, or `geometry` thesis for the thesis' Crazyflie, cube and test body."
        )
    return found


def threads_of(mount: Mount | None, gravity_mps2: float) -> Threads:
    """Return the effect of a mount's threads on the equation of motion, if it has any."""
    if mount is None or mount.threads is None:
        return NO_THREADS
    above, below, length = mount.threads.lengths_m[0]
    product, height = above * below / 4, math.sqrt(length**2 - (above - below) ** 2 / 4)
    return Threads(product / height**2, product / (gravity_mps2 * height))


def contradicted_axes(body: SwungBody, records: Iterable[AxisRecord]) -> list[tuple[str, Finding]]:
    """Return a rejection for each mount about whose direction a gyro did not turn, with the mount's name."""
    findings = []
    for record in records:
        mount = body.mounts.get(record.label.axis or "")
        if record.rates is None or mount is None or record.label.body == FIXTURE:
            continue
        stated, seen = np.array(mount.direction) / math.hypot(*mount.direction), record.rates.axis
        apart_deg = math.degrees(math.acos(min(abs(float(seen @ stated)), 1.0)))
        limit_deg = _APART_STD * math.hypot(mount.direction_std_deg, math.degrees(ALIGNMENT_STD_RAD))
        if apart_deg > limit_deg:
            text = (
                f"the gyro turned about ({seen[0]:+.3f}, {seen[1]:+.3f}, {seen[2]:+.3f}), {apart_deg:.2g} degrees from "
                f"the direction in rig.toml (limit {limit_deg:.2g}). Check whether the run is labelled with the right "
                "mount, and the mount's direction."
            )
            findings.append((record.label.axis or "", rejection("swing-axis-contradicts", text)))
    return findings


def vehicle(rig: Rig, mass_kg: float | None, mass_std_kg: float | None = None) -> SwungBody:
    """Return the vehicle of rig.toml; `mass_kg` and `mass_std_kg` replace its own.

    Raises ConfigError for a mass of zero or less.
    """
    check_positive(mass_kg=mass_kg)
    given = rig.vehicle
    return SwungBody(
        mass_kg=given.mass_kg if mass_kg is None else mass_kg,
        mass_std_kg=given.mass_std_kg if mass_std_kg is None else mass_std_kg,
        centre_m=MM * np.array(given.centre_of_mass_mm),
        centre_std_m=MM * np.array(given.centre_of_mass_std_mm),
        mounts=rig.mounts,
    )


def drawn_body(rig: Rig, mass_kg: float | None, mass_std_kg: float | None = None) -> TestBody:
    """Return the test body of rig.toml; `mass_kg` and `mass_std_kg` replace its own.

    Raises ConfigError when rig.toml does not describe one, and for a mass of zero or less.
    """
    check_positive(mass_kg=mass_kg)
    if rig.testbody is None:
        raise ConfigError("rig.toml describes no test body: add [testbody] with its cuboids and mounts.")
    given = {"mass_kg": mass_kg, "mass_std_kg": mass_std_kg}
    return rig.testbody.model_copy(update={key: value for key, value in given.items() if value is not None})


def surroundings(
    rig: Rig | None,
    gravity_mps2: float | None,
    gravity_std_mps2: float | None = None,
    fixture_swing: MountedSwing | None = None,
) -> Surroundings:
    """Return gravity and, if it was swung, the empty fixture.

    `gravity_mps2` and `gravity_std_mps2` replace those of rig.toml, or without one those of the middle latitudes.

    Raises ConfigError for a swing of a fixture that rig.toml does not describe, and for gravity of zero or less.
    """
    check_positive(gravity_mps2=gravity_mps2)
    site, fixture = (thesis_rig().site, None) if rig is None else (rig.site, rig.fixture)
    if fixture_swing is not None and fixture is None:
        raise ConfigError("a swing of the fixture needs its mass and distance: add [fixture] to rig.toml.")
    return Surroundings(
        gravity_mps2=site.gravity_mps2 if gravity_mps2 is None else gravity_mps2,
        gravity_std_mps2=site.gravity_std_mps2 if gravity_std_mps2 is None else gravity_std_mps2,
        fixture=fixture,
        fixture_swing=fixture_swing,
    )


def rests_on(axes: Iterable[str], *, body: str | None = None) -> tuple[str, ...]:
    """Return the keys of rig.toml on which the inertia of a body depends that swung about these axes."""
    if body == "testbody":
        return ("site", "fixture", "testbody")
    return ("site", "fixture", *_WEIGHED, *(f"mounts.{axis}" for axis in axes))


def body_of_swing(
    rig: Rig | None, *, axis: str | None, body: str | None, mass: Measured, distance: Measured
) -> tuple[SwungBody, str] | None:
    """Return the body that swung and its mount's name, or None where only a frequency can be found.

    A given mass and distance, each with its standard uncertainty, make a mount of their own; otherwise the axis has to
    be a mount of the rig. Raises ConfigError where one of them is missing.
    """
    (mass_kg, mass_std_kg), (distance_m, distance_std_m) = mass, distance
    if distance_m is not None:
        return _given_body(mass_kg, mass_std_kg or 0.0, distance_m, distance_std_m or 0.0)
    if rig is None or axis is None or body == FIXTURE:
        if mass_kg is not None:
            raise ConfigError("a mass alone gives no inertia: give the distance too, or a rig.toml and the axis.")
        return None
    return body_on(rig, [axis], body=body, mass=mass), axis


def body_on(rig: Rig, names: Iterable[str], *, body: str | None, mass: Measured = (None, None)) -> SwungBody:
    """Return the vehicle or test body of a rig on named mounts; a given mass replaces its own.

    Raises ConfigError that lists the existing mounts where one is missing.
    """
    is_test_body = body == "testbody"
    swung = swung_test_body(drawn_body(rig, *mass)) if is_test_body else vehicle(rig, *mass)
    table = "testbody.mounts" if is_test_body else "mounts"
    for name in names:
        if name not in swung.mounts:
            there = ", ".join(swung.mounts) or "none"
            remedy = rig.unknown(f"{table}.{name}") or f"add [{table}.{name}]."
            raise ConfigError(f"'{name}' is no mount of this rig.toml (it has: {there}): {remedy}")
    return swung


def _given_body(
    mass_kg: float | None, mass_std_kg: float, distance_m: float, distance_std_m: float
) -> tuple[SwungBody, str]:
    if mass_kg is None:
        raise ConfigError("a distance alone gives no inertia: give the mass too.")
    check_positive(mass_kg=mass_kg, distance_m=distance_m)
    mount = Mount(
        point_mm=(0.0, distance_m / MM, 0.0), point_std_mm=(0.0, distance_std_m / MM, 0.0), direction=(1, 0, 0)
    )
    body = SwungBody(
        mass_kg=mass_kg,
        mass_std_kg=mass_std_kg,
        centre_m=np.zeros(3),
        centre_std_m=np.zeros(3),
        mounts={_GIVEN: mount},
    )
    return body, _GIVEN


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


class MassProperties(NamedTuple):
    """Centre of mass (3,) and inertia matrix (3, 3) about the centre of mass, in the body frame."""

    centre_m: Any
    inertia_kg_m2: Any


def from_cuboids(cuboids: Sequence[Cuboid], *, mass_kg: Any, sizes_m: Any = None) -> MassProperties:
    """Return the mass properties of boxes of one density (eq. 2.21 and 2.3, C.1.5).

    Mass and edges (boxes, 3) may be uncertain numbers; the edges are those of the drawing by default.
    """
    sizes = MM * np.array([cuboid.size_mm for cuboid in cuboids]) if sizes_m is None else sizes_m
    centres = MM * np.array([cuboid.centre_mm for cuboid in cuboids])
    volumes = np.prod(sizes, axis=1)
    masses = mass_kg * volumes / volumes.sum()
    centre = masses @ centres / mass_kg
    inertia = np.zeros((3, 3))
    for mass, size, offset in zip(masses, sizes, centres - centre, strict=True):
        squares = size**2
        alone = np.diag(mass / 12 * (squares.sum() - squares))
        inertia = inertia + alone + mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return MassProperties(centre, inertia)


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
