"""The motion of a measured vehicle, calculated from the thesis' numbers alone, and the rows that judge an export.

Axes are x forward, y left, z up; motors m1 to m4 are front right, rear right, rear left and front left.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.export.vehicle import ExportVehicle
from tests.export import thesis_vehicle as thesis
from tests.export.reading import export

Array = npt.NDArray[np.float64]

RPM = 2 * math.pi / 60
G = 9.81
MASS_KG, ARM_M = thesis.MASS_KG, thesis.ARM_M
CENTRE_MM = (0.4, -0.6, 17.425)  # of mass, in the thesis' axes: 0.6 mm behind and 0.4 mm to the right of the middle
INERTIA = np.array(  # the thesis' matrix, turned so that its y points forward and its -x left
    [
        [16.655602e-6, -0.830806e-6, 1.800197e-6],
        [-0.830806e-6, 16.571710e-6, -0.718277e-6],
        [1.800197e-6, -0.718277e-6, 29.261652e-6],
    ]
)
PLACES = ARM_M / math.sqrt(2) * np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]]) + np.array([0.6e-3, 0.4e-3])
YAW = np.array([-1, 1, -1, 1])
MOST_N = thesis.MAX_THRUST_N
K, MOMENT_M = thesis.K_N_S2, thesis.TORQUE_POLY[0]
HOVER_RAD_S = math.sqrt(MASS_KG * G / 4 / K)
MOST_RAD_S = thesis.SPEED_POLY[0] * 65535 + thesis.SPEED_POLY[1]
UP_S, DOWN_S = (1 / (a + 2 * b * HOVER_RAD_S) for a, b in (thesis.RISING, thesis.FALLING))
DRAG_KG_PER_RAD = np.array([9.1785e-7, 9.1785e-7, 10.311e-7])  # per velocity and per sum of the rotor speeds
DRAG_1_S = DRAG_KG_PER_RAD * 4 * HOVER_RAD_S / MASS_KG  # deceleration per velocity in hover
FLAPPING_NS = (6e-4, -8e-4)  # about x over velocity along y, about y over that along x
MIXES = {"roll": np.array([-1, -1, 1, 1]), "pitch": np.array([-1, 1, 1, -1]), "yaw": np.array([-1, 1, -1, 1])}


def measured() -> ExportVehicle:
    """Return the vehicle of a campaign, with its centre of mass off the middle and its rotors measured."""
    known = thesis.with_value(thesis.vehicle(), "centre_of_mass_m", [0.001 * part for part in CENTRE_MM])
    known = thesis.with_value(known, "rotor_inertia_kg_m2", 3.0e-8)
    for axis, moment_ns in zip(("roll", "pitch"), FLAPPING_NS, strict=True):
        known = thesis.with_value(known, f"flight.moment_per_velocity_ns.{axis}", moment_ns)
    return thesis.with_value(known, "rotor_radius_m", 0.0225)


def written(target: str, folder: Path, name: str) -> Path:
    """Write an export of the measured vehicle, and return its path."""
    path = folder / name
    path.write_text(export(target, measured()))
    return path


def speeds(axis: str) -> Array:
    """Return rotor speeds that turn the vehicle about an axis: 5 % more on one side, 5 % less on the other."""
    faster: Array = HOVER_RAD_S * (1 + 0.05 * MIXES[axis])
    return faster


def moments(rotor_speeds: Array) -> Array:
    """Return the moments about the centre of mass in N m."""
    thrusts = K * rotor_speeds**2
    found: Array = np.array([PLACES[:, 1] @ thrusts, -PLACES[:, 0] @ thrusts, MOMENT_M * YAW @ thrusts])
    return found


def accelerations(inertia: Array = INERTIA) -> list[float]:
    """Return the angular acceleration about each axis at the rotor speeds that turn the vehicle about this axis."""
    return [float(np.linalg.solve(inertia, moments(speeds(axis)))[i]) for i, axis in enumerate(MIXES)]


def time_to_63(thrust_of_time: Callable[[float], float], step_s: float = 1e-4, most_s: float = 2.0) -> float:
    """Return the time at which a thrust has made 63.2 % of its change from time 0 to the end."""
    share = 1 - math.exp(-1)
    values = np.array([thrust_of_time(t) for t in np.arange(0, most_s, step_s)])
    return crossing(np.arange(0, most_s, step_s), values, values[0] + share * (values[-1] - values[0]))


def crossing(times: Sequence[float] | Array, values: Sequence[float] | Array, level: float) -> float:
    """Return the time at which rising values first reach a level, interpolated between two samples."""
    after = int(np.argmax(np.asarray(values) >= level))
    rise = (level - values[after - 1]) / (values[after] - values[after - 1])
    return float(times[after - 1] + rise * (times[after] - times[after - 1]))


def lag_of_first_order(lag_s: float, faster: float = 1.1) -> float:
    """Return the time of 63.2 % of the change of thrust while a rotor goes to `faster` times its speed in hover."""
    share = 1 - math.exp(-1)
    reached = math.sqrt(1 + share * (faster**2 - 1))  # relative to the speed in hover
    return -lag_s * math.log((faster - reached) / (faster - 1))


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of evidence: pairs of predicted and found values, None or empty where the format has no such value."""

    target: str
    version: str
    loaded: str
    hover: tuple[float, float]
    hover_unit: str
    turning: Sequence[tuple[float, float]] = ()
    lag_s: tuple[float, float] | None = None
    drag_1_s: Sequence[tuple[float, float]] = ()

    def check(self) -> None:
        """Raise AssertionError if a found value differs by more than 0.1 % from what the file can represent."""
        pairs = [self.hover, *self.turning, *([self.lag_s] if self.lag_s else []), *self.drag_1_s]
        for predicted, found in pairs:
            assert found == pytest.approx(predicted, rel=1e-3), (self.target, predicted, found)


def pairs(predicted: Sequence[float] | Array, found: Sequence[float]) -> list[tuple[float, float]]:
    """Return pairs of predicted and found values."""
    return list(zip(map(float, predicted), map(float, found), strict=True))
