"""From forces in wind to experiments: references, missing values, and files that belong to other runs."""

import math

import numpy as np
import pandas as pd
import pytest

from cfid.drag.comparison import fit_models
from cfid.drag.data import FORCE, FORCE_STD, TABLE_COLUMNS, experiments_from_table, reduce_points, velocity_in_air
from cfid.drag.model import DragExperiments
from cfid.errors import DataError
from cfid.recordings.wrench import turn_about_z
from tests.drag.thesis_campaign import (
    COMPLEX_AIR,
    CROSS_AIR,
    NAMES,
    SIMPLE_AIR,
    WORLDS,
    exact,
    exact_runs,
    measured_runs,
)
from tests.drag.wind_tunnel import Air

AIRS = [air for air, _, _ in WORLDS]


@pytest.fixture
def runs() -> pd.DataFrame:
    return measured_runs(SIMPLE_AIR, np.random.default_rng(1))


def exchanged(runs: pd.DataFrame, *pairs: tuple[int, int]) -> pd.DataFrame:
    """Return runs in which each of the `pairs` has exchanged its files."""
    swapped = runs.copy()
    for i, j in pairs:
        swapped.loc[[i, j], FORCE + FORCE_STD] = runs.loc[[j, i], FORCE + FORCE_STD].to_numpy()
    return swapped


def run_at(runs: pd.DataFrame, command: int, angle: float | None, wind: int = 0) -> int:
    at_angle = runs["angle_deg"].isna() if angle is None else runs["angle_deg"] == angle
    return int(runs.index[(runs["command"] == command) & at_angle][wind])


def changed(runs: pd.DataFrame, row: int, **values: float) -> pd.DataFrame:
    spoilt = runs.copy()
    for name, value in values.items():
        spoilt.loc[row, name] = value
    return spoilt


def texts(runs: pd.DataFrame, severity: str = "warning") -> list[str]:
    return [finding.text for finding in reduce_points(runs).findings if finding.severity == severity]


def rejections(runs: pd.DataFrame) -> dict[str, str]:
    """Return the codes and texts of the rejections of whole campaigns, not of single models."""
    found = [finding for finding in fit_models(reduce_points(runs)).findings if finding.severity == "rejection"]
    return {finding.code: finding.text for finding in found if finding.concerns("drag.simple_kg_per_rad")}


def test_the_velocity_is_that_of_the_vehicle_relative_to_the_air() -> None:
    (above, side, slanting) = velocity_in_air(
        np.array([2.0, 3.0, 4.15]), angle_deg=np.array([0, 90, 48.4]), azimuth_deg=np.full(3, 28.46)
    )

    np.testing.assert_allclose(above, [0, 0, 2])  # wind from above is a climb
    azimuth = math.radians(28.46)
    np.testing.assert_allclose(side, [3 * math.cos(azimuth), -3 * math.sin(azimuth), 0], atol=1e-12)
    assert np.linalg.norm(slanting) == pytest.approx(4.15)
    assert slanting[2] == pytest.approx(4.15 * math.cos(math.radians(48.4)))


@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_forces_are_the_airs_own_in_the_body_frame(air: Air) -> None:
    experiments = exact(air)
    rows = zip(experiments.velocity_mps, experiments.speed_sum_rad_s, strict=True)

    expected = [air.force_n(velocity, speed) for velocity, speed in rows]
    np.testing.assert_allclose(experiments.force_n, expected, rtol=1e-9, atol=1e-12)


def test_the_campaign_is_90_experiments_in_15_winds_with_the_thesis_means() -> None:
    experiments = exact(SIMPLE_AIR)

    assert experiments.force_n.shape == (90, 3)
    assert 0 not in experiments.command  # standing rotors are recorded and unused
    assert experiments.settings == 15
    assert experiments.wind_mps.mean() == pytest.approx(2.85)
    assert experiments.speed_sum_rad_s.mean() == pytest.approx(5992.7, abs=0.05)


def test_the_reference_is_that_of_the_same_command_whatever_the_angle(runs: pd.DataFrame) -> None:
    turned = runs.assign(angle_deg=runs["angle_deg"].fillna(77.9))
    reference = run_at(runs, 30000, None)
    heavier = changed(runs, reference, fz_n=runs["fz_n"][reference] + 1e-3)
    before, after = reduce_points(runs), reduce_points(heavier)

    np.testing.assert_array_equal(reduce_points(turned).force_n, before.force_n)
    moved = (after.force_n - before.force_n)[:, 2]
    np.testing.assert_allclose(moved, np.where(before.command == 30000, -1e-3, 0), atol=1e-12)


