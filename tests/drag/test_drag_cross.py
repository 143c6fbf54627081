"""Cross coupling with its sign mended, forces that are constant in a wind setting, and rejected fits."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cfid.drag.checks import fit_findings, force_findings, resolves_kappa_4
from cfid.drag.comparison import fit_models
from cfid.drag.estimation import fit_drag
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import COMPLEX, CROSS, CROSS_MENDED, SIMPLE, DragModel
from cfid.errors import ConfigError, FitError
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
from tests.drag.wind_tunnel import CrossAir

MENDED_AIR = CrossAir(kg_per_rad=EQ_4_11, mended=True)
TWO_AZIMUTHS = [*WINDS, *(wind._replace(azimuth_rad=0.4967 + math.pi) for wind in WINDS[5:])]
MIRRORED = [*WINDS, *(wind._replace(azimuth_rad=-math.pi / 2 - 0.4967) for wind in WINDS[5:])]


def codes(experiments: DragExperiments, model: DragModel) -> list[str]:
    """Return the codes of the findings about a cross-coupling model's fit."""
    return [one.code for one in fit_findings("cross", fit_drag(experiments, model), experiments)]


def test_the_mended_model_gives_its_coefficients_back_from_two_azimuths() -> None:
    experiments = exact(MENDED_AIR, TWO_AZIMUTHS)

    np.testing.assert_allclose(fit_drag(experiments, CROSS_MENDED).value, EQ_4_11, rtol=1e-6)
    assert codes(experiments, CROSS_MENDED) == ["drag-kappa4-mended"]


def test_from_one_azimuth_both_forms_fit_alike_and_kappa_4_is_unresolved() -> None:
    experiments = exact(MENDED_AIR)

    for model in (CROSS, CROSS_MENDED):
        assert fit_drag(experiments, model).sse_n2 < 1e-18
        assert "drag-kappa4-one-azimuth" in codes(experiments, model)


def test_from_two_azimuths_only_the_mended_form_fits_what_loses_lift_both_ways() -> None:
    experiments = exact(MENDED_AIR, TWO_AZIMUTHS)

    assert fit_drag(experiments, CROSS_MENDED).sse_n2 < 1e-18
    assert fit_drag(experiments, CROSS).sse_n2 > 1e-4


def test_azimuths_in_which_both_forms_look_alike_do_not_resolve_it() -> None:
    assert not resolves_kappa_4(exact(MENDED_AIR))
    assert not resolves_kappa_4(exact(MENDED_AIR, MIRRORED))
    assert resolves_kappa_4(exact(MENDED_AIR, TWO_AZIMUTHS))


def test_the_printed_form_is_reported_as_impossible_where_it_matters() -> None:
    coupled, simple = (measured(air, np.random.default_rng(6)) for air in (CROSS_AIR, SIMPLE_AIR))

    assert "drag-kappa4-sign" in codes(coupled, CROSS)
    assert "drag-kappa4-sign" not in codes(coupled, CROSS_MENDED)
    assert "drag-kappa4-sign" not in codes(simple, CROSS)


@pytest.mark.parametrize("model", [SIMPLE, CROSS, CROSS_MENDED], ids=lambda model: model.name)
def test_intercepts_take_up_a_tare_that_drifted_between_runs(model: DragModel) -> None:
    experiments = exact(SIMPLE_AIR)
    drifted = np.random.default_rng(4).normal(0, 0.005, (15, 3))
    moved = replace(experiments, force_n=experiments.force_n + drifted[experiments.setting])
    with_intercepts, without = fit_drag(moved, model, intercepts=True), fit_drag(moved, model)

    diagonal = np.diag(with_intercepts.value) if model is not SIMPLE else with_intercepts.value
    np.testing.assert_allclose(diagonal, EQ_4_8, rtol=1e-6)
    assert with_intercepts.intercepts_n is not None
    np.testing.assert_allclose(with_intercepts.intercepts_n.value, drifted, atol=1e-8)
    assert without.sse_n2 > 1e-3


