"""Simulates a vehicle on a load cell in the wind: averaged forces of a whole campaign, or the record of one run.

The wind is not uniform: an operator reads a lowest and a highest speed around the vehicle, and the speed that acts on
it lies anywhere between. The load cell is tared with the wind on and the rotors off, so the forces do not include the
body's drag.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from cfid.sim.loadcell import Counts, LoadCellTruth, SimulatedLoadCell
from cfid.sim.stepping import Array

COMMANDS = (0, 10000, 20000, 30000, 37300, 40000, 50000)
SHOWN_RPM = (0, 15400, 21900, 27800, 31600, 33400, 39300)  # of a rotor with two markers, C.3.1, at these commands

MARKERS = 2
# Wind turns the rotors faster: the mean of the thesis' 90 speed sums, 5992.7 rad/s, divided by that of SHOWN_RPM.
_FASTER_IN_WIND = 5992.7 / 5913.2 - 1
_USUAL_WIND_MPS = 2.85

_TARE_SAMPLES, _WINDOW_SAMPLES = 500, 4000
_WINDOW_AFTER_S = 10.0  # from the tare to the window's middle


class Air(Protocol):
    """The force of moving air on turning rotors."""

    def force_n(self, velocity_mps: Array, speed_sum_rad_s: float) -> Array:
        """Return the force (3,) at a velocity (3,) relative to the air, both in the body frame."""
        ...


@dataclass(frozen=True, kw_only=True)
class SimpleAir:
    """Force along each axis in proportion to rotor speed and velocity (eq. 4.2); kg/rad for x, y, z."""

    kg_per_rad: Sequence[float]

    def force_n(self, velocity_mps: Array, speed_sum_rad_s: float) -> Array:
        return np.asarray(self.kg_per_rad) * velocity_mps * speed_sum_rad_s


@dataclass(frozen=True, kw_only=True)
class ComplexAir:
    """Eq. 4.5: six terms, each with coefficients for x, y, z, shape (6, 3), in SI units."""

    k: npt.ArrayLike

    def force_n(self, velocity_mps: Array, speed_sum_rad_s: float) -> Array:
        k1, k2, k3, k4, k5, k6 = np.asarray(self.k)
        with_speed = k1 * velocity_mps + k3 * speed_sum_rad_s + k5
        return np.asarray(with_speed * speed_sum_rad_s + k2 * velocity_mps**2 + k4 * velocity_mps + k6)


@dataclass(frozen=True, kw_only=True)
class CrossAir:
    """Eq. 4.6 with a full matrix (3, 3) in kg/rad; if `mended`, lateral wind from any direction takes lift.

    The first entry of the third row then multiplies |v_xy|, and the second is not used.
    """

    kg_per_rad: npt.ArrayLike
    mended: bool = False

    def force_n(self, velocity_mps: Array, speed_sum_rad_s: float) -> Array:
        matrix = np.asarray(self.kg_per_rad)
        force = matrix @ velocity_mps
        if self.mended:
            force[2] = matrix[2, 0] * math.hypot(velocity_mps[0], velocity_mps[1]) + matrix[2, 2] * velocity_mps[2]
        return np.asarray(force * speed_sum_rad_s)


class Wind(NamedTuple):
    """A wind setting: the fan's direction, and the lowest and highest wind speed read."""

    angle_deg: float
    min_mps: float
    max_mps: float
    azimuth_rad: float = 0.4967


@dataclass(frozen=True, kw_only=True)
class Tunnel:
    """The true set-up. `unsteady` is the relative variation of the wind at the vehicle from run to run.

    In each run the load cell drifts at a random rate, whose standard deviation its truth states.
    """

    air: Air
    cell: LoadCellTruth = field(default_factory=LoadCellTruth)
    yaw_rad: float = math.pi / 4
    unsteady: float = 0.01
    thrust_ns2_per_rad2: float = 1.8e-8
    time_constant_s: float = 0.06


class TunnelRun(NamedTuple):
    """The result of a run of a campaign: typed readings, and the mean force (3,) in the load cell's frame.

    A reference, without wind, has the angle nan and wind 0. `force_std_n` (3,) includes the cell's noise only.
    """

    command: int
    angle_deg: float
    azimuth_rad: float
    min_mps: float
    max_mps: float
    shown_rpm: float
    force_n: Array
    force_std_n: Array


