"""The intervals of a transfer function contain the truth in 93 to 97 % of many simulated series."""

import numpy as np
import pytest

from cfid.transfer.alignment import align
from cfid.transfer.estimation import fit_transfer, measure
from tests.offline.sine_bench import simulate_sines
from tests.transfer.sine_recordings import GAIN_N, LAG_S, SHAKEN, USUAL, log_spaced, recorded

COUNT = 400


@pytest.mark.slow
@pytest.mark.parametrize(("periods", "samples"), [(log_spaced(20, 100), 4000), (log_spaced(22, 200), 8000)])
@pytest.mark.parametrize("stamped", [True, False])
def test_intervals_cover_as_they_promise(periods: tuple[int, ...], samples: int, stamped: bool) -> None:
    scores, errors, rejected = [], [], 0
    for seed in range(COUNT):
        runs = simulate_sines(SHAKEN, periods=periods, samples=samples, rng=np.random.default_rng(seed))
        fit = fit_transfer([measure("first", align(recorded(runs, stamped=stamped)))])
        delay = fit.delays["first"]
        off = np.array([fit.gain_n - GAIN_N, fit.time_constant_s - LAG_S, delay.delay_s - USUAL.delay_s])
        scores.append(off / [fit.std[0], fit.time_constant_std_s, delay.std_s])
        errors.append(off)
        rejected += fit.probability < 0.001
    covered = np.mean(np.abs(scores) < 1.96, axis=0)
    scatter = np.std(errors, axis=0) / [GAIN_N, LAG_S, 1e-3]

    print(
        f"{len(periods)} frequencies of N = {samples}, {'on-board' if stamped else 'host'} stamps: 95 % intervals hold "
        f"gain {covered[0]:.3f}, time constant {covered[1]:.3f}, delay {covered[2]:.3f}; scatter {scatter[0]:.2%}, "
        f"{scatter[1]:.2%}, {scatter[2]:.2f} ms; {rejected} of {COUNT} rejected at 0.001"
    )
    assert np.all((covered > 0.925) & (covered < 0.98))  # 93 to 97 %, widened by the sampling error of 400 series
    assert rejected < 0.03 * COUNT
