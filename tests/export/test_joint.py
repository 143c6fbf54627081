"""Draws from the joint results of several fits have the stated means and covariances, within and between fits."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import DataError
from cfid.export.joint import Joint, joint_of
from cfid.records.covariances import covariance_between
from cfid.records.parameters import Parameter, Section

Array = npt.NDArray[np.float64]

COUNT = 40_000
MATRIX = [[16.6e-6, 0.8e-6, 0.7e-6], [0.8e-6, 16.7e-6, 1.8e-6], [0.7e-6, 1.8e-6, 29.3e-6]]


def random_covariance(seed: int, size: Sequence[float]) -> Array:
    factor = np.random.default_rng(seed).standard_normal((len(size), len(size)))
    covariance = factor @ factor.T
    unit = np.array(size) / np.sqrt(np.diag(covariance))
    return np.asarray(covariance * np.outer(unit, unit))


def fit_of(
    parameters: Mapping[str, tuple[Any, Any]],
    *,
    covariance: Array | None = None,
    common: Mapping[str, Mapping[str, list[float]]] | None = None,
) -> Section:
    """Return a fit of parameters with values and standard uncertainties, and their covariance."""
    values = {key: value for key, (value, _) in parameters.items()}
    return Section(
        method="default",
        found=datetime(2026, 11, 22, tzinfo=UTC),
        cfid_version="0",
        accepted=True,
        sources=(),
        parameters={key: Parameter(value=value, std=std) for key, (value, std) in parameters.items()},
        covariance=() if covariance is None else covariance_between(values, covariance),
        common=common or {},
    )


def assert_drawn_as_stated(joint: Joint, *, seed: int = 5) -> None:
    """Compare the mean and covariance of many draws with the stated ones, in units of their sampling errors."""
    draws = joint.draw(COUNT, np.random.default_rng(seed))
    std = np.sqrt(np.diag(joint.covariance))
    free = std > 0
    assert np.array_equal(draws[:, ~free], np.broadcast_to(joint.mean[~free], (COUNT, int(np.sum(~free)))))
    scaled = (draws - joint.mean)[:, free] / std[free]
    stated = (joint.covariance / np.outer(np.where(free, std, 1), np.where(free, std, 1)))[np.ix_(free, free)]
    assert np.max(np.abs(scaled.mean(axis=0))) * np.sqrt(COUNT) < 3.5
    error = np.sqrt((1 + stated**2) / COUNT)
    assert np.max(np.abs(scaled.T @ scaled / COUNT - stated) / error) < 3.5


def test_mean_and_covariance_of_draws_are_the_stated_ones() -> None:
    poly = random_covariance(1, [5e-13, 4e-8, 6e-4, 3e-4])
    inertia = random_covariance(2, [1e-8, 2e-8, 3e-8, 1e-8, 2e-8, 1e-8])
    std = np.sqrt(np.diag(poly))
    map_ = fit_of(
        {"motor.thrust_poly": ([2e-11, 1e-6, 5e-4], std[:3].tolist()), "motor.max_thrust_n": (0.15, std[3])},
        covariance=poly,
    )
    body = fit_of({"inertia.matrix_kg_m2": (MATRIX, None)}, covariance=inertia)
    arm = fit_of({"arm_m": (0.046, 1e-4), "rotor_radius_m": (0.0231, None)})
    joint = joint_of(
        [
            (map_, ["motor.thrust_poly", "motor.max_thrust_n"]),
            (body, ["inertia.matrix_kg_m2"]),
            (arm, ["arm_m", "rotor_radius_m"]),
        ]
    )

    assert joint.covariance[:4, :4] == pytest.approx(poly)
    assert joint.covariance[4:10, 4:10] == pytest.approx(inertia)
    assert (joint.exact, joint.independent) == (("rotor_radius_m",), ())
    assert joint.names[4:10] == tuple(f"inertia.matrix_kg_m2 {entry}" for entry in ("xx", "yy", "zz", "xy", "xz", "yz"))
    assert_drawn_as_stated(joint)


def test_maps_that_share_a_tachometer_or_an_arm_covary_by_what_it_does_to_both() -> None:
    speed = fit_of(
        {"motor.speed_poly": ([0.041, 380.0], [4e-4, 5.0])},
        covariance=np.array([[16e-8, 1e-3], [1e-3, 25.0]]),
        common={"tachometer": {"motor.speed_poly": [3e-4, 3.0]}},
    )
    square = fit_of(
        {"motor.thrust_per_speed_squared_n_s2": (2e-8, 4e-10)},
        common={"tachometer": {"motor.thrust_per_speed_squared_n_s2": [-3e-10]}, "arm": {}},
    )
    lag = fit_of({"tf.static_gain_n": (2.2e-6, 3e-8)}, common={"arm": {"tf.static_gain_n": [-2e-8]}})
    arm = fit_of({"arm_m": (0.046, 1e-4)}, common={"arm": {"arm_m": [1e-4]}})
    fits = [
        (speed, ["motor.speed_poly"]),
        (square, ["motor.thrust_per_speed_squared_n_s2"]),
        (lag, ["tf.static_gain_n"]),
        (arm, ["arm_m"]),
    ]
    joint = joint_of(fits)

    assert joint.covariance[:2, 2] == pytest.approx([3e-4 * -3e-10, 3.0 * -3e-10])
    assert joint.covariance[3, 4] == pytest.approx(-2e-8 * 1e-4)
    assert np.diag(joint.covariance) == pytest.approx(np.square([4e-4, 5.0, 4e-10, 3e-8, 1e-4]))
    assert joint.covariance[0, 4] == 0.0
    assert_drawn_as_stated(joint)


def test_a_draw_has_the_shape_of_its_parameters() -> None:
    body = fit_of(
        {
            "inertia.matrix_kg_m2": (MATRIX, None),
            "drag.cross_coupling_kg_per_rad": ([[1, 2, 3], [4, 5, 6], [7, 8, 9]], None),
        }
    )
    joint = joint_of([(body, list(body.parameters))])

    assert joint.shaped(joint.mean) == {key: parameter.value for key, parameter in body.parameters.items()}
    assert len(joint.mean) == 6 + 9


def test_numbers_without_a_covariance_are_independent_and_named() -> None:
    joint = joint_of([(fit_of({"motor.torque_poly": ([6e-3, 1e-5], [1e-5, 1e-6])}), ["motor.torque_poly"])])

    assert joint.independent == ("motor.torque_poly",)
    assert joint.covariance == pytest.approx(np.diag([1e-10, 1e-12]))


def test_of_a_covariance_with_more_in_it_the_part_that_is_wanted_is_taken() -> None:
    whole = random_covariance(3, [1.0, 2.0, 3.0])
    fit = fit_of({"tf.denominator": ([1.0, -0.97], None), "tf.time_constant_s": (0.06, 3.0)}, covariance=whole)
    joint = joint_of([(fit, ["tf.time_constant_s"])])

    assert joint.covariance == pytest.approx(whole[2:, 2:])


def test_common_causes_that_no_uncertainty_holds_are_refused() -> None:
    fits = [
        (fit_of({name: (1.0, 0.1)}, common={"arm": {name: [effect]}}), [name])
        for name, effect in (("a_m", 0.3), ("b_m", 0.3))
    ]
    with pytest.raises(DataError, match="contradict each other"):
        joint_of(fits).draw(1, np.random.default_rng(1))


def test_a_covariance_that_contradicts_the_stated_uncertainties_is_refused() -> None:
    fit = fit_of({"motor.torque_poly": ([6e-3, 1e-5], [1e-5, 1e-6])}, covariance=np.diag([4e-10, 1e-12]))
    with pytest.raises(DataError, match=r"std of motor\.torque_poly and the diagonal of its covariance contradict"):
        joint_of([(fit, ["motor.torque_poly"])])


def test_an_uncertainty_whose_square_is_no_number_is_refused() -> None:
    with pytest.raises(DataError, match="std of arm_m is too large"):
        joint_of([(fit_of({"arm_m": (0.046, 1e308)}), ["arm_m"])])
