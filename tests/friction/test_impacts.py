"""A weight that reaches the floor: the motion of the axis from there on is not part of the steady fall.

The plant is the solution of (I + m r^2) w' = m g r - M_c - c w until the impact, and of I w' = -M_c - c w after it.
"""

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import brentq

from cfid.friction.drops import Drop, measure_drop
from cfid.friction.estimation import fit_friction

Array = npt.NDArray[np.float64]

GRAVITY, RADIUS_M, FALL_M, RELEASE_S = 9.80665, 0.002, 0.4, 1.0
SETUP_KG_M2, DRY_NM, VISCOUS_NMS = 2e-5, 1.2e-4, 2e-5
TIME_S = np.arange(12_000) / 500


def fallen(grams: float) -> tuple[Array, float]:
    """Return the angle (n,) of a fall, and the time at which the weight meets the floor."""
    mass = grams / 1000
    tau, tends_to = (SETUP_KG_M2 + mass * RADIUS_M**2) / VISCOUS_NMS, (mass * GRAVITY * RADIUS_M - DRY_NM) / VISCOUS_NMS

    def falling(since: Array | float) -> Array:
        return np.asarray(tends_to * (since + tau * np.expm1(-np.asarray(since) / tau)))

    impact = float(brentq(lambda since: float(falling(since)) * RADIUS_M - FALL_M, 0.0, 100.0))
    fastest, alone = tends_to * -np.expm1(-impact / tau), SETUP_KG_M2 / VISCOUS_NMS
    dry = DRY_NM / VISCOUS_NMS
    rest = alone * np.log1p(fastest / dry)
    since = np.clip(TIME_S - RELEASE_S, 0.0, None)
    after = np.clip(since - impact, 0.0, rest)
    angle = falling(np.minimum(since, impact)) - dry * after - (fastest + dry) * alone * np.expm1(-after / alone)
    return np.asarray(angle), RELEASE_S + impact


def dropped(rng: np.random.Generator, grams: float) -> Drop:
    shown = fallen(grams)[0] + rng.normal(0, 4e-4, len(TIME_S))
    return measure_drop(TIME_S, shown, weight_kg=grams / 1000, radius_m=RADIUS_M, gravity_mps2=GRAVITY)


def test_friction_is_that_of_the_fall_where_weights_reach_the_floor() -> None:
    rng, grams = np.random.default_rng(2), (25.0, 25.0, 30.0, 30.0, 40.0, 40.0)
    drops = [dropped(rng, each) for each in grams]
    assert all(drop.settled for drop in drops)
    assert all(-0.15 < drop.to_s - fallen(each)[1] < 0 for drop, each in zip(drops, grams, strict=True))
    found = fit_friction(drops, radius_m=RADIUS_M, radius_std_m=0.0, gravity_mps2=GRAVITY)
    assert found.viscous_nms_per_rad == pytest.approx(VISCOUS_NMS, rel=1e-5)
    assert found.coulomb_nm == pytest.approx(DRY_NM, rel=1e-5)
    assert found.setup_inertia_kg_m2 == pytest.approx(SETUP_KG_M2, rel=1e-4)
