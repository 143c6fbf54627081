"""A pendulum integrated by SciPy and read by an encoder: a plant that shares no code with the fit."""

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from cfid.records.rig_file import thesis_rig

Array = npt.NDArray[np.float64]

GRAVITY_MPS2 = 9.81
HELD_S = 2.0
_SLIP_RAD_PER_S = 0.01  # dry friction changes its sign within this speed


@cache
def motion(
    *,
    frequency_squared_s2: float,
    release_deg: float,
    seconds: float,
    row_s: float = 0.004,
    viscous_per_s: float = 0.0,
    coulomb_per_s2: float = 0.0,
    cable: float = 0.0,
    friction_per_s2: Callable[[float], float] | None = None,
) -> tuple[Array, Array]:
    """Return times (n,) and angles (n,) of a body at rest, lifted, held and let go; friction is divided by inertia.

    `cable` is a spring's stiffness over gravity's; `friction_per_s2` is a further friction at a speed of at least 0.
    """

    def derivative(_: float, state: Array) -> tuple[float, float]:
        angle, speed = state
        friction = viscous_per_s * speed + coulomb_per_s2 * math.tanh(speed / _SLIP_RAD_PER_S)
        if friction_per_s2 is not None:
            friction += math.copysign(friction_per_s2(abs(speed)), speed)
        return speed, -frequency_squared_s2 * (math.sin(angle) + cable * angle) - friction

    release = math.radians(release_deg)
    swung_s = row_s * np.arange(round(seconds / row_s))
    method = "LSODA" if coulomb_per_s2 else "DOP853"
    solved = solve_ivp(
        derivative, (0, seconds), (release, 0.0), t_eval=swung_s, rtol=1e-9, atol=1e-10, method=method, max_step=0.01
    )
    lift = np.clip(np.linspace(-1.3, 2.0, round(HELD_S / row_s)), 0, 1)
    angle: Array = np.concatenate([release * lift, solved.y[0]])
    return np.asarray(row_s * np.arange(len(angle)), dtype=float), angle


def encoded(
    angle_rad: Array,
    *,
    seed: int,
    eccentric_deg: float = 0.0,
    phase_deg: float = 0.0,
    noise_deg: float = 0.02,
    counts: float = 8192.0,
) -> Array:
    """Return an encoder's readings (n,); `phase_deg` lies between its disc's offset and the angle of rest."""
    off, phase = math.radians(eccentric_deg), math.radians(phase_deg)
    read = angle_rad + off * (np.sin(angle_rad + phase) - math.sin(phase))
    read = read + math.radians(noise_deg) * np.random.default_rng(seed).standard_normal(len(angle_rad))
    return np.asarray(2 * math.pi / counts * np.round(read * counts / (2 * math.pi)))


def frequency_on(mount: str, inertia_kg_m2: Array) -> float:
    """Return W, m g r / (u' I u + m r^2), of the thesis' Crazyflie with an inertia matrix (3, 3) on a mount."""
    rig = thesis_rig()
    hung, mass = rig.mounts[mount], rig.vehicle.mass_kg
    about, across = (
        np.array(one) / np.linalg.norm(one) for one in (hung.direction, hung.distance_direction or hung.direction)
    )
    away = 1e-3 * np.array(rig.vehicle.centre_of_mass_mm) - hung.point_m
    distance = float(np.linalg.norm(away - (away @ across) * across))
    return mass * GRAVITY_MPS2 * distance / (float(about @ inertia_kg_m2 @ about) + mass * distance**2)


def written(path: Path, time_s: Array, angle_rad: Array) -> Path:
    """Write a table of a swing."""
    np.savetxt(
        path, np.column_stack([time_s, angle_rad]), delimiter=",", header="t_s,angle_rad", comments="", fmt="%.7g"
    )
    return path
