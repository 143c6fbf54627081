"""A cubic that rises over all voltages: the best fit, with a correct uncertainty, refused where data contradict it."""

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import minimize

from cfid.errors import FitError
from cfid.estimate.monotone_cubic import MonotoneCubic, constrain
from cfid.estimate.polynomials import fit_polynomial
from cfid.estimate.voltage_cubic import firmware_volts

Array = npt.NDArray[np.float64]

VOLTS = np.repeat(np.linspace(0.4, 3.8, 18), 2)
INSIDE = np.array([0.002, 0.0130, 0.0050, 0.0010])  # lowest power first; rises over all voltages
SQUARE = np.array([0.0, 0.0, 0.0105, 0.0])  # the thrust of a rotor whose speed is proportional to voltage
FOLDED = np.array([0.0, 0.0, 0.02, -0.0025])  # bends down, as with a battery that sags


def value_of(lowest_first: Array, volts: Array) -> Array:
    return np.asarray(np.polynomial.polynomial.polyval(volts, lowest_first))


def fitted(lowest_first: Array, *, seed: int, noise_n: float = 2e-4, stated: bool = True) -> MonotoneCubic:
    thrust = value_of(lowest_first, VOLTS) + noise_n * np.random.default_rng(seed).standard_normal(len(VOLTS))
    std = np.full_like(VOLTS, noise_n) if stated else None
    return constrain(fit_polynomial(VOLTS, thrust, order=3, std=std), thrust_n=thrust, std_n=std)


def test_a_cubic_that_rises_anyway_stays_as_it_is() -> None:
    thrust = value_of(INSIDE, VOLTS)
    free = fit_polynomial(VOLTS, thrust, order=3)
    found = constrain(free, thrust_n=thrust)

    assert found.fit is free
    assert (found.bound, found.departure, found.refusal) == (False, 0.0, "")


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("truth", [SQUARE, FOLDED], ids=["square", "folded"])
def test_it_is_the_least_squares_cubic_among_those_that_rise(truth: Array, seed: int) -> None:
    """The reference is a general optimiser with the constraint; points weigh alike, since no uncertainty is stated."""
    thrust = value_of(truth, VOLTS) + 2e-4 * np.random.default_rng(seed).standard_normal(len(VOLTS))
    found = constrain(fit_polynomial(VOLTS, thrust, order=3), thrust_n=thrust)
    scale = np.array([0.1, 0.1 / 4, 0.1 / 16, 0.1 / 64])

    def misfit(c: Array) -> float:
        return float(np.sum((value_of(c * scale, VOLTS) - thrust) ** 2)) * 1e4

    rises = [
        {"type": "ineq", "fun": lambda c: c[1]},
        {"type": "ineq", "fun": lambda c: c[3]},
        {"type": "ineq", "fun": lambda c: 3 * c[1] * c[3] - c[2] ** 2},
    ]
    starts = [np.array([0.0, 0.5, 0.2, 0.2]), np.array([0.1, 0.2, -0.05, 0.3])]
    other = min((minimize(misfit, start, constraints=rises, tol=1e-12) for start in starts), key=lambda r: r.fun)
    _, c1, c2, c3 = found.fit.coefficients[::-1]

    assert found.bound
    assert c1 > 0
    assert c3 > 0
    assert c2**2 < 3 * c1 * c3
    assert misfit(found.fit.coefficients[::-1] / scale) == pytest.approx(other.fun, rel=2e-3)


def test_the_firmware_finds_the_voltage_of_what_it_gives() -> None:
    found = fitted(SQUARE, seed=1)
    volts = np.linspace(1.5, 4.2, 500)

    assert firmware_volts(found.fit.coefficients[::-1], found.fit.at(volts)) == pytest.approx(volts, abs=0.005)


def test_what_rises_is_accepted_and_what_folds_is_refused_with_the_numbers() -> None:
    assert not any(fitted(INSIDE, seed=seed).refusal for seed in range(40))
    assert not any(fitted(SQUARE, seed=seed).refusal for seed in range(20))  # departs by less than 1 %
    messages = [fitted(FOLDED, seed=seed).refusal for seed in range(20)]
    assert all("no voltage cubic for the firmware" in one for one in messages)
    assert "% of the largest thrust at" in messages[0]


@pytest.mark.parametrize("truth", [INSIDE, SQUARE], ids=["inside, near the surface", "outside"])
def test_stated_uncertainties_are_those_of_repeated_campaigns(truth: Array) -> None:
    """Thrusts are compared, since users need those."""
    volts = np.linspace(1.5, 3.8, 10)
    found = [fitted(truth, seed=seed, noise_n=1e-3) for seed in range(100)]
    scatter = np.std([one.fit.at(volts) for one in found], axis=0, ddof=1)
    stated = np.sqrt(np.mean([one.fit.std_at(volts) ** 2 for one in found], axis=0))
    print(np.mean([one.bound for one in found]), np.round(stated / scatter, 2))

    assert np.any([one.bound for one in found])
    assert np.all(stated / scatter > 0.8)
    assert np.all(stated / scatter < 1.6)


def test_another_order_and_thrust_that_falls_are_refused() -> None:
    thrust = value_of(INSIDE, VOLTS)
    with pytest.raises(FitError, match="order 2"):
        constrain(fit_polynomial(VOLTS, thrust, order=2), thrust_n=thrust)
    with pytest.raises(FitError, match="does not rise with motor voltage"):
        constrain(fit_polynomial(VOLTS, -thrust, order=3), thrust_n=-thrust)
