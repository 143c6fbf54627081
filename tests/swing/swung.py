"""A pendulum that a hand lifts, holds and lets go, and its encoder: a plant in C that shares no code with the fit."""

import ctypes
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.records.rig_file import thesis_rig
from cfid.sim.app_core import compiled

Array = npt.NDArray[np.float64]

GRAVITY_MPS2 = 9.81
HELD_S = 1.0
STEP_S = 5e-4
FINE_STEP_S = 1e-4  # within a coarse step, a jump of dry friction changes W by up to 6e-6, an interval's width
_STRIBECK_RAD_PER_S = 0.5  # within which dry friction is larger, if `stribeck` is set


@cache
def swung(
    frequency_squared_s2: float,
    *,
    release_rad: float,
    seconds: float,
    viscous: float = 0.0,
    coulomb: float = 0.0,
    quadratic: float = 0.0,
    root: float = 0.0,
    stribeck: float = 0.0,
    cable: float = 0.0,
    ripple: float = 0.0,
    slip_rad_per_s: float = 2e-3,
    row_s: float = 1e-3,
    step_s: float = STEP_S,
) -> tuple[Array, Array]:
    """Return times (n,) and angles (n,); friction is divided by inertia, `root` is that with the root of the speed.

    `stribeck` is the relative excess of dry friction at standstill. `cable` is the ratio of a cable's stiffness to that
    of gravity. `ripple` is dry friction that goes with the cosine of the angle. Dry friction changes its sign within
    `slip_rad_per_s`.
    """
    lift = np.clip(3 * np.linspace(0, 1, round(HELD_S / row_s)) - 1, 0, 1)
    free = np.zeros(round((seconds - HELD_S) / row_s))
    numbers = [frequency_squared_s2, viscous, coulomb, quadratic, root, release_rad, stribeck, cable, ripple]
    _compiled()(
        np.array([*numbers, slip_rad_per_s, _STRIBECK_RAD_PER_S]), step_s, len(free), round(row_s / step_s), free
    )
    angle = np.concatenate([release_rad * lift, free])
    return row_s * np.arange(float(len(angle))), angle


@cache
def _compiled() -> Callable[..., None]:
    """Return the function that swings one pendulum; its steps in C take a hundredth of the time of steps in NumPy."""
    step_by_step = compiled(Path(__file__).with_suffix(".c")).swing
    numbers = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
    step_by_step.argtypes = [numbers, ctypes.c_double, ctypes.c_int, ctypes.c_int, numbers]
    step_by_step.restype = None
    return step_by_step


def encoded(
    angle_rad: Array,
    rng: np.random.Generator,
    *,
    eccentric_deg: float = 0.0,
    phase_deg: float = 0.0,
    noise_deg: float = 0.0,
    counts: float = 8192.0,
) -> Array:
    """Return an encoder's readings (n,); `phase_deg` lies between its disc's offset and the angle of rest."""
    read = angle_rad + rng.uniform(0, 2 * math.pi)
    read = read + math.radians(eccentric_deg) * np.sin(angle_rad + math.radians(phase_deg))
    if noise_deg:
        read = read + math.radians(noise_deg) * rng.standard_normal(len(angle_rad))
    return np.asarray(2 * math.pi / counts * np.floor(read * counts / (2 * math.pi)))


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
    rows = np.column_stack([time_s, angle_rad])
    np.savetxt(path, rows, delimiter=",", header="t_s,angle_rad", comments="", fmt="%.7g")
    return path
