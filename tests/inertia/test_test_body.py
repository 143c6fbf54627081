"""The test body: table 2.5 from the thesis' own inputs."""

import numpy as np
import pytest
from uncertainties import nominal_value, std_dev

from cfid.inertia.comparison import compare
from cfid.records.rig_file import Cuboid, TestBody, thesis_rig
from cfid.swing.body import (
    MountedSwing,
    Surroundings,
    axis_inertias,
    from_cuboids,
    numbers,
    swung_test_body,
)
from tests.inertia.test_inertia_matrix import distance_of

KEYS = "calculated_kg_m2", "measured_kg_m2", "error"
SITE = Surroundings(gravity_mps2=9.81, gravity_std_mps2=0.003)


def thesis_test_body() -> TestBody:
    body = thesis_rig().testbody
    assert body is not None
    return body


@pytest.mark.parametrize(
    ("given", "measured", "errors"),
    [
        # C.1.6: the 10th and the 13th peak (n_pks = 9 and 12 there), then the 8th for both.
        ((3.507552821629088e-5, 4.469524719338436e-5), (6.428337, 9.998638), (0.2833, 1.4037)),
        ((3.517772052094052e-5, 4.512302287526182e-5), (6.530529, 10.426414), (1.8775, 5.7421)),
    ],
    ids=["measured (1)", "measured (2)"],
)
def test_table_2_5_comes_out_to_the_last_printed_digit(
    given: tuple[float, float], measured: tuple[float, float], errors: tuple[float, float]
) -> None:
    body = thesis_test_body()
    swings = [
        MountedSwing(axis=axis, value=value, std=0.0, known=True) for axis, value in zip("xz", given, strict=True)
    ]
    found = compare(body, axis_inertias(swings, swung_test_body(body), SITE))

    calculated, seen, error = (numbers(np.array([getattr(c, key) for c in found])) for key in KEYS)
    assert np.round(1e6 * calculated, 6).tolist() == [6.410179, 9.860228]
    assert tuple(np.round(1e6 * seen, 6)) == measured
    assert tuple(np.round(100 * error, 4)) == errors


def test_its_distances_are_those_of_c_1_6() -> None:
    swings = [MountedSwing(axis=axis, value=150.0, std=0.0) for axis in "xz"]
    swung = axis_inertias(swings, swung_test_body(thesis_test_body()), SITE)
    x, z = numbers(swung.distance_m)

    assert x == pytest.approx(0.040344532815297, abs=1e-15)
    assert z == pytest.approx(0.044400430747127, abs=1e-15)


def test_a_box_cut_in_two_has_the_inertia_of_the_box() -> None:
    whole = from_cuboids([Cuboid(size_mm=(20, 30, 8), centre_mm=(1, 2, 3))], mass_kg=0.05)
    halves = [Cuboid(size_mm=(10, 30, 8), centre_mm=(x, 2, 3)) for x in (-4, 6)]
    cut = from_cuboids(halves, mass_kg=0.05)

    assert cut.inertia_kg_m2 == pytest.approx(whole.inertia_kg_m2, rel=1e-12)
    assert cut.centre_m == pytest.approx(whole.centre_m)
    assert whole.inertia_kg_m2[2, 2] == pytest.approx(0.05 / 12 * (0.02**2 + 0.03**2))


def test_the_calculated_inertia_is_as_uncertain_as_mass_and_lengths_make_it() -> None:
    body = TestBody(
        mass_kg=0.02,
        mass_std_kg=0.0002,
        length_std_mm=0.0,
        cuboids=(Cuboid(size_mm=(20, 20, 20), centre_mm=(0, 0, 0)),),
        mounts=thesis_test_body().mounts,
    )
    swings = [MountedSwing(axis="x", value=1e-4, std=0.0, known=True)]
    comparison = compare(body, axis_inertias(swings, swung_test_body(body), SITE))[0]

    assert std_dev(comparison.calculated_kg_m2) == pytest.approx(0.01 * nominal_value(comparison.calculated_kg_m2))
    assert np.isfinite(comparison.deviations)


def test_the_drawings_centre_is_known_to_half_of_what_its_lengths_are() -> None:
    body = thesis_test_body().model_copy(update={"length_std_mm": 0.2})

    assert swung_test_body(body).centre_std_m == pytest.approx([1e-4] * 3)


def test_a_mass_that_both_inertias_share_does_not_set_them_apart() -> None:
    body = thesis_test_body().model_copy(update={"mass_std_kg": 0.002, "length_std_mm": 0.0})
    exact = {
        name: mount.model_copy(update={"point_std_mm": (0, 0, 0), "direction_std_deg": 0.0})
        for name, mount in body.mounts.items()
    }
    body = body.model_copy(update={"mounts": exact})
    swung = swung_test_body(body)
    site = Surroundings(gravity_mps2=9.81, gravity_std_mps2=0.0)
    drawn = from_cuboids(body.cuboids, mass_kg=body.mass_kg)
    distance = distance_of(drawn.centre_m, exact["x"])
    frequency = 9.81 * distance / (drawn.inertia_kg_m2[0, 0] / body.mass_kg + distance**2)
    (found,) = compare(body, axis_inertias([MountedSwing(axis="x", value=float(frequency), std=0.0)], swung, site))

    # m g r / W - m r^2 and the drawing's inertia are both proportional to the mass.
    assert std_dev(found.measured_kg_m2) > 0.1 * nominal_value(found.measured_kg_m2)
    assert nominal_value(found.error) == pytest.approx(0.0, abs=1e-9)
    assert std_dev(found.error) == pytest.approx(0.0, abs=1e-9)
