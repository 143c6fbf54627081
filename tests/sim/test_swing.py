"""Bodies drawn around a rig.toml scatter as it states, hang as geometry requires, and swing without a jump."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from cfid.records.rig_file import Rig, Site, thesis_rig
from cfid.sim.devices import SimulatedRig
from cfid.sim.swing import (
    PERIOD_S,
    RELEASES,
    Axis,
    Truth,
    draw_testbody,
    draw_truth,
    pendulum,
    swinging,
)
from cfid.wire import e201

INERTIA_KG_M2 = np.array([[16.6, 0.8, 0.7], [0.8, 16.7, 1.8], [0.7, 1.8, 29.3]]) * 1e-6
DRAWS = 600


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


# The axis that the encoder reads

MS = 1e-3


@pytest.fixture(scope="module")
def swung() -> Axis:
    rng = np.random.default_rng(4)
    vehicle = draw_truth(thesis_rig(), inertia_kg_m2=INERTIA_KG_M2, rng=rng)
    return swinging(pendulum(vehicle, "x"), rng=rng)


def _angles(axis: Axis, begin_s: float, end_s: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([axis.angle_at(time_s) for time_s in np.arange(begin_s, end_s, MS)])


def test_a_swing_goes_over_into_the_next_without_a_jump(swung: Axis) -> None:
    for turn in (1, RELEASES):
        steps = np.diff(_angles(swung, turn * PERIOD_S - 0.5, turn * PERIOD_S + 0.5))
        assert np.abs(steps).max() < 1e-3


@pytest.mark.parametrize("break_s", [7.0, 33.0])
def test_a_weight_falls_anew_when_a_recording_begins_to_look(break_s: float) -> None:
    rig = SimulatedRig(thesis_rig(), seconds=lambda: 100.0, seed=1, weight_g=30.0)

    def words(from_s: float, to_s: float) -> set[bytes]:
        times_s = np.arange(from_s, to_s, 0.01)
        return {reply for time_s in times_s for _, reply in rig.encoder.received(e201.POSITION, float(time_s))}

    words(100, 112)
    began_s = 112 + break_s
    words(began_s, began_s + 4.1)  # while the line is wound up
    assert len(words(began_s + 4.1, began_s + 4.4)) == 1
    assert len(words(began_s + 4.6, began_s + 5.5)) > 50
