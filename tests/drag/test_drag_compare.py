"""The choice of a drag model: wind settings are left out in turn, and the simplest of the good models is chosen."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cfid.drag.comparison import compare_models
from cfid.drag.estimation import design, fit_drag, solve
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import COMPLEX, CROSS, CROSS_MENDED, SIMPLE, DragModel
from cfid.drag.wind.reduction import reduce_forces
from cfid.errors import FitError
from tests.drag.test_drag_campaigns import EQ_4_11, SIMPLE_AIR, WINDS, WORLDS, as_typed, measured
from tests.drag.wind_tunnel import Air, CrossAir, Tunnel, Wind, simulate_campaign

ORDER = ("simple", "cross", "complex")
AIRS = {model.name: air for air, model, _ in WORLDS}


def choices(air: Air, campaigns: int, *, seed: int) -> Counter[str]:
    rng = np.random.default_rng(seed)
    return Counter(compare_models(measured(air, rng)).chosen.model.name for _ in range(campaigns))


def spread_as_read(air: Air, rng: np.random.Generator, winds: Sequence[Wind]) -> DragExperiments:
    """Return a campaign in winds as inhomogeneous as the thesis read them."""
    return reduce_forces(as_typed(simulate_campaign(Tunnel(air=air), winds, rng=rng)))


@pytest.mark.parametrize("name", ORDER)
def test_the_true_model_is_chosen_in_three_campaigns_of_three(name: str) -> None:
    assert choices(AIRS[name], 3, seed=3) == {name: 3}


@pytest.mark.slow
@pytest.mark.parametrize("name", ORDER)
def test_the_true_model_is_chosen_at_least_nine_times_in_ten(name: str) -> None:
    found = choices(AIRS[name], 300, seed=20261121)

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


def test_predictions_are_ordered_from_the_simplest_model_on_and_squared_errors_fall() -> None:
    experiments = measured(SIMPLE_AIR, np.random.default_rng(3))
    found = compare_models(experiments)

    assert tuple(one.model.name for one in found.predictions) == ORDER
    errors = [fit_drag(experiments, one.model).sse_n2 for one in found.predictions]
    assert errors[0] > errors[2]
    assert found.chosen.model is SIMPLE
    assert found.chosen.surprise.mean() <= found.best.surprise.mean() + found.margin
    assert found.margin == pytest.approx(found.best.surprise.std(ddof=1) / math.sqrt(15))


@pytest.mark.parametrize("model", [SIMPLE, CROSS, COMPLEX], ids=ORDER)
def test_a_wind_is_predicted_as_if_its_forces_had_never_been_seen(model: DragModel) -> None:
    experiments = measured(AIRS[model.name], np.random.default_rng(3))
    (predicted,) = compare_models(experiments, [model]).predictions
    rows = design(experiments, model).rows
    covariance = solve(design(experiments, model)).errors.covariance_of(np.eye(len(rows)))
    force, out = experiments.force_n.reshape(-1), np.repeat(experiments.setting == 7, 3)

    weight = np.linalg.inv(covariance[np.ix_(~out, ~out)])
    known = np.linalg.inv(rows[~out].T @ weight @ rows[~out])
    coefficients = known @ (rows[~out].T @ weight @ force[~out])
    carried = covariance[np.ix_(out, ~out)] @ weight  # what the other forces show about the references
    left = force[out] - rows[out] @ coefficients - carried @ (force[~out] - rows[~out] @ coefficients)
    direct = rows[out] - carried @ rows[~out]
    spread = covariance[np.ix_(out, out)] - carried @ covariance[np.ix_(~out, out)] + direct @ known @ direct.T
    surprise = (left @ np.linalg.solve(spread, left) + np.linalg.slogdet(math.tau * spread)[1]) / 2

    assert predicted.sse_n2[7] == pytest.approx(left @ left, rel=1e-6)
    assert predicted.surprise[7] == pytest.approx(surprise, rel=1e-9)


def test_a_fault_of_one_reference_is_not_taken_for_drag_that_depends_on_the_command_alone() -> None:
    experiments = measured(SIMPLE_AIR, np.random.default_rng(3))
    off = 0.003 * (experiments.command == 30000)[:, np.newaxis] * np.array([0, 0, 1])
    shifted = replace(experiments, force_n=experiments.force_n + off)

    assert compare_models(shifted).chosen.model is SIMPLE


def test_two_azimuths_distinguish_the_mended_form_from_the_printed_one() -> None:
    winds = [*WINDS, *(wind._replace(azimuth_rad=0.4967 + math.pi) for wind in WINDS[5:])]
    mended = CrossAir(kg_per_rad=EQ_4_11, mended=True)
    experiments = measured(mended, np.random.default_rng(3), winds)

    assert compare_models(experiments, (SIMPLE, CROSS, CROSS_MENDED, COMPLEX)).chosen.model is CROSS_MENDED


def test_two_wind_settings_are_too_few_to_compare_models() -> None:
    experiments = measured(SIMPLE_AIR, np.random.default_rng(3), WINDS[7:9])

    with pytest.raises(FitError, match="2 wind settings are too few to leave one out"):
        compare_models(experiments)
