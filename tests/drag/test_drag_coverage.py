"""Coverage of the intervals of drag coefficients, from whole simulated campaigns whose every value is drawn anew.

The campaigns have load-cell noise, drift that is not stated, and wind that is inhomogeneous, unsteady and known to 5 %.
"""

from dataclasses import replace

import numpy as np
import pytest

from cfid.drag.data import experiments_from_table, reduce_points
from cfid.drag.estimation import DragFit, fit_drag
from cfid.drag.model import CROSS, SIMPLE, DragExperiments, DragModel
from cfid.drag.thesis import means_gain
from tests.coverage_rows import reaches_93_percent
from tests.drag.test_drag_reduction import as_table
from tests.drag.thesis_campaign import (
    CROSS_AIR,
    EQ_4_8,
    EQ_4_11,
    NAMES,
    SIMPLE_AIR,
    WINDS,
    WORLDS,
    Array,
    as_typed,
    exact,
    measured,
)
from tests.drag.wind_tunnel import Air, Tunnel, simulate_campaign

CAMPAIGNS = 1000


def scores(air: Air, model: DragModel, printed: Array, campaigns: int, *, seed: int, weighted: bool = True) -> Array:
    """Return the error of each coefficient in standard uncertainties, (campaigns, p)."""
    rng, true = np.random.default_rng(seed), coefficients(model, printed)
    fits = (fit_drag(measured(air, rng), model, weighted=weighted) for _ in range(campaigns))
    return np.array([(fit.values - true) / np.sqrt(np.diag(fit.covariance)) for fit in fits])


def coefficients(model: DragModel, printed: Array) -> Array:
    """Return the coefficients (p,) of a table in the layout of the thesis."""
    values = np.zeros(len(model.terms))
    values[model.layout] = printed
    return values


def fit_means(experiments: DragExperiments) -> DragFit:
    return fit_drag(experiments, SIMPLE, gain=means_gain(experiments))


def in_thesis_winds(rng: np.random.Generator) -> DragExperiments:
    return reduce_points(as_typed(simulate_campaign(Tunnel(air=SIMPLE_AIR), WINDS, rng=rng)))


def test_simple_coefficients_lie_within_their_intervals_over_sixty_campaigns() -> None:
    found = scores(SIMPLE_AIR, SIMPLE, EQ_4_8, 60, seed=5)

    assert reaches_93_percent(np.abs(found) < 1.96)
    assert 0.75 < found.std() < 1.25
    assert np.abs(found.mean(axis=0)).max() < 0.45


def test_wind_errors_move_the_bodys_own_drag_too() -> None:
    """Wind known to 5 % acts on rotors and body alike, and both coefficients lie within their intervals."""
    nominal, rng, body, covered = exact(SIMPLE_AIR), np.random.default_rng(5), np.array([-1e-3, -1e-3, -2e-3]), []
    noise = np.full_like(nominal.force_n, 3e-4)
    for _ in range(60):
        true = (1 + 0.05 * rng.standard_normal(nominal.settings))[nominal.setting, np.newaxis] * nominal.velocity_mps
        rotors = nominal.speed_sum_rad_s[:, np.newaxis] * true * EQ_4_8
        force = rotors + np.linalg.norm(true, axis=1, keepdims=True) * true * body + rng.normal(0, noise)
        experiments = replace(nominal, force_n=force, force_std_n=noise, reference_std_n=0 * noise, noise_known=True)
        fit = fit_drag(experiments, SIMPLE, parasitic=True)
        value, std = fit.parasitic_kg_per_m
        covered += [
            np.abs(fit.value - EQ_4_8)[[0, 2]] < 1.96 * fit.std[[0, 2]],
            np.abs(value - body)[[0, 2]] < 1.96 * std[[0, 2]],
        ]

    assert reaches_93_percent(covered)


@pytest.mark.slow
@pytest.mark.parametrize(("air", "model", "printed"), WORLDS, ids=NAMES)
@pytest.mark.parametrize("weighted", [True, False], ids=["generalised", "plain"])
def test_coefficients_lie_within_their_95_percent_intervals_93_to_97_times_in_100(
    air: Air, model: DragModel, printed: Array, weighted: bool
) -> None:
    covered = np.abs(scores(air, model, printed, CAMPAIGNS, seed=20261121, weighted=weighted)) < 1.96

    print(model.name, covered.mean(axis=0), "all:", covered.mean())
    assert 0.94 <= covered.mean() <= 0.96
    assert np.all((covered.mean(axis=0) >= 0.93) & (covered.mean(axis=0) <= 0.97))


@pytest.mark.slow
def test_so_do_the_means_of_c_3_1() -> None:
    rng, covered = np.random.default_rng(20261121), []
    for _ in range(CAMPAIGNS):
        fit = fit_means(measured(SIMPLE_AIR, rng))
        covered.append(np.abs(fit.value - EQ_4_8)[[0, 2]] < 1.96 * fit.std[[0, 2]])

    print("means of C.3.1:", np.mean(covered, axis=0))
    assert np.all((np.mean(covered, axis=0) >= 0.93) & (np.mean(covered, axis=0) <= 0.97))


@pytest.mark.slow
def test_so_do_coefficients_of_a_table_that_states_no_noise() -> None:
    rng, covered = np.random.default_rng(20261121), []
    for _ in range(CAMPAIGNS):
        fit = fit_drag(experiments_from_table(as_table(measured(CROSS_AIR, rng))), CROSS)
        covered.append(np.abs(fit.value - EQ_4_11) < 1.96 * fit.std)

    found = coefficients(CROSS, np.mean(covered, axis=0))
    print("of a table:", found)
    assert np.all((found >= 0.93) & (found <= 0.97))


@pytest.mark.slow
def test_weights_make_uncertainties_a_third_smaller_than_the_means_of_c_3_1() -> None:
    rng = np.random.default_rng(3)
    campaigns = [measured(SIMPLE_AIR, rng) for _ in range(100)]
    generalised = np.mean([fit_drag(experiments, SIMPLE).std for experiments in campaigns], axis=0)
    means = np.mean([fit_means(experiments).std for experiments in campaigns], axis=0)

    print("relative uncertainties:", generalised / np.abs(EQ_4_8), means / np.abs(EQ_4_8))
    assert np.all(generalised < 0.67 * means)


@pytest.mark.slow
def test_the_thesis_own_winds_spread_further_and_intervals_are_as_much_wider() -> None:
    rng = np.random.default_rng(20261121)
    fits = [fit_drag(in_thesis_winds(rng), SIMPLE) for _ in range(CAMPAIGNS)]
    # The two winds that the thesis read once are simulated as known, but the fit takes them as uncertain as the others.
    covered = np.mean([np.abs(fit.value - EQ_4_8)[:1] < 1.96 * fit.std[:1] for fit in fits])

    print("x and y in the thesis' winds:", covered, "relative uncertainty:", fits[0].std[0] / -EQ_4_8[0])
    assert 0.93 <= covered <= 0.97
