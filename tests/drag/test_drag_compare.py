"""The judge between models of drag: winds left out, the simplest that does as well as the best."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cfid.drag.comparison import compare_models
from cfid.drag.estimation import flat_rows, solve
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import COMPLEX, CROSS, CROSS_MENDED, SIMPLE, DragModel
from cfid.drag.wind.reduction import reduce_runs
from cfid.errors import FitError
from cfid.sim.wind_tunnel import Air, CrossAir, Tunnel, Wind, simulate_campaign
from tests.drag.test_drag_campaigns import EQ_4_11, NAMES, SIMPLE_AIR, WINDS, WORLDS, as_typed, measured

ORDER = ("simple", "cross", "complex")
AIRS = {model.name: air for air, model, _ in WORLDS}


def verdicts(air: Air, campaigns: int, *, seed: int) -> Counter[str]:
    rng = np.random.default_rng(seed)
    return Counter(compare_models(measured(air, rng)).chosen.model.name for _ in range(campaigns))


def spread_as_read(air: Air, rng: np.random.Generator, winds: Sequence[Wind]) -> DragExperiments:
    """Return a campaign in winds as inhomogeneous as the thesis read them."""
    return reduce_runs(as_typed(simulate_campaign(Tunnel(air=air), winds, rng=rng))).experiments


@pytest.mark.parametrize("name", ORDER)
def test_the_true_model_is_chosen_in_three_campaigns_of_three(name: str) -> None:
    assert verdicts(AIRS[name], 3, seed=3) == {name: 3}


@pytest.mark.slow
@pytest.mark.parametrize("name", ORDER)
def test_the_true_model_is_chosen_at_least_nine_times_in_ten(name: str) -> None:
    found = verdicts(AIRS[name], 300, seed=20261121)

    print(name, dict(found))
    assert found[name] >= 0.9 * 300


@pytest.mark.slow
@pytest.mark.parametrize("name", ORDER)
def test_so_it_is_in_winds_as_inhomogeneous_as_the_thesis_read_them(name: str) -> None:
    rng = np.random.default_rng(20261121)
    winds = [wind._replace(min_mps=wind.min_mps - 0.2, max_mps=wind.max_mps + 0.2) for wind in WINDS[:2]] + WINDS[2:]
    found = Counter(compare_models(spread_as_read(AIRS[name], rng, winds)).chosen.model.name for _ in range(200))

    print(name, dict(found))
    assert found[name] >= 0.9 * 200


def test_candidates_stand_from_the_simplest_on_and_squared_errors_fall() -> None:
    found = compare_models(measured(SIMPLE_AIR, np.random.default_rng(3)))

    assert tuple(candidate.model.name for candidate in found.candidates) == ORDER
    errors = [candidate.fit.sse_n2 for candidate in found.candidates]
    assert errors[0] > errors[2]
    assert found.chosen.model is SIMPLE
    assert found.chosen.surprise.mean() <= found.best.surprise.mean() + found.margin
    assert found.margin == pytest.approx(found.best.surprise.std(ddof=1) / math.sqrt(15))


@pytest.mark.parametrize("model", [SIMPLE, CROSS, COMPLEX], ids=ORDER)
def test_a_wind_is_predicted_as_if_its_forces_had_never_been_seen(model: DragModel) -> None:
    experiments = measured(AIRS[model.name], np.random.default_rng(3))
    (candidate,) = compare_models(experiments, [model]).candidates
    errors = solve(experiments, model, flat_rows(experiments, model)).errors
    covariance, rows = errors.columns @ errors.columns.T, flat_rows(experiments, model)
    force, out = experiments.force_n.reshape(-1), np.repeat(experiments.setting == 7, 3)

    weight = np.linalg.inv(covariance[np.ix_(~out, ~out)])
    known = np.linalg.inv(rows[~out].T @ weight @ rows[~out])
    coefficients = known @ (rows[~out].T @ weight @ force[~out])
    carried = covariance[np.ix_(out, ~out)] @ weight  # what the others say of the references
    left = force[out] - rows[out] @ coefficients - carried @ (force[~out] - rows[~out] @ coefficients)
    beside = rows[out] - carried @ rows[~out]
    spread = covariance[np.ix_(out, out)] - carried @ covariance[np.ix_(~out, out)] + beside @ known @ beside.T
    surprise = (left @ np.linalg.solve(spread, left) + np.linalg.slogdet(math.tau * spread)[1]) / 2

    assert candidate.left_out_sse_n2[7] == pytest.approx(left @ left, rel=1e-6)
    assert candidate.surprise[7] == pytest.approx(surprise, rel=1e-9)


def test_a_fault_of_one_reference_is_not_taken_for_drag_that_depends_on_the_command_alone() -> None:
    experiments = measured(SIMPLE_AIR, np.random.default_rng(3))
    off = 0.003 * (experiments.command == 30000)[:, np.newaxis] * np.array([0, 0, 1])
    shifted = replace(experiments, force_n=experiments.force_n + off)

    assert compare_models(shifted).chosen.model is SIMPLE


def test_two_azimuths_let_the_judge_tell_the_mended_form_from_the_printed_one() -> None:
    winds = [*WINDS, *(wind._replace(azimuth_rad=0.4967 + math.pi) for wind in WINDS[5:])]
    mended = CrossAir(kg_per_rad=EQ_4_11, mended=True)
    experiments = measured(mended, np.random.default_rng(3), winds)

    assert compare_models(experiments, (SIMPLE, CROSS, CROSS_MENDED, COMPLEX)).chosen.model is CROSS_MENDED


def test_two_winds_are_too_few_to_judge() -> None:
    experiments = measured(SIMPLE_AIR, np.random.default_rng(3), WINDS[7:9])

    with pytest.raises(FitError, match="2 wind settings are too few to leave one out"):
        compare_models(experiments)


def test_the_worlds_are_named_as_their_models() -> None:
    assert set(NAMES) == set(ORDER)
