"""A rotor's delay that is negative, or consistent with zero, is reported as such."""

import math

import pytest

from cfid.motors.delays import delay_text, negative_delay


@pytest.mark.parametrize(
    ("delay_ms", "std_ms", "told"), [(-9.0, 1.0, True), (-1.0, 1.0, False), (9.0, 1.0, False), (-9.0, math.nan, False)]
)
def test_a_delay_is_explained_where_it_is_surely_negative(delay_ms: float, std_ms: float, told: bool) -> None:
    found = negative_delay(1e-3 * delay_ms, 1e-3 * std_ms, "dynamics.delay_s")

    assert [(one.code, one.severity) for one in found] == [("rotor-delay-negative", "note")] * told
    assert not told or "9.0 +- 1 ms before its command as stamped" in found[0].text


def test_a_delay_within_its_uncertainty_is_consistent_with_zero() -> None:
    assert delay_text(-0.0004, 0.0003) == "delay consistent with zero: -0.4 +- 0.3 ms"
    assert delay_text(0.027, 0.001) == "delay 27.0 +- 1 ms"
