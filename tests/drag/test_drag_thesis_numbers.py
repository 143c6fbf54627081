"""Forces made with the thesis' printed drag coefficients, in its own 90 wind combinations, give them back."""

import numpy as np
import pytest

from cfid.drag.estimation import fit_drag
from cfid.drag.model import SIMPLE, DragExperiments, DragModel
from cfid.drag.thesis import group_rows, lateral_kg_per_rad, means_gain, normalise, ratios_kg_per_rad
from tests.drag.thesis_campaign import (
    COMPLEX_AIR,
    EQ_4_8,
    EQ_4_9,
    NAMES,
    SIMPLE_AIR,
    WORLDS,
    Array,
    exact,
    measured,
)
from tests.drag.wind_tunnel import Air

EQ_4_10 = np.array(
    [
        [-5.2370e-7, -5.2370e-7, -1.8546e-7],
        [-1.9155e-8, -1.9155e-8, 1.4545e-8],
        [2.3195e-11, 2.3195e-11, -4.8768e-11],
        [-5.3157e-8, -5.3157e-8, -22.4798e-8],
        [-3.8011e-7, -3.8011e-7, 1.0069e-7],
        [2.2032e-7, 2.2032e-7, 1.0656e-7],
    ]
)


@pytest.fixture(scope="module")
def noisy() -> DragExperiments:
    return measured(COMPLEX_AIR, np.random.default_rng(17))


@pytest.mark.parametrize("weighted", [True, False], ids=["generalised", "plain"])
@pytest.mark.parametrize(("air", "model", "printed"), WORLDS, ids=NAMES)
def test_forces_made_with_4_8_4_9_and_4_11_give_the_coefficients_back_to_six_digits(
    air: Air, model: DragModel, printed: Array, weighted: bool
) -> None:
    fit = fit_drag(exact(air), model, weighted=weighted)

    np.testing.assert_allclose(fit.value, printed, rtol=1e-9)
    assert fit.sse_n2 < 1e-18


def test_the_means_of_c_3_1_give_4_8_back_too() -> None:
    experiments = exact(SIMPLE_AIR)
    fit = fit_drag(experiments, SIMPLE, gain=means_gain(experiments))

    np.testing.assert_allclose(fit.value, EQ_4_8, rtol=1e-9)


def test_4_10_follows_from_4_9_and_the_square_of_the_speed_makes_the_third_term_the_largest() -> None:
    experiments = exact(COMPLEX_AIR)
    wind, speed_sum = experiments.wind_mps, experiments.speed_sum_rad_s

    np.testing.assert_allclose(normalise(EQ_4_9, wind_mps=2.85, speed_sum_rad_s=5992.7), EQ_4_10, rtol=5e-5)
    np.testing.assert_allclose(normalise(EQ_4_9, wind_mps=wind, speed_sum_rad_s=speed_sum), EQ_4_10, rtol=5e-5)
    total = 5992.7 * 2.85 + 2.85**2 + 5992.7**2 + 2.85 + 5992.7 + 1
    squared = normalise(EQ_4_9, wind_mps=2.85, speed_sum_rad_s=5992.7, squared=True)
    np.testing.assert_allclose(squared[2], EQ_4_9[2] * 5992.7**2 / total)
    np.testing.assert_allclose(squared[5], EQ_4_9[5] / total)


def test_groups_are_means_over_winds_over_commands_and_over_both(noisy: DragExperiments) -> None:
    by_command, by_wind, by_angle = (group_rows(noisy, grouping) for grouping in ("command", "wind", "angle"))
    for group in (*by_command, *by_wind, *by_angle):
        rows = noisy.angle_deg == group["angle_deg"]
        if "command" in group:
            rows &= noisy.command == group["command"]
        if "wind_mps" in group:
            rows &= np.isclose(noisy.wind_mps, group["wind_mps"])
        assert group["kg_per_rad"] == pytest.approx(lateral_kg_per_rad(noisy)[rows].mean())

    assert (len(by_command), len(by_wind), len(by_angle)) == (12, 10, 2)
    lateral = np.mean([group["kg_per_rad"] for group in by_angle])
    value = fit_drag(noisy, SIMPLE, gain=means_gain(noisy)).value
    np.testing.assert_allclose(value, [lateral, lateral, ratios_kg_per_rad(noisy)[:, 2].mean()])


def test_every_angle_weighs_the_same_in_x_and_y_however_often_it_was_recorded(noisy: DragExperiments) -> None:
    uneven = noisy.at((noisy.angle_deg != 77.9) | (noisy.command > 30000))
    of_angles = [group["kg_per_rad"] for group in group_rows(uneven, "angle")]
    value = fit_drag(uneven, SIMPLE, gain=means_gain(uneven)).value

    np.testing.assert_allclose(value[:2], np.mean(of_angles))
    assert value[0] != pytest.approx(np.nanmean(lateral_kg_per_rad(uneven)), rel=1e-3)
