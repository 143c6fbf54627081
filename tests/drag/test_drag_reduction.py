"""From runs to experiments: frames, references, what is missing, and files that belong to other runs."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cfid.drag.experiments import DragExperiments, experiments_from_table
from cfid.drag.wind.reduction import WindRun, reduce_runs
from cfid.errors import DataError
from cfid.sim.wind_tunnel import Air
from tests.drag.test_drag_campaigns import (
    COMPLEX_AIR,
    CROSS_AIR,
    NAMES,
    SIMPLE_AIR,
    WINDS,
    WORLDS,
    exact,
    exact_runs,
    measured_runs,
)

AIRS = [air for air, _, _ in WORLDS]


@pytest.fixture(scope="module")
def runs() -> list[WindRun]:
    return measured_runs(SIMPLE_AIR, np.random.default_rng(1))


def exchanged(runs: list[WindRun], *pairs: tuple[int, int]) -> list[WindRun]:
    """Return runs of which some have each other's files."""
    swapped = list(runs)
    for i, j in pairs:
        swapped[i] = replace(runs[i], force_n=runs[j].force_n, force_std_n=runs[j].force_std_n)
        swapped[j] = replace(runs[j], force_n=runs[i].force_n, force_std_n=runs[i].force_std_n)
    return swapped


def run_at(runs: list[WindRun], command: int, angle: float | None, wind: int = 0) -> int:
    return [i for i, run in enumerate(runs) if (run.command, run.angle_deg) == (command, angle)][wind]


@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_forces_are_the_airs_own_in_the_body_frame(air: Air) -> None:
    experiments = exact(air)
    rows = zip(experiments.velocity_mps, experiments.speed_sum_rad_s, strict=True)

    expected = [air.force_n(velocity, speed) for velocity, speed in rows]
    np.testing.assert_allclose(experiments.force_n, expected, rtol=1e-9, atol=1e-12)


def test_standing_rotors_are_recorded_and_unused_and_that_is_noted(runs: list[WindRun]) -> None:
    reduction = reduce_runs(runs)

    assert 0 not in reduction.experiments.command
    assert len(reduction.names) == 90
    assert reduction.notes == ("15 run(s) in wind with standing rotors hold no drag of rotors: not used.",)


def test_the_reference_is_that_of_the_same_command_whatever_the_angle(runs: list[WindRun]) -> None:
    turned = [replace(run, angle_deg=77.9) if not run.windy else run for run in runs]
    of_30000 = run_at(runs, 30000, None)
    heavier = list(runs)
    heavier[of_30000] = replace(runs[of_30000], force_n=runs[of_30000].force_n + np.array([0, 0, 1e-3]))
    before, after = reduce_runs(runs).experiments, reduce_runs(heavier).experiments

    np.testing.assert_array_equal(reduce_runs(turned).experiments.force_n, before.force_n)
    moved = (after.force_n - before.force_n)[:, 2]
    np.testing.assert_allclose(moved, np.where(before.command == 30000, -1e-3, 0), atol=1e-12)


def test_several_references_at_a_command_are_averaged_and_then_known_better(runs: list[WindRun]) -> None:
    first = run_at(runs, 30000, None)
    again = replace(runs[first], name="again", force_n=runs[first].force_n + np.array([0, 0, 2e-3]))
    before, after = reduce_runs(runs).experiments, reduce_runs([*runs, again]).experiments
    rows = before.command == 30000

    np.testing.assert_allclose((after.force_n - before.force_n)[rows, 2], -1e-3)
    np.testing.assert_allclose(after.reference_std_n[rows] * math.sqrt(2), before.reference_std_n[rows])


def test_a_run_may_have_an_azimuth_a_yaw_and_markers_of_its_own() -> None:
    runs = exact_runs(SIMPLE_AIR)
    usual = reduce_runs(runs).experiments
    last = replace(runs[-1], azimuth_deg=50.0, yaw_deg=10.0, markers=1)
    own = reduce_runs([*runs[:-1], last]).experiments

    lateral = usual.velocity_mps[-1, :2], own.velocity_mps[-1, :2]
    assert [math.atan2(-y, x) for x, y in lateral] == pytest.approx([0.4967, math.radians(50)])
    force = usual.force_n[-1], own.force_n[-1]
    angles = [math.degrees(math.atan2(y, x)) for x, y, _ in force]
    assert angles[0] - angles[1] == pytest.approx(45 - 10)
    assert own.speed_sum_rad_s[-1] == pytest.approx(2 * usual.speed_sum_rad_s[-1])
    np.testing.assert_array_equal(own.force_n[:-1], usual.force_n[:-1])


