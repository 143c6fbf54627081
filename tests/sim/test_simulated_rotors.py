"""The simulated rotors settle, lag and vibrate as their closed forms state."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.sim.propulsion import RotorTruth, SimulatedRotors

SMOOTH = RotorTruth(unbalance=(0.0,) * 6, blade_pass=(0.0,) * 6)
HZ = 7000
SECOND = np.arange(HZ) / HZ
ONLY_FIRST = np.array([40000.0, 0, 0, 0])
ALL = np.full(4, 40000.0)


def _rotors(truth: RotorTruth = SMOOTH) -> SimulatedRotors:
    return SimulatedRotors(truth, np.random.default_rng(3))


def test_one_motor_lifts_and_tilts_and_twists_as_its_place_and_sense_of_rotation_say() -> None:
    wrench = _rotors().advance(SECOND, ONLY_FIRST)[-1]
    thrust_n = 1.8e-8 * (381.0 + 0.0408 * 40000) ** 2
    arm_m = 0.046 / math.sqrt(2)
    np.testing.assert_allclose(wrench, thrust_n * np.array([0, 0, 1, -arm_m, -arm_m, -0.006]), rtol=1e-6)


@pytest.mark.parametrize(
    ("command", "thesis_n"),
    [(20000, 0.029722), (40000, 0.075939), (60000, 0.139197)],  # 2.130295e-11 u^2 + 1.032633e-6 u + 5.48456e-4
)
def test_thrust_is_near_the_thesis_polynomial(command: float, thesis_n: float) -> None:
    wrench = _rotors().advance(SECOND, np.array([command, 0, 0, 0]))[-1]
    assert wrench[2] == pytest.approx(thesis_n, rel=0.2)


def test_below_the_dead_zone_a_rotor_stands() -> None:
    rotors = _rotors()
    assert not rotors.advance(SECOND, np.full(4, 999.0)).any()
    assert not rotors.speed_rad_per_s.any()


def test_speed_has_covered_63_percent_after_the_time_constant() -> None:
    rotors = _rotors()
    rotors.advance(np.array([0.0]), ALL)
    rotors.advance(np.array([0.06]), ALL)
    steady = 381.0 + 0.0408 * 40000
    np.testing.assert_allclose(rotors.speed_rad_per_s, (1 - math.exp(-1)) * steady)


@given(cuts=st.lists(st.integers(1, 999), max_size=6))
def test_the_slicing_into_calls_changes_nothing(cuts: list[int]) -> None:
    time_s = np.arange(1000) / HZ
    whole = _rotors(RotorTruth()).advance(time_s, ALL)
    rotors = _rotors(RotorTruth())
    parts = [rotors.advance(part, ALL) for part in np.split(time_s, sorted(set(cuts)))]
    np.testing.assert_allclose(np.vstack(parts), whole, atol=1e-9)


def test_a_stopped_rotor_comes_to_rest_and_all_forces_vanish() -> None:
    rotors = _rotors(RotorTruth())
    rotors.advance(SECOND, ALL)
    rotors.advance(1 + SECOND, np.zeros(4))
    assert not rotors.advance(2 + SECOND, np.zeros(4)).any()


def test_vibration_stands_at_rotor_and_blade_frequency_alone() -> None:
    rotors = _rotors(RotorTruth())
    rotors.advance(SECOND, ONLY_FIRST)
    spectrum = np.abs(np.fft.rfft(rotors.advance(1 + SECOND, ONLY_FIRST)[:, 2] * np.hanning(HZ)))
    rotor_hz = (381.0 + 0.0408 * 40000) / math.tau
    loudest = np.argsort(spectrum[10:])[::-1][:4] + 10
    for hz in loudest:
        assert min(abs(hz - rotor_hz), abs(hz - 2 * rotor_hz)) < 2
    away = np.ones(len(spectrum), bool)
    for line in (0, rotor_hz, 2 * rotor_hz):
        away[max(0, int(line) - 10) : int(line) + 11] = False
    assert spectrum[away].max() < 1e-3 * spectrum[loudest].max()
