"""Round trips and clocks over channels that are not ideal: bursts, congestion, latencies that are not exponential."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from cfid.latency.clocks import clock_line
from cfid.latency.result import quantiles, round_trips
from tests.coverage_rows import Array, Row, reaches_93_percent

EVERY_S, RATE, LEAST_S = 0.1, 1.00002, 0.005


def exponential(count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return latencies beyond the smallest (n,) in s, and their true mean."""
    return rng.exponential(2e-3, count), 2e-3


def gamma(count: int, rng: np.random.Generator) -> tuple[Array, float]:
    return rng.gamma(4.0, 1e-3, count), 4e-3


def rounded(count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return latencies without a sharp edge: hardly any is near the smallest."""
    return rng.gamma(2.0, 2e-3, count), 4e-3


def bursts(count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return latencies with retries in bursts: one packet in ten, in runs of ten on average."""
    busy, state = np.zeros(count, dtype=bool), False
    for place, draw in enumerate(rng.random(count).tolist()):
        state = draw > 1 / 10 if state else draw < 1 / 90
        busy[place] = state
    return rng.exponential(1e-3, count) + busy * rng.exponential(20e-3, count), 3e-3


def congestion(count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return latencies whose minimum wanders by 1 ms, with a correlation time of 3 s."""
    decay = np.exp(-EVERY_S / 3.0)
    wander = lfilter([1.0], [1.0, -decay], np.sqrt(1 - decay**2) * rng.standard_normal(count + 500))[500:]
    return 5e-3 + 1e-3 * wander + rng.gamma(3.0, 5e-4, count), 6.5e-3


CHANNELS = {"exponential": exponential, "gamma": gamma, "rounded": rounded, "bursts": bursts, "congestion": congestion}


def rows(name: str, campaigns: int, *, count: int, seed: int) -> tuple[Row, Row]:
    draw: Callable[[int, np.random.Generator], tuple[Array, float]] = CHANNELS[name]
    rng, device_s = np.random.default_rng(seed), EVERY_S * np.arange(float(count))
    found = []
    for _ in range(campaigns):
        late_s, mean_s = draw(count, rng)
        trips, line = round_trips(LEAST_S + late_s), clock_line(device_s, RATE * device_s + LEAST_S + late_s)
        found.append((trips.mean_s - LEAST_S - mean_s, trips.mean_std_s, line.rate - RATE, line.rate_std))
    mean, mean_std, rate, rate_std = np.array(found).T
    kind = f"{name}, {count} pings"
    return Row(f"ping: mean, {kind}", mean, mean_std, 5e-3), Row(f"ping: skew, {kind}", rate, rate_std, 1e-2)


QUICK = [
    ("gamma", 1000),
    ("rounded", 300),
    ("bursts", 2000),
]
# 500 pings of the others are too few to show how they are correlated, and are marked
MANY = [("exponential", 500), ("gamma", 500), ("rounded", 300), *((name, 2000) for name in CHANNELS)]


@pytest.mark.parametrize(
    ("name", "count", "campaigns"),
    [*((*one, 40) for one in QUICK), *(pytest.param(*one, 1000, marks=pytest.mark.slow) for one in MANY)],
)
def test_round_trips_and_clocks_lie_within_their_intervals(name: str, count: int, campaigns: int) -> None:
    for row in rows(name, campaigns, count=count, seed=1 if campaigns == 40 else 2):
        print(row)
        assert row.covers()


@pytest.mark.parametrize(("name", "marked"), [("exponential", 0), ("gamma", 0), ("bursts", 45), ("congestion", 50)])
def test_short_records_of_a_busy_channel_are_marked(name: str, marked: int) -> None:
    rng = np.random.default_rng(3)
    found = sum(round_trips(LEAST_S + CHANNELS[name](500, rng)[0]).are_correlated for _ in range(50))

    assert found == 0 if marked == 0 else found >= marked


@pytest.mark.parametrize("name", ["rounded", "bursts"])
def test_median_and_percentile_lie_within_their_intervals(name: str) -> None:
    rng = np.random.default_rng(7)
    true_s = np.quantile(CHANNELS[name](400_000, rng)[0], (0.5, 0.95))
    held = []
    for _ in range(40):
        value, std = quantiles(CHANNELS[name](2000, rng)[0])
        held += (np.abs(value - true_s) < 1.96 * std).tolist()

    assert reaches_93_percent(held)
