"""From forces in wind to experiments: references, missing values, and files that belong to other runs."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cfid.drag.experiments import DragExperiments, experiments_from_table
from cfid.drag.wind.reduction import WindForce, reduce_forces, sagged
from cfid.errors import DataError
from cfid.recordings.wrench import turn_about_z
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
from tests.drag.wind_tunnel import Air

AIRS = [air for air, _, _ in WORLDS]


@pytest.fixture(scope="module")
def runs() -> list[WindForce]:
    return measured_runs(SIMPLE_AIR, np.random.default_rng(1))


def exchanged(runs: list[WindForce], *pairs: tuple[int, int]) -> list[WindForce]:
    """Return runs in which each of the `pairs` has exchanged its files."""
    swapped = list(runs)
    for i, j in pairs:
        swapped[i] = replace(runs[i], force_n=runs[j].force_n, force_std_n=runs[j].force_std_n, at_s=runs[j].at_s)
        swapped[j] = replace(runs[j], force_n=runs[i].force_n, force_std_n=runs[i].force_std_n, at_s=runs[i].at_s)
    return swapped


def run_at(runs: list[WindForce], command: int, angle: float | None, wind: int = 0) -> int:
    return [i for i, run in enumerate(runs) if (run.command, run.setting.angle_deg) == (command, angle)][wind]


def placed(run: WindForce, **setting: float | None) -> WindForce:
    """Return a force with its wind setting changed."""
    return replace(run, setting=replace(run.setting, **setting))  # type: ignore[arg-type]


def texts(runs: list[WindForce], severity: str = "rejection") -> list[str]:
    return [one.text for one in reduce_forces(runs).findings if one.severity == severity]


@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_forces_are_the_airs_own_in_the_body_frame(air: Air) -> None:
    experiments = exact(air)
    rows = zip(experiments.velocity_mps, experiments.speed_sum_rad_s, strict=True)

    expected = [air.force_n(velocity, speed) for velocity, speed in rows]
    np.testing.assert_allclose(experiments.force_n, expected, rtol=1e-9, atol=1e-12)


def test_standing_rotors_are_recorded_and_unused_and_that_is_noted(runs: list[WindForce]) -> None:
    experiments = reduce_forces(runs)

    assert 0 not in experiments.command
    assert len(experiments.command) == 90
    assert texts(runs, "note") == ["15 runs in wind with standing rotors contain no drag of rotors: not used."]


def test_the_reference_is_that_of_the_same_command_whatever_the_angle(runs: list[WindForce]) -> None:
    turned = [placed(run, angle_deg=77.9) if not run.windy else run for run in runs]
    of_30000 = run_at(runs, 30000, None)
    heavier = list(runs)
    heavier[of_30000] = replace(runs[of_30000], force_n=runs[of_30000].force_n + np.array([0, 0, 1e-3]))
    before, after = reduce_forces(runs), reduce_forces(heavier)

    np.testing.assert_array_equal(reduce_forces(turned).force_n, before.force_n)
    moved = (after.force_n - before.force_n)[:, 2]
    np.testing.assert_allclose(moved, np.where(before.command == 30000, -1e-3, 0), atol=1e-12)


def test_several_references_at_a_command_are_averaged_and_then_less_uncertain(runs: list[WindForce]) -> None:
    first = run_at(runs, 30000, None)
    again = replace(runs[first], name="again", force_n=runs[first].force_n + np.array([0, 0, 2e-3]))
    before, after = reduce_forces(runs), reduce_forces([*runs, again])
    rows = before.command == 30000

    np.testing.assert_allclose((after.force_n - before.force_n)[rows, 2], -1e-3)
    np.testing.assert_allclose(after.reference_std_n[rows] * math.sqrt(2), before.reference_std_n[rows])


def test_each_run_has_its_own_azimuth() -> None:
    runs = exact_runs(SIMPLE_AIR)
    usual, own = reduce_forces(runs), reduce_forces([*runs[:-1], placed(runs[-1], azimuth_deg=50.0)])

    lateral = usual.velocity_mps[-1, :2], own.velocity_mps[-1, :2]
    assert [math.atan2(-y, x) for x, y in lateral] == pytest.approx([0.4967, math.radians(50)])
    np.testing.assert_array_equal(own.force_n, usual.force_n)


def test_a_battery_that_differs_from_that_of_its_reference_is_reported_with_the_largest_difference() -> None:
    volts = {0.0: 3.7, 48.4: 3.65, 77.9: 3.69}
    runs = [replace(run, volts=volts[run.setting.angle_deg or 0.0]) for run in exact_runs(SIMPLE_AIR)]
    (found,) = sagged(runs)

    assert (found.code, found.severity) == ("drag-battery-differs", "warning")
    assert found.text.startswith("35 runs had another battery voltage than their reference, run ")
    assert "by -1.4 %" in found.text
    assert sagged([replace(run, volts=3.7) for run in runs]) == []
    assert sagged(exact_runs(SIMPLE_AIR)) == []


def test_a_single_reading_of_a_wind_takes_the_spread_of_the_others() -> None:
    runs = exact_runs(SIMPLE_AIR, WINDS)
    spread = [
        placed(run, min_mps=0.9 * run.setting.min_mps, max_mps=1.1 * run.setting.max_mps)
        if run.setting.angle_deg
        else run
        for run in runs
    ]
    alone, among = reduce_forces(runs), reduce_forces(spread)

    np.testing.assert_allclose(alone.wind_relative_std, 0.05)
    np.testing.assert_allclose(among.wind_relative_std, 0.2 / math.sqrt(12))
    assert "90 runs state a single wind speed: a relative standard uncertainty of 5 % is taken, by default." in texts(
        runs, "note"
    )
    assert "of 5.8 % is taken, as in the median of the others." in texts(spread, "note")[0]


def test_runs_whose_reference_is_missing_are_named_and_left_out(runs: list[WindForce]) -> None:
    lacking = [run for run in runs if run.windy or run.command not in {20000, 40000}]
    reduced = reduce_forces(lacking)
    whole = reduce_forces(runs)
    sentence = "no run without wind at command 20000, 40000: 30 runs in wind need it"

    assert any(text.startswith(sentence) for text in texts(lacking, "warning"))
    kept = ~np.isin(whole.command, [20000, 40000])
    np.testing.assert_array_equal(reduced.force_n, whole.force_n[kept])


def test_wind_at_commands_that_all_lack_a_reference_is_refused(runs: list[WindForce]) -> None:
    with pytest.raises(DataError, match="no run without wind at command"):
        reduce_forces([run for run in runs if run.windy])


def test_a_wind_without_an_angle_is_named(runs: list[WindForce]) -> None:
    row = run_at(runs, 30000, 48.4)
    for angle in (None, math.nan):
        without = [*runs[:row], placed(runs[row], angle_deg=angle), *runs[row + 1 :]]
        with pytest.raises(DataError, match=f"{runs[row].name}: wind of .* m/s without an angle"):
            reduce_forces(without)


def test_an_angle_without_wind_is_named_and_not_taken_for_references(runs: list[WindForce]) -> None:
    calm = [placed(run, min_mps=0.0, max_mps=0.0) if run.setting.angle_deg == 48.4 else run for run in runs]

    with pytest.raises(DataError, match=r"35 runs at 48.4 degrees, none with wind \(run 42\): give their wind"):
        reduce_forces(calm)


@pytest.mark.parametrize("angle", [None, 0.0, math.nan])
def test_references_may_have_any_angle_that_stands_for_none(runs: list[WindForce], angle: float | None) -> None:
    lateral = [run if run.windy else placed(run, angle_deg=angle) for run in runs if run.setting.angle_deg != 0]

    assert reduce_forces(lateral).settings == 10


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ({"min_mps": math.nan, "max_mps": math.nan}, "no wind speed: give its lowest and highest reading"),
        ({"min_mps": 3.0, "max_mps": 2.0}, "wind between 3 and 2 m/s"),
        ({"min_mps": -1.0}, "none below zero"),
        ({"max_mps": 100.5}, "give it in m/s, up to 100"),
        ({"angle_deg": 180.5}, "an angle of 180.5 degrees"),
        ({"angle_deg": -0.5}, "an angle of -0.5 degrees"),
    ],
)
def test_an_impossible_wind_setting_is_named(runs: list[WindForce], setting: dict[str, float], sentence: str) -> None:
    row = run_at(runs, 30000, 48.4)
    wrong = [*runs[:row], placed(runs[row], **setting), *runs[row + 1 :]]

    with pytest.raises(DataError, match=f"{runs[row].name}: .*{sentence}"):
        reduce_forces(wrong)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"rotor_rad_s": 0.0}, "a rotor speed of 0 rad/s at command 30000"),
        ({"rotor_rad_s": math.nan}, "measure it, as drag grows with it"),
        ({"force_n": np.array([0.0, math.nan, 0.0])}, "its mean force is not a number"),
        ({"force_std_n": np.array([0.0, math.nan, 0.0])}, "its mean force is not a number"),
    ],
)
def test_an_impossible_reading_is_named(runs: list[WindForce], changed: dict[str, float], sentence: str) -> None:
    row = run_at(runs, 30000, 48.4)
    wrong = [*runs[:row], replace(runs[row], **changed), *runs[row + 1 :]]  # type: ignore[arg-type]

    with pytest.raises(DataError, match=f"{runs[row].name}: .*{sentence}"):
        reduce_forces(wrong)


def test_winds_from_straight_below_are_as_good_as_from_above() -> None:
    runs = exact_runs(SIMPLE_AIR)
    below = [placed(run, angle_deg=180.0) if run.setting.angle_deg == 0 else run for run in runs]
    one, other = reduce_forces(runs), reduce_forces(below)

    vertical = one.angle_deg == 0
    np.testing.assert_allclose(other.velocity_mps[vertical, 2], -one.velocity_mps[vertical, 2])


def test_a_campaign_without_wind_is_refused(runs: list[WindForce]) -> None:
    with pytest.raises(DataError, match="no run has both wind and turning rotors"):
        reduce_forces([run for run in runs if not run.windy])


@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_a_sound_campaign_is_not_rejected(air: Air) -> None:
    for seed in range(5):
        assert texts(measured_runs(air, np.random.default_rng(seed))) == []


@pytest.mark.slow
@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_less_than_one_sound_campaign_in_a_hundred_is_rejected(air: Air) -> None:
    rng = np.random.default_rng(8)
    rejected = [bool(texts(measured_runs(air, rng))) for _ in range(400)]

    print("rejected:", np.mean(rejected))
    assert np.mean(rejected) < 0.01


@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_two_commands_whose_files_were_exchanged_are_both_named(air: Air) -> None:
    runs = measured_runs(air, np.random.default_rng(1))
    pair = run_at(runs, 20000, 48.4, wind=2), run_at(runs, 30000, 48.4, wind=2)
    rejections = texts(exchanged(runs, pair))

    assert len(rejections) == 2
    for row, text in zip(pair, rejections, strict=True):
        assert text.startswith(f"{runs[row].name}: its force is off by")
        assert "the file of another run?" in text


def test_a_force_of_another_angle_is_named(runs: list[WindForce]) -> None:
    pair = run_at(runs, 40000, 0.0, wind=4), run_at(runs, 40000, 77.9, wind=4)
    rejections = texts(exchanged(runs, pair))

    assert [text.split(":")[0] for text in rejections] == [runs[row].name for row in pair]


def test_a_whole_wind_under_another_angle_contradicts_its_direction(runs: list[WindForce]) -> None:
    pairs = [
        (run_at(runs, command, 0.0, wind=3), run_at(runs, command, 77.9, wind=3))
        for command in (10000, 20000, 30000, 37300, 40000, 50000)
    ]
    rejections = texts(exchanged(runs, *pairs))

    assert len(rejections) == 2
    assert "forces in wind of 3.65 m/s at 0 degrees are typically" in rejections[0]
    assert "at 77.9 degrees" in rejections[1]


def test_two_references_that_were_exchanged_lift_in_the_wrong_order(runs: list[WindForce]) -> None:
    pair = run_at(runs, 37300, None), run_at(runs, 40000, None)
    rejections = texts(exchanged(runs, pair))

    assert rejections[0].startswith("without wind, command 37300 lifts")
    assert "all forces at command 37300 are off by" in rejections[1]


@pytest.mark.parametrize("air", [SIMPLE_AIR, CROSS_AIR, COMPLEX_AIR], ids=["simple", "cross", "complex"])
def test_a_reference_that_was_exchanged_with_a_run_in_wind_is_named(air: Air) -> None:
    runs = measured_runs(air, np.random.default_rng(1))
    pair = run_at(runs, 40000, None), run_at(runs, 40000, 48.4, wind=4)
    rejections = texts(exchanged(runs, pair))

    expected = f"is the reference {runs[pair[0]].name} of another command, or was there wind?"
    assert any(expected in text for text in rejections)


def timed(runs: list[WindForce]) -> list[WindForce]:
    return [replace(run, at_s=1.8e9 + 30.0 * place) for place, run in enumerate(runs)]


def test_forces_that_drift_smoothly_in_time_are_no_exchanged_files(runs: list[WindForce]) -> None:
    turns = np.linspace(0, 2 * np.pi, len(runs))
    drifting = [
        replace(run, force_n=run.force_n + np.array([0.0, 0.0, 0.03 * math.sin(turn)]))
        for run, turn in zip(timed(runs), turns, strict=True)
    ]
    (warned,) = [one for one in reduce_forces(drifting).findings if one.code == "drag-forces-drift"]

    assert texts(drifting) == []
    assert "does the tare drift, or the battery sag?" in warned.text
    assert texts([replace(run, at_s=math.nan) for run in drifting])


def test_files_exchanged_in_a_series_with_times_are_named(runs: list[WindForce]) -> None:
    series = timed(runs)
    for pair in (
        (run_at(runs, 20000, 48.4, wind=2), run_at(runs, 30000, 48.4, wind=2)),
        (run_at(runs, 40000, 0.0, wind=4), run_at(runs, 40000, 77.9, wind=4)),
    ):
        assert len(texts(exchanged(series, pair))) == 2


def test_a_load_cell_that_is_turned_otherwise_contradicts_the_wind(runs: list[WindForce]) -> None:
    turned = [replace(run, force_n=turn_about_z(run.force_n, yaw_deg=-90.0)) for run in runs]
    rejections = texts(turned)

    assert sum("at 48.4 degrees" in text or "at 77.9 degrees" in text for text in rejections) == 10


def test_rotors_that_count_double_are_named_by_what_one_rotor_lifts(runs: list[WindForce]) -> None:
    doubled = [replace(run, rotor_rad_s=2 * run.rotor_rad_s) for run in runs]
    lift_n, speed_rad_s = np.array(
        [
            (runs[run_at(runs, run.command, None)].force_n[2] / 4, run.rotor_rad_s)
            for run in doubled
            if run.windy and not run.standing
        ]
    ).T
    per_square = float(lift_n @ speed_rad_s**2 / (speed_rad_s**2 @ speed_rad_s**2))
    (found,) = [one for one in reduce_forces(doubled).findings if one.code == "speed-unusual"]

    assert f"thrust over speed squared is {per_square:.2g} N s^2" in found.text


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

    with pytest.raises(DataError, match="row 5 of force_n is not a number"):
        as_table(replace(experiments, force_n=hole))
    with pytest.raises(DataError, match="angle_deg has the shape"):
        as_table(replace(experiments, angle_deg=experiments.angle_deg[:-1]))
    with pytest.raises(DataError, match="no row has both wind and turning rotors"):
        as_table(replace(experiments, velocity_mps=0 * experiments.velocity_mps))
