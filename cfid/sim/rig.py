"""Simulates the swing rig: a true body hangs on its mounts, is released by hand and recorded.

Axis inertias and distances are computed here independently of the analysis, which can be judged by them.
"""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from cfid.sim.encoder import EncoderModel, EncoderRecording, record
from cfid.sim.imu import Hanging
from cfid.sim.plants import HandRelease, Pendulum, swing
from cfid.sim.threads import TwoThreads
from cfid.sim.truth import CUBE_ARM_M, CUBE_M, TrueFriction, Truth, draw_testbody, draw_truth

__all__ = [
    "TrueFriction",
    "Truth",
    "draw_release",
    "draw_testbody",
    "draw_truth",
    "hanging",
    "pendulum",
    "record_swings",
    "two_threads",
]


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
        viscous_nms_per_rad=mount.friction.viscous_nms_per_rad,
        coulomb_nm=mount.friction.coulomb_nm,
        quadratic_nms2_per_rad2=mount.friction.quadratic_nms2_per_rad2,
        spring_nm_per_rad=mount.friction.spring_nm_per_rad,
        stribeck_nm=mount.friction.stribeck_nm,
        ripple_nm=mount.friction.ripple_nm,
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
    if mount.threads_m is not None:
        return Hanging(
            axis=mount.direction,
            down=-mount.direction,
            sensor_m=-truth.centre_of_mass_m,
            gravity_mps2=truth.gravity_mps2,
        )
    below = truth.centre_of_mass_m - mount.point_m
    below = below - (below @ mount.direction) * mount.direction
    return Hanging(
        axis=mount.direction,
        down=below / np.linalg.norm(below),
        sensor_m=-mount.point_m,
        gravity_mps2=truth.gravity_mps2,
    )


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


def record_swings(
    truth: Truth,
    mounts: Iterable[str],
    *,
    rng: np.random.Generator,
    encoder: EncoderModel,
    angle_deg: tuple[float, float] = (20, 70),
    duration_s: float = 16.0,
) -> dict[str, EncoderRecording]:
    """Swing the body once in each of the named mounts and record it.

    A body that is mounted again meets the encoder at any angle: every swing gets its own offset in place of the
    encoder's.
    """
    names = tuple(mounts)
    releases = [draw_release(rng, angle_deg=angle_deg) for _ in names]
    pendulums = [pendulum(truth, name) for name in names]
    motion = swing(pendulums, releases, duration_s=duration_s, step_s=2e-3, store_every=1)
    return {
        name: record(
            motion.time_s,
            motion.angle_rad[:, i],
            speed_rad_per_s=motion.speed_rad_per_s[:, i],
            encoder=replace(encoder, offset_rad=rng.uniform(0, 2 * math.pi)),
            rng=rng,
        )
        for i, name in enumerate(names)
    }
