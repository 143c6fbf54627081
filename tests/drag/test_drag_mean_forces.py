"""One mean force per command, less the tare: its value, sign and standard uncertainty, with known noise."""

from collections.abc import Callable
from typing import TypedDict

import numpy as np
import numpy.typing as npt
import pytest

from cfid.drag.data import MeanForce, mean_force, mean_force_thesis
from cfid.errors import DataError, FitError

RATE_HZ, NOISE_N = 500.0, 0.01
TARE_N, FORCE_N = np.array([0.2, -0.1, 0.4]), np.array([0.03, 0.02, 0.25])
RUNS_S, PAUSE_S = (2.0, 6.0), 1.0  # the tare has 1000 samples, of which the thesis uses 500
WINDOW_S = (3.0, 5.0)


class Recorded(TypedDict):
    time_s: npt.NDArray[np.float64]
    force_n: npt.NDArray[np.float64]


def record(seed: int, *, pause_after: bool = True) -> Recorded:
    """Return a load cell's record of white noise on a constant tare, with a force while the motors run."""
    time_s = np.arange(0, RUNS_S[1] + (2.0 if pause_after else 0.0), 1 / RATE_HZ)
    running = (time_s >= RUNS_S[0]) & (time_s < RUNS_S[1])
    noise = np.random.default_rng(seed).normal(0, NOISE_N, (len(time_s), 3))
    return {"time_s": time_s, "force_n": TARE_N + running[:, np.newaxis] * FORCE_N + noise}


def test_the_tare_is_subtracted() -> None:
    for found in (
        mean_force(**record(1), command=20000),
        mean_force_thesis(**record(1), command=20000),
        mean_force_thesis(**record(1), command=20000, window_s=WINDOW_S),
    ):
        np.testing.assert_allclose(found.force_n, FORCE_N, atol=5 * NOISE_N / np.sqrt(500))
        assert RUNS_S[0] <= found.window_s[0] < found.window_s[1] <= RUNS_S[1]


@pytest.mark.parametrize("method", [mean_force, mean_force_thesis])
def test_stated_uncertainties_are_those_of_the_errors(method: Callable[..., MeanForce]) -> None:
    found = [method(**record(seed), command=20000, window_s=WINDOW_S) for seed in range(40)]
    errors = np.array([one.force_n - FORCE_N for one in found])
    stated = np.array([one.std_n for one in found])

    # The root mean square of 120 errors is known to 6.5 %.
    assert float(np.sqrt(np.mean((errors / stated) ** 2))) == pytest.approx(1, abs=0.25)


def test_a_command_without_a_pause_after_it_has_a_warning() -> None:
    assert [one.code for one in mean_force(**record(1, pause_after=False), command=20000).findings] == [
        "no-baseline-after"
    ]
    assert mean_force(**record(1), command=20000).findings == ()


def test_readings_that_rows_repeat_count_once_and_explain_steps_that_are_none() -> None:
    time_s = record(3)["time_s"]
    read = np.arange(len(time_s)) // 25 * 25  # a load cell that is read at 20 Hz
    mean = mean_force(time_s=time_s, force_n=record(3)["force_n"][read], command=20000)

    assert np.all(np.abs(mean.force_n - FORCE_N) < 3 * mean.std_n)
    noise = np.random.default_rng(1).normal(0, 5 * NOISE_N, (len(time_s), 3))
    with pytest.raises(FitError, match="Readings repeat in about 25 rows: the scatter of so few may look like steps"):
        mean_force(time_s=time_s, force_n=(record(1)["force_n"] + noise)[read], command=20000)


def test_spikes_do_not_move_the_mean() -> None:
    whole = record(1)
    spoilt = whole["force_n"].copy()
    spoilt[[400, 1501, 1700, 2202], [0, 1, 2, 2]] += (5.0, -30.0, 2000.0, 1e5)

    sound, mean = mean_force(**whole, command=20000), mean_force(time_s=whole["time_s"], force_n=spoilt, command=20000)
    np.testing.assert_allclose(mean.force_n, sound.force_n, atol=sound.std_n.min())


def test_a_record_or_window_that_is_too_short_is_refused() -> None:
    whole = record(1)
    with pytest.raises(DataError, match="500 samples: the thesis takes its tare from the first 500"):
        mean_force_thesis(time_s=whole["time_s"][:500], force_n=whole["force_n"][:500], command=20000)
    with pytest.raises(DataError, match=r"from 3 to 3\.03 s has 15 samples; 16 are needed"):
        mean_force_thesis(**whole, command=20000, window_s=(3.0, 3.03))