def test_several_references_at_a_command_are_averaged_and_then_less_uncertain(runs: pd.DataFrame) -> None:
    again = runs.loc[[run_at(runs, 30000, None)]]
    more = pd.concat([runs, again.assign(name="again", fz_n=again["fz_n"] + 2e-3)], ignore_index=True)
    before, after = reduce_points(runs), reduce_points(more)
    rows = before.command == 30000

    np.testing.assert_allclose((after.force_n - before.force_n)[rows, 2], -1e-3)
    np.testing.assert_allclose(after.reference_std_n[rows] * math.sqrt(2), before.reference_std_n[rows])


def test_each_run_has_its_own_azimuth() -> None:
    runs = exact_runs(SIMPLE_AIR)
    turned = reduce_points(changed(runs, len(runs) - 1, azimuth_deg=50.0))

    lateral = reduce_points(runs).velocity_mps[-1, :2], turned.velocity_mps[-1, :2]
    assert [math.atan2(-y, x) for x, y in lateral] == pytest.approx([0.4967, math.radians(50)])
    assert turned.settings == 16


def test_a_battery_that_differs_from_that_of_its_reference_is_reported_with_the_largest_difference() -> None:
    runs = exact_runs(SIMPLE_AIR)
    volts = runs["angle_deg"].map({48.4: 3.65, 77.9: 3.69}).fillna(3.7)
    (finding,) = [finding for finding in reduce_points(runs.assign(volts=volts)).findings if "battery" in finding.code]

    assert (finding.code, finding.severity) == ("drag-battery-differs", "warning")
    assert finding.text.startswith("30 runs had another battery voltage than their reference, run ")
    assert "by -1.4 %" in finding.text
    assert texts(runs.assign(volts=3.7)) == texts(runs) == []


def test_a_single_reading_of_a_wind_takes_the_spread_of_the_others() -> None:
    runs = exact_runs(SIMPLE_AIR)
    aslant = runs["angle_deg"] > 0
    spread = runs.assign(
        min_mps=runs["min_mps"].where(~aslant, 0.9 * runs["min_mps"]),
        max_mps=runs["max_mps"].where(~aslant, 1.1 * runs["max_mps"]),
    )

    np.testing.assert_allclose(reduce_points(runs).wind_relative_std, 0.05)
    np.testing.assert_allclose(reduce_points(spread).wind_relative_std, 0.2 / math.sqrt(12))
    (alone,), (among,) = texts(runs, "note"), texts(spread, "note")
    assert alone.startswith("90 runs state a single wind speed: a relative standard uncertainty of 5 % is taken")
    assert "of 5.8 % is taken" in among


def test_runs_whose_reference_is_missing_are_named_and_left_out(runs: pd.DataFrame) -> None:
    windy = runs["max_mps"] > 0
    lacking = runs[windy | ~runs["command"].isin([20000, 40000])]
    whole = reduce_points(runs)

    assert any("at command 20000, 40000: 30 runs in wind need it" in text for text in texts(lacking))
    kept = ~np.isin(whole.command, [20000, 40000])
    np.testing.assert_array_equal(reduce_points(lacking).force_n, whole.force_n[kept])
    with pytest.raises(DataError, match="no run without wind at command"):
        reduce_points(runs[windy])
    with pytest.raises(DataError, match="no run has both wind and turning rotors"):
        reduce_points(runs[~windy])


def test_an_angle_without_wind_is_named_and_not_taken_for_references(runs: pd.DataFrame) -> None:
    calm = runs.copy()
    calm.loc[calm["angle_deg"] == 48.4, ["min_mps", "max_mps"]] = 0.0

    with pytest.raises(DataError, match=r"35 runs at 48.4 degrees, none with wind \(run 42\): give their wind"):
        reduce_points(calm)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"angle_deg": math.nan}, "wind of .* m/s without an angle"),
        ({"min_mps": math.nan, "max_mps": math.nan}, "no wind speed: give its lowest and highest reading"),
        ({"min_mps": 3.0, "max_mps": 2.0}, "wind between 3 and 2 m/s"),
        ({"min_mps": -1.0}, "none below zero"),
        ({"max_mps": 100.5}, "give it in m/s, up to 100"),
        ({"angle_deg": 180.5}, "an angle of 180.5 degrees"),
        ({"angle_deg": -0.5}, "an angle of -0.5 degrees"),
        ({"rotor_rad_s": 0.0}, "a rotor speed of 0 rad/s at command 30000"),
        ({"rotor_rad_s": math.nan}, "measure it, as drag grows with it"),
        ({"fy_n": math.nan}, "its mean force is not a number"),
        ({"fy_std_n": math.nan}, "its mean force is not a number"),
    ],
)
def test_an_impossible_point_is_named(runs: pd.DataFrame, values: dict[str, float], sentence: str) -> None:
    row = run_at(runs, 30000, 48.4)

    with pytest.raises(DataError, match=f"{runs['name'][row]}: .*{sentence}"):
        reduce_points(changed(runs, row, **values))


