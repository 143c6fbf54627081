"""From axis inertias to the matrix: the thesis' own numbers, and properties that must hold for any rig."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from uncertainties import nominal_value, std_dev

from cfid.errors import FitError
from cfid.inertia.comparison import compare
from cfid.inertia.matrix import fit_inertia, is_consistent, nearest_consistent
from cfid.records.rig_file import Cuboid, Fixture, Mount, TestBody, thesis_rig
from cfid.swing.body import (
    MountedSwing,
    Surroundings,
    SwungBody,
    axis_inertias,
    from_cuboids,
    numbers,
    swung_test_body,
)
from cfid.units import MM

Array = npt.NDArray[np.float64]

# Appendix C.1.4: eight peaks for all axes, and table 2.3's larger numbers of peaks.
EIGHT_PEAKS = {
    "x": 3.144988206680423e-05,
    "y": 3.151127080468852e-05,
    "z": 7.058874150001670e-05,
    "xy": 5.003777167580184e-05,
    "xz": 4.640539662252733e-05,
    "yz": 4.780234696836194e-05,
}
MORE_PEAKS = {
    "x": 3.119770273213515e-05,
    "y": 3.128159434626518e-05,
    "z": 7.004148241971259e-05,
    "xy": 4.940332984711082e-05,
    "xz": 4.600706365028182e-05,
    "yz": 4.713092929680177e-05,
}
TRUTH = 1e-6 * np.array([[16.4, -0.6, 0.5], [-0.6, 16.9, 1.1], [0.5, 1.1, 29.0]])
SITE = Surroundings(gravity_mps2=9.81, gravity_std_mps2=0.003)


def thesis_body() -> SwungBody:
    vehicle = thesis_rig().vehicle
    return SwungBody(
        mass_kg=vehicle.mass_kg,
        mass_std_kg=vehicle.mass_std_kg,
        centre_m=MM * np.array(vehicle.centre_of_mass_mm),
        centre_std_m=MM * np.array(vehicle.centre_of_mass_std_mm),
        mounts=thesis_rig().mounts,
    )


def distance_of(centre_m: Array, mount: Mount) -> float:
    """Return the distance of a centre of mass from a mount's axis, as the component across the axis."""
    from_axis = centre_m - np.array(mount.point_m)
    unit = np.array(mount.direction) / np.linalg.norm(mount.direction)
    return float(np.linalg.norm(from_axis - (from_axis @ unit) * unit))


def known(values: Mapping[str, float], std: float = 0.0) -> list[MountedSwing]:
    return [MountedSwing(axis=axis, value=value, std=std, known=True) for axis, value in values.items()]


def body_with(mounts: dict[str, Mount], **spread: float) -> SwungBody:
    return SwungBody(
        mass_kg=0.028,
        mass_std_kg=spread.get("mass_std_kg", 0.0),
        centre_m=np.zeros(3),
        centre_std_m=np.zeros(3),
        mounts=mounts,
    )


def swings_of(body: SwungBody, inertia: Array = TRUTH, *, std: float = 0.0) -> list[MountedSwing]:
    """Return the exact natural frequencies squared of a body on all its mounts, W = m g r / (u' I u + m r^2)."""
    swings = []
    for axis, mount in body.mounts.items():
        unit = np.array(mount.direction) / np.linalg.norm(mount.direction)
        offset = body.centre_m - np.array(mount.point_m)
        distance = np.sqrt(offset @ offset - (offset @ unit) ** 2)
        total = unit @ inertia @ unit + body.mass_kg * distance**2
        frequency = body.mass_kg * 9.81 * distance / total
        swings.append(MountedSwing(axis=axis, value=float(frequency), std=std * float(frequency)))
    return swings


def mount_along(direction: Array | tuple[float, float, float], **spread: float) -> Mount:
    unit = np.array(direction) / np.linalg.norm(direction)
    across = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    x, y, z = 25 * across / np.linalg.norm(across)
    return Mount(
        point_mm=(x, y, z),
        direction=(unit[0], unit[1], unit[2]),
        point_std_mm=(spread.get("point_std_mm", 0.0),) * 3,
        direction_std_deg=spread.get("direction_std_deg", 0.0),
    )


AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "xy": (1, 1, 0), "xz": (1, 0, 1), "yz": (0, 1, 1)}


@pytest.mark.parametrize(
    ("given", "printed"),
    [
        (
            EIGHT_PEAKS,
            [[16.823890, 1.224320, 0.716891], [1.224320, 16.885278, 2.083147], [0.716891, 2.083147, 29.808912]],
        ),
        (
            MORE_PEAKS,
            [[16.571710, 0.830806, 0.718277], [0.830806, 16.655602, 1.800197], [0.718277, 1.800197, 29.261652]],
        ),
    ],
    ids=["eq. 2.17", "eq. 2.18"],
)
def test_the_thesis_matrices_come_out_to_the_last_printed_digit(
    given: dict[str, float], printed: list[list[float]]
) -> None:
    fit = fit_inertia(axis_inertias(known(given), thesis_body(), SITE))

    assert np.round(1e6 * fit.matrix_kg_m2, 6).tolist() == printed


@pytest.mark.parametrize(
    ("mount", "millimetres"),
    [("x", 22.855), ("y", 22.855), ("z", 38.163), ("xy", 33.784), ("xz", 28.267), ("yz", 28.267)],
)
def test_the_distances_of_c_1_7_follow_from_the_numbers_in_the_rig_file(mount: str, millimetres: float) -> None:
    given = axis_inertias([MountedSwing(axis=mount, value=150.0, std=0.0)], thesis_body(), SITE)
    (distance,) = numbers(given.distance_m)

    assert round(1e3 * distance, 3) == millimetres


def test_six_exact_swings_give_the_matrix_exactly() -> None:
    body = body_with({name: mount_along(direction) for name, direction in AXES.items()})
    fit = fit_inertia(axis_inertias(swings_of(body), body, Surroundings(gravity_mps2=9.81, gravity_std_mps2=0.0)))

    assert fit.matrix_kg_m2 == pytest.approx(TRUTH, rel=1e-12)
    assert fit.residual is None
    assert not fit.std_kg_m2.any()


def test_five_axes_and_six_in_a_plane_are_refused() -> None:
    flat = {f"a{i}": mount_along((np.cos(i), np.sin(i), 0)) for i in range(6)}
    for mounts in ({name: mount_along(AXES[name]) for name in list(AXES)[:5]}, flat):
        body = body_with(mounts)
        with pytest.raises(FitError, match="six are needed"):
            fit_inertia(axis_inertias(swings_of(body), body, SITE))


def test_a_swing_that_contradicts_the_others_is_rejected_and_widens_the_uncertainties() -> None:
    names = {**AXES, "xy2": (1, -1, 0), "xz2": (1, 0, -1), "yz2": (0, 1, -1)}
    body = body_with({name: mount_along(direction) for name, direction in names.items()})
    swings = swings_of(body, std=1e-4)
    honest = fit_inertia(axis_inertias(swings, body, SITE))
    spoilt = [*swings[:-1], MountedSwing(axis="yz2", value=1.01 * swings[-1].value, std=swings[-1].std)]
    fit = fit_inertia(axis_inertias(spoilt, body, SITE))

    assert honest.findings == ()
    assert honest.chi_squared < 1e-6
    assert fit.degrees_of_freedom == 3
    assert [finding.code for finding in fit.findings] == ["inertia-swings-contradict"]
    assert np.all(fit.std_kg_m2 > 3 * honest.std_kg_m2)
    # Birge's ratio: scatter of the swings beyond their uncertainties widens the uncertainties of the entries.
    assert fit.std_kg_m2 == pytest.approx(np.sqrt(fit.chi_squared / 3) * honest.std_kg_m2, rel=0.05)
    assert np.sqrt(np.diag(fit.covariance)) == pytest.approx(fit.std_kg_m2[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])


