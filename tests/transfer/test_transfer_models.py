"""Transfer functions in both forms have consistent coefficients, responses and time series."""

import math

import numpy as np
import pytest

from cfid.transfer.model import EQ_3_15, EQ_3_16, Dynamics, Form, evaluate, static_gain, time_constant_s

PLANTS = [
    EQ_3_15,
    Dynamics(static_gain_n=2.0, lags_s=(0.08, 0.01)),
    Dynamics(static_gain_n=2.0, lags_s=(0.05, 0.05)),
    Dynamics(static_gain_n=2.0, lags_s=(0.08,), lead_s=0.03),
]
COMMANDS = np.random.default_rng(1).uniform(10000, 50000, 400)
SAMPLES_S = np.arange(400) * np.float64(0.002)


def by_difference_equation(plant: Dynamics, form: Form) -> list[float]:
    numerator, denominator = plant.coefficients(form=form)
    force: list[float] = []
    for n in range(len(COMMANDS)):
        fed = sum(b * COMMANDS[n - k] for k, b in enumerate(numerator) if n >= k)
        force.append(fed - sum(a * force[n - k] for k, a in enumerate(denominator) if 0 < k <= n))
    return force


@pytest.mark.parametrize("plant", PLANTS)
def test_a_simulation_is_what_the_coefficients_say_at_the_samples(plant: Dynamics) -> None:
    assert plant.simulate(COMMANDS, SAMPLES_S) == pytest.approx(by_difference_equation(plant, "hold"), rel=1e-6)


@pytest.mark.parametrize("plant", PLANTS[:2])
def test_the_thesis_form_feels_each_command_a_sample_earlier(plant: Dynamics) -> None:
    early = plant.simulate(COMMANDS, SAMPLES_S, form="thesis")
    later = plant.simulate(COMMANDS, SAMPLES_S + 0.002)

    assert early[:-1] == pytest.approx(later[:-1])
    if len(plant.lags_s) == 1:
        assert early == pytest.approx(by_difference_equation(plant, "thesis"))


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("form", ["hold", "thesis"])
def test_the_static_gain_is_that_of_the_coefficients(plant: Dynamics, form: Form) -> None:
    numerator, denominator = plant.coefficients(form=form)

    assert numerator.sum() / denominator.sum() == pytest.approx(plant.static_gain_n)
    assert plant.response(np.array([1e-6]), form=form)[0] == pytest.approx(plant.static_gain_n)
    assert denominator[0] == 1


@pytest.mark.parametrize("plant", PLANTS)
def test_a_step_ends_at_the_static_gain_and_begins_at_the_lead_s_share(plant: Dynamics) -> None:
    step = plant.step_response(np.array([-0.1, 0.0, 5.0]))

    assert step[0] == 0
    assert step[1] == pytest.approx(plant.static_gain_n * plant.lead_s / plant.lags_s[0], abs=1e-12)
    assert step[2] == pytest.approx(plant.static_gain_n)


def test_the_held_response_is_that_of_the_force_between_samples_too() -> None:
    plant, omega = PLANTS[1], 2 * np.pi * 5
    time_s = np.arange(0, 4, 1e-4)
    commands = np.cos(omega * 0.002 * np.arange(2000))
    force = plant.simulate(commands, time_s)
    late = time_s >= 2
    phasor = 2 * np.mean(force[late] * np.exp(-1j * omega * time_s[late]))

    assert phasor == pytest.approx(plant.response(np.array([omega]))[0], rel=1e-3)


def test_eq_3_15_and_3_16_as_gain_and_time_constant() -> None:
    assert EQ_3_15.static_gain_n == pytest.approx(6.0705967e-8 / (1 - 0.9745210))
    assert EQ_3_15.lags_s[0] == pytest.approx(0.0775, abs=1e-4)
    assert EQ_3_16.static_gain_n == pytest.approx(2.375e-6, rel=1e-3)
    assert EQ_3_16.lags_s[0] == pytest.approx(0.0647, abs=1e-4)
    assert static_gain(7.2345374e-8, 0.9695404) == EQ_3_16.static_gain_n
    assert math.exp(-0.002 / time_constant_s(0.9695404)) == pytest.approx(0.9695404)
    numerator, denominator = EQ_3_16.coefficients(form="thesis")
    assert numerator == pytest.approx([7.2345374e-8])
    assert denominator == pytest.approx([1, -0.9695404])
    # The slope of the thrust map at 30000, from eq. 3.3, is 3 % smaller.
    assert EQ_3_15.static_gain_n == pytest.approx(2 * 2.130295e-11 * 30000 + 1.032633e-6, rel=0.04)


def test_eq_3_11_is_evaluated_in_rising_powers() -> None:
    z = np.exp(0.3j)

    assert evaluate(np.array([1.0, 2.0]), np.array([1.0, -0.5, 0.2]), np.array([0.3]))[0] == pytest.approx(
        (1 + 2 / z) / (1 - 0.5 / z + 0.2 / z**2)
    )