def test_winds_from_straight_below_are_as_good_as_from_above() -> None:
    runs = exact_runs(SIMPLE_AIR)
    above, below = reduce_points(runs), reduce_points(runs.replace({"angle_deg": {0.0: 180.0}}))

    vertical = above.angle_deg == 0
    np.testing.assert_allclose(below.velocity_mps[vertical, 2], -above.velocity_mps[vertical, 2])


@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_a_sound_campaign_is_not_rejected(air: Air) -> None:
    for seed in range(3):
        assert rejections(measured_runs(air, np.random.default_rng(seed))) == {}


@pytest.mark.slow
@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_less_than_one_sound_campaign_in_a_hundred_is_rejected(air: Air) -> None:
    rng = np.random.default_rng(8)
    rejected = [bool(rejections(measured_runs(air, rng))) for _ in range(400)]

    print("rejected:", np.mean(rejected))
    assert np.mean(rejected) < 0.01


@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_two_commands_whose_files_were_exchanged_are_both_named(air: Air) -> None:
    runs = measured_runs(air, np.random.default_rng(1))
    pair = run_at(runs, 20000, 48.4, wind=2), run_at(runs, 30000, 48.4, wind=2)

    assert rejections(exchanged(runs, pair))["drag-run-off"].startswith(f"run {pair[0]}, run {pair[1]}: ")


def test_a_force_of_another_angle_is_named(runs: pd.DataFrame) -> None:
    pair = run_at(runs, 40000, 0.0, wind=4), run_at(runs, 40000, 77.9, wind=4)

    assert rejections(exchanged(runs, pair))["drag-run-off"].startswith(f"run {pair[0]}, run {pair[1]}: ")


def test_a_whole_wind_under_another_angle_is_rejected(runs: pd.DataFrame) -> None:
    pairs = [
        (run_at(runs, command, 0.0, wind=3), run_at(runs, command, 77.9, wind=3))
        for command in (10000, 20000, 30000, 37300, 40000, 50000)
    ]

    assert "and 8 more: the force is off" in rejections(exchanged(runs, *pairs))["drag-run-off"]


def test_two_references_that_were_exchanged_lift_in_the_wrong_order(runs: pd.DataFrame) -> None:
    pair = run_at(runs, 37300, None), run_at(runs, 40000, None)
    rejected = rejections(exchanged(runs, pair))

    assert rejected["drag-references-out-of-order"].startswith("without wind, command 37300 lifts")


@pytest.mark.parametrize("air", [SIMPLE_AIR, CROSS_AIR, COMPLEX_AIR], ids=["simple", "cross", "complex"])
def test_a_reference_that_was_exchanged_with_a_run_in_wind_is_rejected(air: Air) -> None:
    runs = measured_runs(air, np.random.default_rng(1))
    pair = run_at(runs, 40000, None), run_at(runs, 40000, 48.4, wind=4)

    assert "its reference" in rejections(exchanged(runs, pair))["drag-run-off"]


def test_forces_that_drift_smoothly_in_time_are_no_exchanged_files(runs: pd.DataFrame) -> None:
    drift = 0.03 * np.sin(np.linspace(0, 2 * np.pi, len(runs)))

    assert "drag-run-off" not in rejections(runs.assign(fz_n=runs["fz_n"] + drift))


def test_a_load_cell_that_is_turned_otherwise_contradicts_the_wind(runs: pd.DataFrame) -> None:
    turned = runs.copy()
    turned[FORCE] = turn_about_z(runs[FORCE].to_numpy(), yaw_deg=-90.0)

    assert "drag-across-wind" in rejections(turned)


def as_table(experiments: DragExperiments) -> pd.DataFrame:
    columns = (experiments.command, experiments.angle_deg, experiments.velocity_mps, experiments.speed_sum_rad_s)
    return pd.DataFrame(np.column_stack([*columns, experiments.force_n]), columns=list(TABLE_COLUMNS))


def test_a_table_with_a_hole_or_without_wind_is_refused() -> None:
    table = as_table(exact(SIMPLE_AIR))

    with pytest.raises(DataError, match="row 5: no number in column 'fy_n'"):
        experiments_from_table(changed(table, 4, fy_n=math.nan))
    with pytest.raises(DataError, match="no row has both wind and turning rotors"):
        experiments_from_table(table.assign(vx_mps=0.0, vy_mps=0.0, vz_mps=0.0))
