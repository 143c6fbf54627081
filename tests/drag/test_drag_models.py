"""The choice of a drag model, cross coupling with its sign mended, constant forces in a wind, and rejections."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cfid.drag.comparison import fit_findings, fit_models, force_findings, resolves_kappa_4
from cfid.drag.data import reduce_points
from cfid.drag.estimation import fit_drag
from cfid.drag.model import COMPLEX, CROSS, CROSS_MENDED, SIMPLE, DragExperiments, DragModel
from cfid.errors import ConfigError, FitError
from tests.drag.thesis_campaign import (
    COMPLEX_AIR,
    CROSS_AIR,
    EQ_4_8,
    EQ_4_9,
    EQ_4_11,
    SIMPLE_AIR,
    WINDS,
    WORLDS,
    Array,
    as_typed,
    exact,
    measured,
)
from tests.drag.wind_tunnel import Air, CrossAir, Tunnel, Wind, simulate_campaign

ORDER = ("simple", "cross", "complex")
AIRS = {model.name: air for air, model, _ in WORLDS}
MENDED_AIR = CrossAir(kg_per_rad=EQ_4_11, mended=True)
TWO_AZIMUTHS = [*WINDS, *(wind._replace(azimuth_rad=0.4967 + math.pi) for wind in WINDS[5:])]
MIRRORED = [*WINDS, *(wind._replace(azimuth_rad=-math.pi / 2 - 0.4967) for wind in WINDS[5:])]


def codes(experiments: DragExperiments, model: DragModel) -> list[str]:
    """Return the codes of the findings about a cross-coupling model's fit."""
    return [finding.code for finding in fit_findings("cross", fit_drag(experiments, model), experiments)]


def choices(air: Air, campaigns: int, *, seed: int) -> Counter[str]:
    rng = np.random.default_rng(seed)
    return Counter(fit_models(measured(air, rng)).chosen for _ in range(campaigns))


def spread_as_read(air: Air, rng: np.random.Generator, winds: Sequence[Wind]) -> DragExperiments:
    """Return a campaign in winds as inhomogeneous as the thesis read them."""
    return reduce_points(as_typed(simulate_campaign(Tunnel(air=air), winds, rng=rng)))


@pytest.mark.parametrize("name", ORDER)
@pytest.mark.parametrize(
    ("campaigns", "seed", "least"), [(3, 3, 3), pytest.param(300, 20261121, 270, marks=pytest.mark.slow)]
)
def test_the_true_model_is_chosen_at_least_nine_times_in_ten(name: str, campaigns: int, seed: int, least: int) -> None:
    chosen = choices(AIRS[name], campaigns, seed=seed)

    print(name, dict(chosen))
    assert chosen[name] >= least


@pytest.mark.slow
@pytest.mark.parametrize("name", ORDER)
def test_so_it_is_in_winds_as_inhomogeneous_as_the_thesis_read_them(name: str) -> None:
    rng = np.random.default_rng(20261121)
    winds = [wind._replace(min_mps=wind.min_mps - 0.2, max_mps=wind.max_mps + 0.2) for wind in WINDS[:2]] + WINDS[2:]
    chosen = Counter(fit_models(spread_as_read(AIRS[name], rng, winds)).chosen for _ in range(200))

    print(name, dict(chosen))
    assert chosen[name] >= 0.9 * 200


def test_the_mended_model_gives_its_coefficients_back_from_two_azimuths() -> None:
    experiments = exact(MENDED_AIR, TWO_AZIMUTHS)
    fit = fit_drag(experiments, CROSS_MENDED)

    np.testing.assert_allclose(fit.value, EQ_4_11, rtol=1e-6)
    assert fit.sse_n2 < 1e-18
    assert fit_drag(experiments, CROSS).sse_n2 > 1e-4


