"""Results of `cfid.inertia.fit` and `fit_testbody` in a notebook."""

import numpy as np
import pytest

import cfid.inertia
from cfid.errors import ConfigError
from cfid.records.result import Result
from cfid.records.rig_file import Mount, ThreadPair, thesis_rig
from cfid.swing.body import KnownInertia

RIG = thesis_rig()
TABLE_2_3 = {"x": 3.119770e-5, "y": 3.128159e-5, "z": 7.004148e-5, "xy": 4.940333e-5, "xz": 4.600706e-5}


def codes(result: Result, severity: str) -> list[str]:
    return [finding.code for finding in result.findings if finding.severity == severity]


def known(std_kg_m2: float = 1e-8, **more: float) -> list[KnownInertia]:
    return [KnownInertia(mount, value, std_kg_m2) for mount, value in ({**TABLE_2_3, "yz": 4.713093e-5} | more).items()]


@pytest.mark.parametrize(("std_kg_m2", "noted"), [(1e-8, []), (0.0, ["x", "xy", "xz", "y", "yz", "z"])])
def test_axis_inertias_that_are_taken_as_exact_are_noted(std_kg_m2: float, noted: list[str]) -> None:
    findings = cfid.inertia.fit(known(std_kg_m2), rig=RIG).findings
    exact = [one for one in findings if "the axis inertia is taken as exact" in one.text]
    assert sorted(mount for one in exact for mount in one.where) == noted


def test_two_swings_of_a_mount_are_weighted_and_the_smaller_uncertainty_stands() -> None:
    swings = [*known(), KnownInertia("x", 3.121e-5, 2e-8)]
    result = cfid.inertia.fit(swings, rig=RIG)
    mean = result.quantities["inertia.axis_kg_m2.x"]

    assert mean.value == pytest.approx((4 * 3.119770e-5 + 3.121e-5) / 5, rel=1e-12)
    assert mean.std == pytest.approx(1e-8)


def test_axes_that_determine_no_matrix_give_their_axis_inertias() -> None:
    result = cfid.inertia.fit(known()[:5], rig=RIG)

    assert not result.accepted
    assert codes(result, "rejection") == ["inertia-axes-dependent"]
    assert result.rejected.keys() == {"inertia.matrix_kg_m2"}
    assert set(result.quantities) == {
        f"inertia.{kind}_kg_m2.{axis}" for kind in ("axis", "centre") for axis in TABLE_2_3
    }
    assert result.figures() == {}


def test_a_mount_on_threads_has_no_curve_over_the_distance_and_spoils_no_other() -> None:
    pair = ThreadPair(above_mm=30.0, below_mm=30.0, length_mm=200.0)
    some, all_six = (
        RIG.model_copy(
            update={
                "mounts": RIG.mounts | {n: Mount(direction=RIG.mounts[n].direction, threads=pair) for n in on_threads}
            }
        )
        for on_threads in (["yz"], list(RIG.mounts))
    )
    drawn = [cfid.inertia.fit(known(), rig=rig).figures() for rig in (some, all_six)]
    some_panel, panel = (figures["inertia"].axes[1] for figures in drawn)
    curves = [line for line in some_panel.lines if len(np.asarray(line.get_xdata())) == 200]

    assert len(curves) == 5
    assert all(np.isfinite(np.asarray(curve.get_ydata())).all() for curve in curves)
    assert not panel.axison
    assert ["inertia_mounts" in figures for figures in drawn] == [True, False]


def test_contradicting_swings_lose_everything_and_no_number_is_in_the_lines() -> None:
    result = cfid.inertia.fit([*known(), KnownInertia("x", 3.3e-5, 1e-9), KnownInertia("x", 2.9e-5, 1e-9)], rig=RIG)

    assert codes(result, "rejection") == ["inertia-swings-contradict"]
    assert result.without_rejected().quantities == {}
    assert not any("budget" in line for line in result.without_rejected().summary())


def test_without_a_rig_the_fits_ask_for_one() -> None:
    for fit in (cfid.inertia.fit, cfid.inertia.fit_testbody):
        with pytest.raises(ConfigError, match="`geometry` thesis"):
            fit(known())


def test_a_fixture_is_one_and_peaks_belong_to_mounts_that_swing() -> None:
    with pytest.raises(ConfigError, match="more than one swing of the empty fixture"):
        cfid.inertia.fit([*known(), KnownInertia("fixture", 1e-8), KnownInertia("fixture", 1e-8)], rig=RIG)
    with pytest.raises(ConfigError, match="no swing is about 'q'"):
        cfid.inertia.fit(known(), rig=RIG, peaks={"q": 9})
    with pytest.raises(ConfigError, match="above zero"):
        KnownInertia("x", -1e-5)


@pytest.mark.parametrize(
    ("off", "expected"),
    [(0.0, []), (5.0, ["testbody-apart"]), (-5.0, ["testbody-apart"]), (21.0, ["testbody-another-axis"])],
)
def test_a_test_body_far_off_its_drawing_is_doubtful_and_then_rejected(off: float, expected: list[str]) -> None:
    # The drawing's inertia about x is 6.410179e-06, and 3.4903e-05 about the axis of the mount (table 2.5).
    exact = cfid.inertia.fit_testbody([KnownInertia("x", 3.5e-5, 1e-8)], rig=RIG)
    calculated, measured, error = (
        exact.quantities[f"testbody.{key}.x"] for key in ("calculated_kg_m2", "measured_kg_m2", "error")
    )
    one_std = error.std * calculated.value
    at_drawing = 3.5e-5 - (measured.value - calculated.value)
    result = cfid.inertia.fit_testbody([KnownInertia("x", at_drawing + off * one_std, 1e-8)], rig=RIG)

    assert codes(result, "warning") + codes(result, "rejection") == expected
    assert result.accepted == ("testbody-another-axis" not in expected)
    assert set(result.without_rejected().quantities) >= {"testbody.calculated_kg_m2.x"}
    assert any("the drawing" in line for line in result.without_rejected().summary()) == result.accepted
