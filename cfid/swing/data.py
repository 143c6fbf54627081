"""Prepare what a swing's fit needs: recordings with their mounts, the body, gravity and the fixture; checked, in SI."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError, check_positive
from cfid.findings import Finding, note, rejection
from cfid.recordings.angle import AngleRecord, AxisRecord
from cfid.recordings.gyro import ALIGNMENT_STD_RAD, SCALE_STD
from cfid.records.campaign import find_campaign
from cfid.records.rig_file import Mount, Rig, TestBody, thesis_rig
from cfid.swing.axis_inertias import MountedSwing, Surroundings, SwungBody, swung_test_body
from cfid.swing.collocation import NO_THREADS, Threads
from cfid.swing.free_swing import FreeSwing, find_swing
from cfid.swing.release import FEWEST_PEAKS
from cfid.swing.repeated import find_read_swing
from cfid.units import MM

Array = npt.NDArray[np.float64]

FIXTURE = "fixture"

_MOST_ROWS = 2_000_000  # half an hour at 1 kHz
_GAP_S = 0.25  # between rows of a gyro: across a longer gap, its angle is unknown
_HELD_S = 5.0  # kept before the release, and at least this long after the swing
# Between a stated direction and a gyro's: beyond this limit, one of them is wrong.
_APART_STD = 4.0
_GIVEN = "given"  # the mount made from a distance that is given as a number


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


def rig_around(records: Iterable[AxisRecord], rig: Rig | None) -> Rig | None:
    """Return the rig if it is given, else that of the campaign that contains the recordings, if any."""
    if rig is not None:
        return rig
    campaigns = (find_campaign(None, start=record.path.resolve().parent) for record in records)
    return next((campaign.rig for campaign in campaigns if campaign is not None), None)


def rig_or_thesis(records: Iterable[AxisRecord], rig: Rig | None) -> tuple[Rig, tuple[Finding, ...]]:
    """Return the rig that `rig_around` finds, else that of the thesis with a note."""
    found = rig_around(records, rig)
    if found is not None:
        return found, ()
    text = "no rig.toml here: the thesis' Crazyflie 2.0, cube and test body are used."
    return thesis_rig(), (note("thesis-geometry", text),)


def swing_in(record: AngleRecord, threads: Threads = NO_THREADS, **window: Any) -> FreeSwing:
    """Find the free swing of a recording; `threads` carry the body, `window` are arguments of `find_swing`.

    Raises DataError that names the file.
    """
    try:
        swing = _finder(record)(record.time_s, record.angle_rad, **window)
    except DataError as error:
        raise DataError(f"{record.path}: {error}{_unsummed(record)}") from None
    swing = replace(swing, time_scale_std=record.time_scale_std, threads=threads)
    if record.rates is None:
        return swing
    return replace(swing, rate_rad_per_s=record.rates.rate_rad_per_s, rate_scale_std=SCALE_STD)


def _finder(record: AngleRecord) -> Callable[..., FreeSwing]:
    if record.rates is not None:
        return find_swing
    return _find_in_long if len(record.time_s) > _MOST_ROWS else find_read_swing


def _unsummed(record: AngleRecord) -> str:
    """Return a sentence on the longest gap in a gyro's rows, which may explain a strange angle; "" for none."""
    steps = np.diff(record.time_s)
    if record.rates is None or not len(steps) or steps.max() < _GAP_S:
        return ""
    at_s = float(record.time_s[int(np.argmax(steps))])
    return (
        f" The gyro has no rows for {steps.max():.2g} s, after {at_s:.3g} s: the angle that its rates sum up to is not "
        "known across that. Record again with fewer losses."
    )


def threads_of(mount: Mount | None, gravity_mps2: float) -> Threads:
    """Return the effect of a mount's threads on the equation of motion, if it has any."""
    if mount is None or mount.threads is None:
        return NO_THREADS
    above, below, length = mount.threads.lengths_m[0]
    product, height = above * below / 4, math.sqrt(length**2 - (above - below) ** 2 / 4)
    return Threads(product / height**2, product / (gravity_mps2 * height))


def turned_about(body: SwungBody, records: Iterable[AxisRecord]) -> tuple[SwungBody, tuple[tuple[str, Finding], ...]]:
    """Return a body with each mount's direction as a gyro showed it, and a finding for each such mount.

    The direction in rig.toml is weighted by its uncertainty, and not used if it has none. If the gyro contradicts it,
    the finding is a rejection, and the stated direction is kept.
    """
    seen: dict[str, list[Array]] = {}
    for record in records:
        mount = record.label.axis
        if record.rates is not None and mount is not None and mount in body.mounts and record.label.body != FIXTURE:
            seen.setdefault(mount, []).append(record.rates.axis)
    mounts, findings = dict(body.mounts), list[tuple[str, Finding]]()
    for name, axes in seen.items():
        mounts[name], finding = _with_direction(mounts[name], axes)
        findings.append((name, finding))
    return replace(body, mounts=mounts), tuple(findings)


