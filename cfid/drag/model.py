"""Hold drag experiments, and model drag: the force of moving air on turning rotors.

The conventions hold for all of drag:

- The body frame has x forward, y left, z up (along the thrust). The load cell is turned about z against it:
  F_body = Rz(+yaw) F_sensor; the thesis' yaw in wind is 45 degrees (see `turn_about_z`).
- v is the velocity of the vehicle relative to the air, in the body frame: it points against the wind. Wind from
  straight above (angle 0) is a climb, so v_z > 0.
- An angle is that of the wind generator to the vertical, an azimuth that of its place about z:
  v = speed (sin angle cos azimuth, -sin angle sin azimuth, cos angle).
- A drag force f is the force of the air on the vehicle beyond the thrust without wind, in the body frame; a drag
  coefficient in f = k speed_sum v is therefore negative.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding
from cfid.records.parameters import Source
from cfid.records.rig_file import RigFacts

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_LATERAL, _VERTICAL = np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class DragExperiments:
    """Experiments (n,) with turning rotors in wind, forces and velocities (n, 3) in the body frame.

    `velocity_mps` is that of the vehicle relative to the air. `setting` numbers the wind settings from 0: all
    experiments of a setting share the error of its wind speed, with the relative standard uncertainty
    `wind_relative_std`. `force_std_n` is the standard uncertainty of each force's own noise, `reference_std_n` that of
    the reference subtracted from it, which all experiments at its command share. Where `noise_known` is false, both are
    only relative weights. `names` are those of the recordings, `sources` their files, `rigs` the facts of their rigs;
    those among them in `tachometers` have measured rotor speeds. A table of forces has no rigs.
    """

    command: Array
    angle_deg: Array
    velocity_mps: Array
    speed_sum_rad_s: Array
    force_n: Array
    force_std_n: Array
    reference_std_n: Array
    noise_known: bool
    setting: Indices
    wind_relative_std: Array
    names: tuple[str, ...]
    findings: tuple[Finding, ...] = ()
    sources: tuple[Source, ...] = ()
    rigs: tuple[RigFacts, ...] = ()
    tachometers: tuple[RigFacts, ...] = ()

    @property
    def wind_mps(self) -> Array:
        """The wind's speed (n,)."""
        return np.asarray(np.linalg.norm(self.velocity_mps, axis=1))

    @property
    def settings(self) -> int:
        """The number of wind settings."""
        return int(self.setting.max()) + 1

    def at(self, rows: npt.NDArray[np.bool_]) -> "DragExperiments":
        """Return some of the experiments, with new numbers of their settings."""
        return replace(
            self,
            command=self.command[rows],
            angle_deg=self.angle_deg[rows],
            velocity_mps=self.velocity_mps[rows],
            speed_sum_rad_s=self.speed_sum_rad_s[rows],
            force_n=self.force_n[rows],
            force_std_n=self.force_std_n[rows],
            reference_std_n=self.reference_std_n[rows],
            setting=np.unique(self.setting[rows], return_inverse=True)[1],
            wind_relative_std=self.wind_relative_std[rows],
            names=tuple(np.array(self.names)[rows].tolist()),
        )


class Term(NamedTuple):
    """One coefficient's part of the force.

    `regressor` maps velocities (n, 3) in m/s and speed sums (n, 1) in rad/s to (n, 3) or (n, 1), one value per axis;
    `axes` (3,) is 1 for the axes that share the coefficient and 0 for the others.
    """

    regressor: Callable[[Array, Array], Array]
    axes: Array


@dataclass(frozen=True, eq=False)
class DragModel:
    """Force (n, 3) = rows (n, 3, p) of `terms` @ coefficients (p,), all SI, body frame.

    `layout` places the coefficients as the thesis prints them.
    """

    name: str
    layout: Indices
    terms: tuple[Term, ...]


def rows_of(terms: tuple[Term, ...], velocity_mps: Array, speed_sum_rad_s: Array) -> Array:
    """Return the regressors (n, 3, p) of p terms at velocities (n, 3) and speed sums (n,)."""
    speed_sum = speed_sum_rad_s[:, np.newaxis]
    return np.stack([term.regressor(velocity_mps, speed_sum) * term.axes for term in terms], axis=2)


def _lateral_and_vertical(*regressors: Callable[[Array, Array], Array]) -> tuple[Term, ...]:
    """Return two terms per regressor: x and y share a coefficient, z has its own."""
    return tuple(Term(regressor, axes) for regressor in regressors for axes in (_LATERAL, _VERTICAL))


def _coupled(name: str, sideways: Callable[[Array], Array]) -> DragModel:
    """Return eq. 4.6 with the symmetries of eq. 4.7; kappa_4 multiplies `sideways` of the velocity, (n, 1)."""
    return DragModel(
        name,
        np.array([[0, 1, 2], [1, 0, 2], [3, 3, 4]]),
        (
            Term(lambda v, s: s * v, _LATERAL),
            Term(lambda v, s: s * v[:, [1, 0, 2]], _LATERAL),
            Term(lambda v, s: s * v[:, 2:], _LATERAL),
            Term(lambda v, s: s * sideways(v), _VERTICAL),
            Term(lambda v, s: s * v, _VERTICAL),
        ),
    )


# Eq. 4.2: the diagonal of K_aero, kg/rad.
SIMPLE = DragModel("simple", np.array([0, 0, 1]), _lateral_and_vertical(lambda v, s: s * v))
# Eq. 4.5: k1 to k6, each for x, y, z; kg/rad, kg/m, N s^2/rad^2, kg/s, N s/rad, N (the thesis prints kg/rad for all).
COMPLEX = DragModel(
    "complex",
    np.arange(0, 12, 2)[:, np.newaxis] + np.array([0, 0, 1]),
    _lateral_and_vertical(
        lambda v, s: s * v,
        lambda v, s: v**2,
        lambda v, s: s**2,
        lambda v, s: v,
        lambda v, s: s,
        lambda v, s: np.ones_like(s),
    ),
)
# Kappa_1 to kappa_5 in the matrix, kg/rad.
CROSS = _coupled("cross", lambda v: v[:, :1] + v[:, 1:2])
# Kappa_4 of eq. 4.7 changes its sign with the direction of flight, which no rotor does (section 4.5): here it
# multiplies |v_xy|.
CROSS_MENDED = _coupled("cross mended", lambda v: np.hypot(v[:, :1], v[:, 1:2]))

# Drag of the body in addition to the rotors', k |v| v: one coefficient for x and y, one for z, kg/m.
BODY = _lateral_and_vertical(lambda v, s: np.linalg.norm(v, axis=1, keepdims=True) * v)