def known_to(relative_std: float, winds: Iterable[Wind]) -> list[Wind]:
    """Return settings with the same middles, whose readings bound a uniform distribution of `relative_std`."""
    half = math.sqrt(3) * relative_std
    middles = [(wind, (wind.min_mps + wind.max_mps) / 2) for wind in winds]
    return [wind._replace(min_mps=(1 - half) * middle, max_mps=(1 + half) * middle) for wind, middle in middles]


def simulate_campaign(
    tunnel: Tunnel, winds: Iterable[Wind], *, rng: np.random.Generator, commands: Sequence[int] = COMMANDS
) -> list[TunnelRun]:
    """Simulate all commands without wind, then in each wind; the thesis' 15 wind settings make 112 runs."""
    still = Wind(math.nan, 0.0, 0.0)
    runs = []
    for wind in (still, *winds):
        acting_mps = rng.uniform(wind.min_mps, wind.max_mps)
        runs += [_averaged(tunnel, wind, command, acting_mps, rng) for command in commands]
    return runs


def record(
    tunnel: Tunnel,
    wind: Wind,
    *,
    command: int,
    rng: np.random.Generator,
    duration_s: float = 12.0,
    rate_hz: float = 1e3,
) -> tuple[Array, Counts]:
    """Record one whole run: times (n,) and counts (n, 6) of the load cell, with the motors on after 2 s."""
    _, force = _steady(tunnel, wind, command, rng.uniform(wind.min_mps, wind.max_mps))
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    since = np.maximum(time_s - 2.0, 0.0)
    wrench = np.zeros((len(time_s), 6))
    wrench[:, :3] = (1 - np.exp(-since / tunnel.time_constant_s))[:, np.newaxis] * force
    drifting = tuple(float(rate) for rate in rng.standard_normal(6) * tunnel.cell.drift_per_s)
    cell = SimulatedLoadCell(tunnel.cell.model_copy(update={"drift_per_s": drifting}), rng)
    return time_s, cell.read(time_s, wrench)[0]


def _averaged(tunnel: Tunnel, wind: Wind, command: int, acting_mps: float, rng: np.random.Generator) -> TunnelRun:
    shown_rpm, force = _steady(tunnel, wind, command, acting_mps * (1 + tunnel.unsteady * rng.standard_normal()))
    noise = np.array(tunnel.cell.noise_std[:3]) * math.sqrt(1 / _TARE_SAMPLES + 1 / _WINDOW_SAMPLES)
    drift = _WINDOW_AFTER_S * np.array(tunnel.cell.drift_per_s[:3])
    off = noise * rng.standard_normal(3) + drift * rng.standard_normal(3)
    return TunnelRun(
        command=command,
        angle_deg=wind.angle_deg,
        azimuth_rad=wind.azimuth_rad,
        min_mps=wind.min_mps,
        max_mps=wind.max_mps,
        shown_rpm=shown_rpm,
        force_n=force + off,
        force_std_n=noise,
    )


def _steady(tunnel: Tunnel, wind: Wind, command: int, acting_mps: float) -> tuple[float, Array]:
    """Return the tachometer's reading in rpm, and thrust and drag (3,) in the load cell's frame."""
    shown_rpm = float(np.interp(command, COMMANDS, SHOWN_RPM))
    thrust_n = 4 * tunnel.thrust_ns2_per_rad2 * (shown_rpm / MARKERS * math.tau / 60) ** 2
    middle_mps = (wind.min_mps + wind.max_mps) / 2
    shown_rpm *= 1 + _FASTER_IN_WIND * middle_mps / _USUAL_WIND_MPS
    force = np.array([0.0, 0.0, thrust_n])
    if acting_mps > 0 and shown_rpm > 0:
        angle = math.radians(wind.angle_deg)
        x, y = math.sin(angle) * math.cos(wind.azimuth_rad), -math.sin(angle) * math.sin(wind.azimuth_rad)
        velocity = acting_mps * np.array([x, y, math.cos(angle)])
        force += tunnel.air.force_n(velocity, 4 * shown_rpm / MARKERS * math.tau / 60)
    cos, sin = math.cos(tunnel.yaw_rad), math.sin(tunnel.yaw_rad)
    return shown_rpm, np.array([cos * force[0] + sin * force[1], cos * force[1] - sin * force[0], force[2]])