def _with_direction(mount: Mount, axes: list[Array]) -> tuple[Mount, Finding]:
    stated, stated_std = np.array(mount.direction) / math.hypot(*mount.direction), math.radians(mount.direction_std_deg)
    found = np.sum([axis * np.sign(axis @ stated) for axis in axes], axis=0)
    found /= np.linalg.norm(found) or 1.0
    apart = math.acos(min(abs(float(found @ stated)), 1.0))
    limit = _APART_STD * math.hypot(stated_std, ALIGNMENT_STD_RAD)
    where = (
        f"the gyro turned about ({found[0]:+.3f}, {found[1]:+.3f}, {found[2]:+.3f}), {math.degrees(apart):.2g} degrees "
        "from the direction in rig.toml"
    )
    if apart > limit:
        text = (
            f"{where} (limit {math.degrees(limit):.2g}). Check whether the run is labelled with the right mount, and "
            "the mount's direction."
        )
        return mount, rejection("swing-axis-contradicts", text)
    share = stated_std**2 / (stated_std**2 + ALIGNMENT_STD_RAD**2) if stated_std else 1.0
    direction = stated + share * (found - stated)
    std = stated_std * ALIGNMENT_STD_RAD / math.hypot(stated_std, ALIGNMENT_STD_RAD) or ALIGNMENT_STD_RAD
    x, y, z = map(float, direction)
    text = f"{where}: both count, as far as they are certain." if stated_std else f"{where}, and replaces it."
    update = {"direction": (x, y, z), "direction_std_deg": math.degrees(std)}
    return mount.model_copy(update=update), note("swing-axis-by-gyro", text)


def _find_in_long(
    time_s: Array, angle_rad: Array, *, from_s: float | None = None, to_s: float | None = None, **how: Any
) -> FreeSwing:
    """Find a free swing in a long record (n,) from every few samples, then in all samples around it."""
    every = -(-len(time_s) // _MOST_ROWS)
    coarse = find_swing(time_s[::every], angle_rad[::every], from_s=from_s, to_s=to_s, **how)
    begin_s, end_s = coarse.release_s, float(coarse.time_s[coarse.end])
    around_s = (begin_s - _HELD_S, end_s + max(end_s - begin_s, _HELD_S))
    first, last = np.searchsorted(time_s, time_s[0] + np.array(around_s)).tolist()
    late_s = float(time_s[first] - time_s[0])
    found = find_read_swing(
        time_s[first:last],
        angle_rad[first:last],
        from_s=None if from_s is None else max(from_s - late_s, 0.0),
        to_s=None if to_s is None else to_s - late_s,
        **how,
    )
    text = (
        f"the record has {len(time_s)} rows: those from {late_s:.0f} to {late_s + found.time_s[-1]:.0f} s are used, "
        "around the free swing."
    )
    return replace(
        found,
        time_s=found.time_s + late_s,
        peak_time_s=found.peak_time_s + late_s,
        findings=(note("swing-part-used", text, "swing.*"), *found.findings),
    )


def check_peaks(peaks: int | Mapping[str, int] | None, axes: Iterable[str]) -> None:
    """Check numbers of peaks, one for all axes or one for each.

    Raises ConfigError for numbers below four, and for an axis without a swing.
    """
    axes = list(axes)
    if isinstance(peaks, Mapping):
        for axis in peaks.keys() - axes:
            there = ", ".join(axes) or "an axis without a name"
            raise ConfigError(f"peaks {axis}={peaks[axis]}: no swing is about '{axis}', but about {there}.")
    counts = peaks.values() if isinstance(peaks, Mapping) else () if peaks is None else (peaks,)
    for count in counts:
        if count < FEWEST_PEAKS:
            raise ConfigError(f"peaks {count}: a fit needs {FEWEST_PEAKS} peaks at least, the release being the first.")


def peaks_on(axis: str | None, peaks: int | Mapping[str, int] | None) -> int | None:
    """Return the number of peaks to use on an axis, None for all."""
    return peaks.get(axis or "") if isinstance(peaks, Mapping) else peaks


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
    rig: Rig,
    gravity_mps2: float | None,
    gravity_std_mps2: float | None = None,
    fixture_swing: MountedSwing | None = None,
) -> Surroundings:
    """Return gravity and, if it was swung, the empty fixture.

    `gravity_mps2` and `gravity_std_mps2` replace those of rig.toml.

    Raises ConfigError for a swing of a fixture that rig.toml does not describe, and for gravity of zero or less.
    """
    check_positive(gravity_mps2=gravity_mps2)
    if fixture_swing is not None and rig.fixture is None:
        raise ConfigError("a swing of the fixture needs its mass and distance: add [fixture] to rig.toml.")
    return Surroundings(
        gravity_mps2=rig.site.gravity_mps2 if gravity_mps2 is None else gravity_mps2,
        gravity_std_mps2=rig.site.gravity_std_mps2 if gravity_std_mps2 is None else gravity_std_mps2,
        fixture=rig.fixture,
        fixture_swing=fixture_swing,
    )


_WEIGHED = tuple(f"vehicle.{key}" for key in ("mass_kg", "mass_std_kg", "centre_of_mass_mm", "centre_of_mass_std_mm"))


def rests_on(axes: Iterable[str], *, body: str | None = None) -> tuple[str, ...]:
    """Return the keys of rig.toml on which the inertia of a body depends that swung about these axes."""
    if body == "testbody":
        return ("site", "fixture", "testbody")
    return ("site", "fixture", *_WEIGHED, *(f"mounts.{axis}" for axis in axes))


Given = tuple[float | None, float | None]  # a number and its standard uncertainty, each None if not given


def body_of_swing(
    rig: Rig | None, *, axis: str | None, body: str | None, mass: Given, distance: Given
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
    is_test_body = body == "testbody"
    swung = swung_test_body(drawn_body(rig, *mass)) if is_test_body else vehicle(rig, *mass)
    check_mounts([axis], swung.mounts, table="testbody.mounts" if is_test_body else "mounts")
    return swung, axis


def check_mounts(names: Iterable[str], mounts: Mapping[str, Mount], *, table: str) -> None:
    """Check that every name is a mount of a table of rig.toml.

    Raises ConfigError that lists the existing mounts.
    """
    for name in names:
        if name not in mounts:
            there = ", ".join(mounts) or "none"
            raise ConfigError(f"'{name}' is no mount of this rig.toml (it has: {there}): add [{table}.{name}].")


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
