"""Signals at rest: simulated noise, drift and lines are found, and noise alone shows no line."""

import numpy as np
import pytest

from cfid.estimate.signals import signal_quality

RATE_HZ = 1000.0
TIME_S = np.arange(10_000) / RATE_HZ


@pytest.mark.parametrize("mains_hz", [50.0, 60.0])
def test_mains_another_line_and_drift_are_found_with_their_sizes(mains_hz: float) -> None:
    noise = np.random.default_rng(1).normal(0, 1.0, len(TIME_S))
    hum, line = 0.5 * np.sin(2 * np.pi * mains_hz * TIME_S), 0.8 * np.cos(2 * np.pi * 137.3 * TIME_S)

    found = signal_quality(7.0 + noise + hum + line + 0.3 * TIME_S / 10, rate_hz=RATE_HZ)

    assert found.mains_hz == pytest.approx(mains_hz, abs=0.2)
    assert found.mains == pytest.approx(0.5, rel=0.2)
    assert found.line_hz == pytest.approx(137.3, abs=0.2)
    assert found.line == pytest.approx(0.8, rel=0.2)
    assert found.drift == pytest.approx(0.3, abs=4 * found.drift_std)
    assert found.noise_std == pytest.approx(np.sqrt(1 + 0.5**2 / 2 + 0.8**2 / 2), rel=0.03)


def test_noise_alone_shows_no_line_and_no_drift() -> None:
    alone = [np.random.default_rng(seed).normal(0, 2.0, len(TIME_S)) for seed in range(100)]

    found = [signal_quality(signal, rate_hz=RATE_HZ) for signal in alone]

    assert sum(np.isfinite(one.line_hz) for one in found) <= 1
    assert sum(abs(one.drift) > 3 * one.drift_std for one in found) <= 3
    assert all(one.noise_std == pytest.approx(2.0, rel=0.04) for one in found)
