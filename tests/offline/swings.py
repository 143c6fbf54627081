"""Simulates chapter 2 of the thesis: swings of vehicle and test body, and dropped weights."""

from collections.abc import Iterable, Mapping
from typing import Literal

import numpy as np

from cfid.records.rig_file import Rig
from cfid.sim.plants import DroppingWeight, drop
from cfid.sim.swing import Truth, draw_testbody
from cfid.sim.truth import SimTruth, draw_vehicle
from cfid.units import MM
from tests.offline.encoder import EncoderModel, EncoderRecording, record, record_swings
from tests.offline.runs import PAUSE_S, SimulatedDevice, SimulatedRun

WEIGHTS_G = (20.0, 20.0, 30.0, 30.0, 40.0, 40.0, 50.0, 50.0)

_SECONDS_OF_A_FALL = {20.0: 12.0, 30.0: 5.0, 40.0: 4.0, 50.0: 4.0}
_SPEED_SCATTER = 0.03  # of friction, from one drop to the next; the thesis' speeds scatter as much (table 2.1)


def record_chapter_2(
    rig: Rig, truth: SimTruth, rng: np.random.Generator
) -> tuple[list[SimulatedRun], Mapping[str, float]]:
    """Draw a rig around its nominal numbers and record on it; also return the test body's true inertias by axis."""
    vehicle = draw_vehicle(rig, truth, rng=rng)
    body = draw_testbody(rig, rng=rng, gravity_mps2=vehicle.gravity_mps2, friction=truth.swing.friction)
    runs = swing_runs("crazyflie", vehicle, vehicle.mounts, truth, rng)
    runs += swing_runs("testbody", body, body.mounts, truth, rng)
    runs += drop_runs(rig, truth, vehicle.gravity_mps2, rng)
    return runs, {
        name: float(mount.direction @ body.inertia_kg_m2 @ mount.direction) for name, mount in body.mounts.items()
    }


def swing_runs(
    body: Literal["crazyflie", "testbody"],
    drawn: Truth,
    mounts: Iterable[str],
    truth: SimTruth,
    rng: np.random.Generator,
) -> list[SimulatedRun]:
    """Swing a drawn body once on each of some mounts."""
    encoder = EncoderModel(eccentricity_rad=truth.swing.eccentricity_rad)
    return [
        SimulatedRun(
            kind="swing",
            next_after_s=float(recording.time_s[-1]) + PAUSE_S,
            devices=_encoder(recording),
            body=body,
            axis=axis,
        )
        for axis, recording in record_swings(drawn, mounts, rng=rng, encoder=encoder).items()
    ]


def _encoder(recording: EncoderRecording) -> dict[str, SimulatedDevice]:
    return {"encoder": SimulatedDevice(columns=("t", "phi"), values=(recording.time_s, recording.counts))}


def drop_runs(rig: Rig, truth: SimTruth, gravity_mps2: float, rng: np.random.Generator) -> list[SimulatedRun]:
    """Drop each of WEIGHTS_G once."""
    radius_m = MM * rig.friction.lever_mm if rig.friction else 0.002
    axis, encoder = truth.axis, EncoderModel(eccentricity_rad=truth.swing.eccentricity_rad)
    weights = [
        DroppingWeight(
            setup_inertia_kg_m2=axis.setup_inertia_kg_m2,
            weight_kg=weight_g / 1000,
            radius_m=radius_m,
            viscous_nms_per_rad=axis.viscous_nms_per_rad,
            coulomb_nm=axis.coulomb_nm * rng.normal(1.0, _SPEED_SCATTER),
            gravity_mps2=gravity_mps2,
            line_diameter_m=MM * axis.line_diameter_mm,
            turns_per_layer=axis.turns_per_layer,
        )
        for weight_g in WEIGHTS_G
    ]
    motion = drop(weights, duration_s=max(_SECONDS_OF_A_FALL.values()))  # all at once, which is as quick as one
    runs = []
    for i, weight_g in enumerate(WEIGHTS_G):
        seen = motion.time_s <= _SECONDS_OF_A_FALL[weight_g]
        recording = record(
            motion.time_s[seen],
            motion.angle_rad[seen, i],
            speed_rad_per_s=motion.speed_rad_per_s[seen, i],
            encoder=encoder,
            rng=rng,
        )
        last_s = float(recording.time_s[-1])
        runs.append(
            SimulatedRun(kind="drop", next_after_s=last_s + PAUSE_S, devices=_encoder(recording), weight_g=weight_g)
        )
    return runs
