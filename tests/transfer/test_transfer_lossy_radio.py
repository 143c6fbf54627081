"""Transfer functions of sines, with host stamps only, after the radio lost some of their reports."""

from dataclasses import replace

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.sim.link import RadioTruth
from cfid.transfer.estimation import fit_transfer, measure
from cfid.transfer.sines.alignment import RecordedSine, align
from cfid.transfer.sines.reports import match_reports
from tests.coverage_rows import Row
from tests.offline.sine_bench import simulate_sines
from tests.transfer.sine_recordings import GAIN_N, LAG_S, SHAKEN, USUAL, log_spaced, recorded


def is_whole(run: RecordedSine) -> bool:
    """Return whether the run kept its first and last reports; without them it is refused and has to be repeated."""
    try:
        match_reports(run.sine, run.reports)
    except DataError:
        return False
    return True


def rows(loss: float, campaigns: int) -> list[Row]:
    bench = replace(USUAL, radio=RadioTruth(latency_s=0.028, jitter_s=0.016, loss=loss))
    found, rejected = [], 0
    for seed in range(campaigns):
        rng = np.random.default_rng(seed)
        runs = recorded(
            simulate_sines(SHAKEN, periods=log_spaced(20, 100), samples=4000, rng=rng, bench=bench), stamped=False
        )
        fit = fit_transfer([measure("first", align([run for run in runs if is_whole(run)]))])
        delay = fit.delays["first"]
        rejected += not fit.accepted
        found.append(
            (
                (fit.dynamics.static_gain_n - GAIN_N, fit.std.static_gain_n),
                (fit.time_constant_s - LAG_S, fit.time_constant_std_s),
                (delay.delay_s - USUAL.delay_s, delay.std_s),
            )
        )
    names = {"gain": GAIN_N, "time constant": LAG_S, "delay": USUAL.delay_s}
    return [
        Row(f"transfer: {name}, {100 * loss:g} % lost", own[:, 0], own[:, 1], scale, rejected)
        for (name, scale), own in zip(names.items(), np.array(found).transpose(1, 0, 2), strict=True)
    ]


def test_a_lossy_radio_leaves_the_intervals_true() -> None:
    for row in rows(0.03, 12):
        print(row)
        assert row.covers()
        assert row.rejected == 0


@pytest.mark.slow
@pytest.mark.parametrize("loss", [0.0, 0.01, 0.03, 0.1])
def test_lossy_radios_leave_the_intervals_true_over_many_campaigns(loss: float) -> None:
    for row in rows(loss, 200):
        print(row)
        assert row.covers()
        assert row.rejected <= (0.02 if loss < 0.1 else 0.1) * 200