def test_azimuths_in_which_both_forms_look_alike_do_not_resolve_kappa_4() -> None:
    for model in (CROSS, CROSS_MENDED):
        assert fit_drag(exact(MENDED_AIR), model).sse_n2 < 1e-18
    assert not resolves_kappa_4(exact(MENDED_AIR))
    assert not resolves_kappa_4(exact(MENDED_AIR, MIRRORED))
    assert resolves_kappa_4(exact(MENDED_AIR, TWO_AZIMUTHS))


def test_the_printed_form_is_reported_as_impossible_where_it_matters() -> None:
    coupled, simple = (measured(air, np.random.default_rng(6)) for air in (CROSS_AIR, SIMPLE_AIR))

    assert codes(coupled, CROSS) == ["drag-kappa4-sign"]
    assert codes(coupled, CROSS_MENDED) == codes(simple, CROSS) == []


@pytest.mark.parametrize("model", [SIMPLE, CROSS_MENDED], ids=lambda model: model.name)
def test_intercepts_take_up_a_tare_that_drifted_between_runs(model: DragModel) -> None:
    experiments = exact(SIMPLE_AIR)
    drifted = np.random.default_rng(4).normal(0, 0.005, (15, 3))
    moved = replace(experiments, force_n=experiments.force_n + drifted[experiments.setting])
    with_intercepts = fit_drag(moved, model, intercepts=True)

    diagonal = np.diag(with_intercepts.value) if model is not SIMPLE else with_intercepts.value
    np.testing.assert_allclose(diagonal, EQ_4_8, rtol=1e-6)
    np.testing.assert_allclose(with_intercepts.intercepts_n, drifted, atol=1e-8)
    assert fit_drag(moved, model).sse_n2 > 1e-3


@pytest.mark.parametrize(("air", "model", "printed"), [(SIMPLE_AIR, SIMPLE, EQ_4_8), (COMPLEX_AIR, COMPLEX, EQ_4_9)])
def test_the_bodys_own_drag_is_distinguished_from_the_rotors(air: Air, model: DragModel, printed: Array) -> None:
    experiments = exact(air)
    k = np.array([-4e-4, -4e-4, -7e-4])
    parasitic = k * experiments.wind_mps[:, np.newaxis] * experiments.velocity_mps
    fit = fit_drag(replace(experiments, force_n=experiments.force_n + parasitic), model, parasitic=True)

    np.testing.assert_allclose(fit.parasitic_kg_per_m[0], k, rtol=1e-6)
    np.testing.assert_allclose(fit.value, printed, rtol=1e-6)


def test_intercepts_and_the_bodys_own_drag_are_both_constant_in_a_wind_setting_and_refused_together() -> None:
    with pytest.raises(FitError, match="determine 47 of 49 unknowns of the simple model with intercepts"):
        fit_drag(exact(SIMPLE_AIR), SIMPLE, intercepts=True, parasitic=True)
    with pytest.raises(ConfigError, match="cannot be distinguished: choose one"):
        fit_models(exact(SIMPLE_AIR), intercepts=True, parasitic=True)


def test_experiments_that_leave_no_residual_or_do_not_determine_a_model_are_refused() -> None:
    few = exact(COMPLEX_AIR, WINDS[5:9])
    some, above = few.at(np.arange(24) % 4 == 0), exact(SIMPLE_AIR, WINDS[:5])

    with pytest.raises(FitError, match="6 forces and 6 unknowns leave no degree of freedom to estimate the noise from"):
        fit_drag(some, COMPLEX)
    assert fit_drag(some, SIMPLE).degrees_of_freedom == 16
    with pytest.raises(FitError, match="determine 51 of 57 unknowns of the complex model"):
        fit_drag(exact(SIMPLE_AIR), COMPLEX, intercepts=True)
    with pytest.raises(FitError, match="determine 1 of 2 unknowns"):
        fit_models(above)
    with pytest.raises(FitError, match="record another angle"):
        fit_models(above, method="thesis")
    with pytest.raises(FitError, match="all forces are zero"):
        fit_drag(replace(above, force_n=0 * above.force_n), SIMPLE)


