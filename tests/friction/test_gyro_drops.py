"""Weights that turn a vehicle on its axis, recorded by its gyro."""

import numpy as np
import numpy.typing as npt
import pytest

from cfid.friction.result import fit
from cfid.recordings.angle import AngleRecord
from cfid.recordings.gyro import Rates, integrated
from cfid.records.rig_file import thesis_rig
from cfid.records.run import Label
from cfid.sim.plants import DroppingWeight, drop
from tests.recordings.made import made_angle

Array = npt.NDArray[np.float64]

VISCOUS, COULOMB, INERTIA = 1.5e-5, 2e-4, 1.5e-5
WEIGHTS_G = (20.0, 30.0, 40.0, 30.0)
RIG = thesis_rig()


def test_friction_by_a_gyro_is_as_by_an_encoder_and_bears_the_scale_of_the_gyro() -> None:
    lever_mm = RIG.friction.lever_mm if RIG.friction else 0.0
    rng = np.random.default_rng(5)
    weights = [
        DroppingWeight(
            setup_inertia_kg_m2=INERTIA,
            weight_kg=grams / 1000,
            radius_m=lever_mm / 1000,
            viscous_nms_per_rad=VISCOUS,
            coulomb_nm=COULOMB * rng.normal(1, 0.01),
        )
        for grams in WEIGHTS_G
    ]
    motion = drop(weights, duration_s=12.0, wait_s=1.0, step_s=2e-3, store_every=1)
    drops = [record(grams, motion.time_s, motion.speed_rad_per_s[:, i], rng=rng) for i, grams in enumerate(WEIGHTS_G)]

    found = fit(drops, rig=RIG).quantities

    viscous, coulomb = found["friction.viscous_nms_per_rad"], found["friction.coulomb_nm"]
    assert viscous.std is not None
    assert viscous.value == pytest.approx(VISCOUS, rel=0.03)
    assert viscous.std >= 0.01 * viscous.value
    assert coulomb.value == pytest.approx(COULOMB, rel=0.1)


def record(grams: float, time_s: Array, speed: Array, *, rng: np.random.Generator) -> AngleRecord:
    rate = speed + np.radians(0.3 + 0.07 * rng.standard_normal(len(speed)))
    angle, bias = integrated(time_s, rate)
    return made_angle(
        time_s,
        angle,
        name=f"{grams:g}g",
        label=Label(weight_g=grams, weight_std_g=0.01),
        rates=Rates(rate - bias, np.array([1.0, 0.0, 0.0]), 0.0),
    )
