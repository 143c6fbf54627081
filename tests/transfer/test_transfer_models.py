"""Transfer functions in both forms: coefficients, responses and time series belong together."""

import math

import numpy as np
import pytest

from cfid.transfer.model import EQ_3_15, EQ_3_16, TransferFunction

LAGS = [((0.0775,), 0.0), ((0.08, 0.01), 0.0), ((0.05, 0.05), 0.0), ((0.08,), 0.03)]
COMMANDS = np.random.default_rng(1).uniform(10000, 50000, 400)
SAMPLES_S = np.arange(400) * np.float64(0.002)


@pytest.mark.parametrize(("lags_s", "lead_s"), LAGS)
def test_a_simulation_is_the_difference_equation_and_ends_at_the_static_gain(
    lags_s: tuple[float, ...], lead_s: float
) -> None:
    function = TransferFunction.of_lags(2.0, lags_s, lead_s=lead_s)
    force: list[float] = []
    for n in range(len(COMMANDS)):
        fed = sum(b * COMMANDS[n - k] for k, b in enumerate(function.numerator) if n >= k)
        force.append(fed - sum(a * force[n - k] for k, a in enumerate(function.denominator) if 0 < k <= n))

    assert function.simulate(COMMANDS, SAMPLES_S) == pytest.approx(force)
    assert function.static_gain_n == pytest.approx(2.0)
    assert function.response(np.array([1e-6]))[0] == pytest.approx(2.0)
    assert function.time_constant_s == pytest.approx(max(lags_s), rel=1e-6)
    assert function.denominator[0] == 1


def test_a_lag_behind_a_hold_has_the_coefficients_of_its_decay_over_a_sample() -> None:
    pole = math.exp(-0.002 / 0.06)
    function = TransferFunction.of_lags(3e-6, [0.06])

    assert function.numerator == pytest.approx([0, 3e-6 * (1 - pole)], rel=1e-12)
    assert function.denominator == pytest.approx([1, -pole], rel=1e-12)


def test_eq_3_15_and_3_16_as_gain_and_time_constant() -> None:
    assert EQ_3_15.static_gain_n == pytest.approx(6.0705967e-8 / (1 - 0.9745210))
    assert EQ_3_15.time_constant_s == pytest.approx(0.0775, abs=1e-4)
    assert EQ_3_16.static_gain_n == pytest.approx(2.375e-6, rel=1e-3)
    assert EQ_3_16.time_constant_s == pytest.approx(0.0647, abs=1e-4)


def test_eq_3_11_is_evaluated_in_rising_powers() -> None:
    z = np.exp(0.3j)
    function = TransferFunction(numerator=np.array([1.0, 2.0]), denominator=np.array([1.0, -0.5, 0.2]))

    assert function.response(np.array([0.3 / 0.002]))[0] == pytest.approx((1 + 2 / z) / (1 - 0.5 / z + 0.2 / z**2))
