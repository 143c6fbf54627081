"""Cross coupling with its sign mended, and what stays the same within a run: intercepts and the body's own drag."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cfid.drag.cross_coupling import fit_cross, resolves_kappa_4
from cfid.drag.estimation import fit_drag
from cfid.drag.model import COMPLEX, CROSS, CROSS_MENDED, SIMPLE, DragModel
from cfid.errors import FitError
from cfid.sim.wind_tunnel import CrossAir
from tests.drag.test_drag_campaigns import (
    COMPLEX_AIR,
    CROSS_AIR,
    EQ_4_8,
    EQ_4_9,
    EQ_4_11,
    SIMPLE_AIR,
    WINDS,
    exact,
    measured,
)

MENDED_AIR = CrossAir(kg_per_rad=EQ_4_11, mended=True)
TWO_AZIMUTHS = [*WINDS, *(wind._replace(azimuth_rad=0.4967 + math.pi) for wind in WINDS[5:])]
MIRRORED = [*WINDS, *(wind._replace(azimuth_rad=-math.pi / 2 - 0.4967) for wind in WINDS[5:])]


def test_the_mended_model_gives_its_coefficients_back_from_two_azimuths() -> None:
    found = fit_cross(exact(MENDED_AIR, TWO_AZIMUTHS), mended=True)

    np.testing.assert_allclose(found.fit.value, EQ_4_11, rtol=1e-6)
    assert found.unresolved == ()
    assert found.warnings == ()


def test_from_one_azimuth_both_forms_fit_alike_and_kappa_4_is_unresolved() -> None:
    experiments = exact(MENDED_AIR)
    printed, mended = fit_cross(experiments), fit_cross(experiments, mended=True)

    assert printed.fit.sse_n2 < 1e-18
    assert mended.fit.sse_n2 < 1e-18
    assert printed.unresolved == mended.unresolved == ("kappa_4",)
    assert "one azimuth" in mended.warnings[0]


def test_from_two_azimuths_only_the_mended_form_fits_what_loses_lift_both_ways() -> None:
    experiments = exact(MENDED_AIR, TWO_AZIMUTHS)

    assert fit_cross(experiments, mended=True).fit.sse_n2 < 1e-18
    assert fit_cross(experiments).fit.sse_n2 > 1e-4


def test_azimuths_in_which_both_forms_look_alike_do_not_resolve_it() -> None:
    assert not resolves_kappa_4(exact(MENDED_AIR))
    assert not resolves_kappa_4(exact(MENDED_AIR, MIRRORED))
    assert resolves_kappa_4(exact(MENDED_AIR, TWO_AZIMUTHS))


def test_the_printed_form_is_told_to_be_impossible_where_it_matters() -> None:
    experiments = measured(CROSS_AIR, np.random.default_rng(6))

    assert any("no rotor does" in warning for warning in fit_cross(experiments).warnings)
    assert not any("no rotor does" in warning for warning in fit_cross(experiments, mended=True).warnings)


@pytest.mark.parametrize("model", [SIMPLE, CROSS, CROSS_MENDED], ids=lambda model: model.name)
def test_intercepts_take_up_a_tare_that_drifted_between_runs(model: DragModel) -> None:
    experiments = exact(SIMPLE_AIR)
    drifted = np.random.default_rng(4).normal(0, 0.005, (15, 3))
    moved = replace(experiments, force_n=experiments.force_n + drifted[experiments.setting])
    with_intercepts, without = fit_drag(moved, model, intercepts=True), fit_drag(moved, model)

    diagonal = np.diag(with_intercepts.value) if model is not SIMPLE else with_intercepts.value
    np.testing.assert_allclose(diagonal, EQ_4_8, rtol=1e-6)
    assert with_intercepts.intercepts_n is not None
    np.testing.assert_allclose(with_intercepts.intercepts_n, drifted, atol=1e-8)
    assert without.sse_n2 > 1e-3


@pytest.mark.parametrize(("air", "model", "printed"), [(SIMPLE_AIR, SIMPLE, EQ_4_8), (COMPLEX_AIR, COMPLEX, EQ_4_9)])
def test_the_bodys_own_drag_is_told_from_the_rotors(
    air: CrossAir, model: DragModel, printed: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
) -> None:
    experiments = exact(air)
    k = np.array([-4e-4, -4e-4, -7e-4])
    parasitic = k * experiments.wind_mps[:, np.newaxis] * experiments.velocity_mps
    fit = fit_drag(replace(experiments, force_n=experiments.force_n + parasitic), model, parasitic=True)

    assert fit.parasitic_kg_per_m is not None
    np.testing.assert_allclose(fit.parasitic_kg_per_m, k, rtol=1e-6)
    np.testing.assert_allclose(fit.value, printed, rtol=1e-6)


def test_intercepts_beside_the_bodys_own_drag_are_refused_as_it_is_the_same_throughout_a_run() -> None:
    with pytest.raises(FitError, match="tell 47 of 49 unknowns of the simple model apart beside intercepts"):
        fit_drag(exact(SIMPLE_AIR), SIMPLE, intercepts=True, parasitic=True)


def test_forces_that_leave_no_residual_tell_no_noise() -> None:
    few = exact(COMPLEX_AIR, WINDS[5:9])
    some = few.at(np.arange(24) % 4 == 0)

    with pytest.raises(FitError, match="6 forces leave none over beside 6 unknowns to tell their noise by"):
        fit_drag(some, COMPLEX)
    assert fit_drag(some, SIMPLE).freedom == 16


def test_a_recording_of_nothing_is_refused() -> None:
    experiments = exact(SIMPLE_AIR)

    with pytest.raises(FitError, match="all forces are zero"):
        fit_drag(replace(experiments, force_n=0 * experiments.force_n), SIMPLE)


def test_what_was_not_asked_for_is_not_there() -> None:
    fit = fit_drag(exact(SIMPLE_AIR), SIMPLE)

    assert (fit.intercepts_n, fit.intercepts_std_n) == (None, None)
    assert (fit.parasitic_kg_per_m, fit.parasitic_std_kg_per_m) == (None, None)


def test_the_complex_model_is_the_worst_conditioned() -> None:
    conditions = [fit_drag(exact(SIMPLE_AIR), model).condition for model in (SIMPLE, CROSS, COMPLEX)]

    assert conditions[0] == pytest.approx(1.0)
    assert conditions[0] < conditions[1] < conditions[2]


def test_forces_that_drive_the_vehicle_are_doubted_and_so_are_forces_that_follow_no_model() -> None:
    experiments = exact(SIMPLE_AIR)
    rng = np.random.default_rng(4)
    noise = replace(experiments, force_n=rng.normal(0, 0.02, experiments.force_n.shape))

    assert fit_drag(experiments, SIMPLE).doubts == ()
    assert [doubt[:13] for doubt in fit_drag(replace(experiments, force_n=-experiments.force_n), SIMPLE).doubts] == [
        "along x and y",
        "along z the f",
    ]
    assert "unexplained" in fit_drag(noise, SIMPLE).doubts[0]
