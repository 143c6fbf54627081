"""From forces in wind to experiments: references, missing values, and files that belong to other runs."""

import math
from collections.abc import Callable
from typing import TypedDict

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from cfid.drag.comparison import fit_models
from cfid.drag.data import FORCE, FORCE_STD, TABLE_COLUMNS, MeanForce, mean_force, mean_force_thesis, reduce_points
from cfid.drag.model import DragExperiments
from cfid.errors import DataError, FitError
from tests.drag.thesis_campaign import (
    NAMES,
    SIMPLE_AIR,
    WORLDS,
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


def test_a_battery_that_differs_from_that_of_its_reference_is_reported_with_the_largest_difference() -> None:
    runs = exact_runs(SIMPLE_AIR)
    volts = runs["angle_deg"].map({48.4: 3.65, 77.9: 3.69}).fillna(3.7)
    (finding,) = [finding for finding in reduce_points(runs.assign(volts=volts)).findings if "battery" in finding.code]

    assert (finding.code, finding.severity) == ("drag-battery-differs", "warning")
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


@pytest.mark.parametrize("air", AIRS, ids=NAMES)
@pytest.mark.parametrize("campaigns", [3, pytest.param(400, marks=pytest.mark.slow)])
def test_less_than_one_sound_campaign_in_a_hundred_is_rejected(air: Air, campaigns: int) -> None:
    rng = np.random.default_rng(8)
    rejected = [bool(rejections(measured_runs(air, rng))) for _ in range(campaigns)]

    print("rejected:", np.mean(rejected))
    assert np.mean(rejected) < 0.01


@pytest.mark.parametrize("air", AIRS, ids=NAMES)
def test_two_commands_whose_files_were_exchanged_are_both_named(air: Air) -> None:
    runs = measured_runs(air, np.random.default_rng(1))
    pair = run_at(runs, 20000, 48.4, wind=2), run_at(runs, 30000, 48.4, wind=2)

    assert rejections(exchanged(runs, pair))["drag-run-off"].startswith(f"run {pair[0]}, run {pair[1]}: ")


def test_two_references_that_were_exchanged_lift_in_the_wrong_order(runs: pd.DataFrame) -> None:
    pair = run_at(runs, 37300, None), run_at(runs, 40000, None)
    rejected = rejections(exchanged(runs, pair))

    assert rejected["drag-references-out-of-order"].startswith("without wind, command 37300 lifts")


def test_a_reference_that_was_exchanged_with_a_run_in_wind_is_rejected(runs: pd.DataFrame) -> None:
    pair = run_at(runs, 40000, None), run_at(runs, 40000, 48.4, wind=4)

    assert "its reference" in rejections(exchanged(runs, pair))["drag-run-off"]


def test_forces_that_drift_smoothly_in_time_are_no_exchanged_files(runs: pd.DataFrame) -> None:
    drift = 0.03 * np.sin(np.linspace(0, 2 * np.pi, len(runs)))

    assert "drag-run-off" not in rejections(runs.assign(fz_n=runs["fz_n"] + drift))


def as_table(experiments: DragExperiments) -> pd.DataFrame:
    columns = (experiments.command, experiments.angle_deg, experiments.velocity_mps, experiments.speed_sum_rad_s)
    return pd.DataFrame(np.column_stack([*columns, experiments.force_n]), columns=list(TABLE_COLUMNS))


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


def test_a_record_or_window_that_is_too_short_is_refused() -> None:
    whole = record(1)
    with pytest.raises(DataError, match="500 samples: the thesis takes its tare from the first 500"):
        mean_force_thesis(time_s=whole["time_s"][:500], force_n=whole["force_n"][:500], command=20000)
    with pytest.raises(DataError, match=r"from 3 to 3\.03 s has 15 samples; 16 are needed"):
        mean_force_thesis(**whole, command=20000, window_s=(3.0, 3.03))


def test_spikes_do_not_move_the_mean() -> None:
    whole = record(1)
    spoilt = whole["force_n"].copy()
    spoilt[[400, 1501, 1700, 2202], [0, 1, 2, 2]] += (5.0, -30.0, 2000.0, 1e5)

    sound, mean = mean_force(**whole, command=20000), mean_force(time_s=whole["time_s"], force_n=spoilt, command=20000)
    np.testing.assert_allclose(mean.force_n, sound.force_n, atol=sound.std_n.min())
