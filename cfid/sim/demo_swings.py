"""Simulates chapter 2 of the thesis: swings of vehicle and test body, and dropped weights."""

from collections.abc import Mapping
from typing import Literal

import numpy as np

from cfid.records.rig_file import Rig
from cfid.sim.demo_runs import PAUSE_S, SimulatedDevice, SimulatedRun
from cfid.sim.encoder import EncoderModel, Recording, record
from cfid.sim.plants import DroppingWeight, drop
from cfid.sim.rig import draw_testbody, draw_truth, record_swings
from cfid.sim.truth_file import AxisTruth, SimTruth
from cfid.units import MM

WEIGHTS_G = (20.0, 20.0, 30.0, 30.0, 40.0, 40.0, 50.0, 50.0)

_ENCODER = EncoderModel()
_SECONDS_OF_A_FALL = {20.0: 12.0, 30.0: 5.0, 40.0: 4.0, 50.0: 4.0}
_SPEED_SCATTER = 0.03  # of friction, from one drop to the next; the thesis' speeds scatter as much (table 2.1)


def record_chapter_2(
    rig: Rig, truth: SimTruth, rng: np.random.Generator
) -> tuple[list[SimulatedRun], Mapping[str, float]]:
    """Draw a rig around its nominal numbers and record on it; also return the test body's true inertias by axis."""
    vehicle = draw_truth(rig, inertia_kg_m2=truth.vehicle.inertia_kg_m2, rng=rng)
    body = draw_testbody(rig, rng=rng, gravity_mps2=vehicle.gravity_mps2)
    runs = [
        _swing("crazyflie", axis, recording)
        for axis, recording in record_swings(vehicle, vehicle.mounts, rng=rng, encoder=_ENCODER).items()
    ]
    runs += [
        _swing("testbody", axis, recording)
        for axis, recording in record_swings(body, body.mounts, rng=rng, encoder=_ENCODER).items()
    ]
    runs += _drops(rig, truth.axis, vehicle.gravity_mps2, rng)
    return runs, {
        name: float(mount.direction @ body.inertia_kg_m2 @ mount.direction) for name, mount in body.mounts.items()
    }


def _swing(body: Literal["crazyflie", "testbody"], axis: str, recording: Recording) -> SimulatedRun:
    return SimulatedRun(
        kind="swing",
        next_after_s=float(recording.time_s[-1]) + PAUSE_S,
        devices=_encoder(recording),
        body=body,
        axis=axis,
    )


def _encoder(recording: Recording) -> dict[str, SimulatedDevice]:
    return {"encoder": SimulatedDevice(columns=("t", "phi"), values=(recording.time_s, recording.counts))}


def _drops(rig: Rig, axis: AxisTruth, gravity_mps2: float, rng: np.random.Generator) -> list[SimulatedRun]:
    radius_m = MM * rig.friction.radius_mm if rig.friction else 0.002
    weights = [
        DroppingWeight(
            setup_inertia_kg_m2=axis.setup_inertia_kg_m2,
            weight_kg=weight_g / 1000,
            radius_m=radius_m,
            viscous_nms_per_rad=axis.viscous_nms_per_rad,
            coulomb_nm=axis.coulomb_nm * rng.normal(1.0, _SPEED_SCATTER),
            gravity_mps2=gravity_mps2,
        )
        for weight_g in WEIGHTS_G
    ]
    motion = drop(weights, duration_s=max(_SECONDS_OF_A_FALL.values()))  # at once: as quick as one of them
    runs = []
    for i, weight_g in enumerate(WEIGHTS_G):
        seen = motion.time_s <= _SECONDS_OF_A_FALL[weight_g]
        recording = record(
            motion.time_s[seen],
            motion.angle_rad[seen, i],
            speed_rad_per_s=motion.speed_rad_per_s[seen, i],
            encoder=_ENCODER,
            rng=rng,
        )
        last_s = float(recording.time_s[-1])
        runs.append(
            SimulatedRun(kind="drop", next_after_s=last_s + PAUSE_S, devices=_encoder(recording), weight_g=weight_g)
        )
    return runs