@pytest.mark.parametrize(("air", "model", "printed"), [(SIMPLE_AIR, SIMPLE, EQ_4_8), (COMPLEX_AIR, COMPLEX, EQ_4_9)])
def test_the_bodys_own_drag_is_distinguished_from_the_rotors(
    air: CrossAir, model: DragModel, printed: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
) -> None:
    experiments = exact(air)
    k = np.array([-4e-4, -4e-4, -7e-4])
    parasitic = k * experiments.wind_mps[:, np.newaxis] * experiments.velocity_mps
    fit = fit_drag(replace(experiments, force_n=experiments.force_n + parasitic), model, parasitic=True)

    assert fit.parasitic_kg_per_m is not None
    np.testing.assert_allclose(fit.parasitic_kg_per_m.value, k, rtol=1e-6)
    np.testing.assert_allclose(fit.value, printed, rtol=1e-6)


def test_intercepts_and_the_bodys_own_drag_are_both_constant_in_a_wind_setting_and_refused_together() -> None:
    with pytest.raises(FitError, match="determine 47 of 49 unknowns of the simple model with intercepts"):
        fit_drag(exact(SIMPLE_AIR), SIMPLE, intercepts=True, parasitic=True)
    with pytest.raises(ConfigError, match="cannot be distinguished: choose one"):
        fit_models(exact(SIMPLE_AIR), intercepts=True, parasitic=True)


def test_forces_that_leave_no_residual_do_not_determine_the_noise() -> None:
    few = exact(COMPLEX_AIR, WINDS[5:9])
    some = few.at(np.arange(24) % 4 == 0)

    with pytest.raises(FitError, match="6 forces and 6 unknowns leave no degree of freedom to estimate the noise from"):
        fit_drag(some, COMPLEX)
    assert fit_drag(some, SIMPLE).degrees_of_freedom == 16


def test_stated_noise_is_widened_and_never_narrowed() -> None:
    experiments = measured(SIMPLE_AIR, np.random.default_rng(6))
    scales = [
        fit_drag(
            replace(
                experiments,
                force_std_n=times * experiments.force_std_n,
                reference_std_n=times * experiments.reference_std_n,
            ),
            SIMPLE,
        ).noise_scale
        for times in (0.1, 0.2, 10.0)
    ]

    assert scales[0] == pytest.approx([2 * scale for scale in scales[1]], rel=0.01)
    assert scales[2] == (1.0, 1.0)


def test_a_recording_of_nothing_is_refused() -> None:
    experiments = exact(SIMPLE_AIR)

    with pytest.raises(FitError, match="all forces are zero"):
        fit_drag(replace(experiments, force_n=0 * experiments.force_n), SIMPLE)


def test_what_was_not_asked_for_is_not_there() -> None:
    fit = fit_drag(exact(SIMPLE_AIR), SIMPLE)

    assert (fit.intercepts_n, fit.parasitic_kg_per_m) == (None, None)


def test_the_complex_model_is_the_worst_conditioned() -> None:
    conditions = [fit_drag(exact(SIMPLE_AIR), model).condition for model in (SIMPLE, CROSS, COMPLEX)]

    assert conditions[0] == pytest.approx(1.0)
    assert conditions[0] < conditions[1] < conditions[2]


def test_forces_that_drive_the_vehicle_are_rejected() -> None:
    experiments = exact(SIMPLE_AIR)
    driven = force_findings(replace(experiments, force_n=-experiments.force_n))

    assert force_findings(experiments) == ()
    assert [(one.code, one.text[:13]) for one in driven] == [
        ("drag-drives", "along x and y"),
        ("drag-drives", "along z the f"),
    ]
    assert all(one.severity == "rejection" and one.concerns("drag.complex.k1") for one in driven)


def test_a_model_that_explains_less_than_half_is_rejected_and_no_other() -> None:
    experiments = exact(SIMPLE_AIR)
    rng = np.random.default_rng(4)
    noise = replace(experiments, force_n=rng.normal(0, 0.02, experiments.force_n.shape))
    (found,) = fit_findings("simple", fit_drag(noise, SIMPLE), noise)

    assert fit_findings("simple", fit_drag(experiments, SIMPLE), experiments) == ()
    assert (found.code, found.severity) == ("drag-unexplained", "rejection")
    assert "% of the forces' sum of squares unexplained (limit 50 %)" in found.text
    assert found.concerns("drag.sse_n2.simple")
    assert found.concerns("drag.simple_kg_per_rad")
    assert not found.concerns("drag.sse_n2.complex")
