"""Bodies drawn around a rig.toml: they scatter as it states, and hang as geometry requires."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import find_peaks

from cfid.errors import ConfigError
from cfid.records.rig_file import Rig, Site, thesis_rig
from tests.offline.encoder import EncoderModel
from cfid.sim.plants import HandRelease, swing
from cfid.sim.swing import TrueFriction, Truth, draw_testbody, draw_truth, pendulum
from tests.offline.encoder import record_swings
from cfid.wire.rls import decode_words

INERTIA_KG_M2 = np.array([[16.6, 0.8, 0.7], [0.8, 16.7, 1.8], [0.7, 1.8, 29.3]]) * 1e-6
DRAWS = 2000


@pytest.fixture(scope="module")
def rig() -> Rig:
    return thesis_rig()


@pytest.fixture(scope="module")
def truths(rig: Rig) -> list[Truth]:
    rng = np.random.default_rng(11)
    return [draw_truth(rig, inertia_kg_m2=INERTIA_KG_M2, rng=rng) for _ in range(DRAWS)]


def _exact(rig: Rig) -> Rig:
    """Return the same rig measured without error."""
    exact = {"point_std_mm": (0, 0, 0), "direction_std_deg": 0}
    assert rig.testbody is not None
    testbody = rig.testbody.model_copy(
        update={
            "mass_std_kg": 0,
            "length_std_mm": 0,
            "mounts": {name: mount.model_copy(update=exact) for name, mount in rig.testbody.mounts.items()},
        }
    )
    return rig.model_copy(
        update={
            "vehicle": rig.vehicle.model_copy(update={"mass_std_kg": 0, "centre_of_mass_std_mm": (0, 0, 0)}),
            "site": Site(),
            "mounts": {name: mount.model_copy(update=exact) for name, mount in rig.mounts.items()},
            "testbody": testbody,
        }
    )


@pytest.mark.parametrize(
    ("measured", "nominal", "spread"),
    [
        (lambda truth: truth.mass_kg, 0.028, 3e-5),
        (lambda truth: truth.gravity_mps2, 9.81, 3e-3),
        (lambda truth: truth.centre_of_mass_m[2], 17.425e-3, 1e-4),
        (lambda truth: truth.mounts["z"].point_m @ [1, 0, 0], 22.734e-3, 1e-4),
    ],
    ids=["mass", "gravity", "centre of mass", "point of a mount"],
)
def test_truths_spread_about_the_rig_as_it_says(
    truths: list[Truth], measured: Callable[[Truth], float], nominal: float, spread: float
) -> None:
    values = np.array([measured(truth) for truth in truths])
    assert values.mean() == pytest.approx(nominal, abs=3 * spread / math.sqrt(DRAWS))
    assert values.std() == pytest.approx(spread, rel=0.07)


def test_a_points_spread_lies_along_the_axes_it_was_measured_along(rig: Rig) -> None:
    along_the_arm = rig.mounts["x"].model_copy(update={"point_std_mm": (0, 0.5, 0)})
    arm_rig = rig.model_copy(update={"mounts": {"x": along_the_arm}})
    rng = np.random.default_rng(3)
    points_m = np.array(
        [draw_truth(arm_rig, inertia_kg_m2=INERTIA_KG_M2, rng=rng).mounts["x"].point_m for _ in range(500)]
    )
    offsets_m = points_m - points_m.mean(axis=0)
    assert (offsets_m @ [1, 1, 0]).std() / math.sqrt(2) == pytest.approx(5e-4, rel=0.1)
    assert (offsets_m @ [1, -1, 0]).std() == pytest.approx(0, abs=1e-15)
    assert offsets_m[:, 2].std() == pytest.approx(0, abs=1e-15)


def test_directions_tilt_equally_to_both_sides_and_stay_of_unit_length(truths: list[Truth]) -> None:
    directions = np.array([truth.mounts["xz"].direction for truth in truths])
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1, abs=1e-12)
    for across in ([0, 1, 0], [math.sqrt(0.5), 0, -math.sqrt(0.5)]):
        assert np.degrees(directions @ across).std() == pytest.approx(0.3, rel=0.07)


@pytest.mark.parametrize(
    ("mount", "distance_m", "about_centre_kg_m2"),
    [
        # distances by hand, in the plane across the axis: from the centre of mass to the axis' point
        ("x", math.hypot(32.25e-3 / math.sqrt(2), 1.525e-3), 16.6e-6),
        ("z", math.hypot(5.6e-3, 37.75e-3), 29.3e-6),
        ("yz", None, (16.7 + 29.3) / 2 * 1e-6 + 1.8e-6),
        ("xz", None, (16.6 + 29.3) / 2 * 1e-6 + 0.7e-6),
    ],
)
def test_a_pendulum_has_the_inertia_and_moment_of_the_true_axis(
    rig: Rig, mount: str, distance_m: float | None, about_centre_kg_m2: float
) -> None:
    truth = draw_truth(_exact(rig), inertia_kg_m2=INERTIA_KG_M2, rng=np.random.default_rng(0))
    hung = pendulum(truth, mount)
    implied_m = hung.gravity_moment_nm / (0.028 * 9.81)
    if distance_m is not None:
        assert implied_m == pytest.approx(distance_m, rel=1e-12)
    assert hung.axis_inertia_kg_m2 - 0.028 * implied_m**2 == pytest.approx(about_centre_kg_m2, rel=1e-9)


def test_the_distance_is_the_shortest_from_the_centre_of_mass_to_the_axis(truths: list[Truth]) -> None:
    along_m = np.linspace(-0.1, 0.1, 200_001)[:, np.newaxis]
    for name, mount in truths[0].mounts.items():
        points_m = mount.point_m + along_m * mount.direction
        shortest_m = np.linalg.norm(points_m - truths[0].centre_of_mass_m, axis=1).min()
        moment_nm = truths[0].mass_kg * truths[0].gravity_mps2 * shortest_m
        assert pendulum(truths[0], name).gravity_moment_nm == pytest.approx(moment_nm, rel=1e-6)


def test_the_test_body_has_the_inertias_of_table_2_5(rig: Rig) -> None:
    truth = draw_testbody(_exact(rig), rng=np.random.default_rng(0))
    assert truth.inertia_kg_m2[0, 0] == pytest.approx(6.410179e-6, rel=1e-6)
    assert truth.inertia_kg_m2[2, 2] == pytest.approx(9.860228e-6, rel=1e-6)
    # the distances that appendix C.1.6 prints
    assert pendulum(truth, "x").gravity_moment_nm == pytest.approx(0.0176 * 9.81 * 0.040344532815297, rel=1e-9)
    assert pendulum(truth, "z").gravity_moment_nm == pytest.approx(0.0176 * 9.81 * 0.044400430747127, rel=1e-9)


def test_a_rig_without_a_test_body_is_told_what_is_missing(rig: Rig) -> None:
    with pytest.raises(ConfigError, match="testbody"):
        draw_testbody(rig.model_copy(update={"testbody": None}), rng=np.random.default_rng(0))


def test_a_crazyflie_on_the_x_mount_dies_away_as_the_thesis_did(rig: Rig) -> None:
    truth = draw_truth(_exact(rig), inertia_kg_m2=INERTIA_KG_M2, rng=np.random.default_rng(0))
    typical = TrueFriction()
    hung = replace(
        pendulum(truth, "x"),
        viscous_nms_per_rad=typical.viscous_nms_per_rad,
        coulomb_nm=typical.coulomb_nm,
        quadratic_nms2_per_rad2=typical.quadratic_nms2_per_rad2,
    )
    release = HandRelease(angle_rad=math.radians(50))
    motion = swing([hung], [release], duration_s=12.0, step_s=1e-3)
    angle_deg = np.degrees(motion.angle_rad[motion.time_s > release.free_s - 0.1, 0])
    peaks_deg = angle_deg[find_peaks(angle_deg, distance=100)[0]]
    assert 7 <= np.sum(peaks_deg > 10) <= 10
    assert 11 <= np.sum(peaks_deg > 1) <= 16


def test_recorded_swings_begin_and_end_at_rest_and_swing_between(rig: Rig) -> None:
    truth = draw_truth(rig, inertia_kg_m2=INERTIA_KG_M2, rng=np.random.default_rng(6))
    recordings = record_swings(
        truth, ("x", "y", "xz"), rng=np.random.default_rng(7), encoder=EncoderModel(), angle_deg=(40, 60)
    )
    assert list(recordings) == ["x", "y", "xz"]
    starts = set()
    for t_s, counts in recordings.values():
        decoded = decode_words(counts)
        angle_deg = np.unwrap(decoded.position, period=8192) * 360 / 8192
        angle_deg = angle_deg - angle_deg[0]
        starts.add(int(decoded.position[0]))
        assert decoded.valid.all()
        assert np.ptp(angle_deg[t_s < 0.35]) == 0
        assert 38 < np.abs(angle_deg).max() < 62
        assert np.ptp(angle_deg[-500:]) == 0
        assert abs(angle_deg[-1]) < 1.5
    assert len(starts) == 3  # every swing starts at another angle of the encoder


def test_the_same_generator_records_the_same_swings(rig: Rig) -> None:
    truth = draw_truth(rig, inertia_kg_m2=INERTIA_KG_M2, rng=np.random.default_rng(6))
    first, again = (
        record_swings(truth, ("x",), rng=np.random.default_rng(9), encoder=EncoderModel(word=4194304), duration_s=3.0)
        for _ in range(2)
    )
    assert np.array_equal(first["x"].time_s, again["x"].time_s)
    assert np.array_equal(first["x"].counts, again["x"].counts)