def test_one_reading_of_a_wind_takes_the_spread_of_the_others() -> None:
    runs = exact_runs(SIMPLE_AIR, WINDS)
    spread = [
        replace(run, min_mps=0.9 * run.min_mps, max_mps=1.1 * run.max_mps) if run.angle_deg else run for run in runs
    ]
    alone, among = reduce_runs(runs), reduce_runs(spread)

    np.testing.assert_allclose(alone.experiments.wind_relative_std, 0.05)
    np.testing.assert_allclose(among.experiments.wind_relative_std, 0.2 / math.sqrt(12))
    assert "90 run(s) state one wind speed alone: 5 % deviation is taken, by default." in alone.notes
    assert "30 run(s) state one wind speed alone: 5.8 % deviation is taken, as in the median of" in among.notes[0]


def test_missing_references_are_named_with_what_needs_them(runs: list[WindRun]) -> None:
    lacking = [run for run in runs if run.windy or run.command not in {20000, 40000}]

    with pytest.raises(DataError, match=r"no run without wind at command 20000, 40000: 30 run\(s\) in wind need it"):
        reduce_runs(lacking)


def test_a_wind_without_an_angle_is_named(runs: list[WindRun]) -> None:
    row = run_at(runs, 30000, 48.4)
    for angle in (None, math.nan):
        without = [*runs[:row], replace(runs[row], angle_deg=angle), *runs[row + 1 :]]
        with pytest.raises(DataError, match=f"{runs[row].name}: wind of .* m/s without an angle"):
            reduce_runs(without)


def test_an_angle_without_wind_is_named_and_not_taken_for_references(runs: list[WindRun]) -> None:
    calm = [replace(run, min_mps=0.0, max_mps=0.0) if run.angle_deg == 48.4 else run for run in runs]

    with pytest.raises(DataError, match=r"35 run\(s\) at 48.4 degrees, none with wind \(run 42\): give their wind"):
        reduce_runs(calm)


@pytest.mark.parametrize("angle", [None, 0.0, math.nan])
def test_references_may_have_any_angle_that_stands_for_none(runs: list[WindRun], angle: float | None) -> None:
    lateral = [run if run.windy else replace(run, angle_deg=angle) for run in runs if run.angle_deg != 0]

    assert reduce_runs(lateral).experiments.settings == 10


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"min_mps": math.nan, "max_mps": math.nan}, "no wind speed: say its lowest and highest reading"),
        ({"min_mps": 3.0, "max_mps": 2.0}, "wind between 3 and 2 m/s"),
        ({"min_mps": -1.0}, "none below zero"),
        ({"shown_rpm": 0.0}, "a tachometer reading of 0 rpm at command 30000"),
        ({"shown_rpm": math.nan}, "measure the speed of a rotor"),
        ({"force_n": np.array([0.0, math.nan, 0.0])}, "its mean force is no number"),
    ],
)
def test_a_reading_that_cannot_be_is_named(runs: list[WindRun], changed: dict[str, float], sentence: str) -> None:
    row = run_at(runs, 30000, 48.4)
    wrong = [*runs[:row], replace(runs[row], **changed), *runs[row + 1 :]]  # type: ignore[arg-type]

    with pytest.raises(DataError, match=f"{runs[row].name}: .*{sentence}"):
        reduce_runs(wrong)


def test_a_campaign_without_wind_is_refused(runs: list[WindRun]) -> None:
    with pytest.raises(DataError, match="no run has both wind and turning rotors"):
        reduce_runs([run for run in runs if not run.windy])


@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_a_sound_campaign_is_not_doubted(air: Air) -> None:
    for seed in range(5):
        assert reduce_runs(measured_runs(air, np.random.default_rng(seed))).doubts == ()