def test_repeated_swings_share_their_mounts_error() -> None:
    mounts = {name: mount_along(direction, point_std_mm=0.1) for name, direction in AXES.items()}
    body = body_with(mounts)
    once = swings_of(body, std=1e-5)
    first, four = (fit_inertia(axis_inertias(once * n, body, SITE)) for n in (1, 4))

    # The noise of the swings averages out, but the error of the mount's distance does not.
    assert four.std_kg_m2 == pytest.approx(first.std_kg_m2, rel=0.02)
    assert np.all(four.budget["swing fits"] < 0.55 * first.budget["swing fits"])


def test_swings_timed_by_one_clock_share_its_error() -> None:
    body = body_with({name: mount_along(direction, point_std_mm=0.0) for name, direction in AXES.items()})
    timed = [replace(swing, clock_std=1e-3) for swing in swings_of(body, std=0.0)]
    fit = fit_inertia(axis_inertias(timed, body, SITE))
    expected = fit_inertia(axis_inertias([replace(s, value=1.001 * s.value, clock_std=0.0) for s in timed], body, SITE))

    assert fit.budget["clock of the encoder"] == pytest.approx(
        np.abs(expected.matrix_kg_m2 - fit.matrix_kg_m2), rel=2e-3
    )


def test_the_empty_fixture_is_taken_off_at_the_common_axis() -> None:
    body = body_with({name: mount_along(direction) for name, direction in AXES.items()})
    fixture = Fixture(mass_kg=0.0012, distance_mm=3.0)
    own_inertia, own_moment = 4e-8, 0.0012 * 9.81 * 0.003
    loaded = []
    for swing, mount in zip(swings_of(body), body.mounts.values(), strict=True):
        moment = 0.028 * 9.81 * distance_of(body.centre_m, mount)
        total = moment / swing.value + own_inertia
        loaded.append(MountedSwing(axis=swing.axis, value=(moment + own_moment) / total, std=0.0))
    empty = MountedSwing(axis="fixture", value=own_moment / own_inertia, std=0.0)
    site = Surroundings(gravity_mps2=9.81, gravity_std_mps2=0.0, fixture=fixture, fixture_swing=empty)

    assert fit_inertia(axis_inertias(loaded, body, site)).matrix_kg_m2 == pytest.approx(TRUTH, rel=1e-9)
    assert fit_inertia(axis_inertias(loaded, body, SITE)).matrix_kg_m2 != pytest.approx(TRUTH, rel=1e-3)


def test_an_impossible_matrix_is_replaced_by_the_nearest_possible_one_with_a_warning() -> None:
    sheet = 1e-6 * np.array([[10.0, 0, 0], [0, 10.0, 0], [0, 0, 21.0]])  # zz exceeds xx + yy, as in no body
    body = body_with({name: mount_along(direction, direction_std_deg=0.5) for name, direction in AXES.items()})
    fit = fit_inertia(axis_inertias(swings_of(body, sheet, std=1e-3), body, SITE))

    assert not is_consistent(sheet)
    assert fit.raw_matrix_kg_m2 == pytest.approx(sheet, rel=1e-9)
    assert is_consistent(fit.matrix_kg_m2)
    assert "no possible body" in fit.findings[0].text
    assert np.abs(fit.matrix_kg_m2 - sheet).max() < 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_the_consistent_refit_never_leaves_the_possible_bodies(seed: int) -> None:
    rng = np.random.default_rng(seed)
    entries = rng.normal(1.0, 1.0, 6) * 1e-5
    xx, yy, zz, xy, xz, yz = nearest_consistent(entries, np.diag(np.full(6, 1e-12)))

    assert is_consistent(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


KEYS = "calculated_kg_m2", "measured_kg_m2", "error"


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


def test_the_drawings_centre_is_known_to_half_of_what_its_lengths_are() -> None:
    body = thesis_test_body().model_copy(update={"length_std_mm": 0.2})

    assert swung_test_body(body).centre_std_m == pytest.approx([1e-4] * 3)
