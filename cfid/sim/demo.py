"""The recordings of a whole campaign on the simulated rig, and the truth behind them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from cfid.campaign import MM, Rig
from cfid.sim.encoder import EncoderModel, Recording, record
from cfid.sim.plants import DroppingWeight, drop
from cfid.sim.rig import draw_testbody, draw_truth, record_swings

Array = npt.NDArray[np.float64]

WEIGHTS_G = (20.0, 20.0, 30.0, 30.0, 40.0, 40.0, 50.0, 50.0)

# A Crazyflie with a battery a little off centre: near the thesis' result, a body that can exist.
INERTIA_KG_M2 = 1e-6 * np.array([[16.4, -0.6, 0.5], [-0.6, 16.9, 1.1], [0.5, 1.1, 29.0]])
# Near what table 2.1 says of the thesis' axis, if its friction is read as Coulomb and viscous.
AXIS_COULOMB_NM = 3.2e-4
AXIS_VISCOUS_NMS_PER_RAD = 1.1e-6
SETUP_INERTIA_KG_M2 = 1.5e-7

_ENCODER = EncoderModel()
_SECONDS_OF_A_FALL = {20.0: 12.0, 30.0: 5.0, 40.0: 4.0, 50.0: 4.0}
_SPEED_SCATTER = 0.03  # of friction, from one drop to the next; the thesis' speeds scatter as much (table 2.1)


@dataclass(frozen=True, kw_only=True)
class SimulatedRun:
    """One recording with the label that an operator would give it: times (n,), counts (n,)."""

    kind: str
    body: Literal["crazyflie", "testbody", "fixture"] | None
    axis: str | None
    weight_g: float | None
    time_s: Array
    counts: npt.NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class DemoTruth:
    """What the simulation knows: inertia matrix (3, 3), the axis' friction, the test body's inertias by axis."""

    inertia_kg_m2: Array
    coulomb_nm: float
    viscous_nms_per_rad: float
    setup_inertia_kg_m2: float
    testbody_kg_m2: Mapping[str, float]


def simulate_demo(rig: Rig, *, seed: int) -> tuple[DemoTruth, list[SimulatedRun]]:
    """Draw a rig around its nominal numbers and record every experiment of chapter 2 on it."""
    rng = np.random.default_rng(seed)
    vehicle = draw_truth(rig, inertia_kg_m2=INERTIA_KG_M2, rng=rng)
    body = draw_testbody(rig, rng=rng, gravity_mps2=vehicle.gravity_mps2)
    runs = [
        _swing("crazyflie", axis, recording)
        for axis, recording in record_swings(vehicle, vehicle.mounts, rng=rng, encoder=_ENCODER).items()
    ]
    runs += [
        _swing("testbody", axis, recording)
        for axis, recording in record_swings(body, body.mounts, rng=rng, encoder=_ENCODER).items()
    ]
    runs += _drops(rig, vehicle.gravity_mps2, rng)
    truth = DemoTruth(
        inertia_kg_m2=INERTIA_KG_M2,
        coulomb_nm=AXIS_COULOMB_NM,
        viscous_nms_per_rad=AXIS_VISCOUS_NMS_PER_RAD,
        setup_inertia_kg_m2=SETUP_INERTIA_KG_M2,
        testbody_kg_m2={
            name: float(mount.direction @ body.inertia_kg_m2 @ mount.direction) for name, mount in body.mounts.items()
        },
    )
    return truth, runs


def _swing(body: Literal["crazyflie", "testbody"], axis: str, recording: Recording) -> SimulatedRun:
    return SimulatedRun(
        kind="swing", body=body, axis=axis, weight_g=None, time_s=recording.time_s, counts=recording.counts
    )


def _drops(rig: Rig, gravity_mps2: float, rng: np.random.Generator) -> list[SimulatedRun]:
    radius_m = MM * rig.friction.radius_mm if rig.friction else 0.002
    runs = []
    for weight_g in WEIGHTS_G:
        scatter = rng.normal(1.0, _SPEED_SCATTER)
        weight = DroppingWeight(
            setup_inertia_kg_m2=SETUP_INERTIA_KG_M2,
            weight_kg=weight_g / 1000,
            radius_m=radius_m,
            viscous_nms_per_rad=AXIS_VISCOUS_NMS_PER_RAD,
            coulomb_nm=AXIS_COULOMB_NM * scatter,
            gravity_mps2=gravity_mps2,
        )
        motion = drop([weight], duration_s=_SECONDS_OF_A_FALL[weight_g])
        recording = record(
            motion.time_s,
            motion.angle_rad[:, 0],
            speed_rad_per_s=motion.speed_rad_per_s[:, 0],
            encoder=_ENCODER,
            rng=rng,
        )
        runs.append(
            SimulatedRun(
                kind="drop",
                body=None,
                axis=None,
                weight_g=weight_g,
                time_s=recording.time_s,
                counts=recording.counts,
            )
        )
    return runs
