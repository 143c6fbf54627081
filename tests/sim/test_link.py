"""The simulated radio: its delays, its losses, and the order of its packets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.sim.link import Direction, RadioTruth


def _latencies(truth: RadioTruth, *, every_s: float = 1.0, count: int = 5000) -> list[float]:
    direction = Direction(truth, np.random.default_rng(2))
    arrivals = [(direction.arrival_s(k * every_s), k * every_s) for k in range(count)]
    return [arrival_s - sent_s for arrival_s, sent_s in arrivals if arrival_s is not None]


def test_latency_has_the_mean_the_scatter_and_the_minimum_of_its_truth() -> None:
    latencies = _latencies(RadioTruth(latency_s=0.028, jitter_s=0.008))
    assert np.mean(latencies) == pytest.approx(0.028, rel=0.02)
    assert np.std(latencies) == pytest.approx(0.008, rel=0.05)
    assert 0.020 <= min(latencies) < 0.0201


def test_as_many_packets_are_lost_as_its_truth_says() -> None:
    assert len(_latencies(RadioTruth(loss=0.1))) == pytest.approx(4500, abs=70)
    assert _latencies(RadioTruth(loss=1.0)) == []
    assert len(_latencies(RadioTruth())) == 5000


@given(gaps_s=st.lists(st.floats(0, 0.01), min_size=2, max_size=50))
def test_no_packet_overtakes_another(gaps_s: list[float]) -> None:
    direction = Direction(RadioTruth(latency_s=0.02, jitter_s=0.02), np.random.default_rng(1))
    arrivals = [direction.arrival_s(sent_s) or 0.0 for sent_s in np.cumsum(gaps_s)]
    assert arrivals == sorted(arrivals)