@pytest.mark.slow
@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_less_than_one_sound_campaign_in_a_hundred_is_doubted(air: Air) -> None:
    rng = np.random.default_rng(8)
    doubted = [bool(reduce_runs(measured_runs(air, rng)).doubts) for _ in range(400)]

    print("doubted:", np.mean(doubted))
    assert np.mean(doubted) < 0.01


@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_two_commands_whose_files_were_exchanged_are_both_named(air: Air) -> None:
    runs = measured_runs(air, np.random.default_rng(1))
    pair = run_at(runs, 20000, 48.4, wind=2), run_at(runs, 30000, 48.4, wind=2)
    doubts = reduce_runs(exchanged(runs, pair)).doubts

    assert len(doubts) == 2
    for row, doubt in zip(pair, doubts, strict=True):
        assert doubt.startswith(f"{runs[row].name}: its force is off by")
        assert "the file of another run?" in doubt


def test_a_force_of_another_angle_is_named(runs: list[WindRun]) -> None:
    pair = run_at(runs, 40000, 0.0, wind=4), run_at(runs, 40000, 77.9, wind=4)
    doubts = reduce_runs(exchanged(runs, pair)).doubts

    assert [doubt.split(":")[0] for doubt in doubts] == [runs[row].name for row in pair]


def test_a_whole_wind_under_another_angle_contradicts_its_direction(runs: list[WindRun]) -> None:
    pairs = [
        (run_at(runs, command, 0.0, wind=3), run_at(runs, command, 77.9, wind=3))
        for command in (10000, 20000, 30000, 37300, 40000, 50000)
    ]
    doubts = reduce_runs(exchanged(runs, *pairs)).doubts

    assert len(doubts) == 2
    assert "forces in wind of 3.65 m/s at 0 degrees are typically" in doubts[0]
    assert "at 77.9 degrees" in doubts[1]


def test_two_references_that_were_exchanged_lift_in_the_wrong_order(runs: list[WindRun]) -> None:
    pair = run_at(runs, 37300, None), run_at(runs, 40000, None)
    doubts = reduce_runs(exchanged(runs, pair)).doubts

    assert doubts[0].startswith("without wind, command 37300 lifts")
    assert "all forces at command 37300 are off by" in doubts[1]


@pytest.mark.parametrize("air", [SIMPLE_AIR, CROSS_AIR, COMPLEX_AIR], ids=["simple", "cross", "complex"])
def test_a_reference_that_was_exchanged_with_a_run_in_wind_is_named(air: Air) -> None:
    runs = measured_runs(air, np.random.default_rng(1))
    pair = run_at(runs, 40000, None), run_at(runs, 40000, 48.4, wind=4)
    doubts = reduce_runs(exchanged(runs, pair)).doubts

    assert any(f"is the reference {runs[pair[0]].name} of another command, or was there wind?" in d for d in doubts)


def test_a_load_cell_that_is_turned_otherwise_contradicts_the_wind(runs: list[WindRun]) -> None:
    doubts = reduce_runs([replace(run, yaw_deg=-45.0) for run in runs]).doubts

    assert sum("at 48.4 degrees" in doubt or "at 77.9 degrees" in doubt for doubt in doubts) == 10


def as_table(experiments: DragExperiments) -> DragExperiments:
    return experiments_from_table(
        command=experiments.command,
        angle_deg=experiments.angle_deg,
        velocity_mps=experiments.velocity_mps,
        speed_sum_rad_s=experiments.speed_sum_rad_s,
        force_n=experiments.force_n,
    )


def test_a_table_with_a_hole_or_of_unequal_columns_is_refused() -> None:
    experiments = exact(SIMPLE_AIR)
    hole = experiments.force_n.copy()
    hole[4, 1] = math.nan

    with pytest.raises(DataError, match="row 5 of force_n is no number"):
        as_table(replace(experiments, force_n=hole))
    with pytest.raises(DataError, match="angle_deg has the shape"):
        as_table(replace(experiments, angle_deg=experiments.angle_deg[:-1]))
    with pytest.raises(DataError, match="no row has both wind and turning rotors"):
        as_table(replace(experiments, velocity_mps=0 * experiments.velocity_mps))