def test_stated_noise_is_widened_and_never_narrowed() -> None:
    experiments = measured(SIMPLE_AIR, np.random.default_rng(6))
    std, reference_std = experiments.force_std_n, experiments.reference_std_n
    scales = [
        fit_drag(replace(experiments, force_std_n=n * std, reference_std_n=n * reference_std), SIMPLE).noise_scale
        for n in (0.1, 0.2, 10.0)
    ]

    assert scales[0] == pytest.approx([2 * scale for scale in scales[1]], rel=0.01)
    assert scales[2] == (1.0, 1.0)


def test_forces_that_drive_the_vehicle_are_rejected() -> None:
    experiments = exact(SIMPLE_AIR)
    driven = force_findings(replace(experiments, force_n=-experiments.force_n))

    assert force_findings(experiments) == []
    assert [(finding.code, finding.severity) for finding in driven] == [("drag-drives", "rejection")] * 2
    assert all(finding.concerns("drag.complex.k1") for finding in driven)


def test_a_model_that_explains_less_than_half_is_rejected_and_no_other() -> None:
    experiments = exact(SIMPLE_AIR)
    noise = replace(experiments, force_n=np.random.default_rng(4).normal(0, 0.02, experiments.force_n.shape))
    (finding,) = fit_findings("simple", fit_drag(noise, SIMPLE), noise)

    assert fit_findings("simple", fit_drag(experiments, SIMPLE), experiments) == []
    assert (finding.code, finding.severity) == ("drag-unexplained", "rejection")
    assert finding.concerns("drag.sse_n2.simple")
    assert finding.concerns("drag.simple_kg_per_rad")
    assert not finding.concerns("drag.sse_n2.complex")


def test_a_fault_of_one_reference_is_not_taken_for_drag_that_depends_on_the_command_alone() -> None:
    experiments = measured(SIMPLE_AIR, np.random.default_rng(3))
    off = 0.003 * (experiments.command == 30000)[:, np.newaxis] * np.array([0, 0, 1])

    assert fit_models(replace(experiments, force_n=experiments.force_n + off)).chosen == "simple"


def test_the_criterion_of_a_model_does_not_count_the_intercepts_of_its_fit() -> None:
    experiments = measured(SIMPLE_AIR, np.random.default_rng(3))

    assert fit_models(experiments, intercepts=True).bic == pytest.approx(fit_models(experiments).bic)


def test_three_winds_at_one_angle_do_not_determine_the_cross_model_whatever_the_rounding() -> None:
    experiments = measured(SIMPLE_AIR, np.random.default_rng(3), WINDS[5:8])
    for times in range(4):
        rounded = replace(experiments, force_n=experiments.force_n * (1 + 1e-13 * times))
        models = fit_models(rounded)
        (refused,) = [finding for finding in models.findings if finding.code == "drag-not-determined"]
        assert refused.concerns("drag.cross_coupling_kg_per_rad")
        assert models.bic == pytest.approx(fit_models(experiments).bic, rel=1e-9)


def test_a_model_that_lacks_what_the_forces_show_is_not_accepted_silently() -> None:
    sound = measured(SIMPLE_AIR, np.random.default_rng(3))
    body_n = -8e-4 * sound.wind_mps[:, np.newaxis] * sound.velocity_mps
    not_tared = replace(sound, force_n=sound.force_n + body_n)
    silent, named = (
        [one.severity for one in fit_models(runs).findings if one.concerns("drag.simple_kg_per_rad")]
        for runs in (sound, not_tared)
    )

    assert (silent, named) == ([], ["warning"])


def test_level_winds_are_refused_though_the_cosine_of_90_degrees_is_not_quite_0() -> None:
    sound = exact(SIMPLE_AIR)
    level = replace(sound, velocity_mps=sound.velocity_mps * [1, 1, 6e-17])

    with pytest.raises(FitError, match="determine 1 of 2 unknowns of the simple model"):
        fit_drag(level, SIMPLE)
