"""Coverage of the inertia matrix's intervals, from whole simulated campaigns whose every value is drawn anew."""

import math

import numpy as np
import numpy.typing as npt
import pytest

from cfid.inertia.matrix import InertiaFit, fit_inertia
from cfid.records.rig_file import Rig, load_rig, new_rig_text
from cfid.sim.plants import swing
from cfid.sim.swing import TrueFriction, Truth, draw_release, draw_truth, pendulum
from cfid.swing.body import MountedSwing, Surroundings, SwungBody, axis_inertias
from cfid.swing.estimation import fit_swing
from cfid.swing.window import find_swing
from cfid.units import MM
from cfid.wire.rls import decode_words
from tests.offline.encoder import EncoderModel, record

Array = npt.NDArray[np.float64]

AXES = ("x", "y", "z", "xy", "xz", "yz")
INERTIA = 1e-6 * np.array([[16.4, -0.6, 0.5], [-0.6, 16.9, 1.1], [0.5, 1.1, 29.0]])
CHUNK = 20  # campaigns that are integrated at once


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    path.write_text(new_rig_text())
    return load_rig(path)


def simulate(rig: Rig, campaigns: int, rng: np.random.Generator) -> list[dict[str, MountedSwing]]:
    """Return the six measured swings of each campaign; each draws its own mass, gravity, geometry and friction."""
    truths = [_truth(rig, rng) for _ in range(campaigns)]
    pendulums = [pendulum(truth, axis) for truth in truths for axis in AXES]
    releases = [draw_release(rng, angle_deg=(20, 70)) for _ in pendulums]
    motion = swing(pendulums, releases, duration_s=14.0, step_s=1e-3, store_every=2)
    measured: list[dict[str, MountedSwing]] = [{} for _ in range(campaigns)]
    for i in range(len(pendulums)):
        encoder = EncoderModel(offset_rad=rng.uniform(0, 2 * math.pi), stamp_error_s=rng.uniform(0.5e-4, 2e-4))
        recorded = record(
            motion.time_s,
            motion.angle_rad[:, i],
            speed_rad_per_s=motion.speed_rad_per_s[:, i],
            encoder=encoder,
            rng=rng,
        )
        angle = np.unwrap(2 * np.pi / 8192 * decode_words(recorded.counts).position)
        fit = fit_swing(find_swing(recorded.time_s, angle))
        axis = AXES[i % len(AXES)]
        measured[i // len(AXES)][axis] = MountedSwing(
            axis=axis,
            value=fit.coefficients.natural_frequency_squared_s2,
            std=fit.std.natural_frequency_squared_s2,
        )
    return measured


def _truth(rig: Rig, rng: np.random.Generator) -> Truth:
    viscous, coulomb, quadratic = rng.uniform(0.3, 1.7, 3)
    friction = TrueFriction(
        viscous_nms_per_rad=1.5e-5 * viscous, coulomb_nm=4e-5 * coulomb, quadratic_nms2_per_rad2=2e-8 * quadratic
    )
    return draw_truth(rig, inertia_kg_m2=INERTIA, rng=rng, friction=friction)


def identify(rig: Rig, measured: dict[str, MountedSwing]) -> InertiaFit:
    vehicle = rig.vehicle
    body = SwungBody(
        mass_kg=vehicle.mass_kg,
        mass_std_kg=vehicle.mass_std_kg,
        centre_m=MM * np.array(vehicle.centre_of_mass_mm),
        centre_std_m=MM * np.array(vehicle.centre_of_mass_std_mm),
        mounts=rig.mounts,
    )
    site = Surroundings(gravity_mps2=rig.site.gravity_mps2, gravity_std_mps2=rig.site.gravity_std_mps2)
    return fit_inertia(axis_inertias(list(measured.values()), body, site))


def z_scores(rig: Rig, campaigns: int, seed: int) -> Array:
    """Return the error of each entry of the matrix in stated standard uncertainties, shape (campaigns, 6)."""
    rng = np.random.default_rng(seed)
    upper = np.triu_indices(3)
    scores: list[Array] = []
    for _ in range(campaigns // CHUNK):
        for measured in simulate(rig, CHUNK, rng):
            fit = identify(rig, measured)
            scores.append(((fit.matrix_kg_m2 - INERTIA) / fit.std_kg_m2)[upper])
    return np.array(scores)


@pytest.mark.slow
def test_the_matrix_lies_within_its_95_percent_intervals_93_to_97_times_in_100_over_1000_campaigns(rig: Rig) -> None:
    covered = np.abs(z_scores(rig, 1000, seed=20261121)) < 1.96

    print("coverage of xx, xy, xz, yy, yz, zz:", covered.mean(axis=0), "all:", covered.mean())
    assert 0.93 <= covered.mean() <= 0.97
    assert np.all((covered.mean(axis=0) >= 0.93) & (covered.mean(axis=0) <= 0.97))
