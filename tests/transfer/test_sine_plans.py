"""The sines that `cfid log sine` plays by default, and the duration that it states before a motor turns."""

from pathlib import Path

import numpy as np
import pytest

from cfid.records.campaign import open_campaign
from cfid.transfer.plan import THESIS_FIRST, THESIS_SECOND, log_spaced
from tests.lab import new_campaign, run_cfid
from tests.virtual_bench import bench_in


@pytest.mark.parametrize("samples", [4000, 8000, 3989, 500, 120])
def test_the_usual_plan_is_even_over_the_logarithm_of_frequency_up_to_12_5_hz(samples: int) -> None:
    periods = sorted(log_spaced(samples).periods)
    most = samples // 40

    assert periods[0] == 2  # one period cannot be distinguished from a drift
    assert periods[-1] == most
    assert len(set(periods)) == len(periods)
    assert np.all(np.diff(np.log([own for own in periods if own >= 8])) < 0.42)
    assert len(periods) >= min(10, most - 1)


def test_the_thesis_plans_are_table_3_1_as_far_as_it_tells() -> None:
    for plan, count, samples, motor in ((THESIS_FIRST, 43, 4000, 1), (THESIS_SECOND, 40, 8000, 3)):
        assert len(set(plan.periods)) == count
        assert (plan.periods[0], plan.periods[-1]) == (0, samples // 2)
        assert (plan.samples, plan.amplitude, plan.motors) == (samples, 20000, (motor,))
        assert np.all(np.diff(plan.periods, 2) >= 0)  # "not constant but increasing"
    assert THESIS_FIRST.periods[:33] == (*range(16), *range(20, 101, 5))


@pytest.mark.parametrize(
    ("words", "lasts", "made_up", "left_out"),
    [
        ("", "20 sines of 12 s: 3:50 min", False, False),
        ("--plan thesis-second --amplitude 15000", "40 sines of 20 s: 13:00 min", True, True),
        ("--hz 1,5,15 --for 4", "3 sines", False, True),
    ],
)
def test_a_plan_states_its_duration_what_of_it_is_made_up_and_that_a_fit_leaves_sines_out(
    tmp_path: Path, words: str, lasts: str, made_up: bool, left_out: bool
) -> None:
    new_campaign(tmp_path)
    ended = run_cfid(["log", "sine", "--dry-run", *words.split()], tmp_path)

    assert ended.stdout.startswith(lasts)
    assert ("reconstructed" in ended.stderr, "cut-off" in ended.stderr) == (made_up, left_out)


def test_motors_of_a_list_are_driven_one_after_the_other(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        words = ("log", "sine", "--hz", "25", "--for", 0.2, "--motor", "3,1")
        rehearsed = bench.start(*words, "--dry-run")
        assert rehearsed.end() == 0
        assert "2 sines of 4 s on motors 1, 3" in rehearsed.out
        assert bench.start(*words, "--yes").end() == 0
        headers = [run.header for run in open_campaign(tmp_path).runs(kind="sine", complete=False)]

    played = [(header.requested["motor"], header.requested["series"]) for header in headers]
    assert played == [(1, "motor1"), (3, "motor3")]


def test_the_duration_stands_before_the_question(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start("log", "sine", "--hz", "3,5", "--for", 1)
        assert pilot.end() == 2
        assert len(bench.history) == 1
    assert "0:09 min" in pilot.err.partition("?")[0]
