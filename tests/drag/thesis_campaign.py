"""The thesis' wind campaign of 112 runs, simulated, and its coefficients, which the tests of drag share."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from cfid.drag.data import FORCE, FORCE_STD, reduce_points
from cfid.drag.model import COMPLEX, CROSS, SIMPLE, DragExperiments, DragModel
from cfid.drag.plan import THESIS_WINDS
from cfid.motors.points import rotor_speed_rad_s
from cfid.recordings.wrench import rotation_about_z
from cfid.sim.loadcell import LoadCellTruth
from tests.drag.wind_tunnel import (
    Air,
    ComplexAir,
    CrossAir,
    SimpleAir,
    Tunnel,
    TunnelRun,
    Wind,
    known_to,
    simulate_campaign,
)

Array = npt.NDArray[np.float64]

EQ_4_8 = np.array([-9.1785e-7, -9.1785e-7, -10.311e-7])
EQ_4_9 = np.array(
    [
        [-8.9158e-7, -8.9158e-7, -3.1574e-7],
        [-6.8572e-5, -6.8572e-5, 5.2068e-5],
        [1.1254e-10, 1.1254e-10, -2.3662e-10],
        [-5.4233e-4, -5.4233e-4, -2.2935e-3],
        [-1.8443e-6, -1.8443e-6, 4.8857e-7],
        [6.4061e-3, 6.4061e-3, 3.0985e-3],
    ]
)
EQ_4_11 = 1e-7 * np.array([[-10.2506, -0.3177, -0.4332], [-0.3177, -10.2506, -0.4332], [-7.7050, -7.7050, -7.5530]])

SIMPLE_AIR = SimpleAir(kg_per_rad=EQ_4_8.tolist())
COMPLEX_AIR = ComplexAir(k=EQ_4_9)
CROSS_AIR = CrossAir(kg_per_rad=EQ_4_11)
WORLDS: tuple[tuple[Air, DragModel, Array], ...] = (
    (SIMPLE_AIR, SIMPLE, EQ_4_8),
    (COMPLEX_AIR, COMPLEX, EQ_4_9),
    (CROSS_AIR, CROSS, EQ_4_11),
)
NAMES = tuple(model.name for _, model, _ in WORLDS)

EXACT = LoadCellTruth(noise_std=(0,) * 6, drift_per_s=(0,) * 6)
WINDS = [Wind(setting.angle_deg or 0.0, setting.min_mps, setting.max_mps) for setting in THESIS_WINDS]


def as_typed(runs: Sequence[TunnelRun], *, yaw_deg: float = 45.0) -> pd.DataFrame:
    """Return simulated runs as rows of points: with names, and references without an angle."""
    turn = rotation_about_z(yaw_deg)
    force = np.array([turn @ run.force_n for run in runs])
    std = np.array([np.sqrt(turn**2 @ run.force_std_n**2) for run in runs])
    points = pd.DataFrame(
        {
            "name": [f"run {i}" for i in range(len(runs))],
            "command": [run.command for run in runs],
            "angle_deg": [math.nan if run.max_mps == 0 else run.angle_deg for run in runs],
            "min_mps": [run.min_mps for run in runs],
            "max_mps": [run.max_mps for run in runs],
            "azimuth_deg": [math.degrees(run.azimuth_rad) for run in runs],
            "rotor_rad_s": [float(rotor_speed_rad_s(run.shown_rpm, markers=2)) for run in runs],
            "volts": math.nan,
        }
    )
    points[FORCE], points[FORCE_STD] = force, std
    return points


def exact_runs(air: Air, winds: Sequence[Wind] = WINDS) -> pd.DataFrame:
    """Return the thesis' campaign without noise, in winds that are exactly the middle of their readings."""
    tunnel = Tunnel(air=air, cell=EXACT, unsteady=0.0)
    return as_typed(simulate_campaign(tunnel, known_to(0.0, winds), rng=np.random.default_rng(0)))


def exact(air: Air, winds: Sequence[Wind] = WINDS) -> DragExperiments:
    return reduce_points(exact_runs(air, winds))


def measured_runs(air: Air, rng: np.random.Generator, winds: Sequence[Wind] = WINDS) -> pd.DataFrame:
    """Return a campaign with noise, drift, and wind that is inhomogeneous and known to 5 %."""
    return as_typed(simulate_campaign(Tunnel(air=air), known_to(0.05, winds), rng=rng))


def measured(air: Air, rng: np.random.Generator, winds: Sequence[Wind] = WINDS) -> DragExperiments:
    return reduce_points(measured_runs(air, rng, winds))
