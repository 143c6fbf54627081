"""The sines that `cfid log sine` plays by default, and the duration that it states before a motor turns."""

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cfid.records.campaign import open_campaign
from cfid.transfer.sines.plan import THESIS_FIRST, THESIS_SECOND, SineSweep, log_spaced
from tests.flying_in_a_folder import bench_in

pytestmark = pytest.mark.usefixtures("in_time")

Cfid = Callable[..., subprocess.CompletedProcess[str]]


@pytest.mark.parametrize("samples", [4000, 8000, 3989, 500, 120])
def test_the_usual_plan_is_even_over_the_logarithm_of_frequency_up_to_12_5_hz(samples: int) -> None:
    periods = sorted(log_spaced(samples).periods)
    most = samples // 40

    assert periods[0] == 2  # one period cannot be distinguished from a drift
    assert periods[-1] == most
    assert len(set(periods)) == len(periods)
    steps = np.diff(np.log([own for own in periods if own >= 8]))
    assert np.all(steps < 0.42)
    assert len(periods) >= min(10, most - 1)


def test_frequency_goes_up_and_comes_down_so_that_no_drift_passes_for_a_time_constant() -> None:
    periods = np.array(log_spaced(4000).periods)
    time = np.arange(len(periods)) - (len(periods) - 1) / 2

    assert abs(np.corrcoef(time, np.log(periods))[0, 1]) < 0.1


def test_the_usual_plan_divides_n_where_it_can() -> None:
    periods = log_spaced(4000).periods

    assert {2, 4, 5, 8, 16, 20, 25, 32, 40, 50, 80, 100} <= set(periods)
    assert "13 divide N" in log_spaced(4000).text


def test_the_thesis_plans_are_table_3_1_as_far_as_it_tells() -> None:
    for plan, count, samples, motor in ((THESIS_FIRST, 43, 4000, 1), (THESIS_SECOND, 40, 8000, 3)):
        assert len(set(plan.periods)) == count
        assert (plan.periods[0], plan.periods[-1]) == (0, samples // 2)
        assert (plan.samples, plan.amplitude, plan.motors) == (samples, 20000, (motor,))
        assert np.all(np.diff(plan.periods, 2) >= 0)  # "not constant but increasing"
        assert "reconstructed" in plan.text
    assert THESIS_FIRST.periods[:33] == (*range(16), *range(20, 101, 5))


def test_a_plan_is_told_with_its_duration_and_what_of_it_is_made_up(cfid: Cfid, tmp_path: Path) -> None:
    assert cfid("new", str(tmp_path)).returncode == 0
    usual, thesis = (
        cfid("log", "sine", "--dry-run", "--campaign", str(tmp_path), *words)
        for words in ((), ("--plan", "thesis-second", "--amplitude", "15000"))
    )

    assert usual.stdout == "20 sines of 12 s: 3:50 min\n"
    assert "l = 2, 4, 6, 8, 13," in usual.stderr
    assert thesis.stdout == "40 sines of 20 s: 13:00 min\n"
    assert "reconstructed" in thesis.stderr
    assert "reconstructed" in " ".join(cfid("log", "sine", "--help").stdout.split())


@pytest.mark.parametrize(
    ("words", "left_out"),
    [
        ("--l 4,20,60 --n 2000", "l = 60"),
        ("--plan thesis-first", "l = 110, 150, 200,"),
        ("--l 50 --n 2000", ""),
        ("", ""),
    ],
)
def test_sines_that_their_fit_leaves_out_are_named_before_they_are_played(
    cfid: Cfid, tmp_path: Path, words: str, left_out: str
) -> None:
    assert cfid("new", str(tmp_path)).returncode == 0
    said = " ".join(cfid("log", "sine", "--dry-run", "--campaign", str(tmp_path), *words.split()).stderr.split())

    assert ("above the cut-off of 12.5 Hz: `cfid tf identify` leaves such sines out" in said) == bool(left_out)
    assert left_out in said


def test_several_motors_play_in_turn_and_each_makes_a_series() -> None:
    alone = SineSweep(periods=(2, 4), samples=500, motors=(3,), series="second")
    both = replace(alone, motors=(0, 3))

    assert [(one.motor, one.periods, one.series) for one in alone.sines] == [(3, 2, "second"), (3, 4, "second")]
    assert [(one.motor, one.periods) for one in both.sines] == [(0, 2), (0, 4), (3, 2), (3, 4)]
    assert [one.series for one in both.sines] == ["second_all", "second_all", "second_motor3", "second_motor3"]
    assert [one.series for one in replace(both, series=None).sines][::2] == ["all", "motor3"]


def test_motors_of_a_list_are_driven_one_after_the_other(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        words = ("log", "sine", "--periods", "5", "--samples", 100, "--before", 0.2, "--motor", "3,1")
        rehearsed = bench.start(*words, "--dry-run")
        assert (rehearsed.end(), rehearsed.out) == (0, "2 sines of 3 s on motors 1, 3 in turn: 0:05 min\n")
        pilot = bench.start(*words, "--yes")
        assert pilot.end() == 0, pilot.err
        headers = [run.header for run in open_campaign(tmp_path).runs(kind="sine", complete=False)]

    assert [(header.requested["motor"], header.requested["series"]) for header in headers] == [
        (1, "motor1"),
        (3, "motor3"),
    ]


def test_the_duration_stands_before_the_question(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start("log", "sine", "--l", "3,5", "--n", 500)
        assert pilot.end() == 2
        assert pilot.err.index("2 sines of 4 s: 0:09 min") < pilot.err.index(
            "Is the vehicle fastened and everyone clear?"
        )
