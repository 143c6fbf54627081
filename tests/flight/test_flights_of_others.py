"""Public logs of flights: what their authors found, and what must not depend on how the fit is written."""

from functools import cache

import numpy as np
import pytest

from cfid.flight.data import read_flight
from cfid.flight.estimation import FlightFit, fit_flights
from cfid.flight.result import Body, fit
from tests.places import DATA

FLIGHTS = DATA / "flights"
MASS_KG = 0.027  # as all authors state it
AUTHORS_LEVER_M = 0.028
AUTHORS_G = 9.18 / 9.81  # their notebook multiplies accelerations in g by 9.18
AUTHORS = (1.03e-5, 1.10e-5)  # about roll and pitch
# Their windows, 35 to 65 s and 55 to 90 s of the logs' own times, since the first row.
LOG10, LOG15 = ("eschmann_log10.usd", 8.76, 39.12), ("eschmann_log15.usd", 15.94, 51.36)
HALVES = (("eschmann_log15.usd", 15.94, 33.6), ("eschmann_log15.usd", 33.6, 51.36))

pytestmark = pytest.mark.skipif(not FLIGHTS.is_dir(), reason="the public flights are not here (CFID_DATA)")


@cache
def fitted(*windows: tuple[str, float, float]) -> FlightFit:
    return fit_flights([read_flight(FLIGHTS / name, from_s=a, to_s=b).flight for name, a, b in windows])


def test_the_time_constant_of_the_climbing_flight_is_its_authors() -> None:
    found = fitted(LOG10)
    assert 0.070 < (found.lag.rising_s + found.lag.falling_s) / 2 < 0.078


@pytest.mark.slow
def test_moments_are_the_authors_with_their_acceleration_of_free_fall_mended() -> None:
    found = fitted(LOG10, LOG15)
    for place, stated in enumerate(AUTHORS):
        gain, std = found.values[5 + place], found.std[5 + place]
        moment = AUTHORS_LEVER_M * MASS_KG / gain
        print(f"{moment:.4g} kg m^2 +- {100 * std / gain:.1f} %, authors {stated / AUTHORS_G:.4g}")
        assert std < 0.1 * gain
        assert abs(moment - stated / AUTHORS_G) < 2 * moment * std / gain


@pytest.mark.slow
def test_halves_of_a_flight_give_the_same_moments_within_their_uncertainty() -> None:
    first, second = (fitted(LOG10, half) for half in HALVES)
    for place in (5, 6):
        apart = float(np.log(first.values[place] / second.values[place]))
        both = np.hypot(first.std[place] / first.values[place], second.std[place] / second.values[place])
        print(f"halves {100 * apart:+.1f} % apart, joint uncertainty {100 * both:.1f} %")
        assert abs(apart) < 2 * both


def test_circles_and_helices_give_drag_and_refuse_the_rest() -> None:
    names = ("nanobench_B2_circle_fast_rep2.csv", "nanobench_B5_helix_fast_rep1.csv")
    body = Body(mass_kg=MASS_KG, mass_std_kg=0.0003, arm_m=0.046, arm_std_m=0.0003)
    result = fit([read_flight(FLIGHTS / name) for name in names], body=body)
    rejections = {finding.code for finding in result.findings if finding.severity == "rejection"}
    assert "flight-thrust-not-excited" in rejections
    assert not any("inertia" in key or "thrust" in key for key in result.without_rejected().quantities)
    assert result.accepted
    for axis in ("forward", "left"):
        one = result.quantities[f"flight.drag_over_mass_per_s.{axis}"]
        print(f"{axis}: {one.value:.3f} +- {one.std:.3f} 1/s")
        assert one.value - 1.96 * one.std < 0.42
        assert one.value + 1.96 * one.std > 0.39
        assert one.std < 0.02
