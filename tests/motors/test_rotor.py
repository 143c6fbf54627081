"""One rotor model for steps, stands and logs: a plant with known rates, public stands, and what is refused."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.errors import ConfigError, DataError, FitError
from cfid.motors.rotor import fit
from cfid.records.result import Result
from tests.lab import DATA, INPUTS, Cfid, codes, new_campaign
from tests.motors.rotor_plant import FULL, Plant, delay_off, rates_off, write_log, write_stand

PLANT = Plant()
WAYS = ("dynamics.rising", "dynamics.falling")


@pytest.mark.parametrize("hold_s", [0.2, 1.0])
def test_a_stand_gives_the_rotor_however_long_it_holds_commands(tmp_path: Path, hold_s: float) -> None:
    write_stand(tmp_path / "stand.csv", PLANT, 3, hold_s=hold_s)
    result = fit(tmp_path / "stand.csv")

    assert result.accepted
    assert np.abs(rates_off(result, PLANT, widest=0.04)).max() < 3
    assert abs(delay_off(result, PLANT)) < 2
    assert result.quantities["dynamics.map"].value[0]["c1"] == pytest.approx(2600, rel=0.1)


@pytest.mark.parametrize(("row_s", "widest"), [(0.002, 0.025), (0.02, 0.06)])
def test_a_log_gives_the_rotor_in_rows_of_any_length(tmp_path: Path, row_s: float, widest: float) -> None:
    """Rows show a command up to one row late: the mean of that is corrected, each change's own lateness is fitted."""
    write_log(tmp_path / "log.csv", PLANT, 4, row_s=row_s)
    result = fit(tmp_path / "log.csv")

    assert np.abs(rates_off(result, PLANT, widest=widest)).max() < 3
    assert abs(delay_off(result, PLANT)) < 2
    poly, (covariance,) = result.quantities["motor.speed_poly"], result.covariances
    share = np.array([0.3, 0.6, 0.8])
    at = np.vander(FULL * share, 3)
    std = np.sqrt(np.diag(at @ np.array(covariance.matrix)[-3:, -3:] @ at.T))
    true = 300 + 2600 * share - 500 * share**2
    assert np.all(np.abs(at @ poly.value - true) < 3 * std)
    assert np.all(std < 0.02 * true)


def test_steps_from_standstill_and_back_give_the_rotor(tmp_path: Path) -> None:
    levels = [0.0]
    for level in (0.2, 0.35, 0.5, 0.65, 0.8, 0.95):
        levels += [level, 0.0]
    write_stand(tmp_path / "stand.csv", PLANT, 5, levels=levels, hold_s=1.5)
    result = fit(tmp_path / "stand.csv")

    assert np.abs(rates_off(result, PLANT, widest=0.04)).max() < 3
    rows = result.quantities["dynamics.time_constant_s"].value
    assert [(row["cmd_from"], row["cmd_to"]) for row in rows[:2]] == [(0.0, 13107.0), (13107.0, 0.0)]
    # Seen from far, w' = k1 (c - w) + k2 (c^2 - w^2) from 0 to c takes about as long as a lag of 1 / (k1 + 1.5 k2 c).
    end = 300 + 2600 * 0.95 - 500 * 0.95**2
    assert rows[-2]["time_constant_s"] == pytest.approx(1 / (4 + 1.5 * 3.5e-3 * end), rel=0.02)


@pytest.mark.skipif(not (DATA / "bitcraze_2021").exists(), reason="the public stand recordings are not here")
def test_a_ramp_and_steps_of_one_propeller_have_the_same_rotor() -> None:
    """The commands of the ramp change ten times a second."""
    rates, stds = [], []
    for name in ("cf21_stock2.csv", "cf2.1-stock-prop.csv"):
        result = fit(DATA / "bitcraze_2021" / name)
        at, (covariance,) = np.array([1.0, 4000.0]), result.covariances
        assert "dynamics.rising" not in result.rejected
        rates.append(float(at @ result.quantities["dynamics.rising"].value))
        stds.append(math.sqrt(at @ np.array(covariance.matrix)[:2, :2] @ at))
    assert abs(rates[0] - rates[1]) < 1.96 * math.hypot(*stds)
    assert 1e3 / rates[0] == pytest.approx(92, abs=8)
    assert max(stds) < 0.15 * min(rates)


@pytest.mark.skipif(not INPUTS.exists(), reason="the reproductions are not here")
def test_slow_starts_with_delays_of_their_own_are_named_and_leave_the_model_alone() -> None:
    """66 ms from standstill, 10 ms between speeds, 30 ms down; changes between speeds come a tenth of a second late."""
    result = fit(INPUTS / "stand_slow_start.csv")

    assert "rotor-starts-slowly" in codes(result, "warning")
    for key, true_s in zip(WAYS, (0.010, 0.030), strict=True):
        rate = result.quantities[key].value @ np.array([1.0, 2000.0])
        assert 1 / rate == pytest.approx(true_s, rel=0.04)
    starts = [row for row in result.quantities["dynamics.time_constant_s"].value if row["cmd_from"] == 0]
    assert [row["time_constant_s"] for row in starts] == pytest.approx([0.066] * len(starts), rel=0.05)


@pytest.mark.parametrize(("slow", "named"), [(2.0, True), (1.0, False)])
def test_a_start_is_slow_only_where_it_is(tmp_path: Path, slow: float, named: bool) -> None:
    plant = Plant(start=slow)
    levels = [0, 0.4, 0.7, 0.4, 0, 0.6, 0.8, 0.5, 0, 0.5, 0.9, 0.4, 0, 0.7, 0.9, 0.3]
    write_stand(tmp_path / "stand.csv", plant, 6, levels=levels)
    result = fit(tmp_path / "stand.csv")

    assert ("rotor-starts-slowly" in codes(result)) is named
    assert np.abs(rates_off(result, plant, widest=0.05)).max() < 3


def test_a_battery_that_sags_under_a_rotor_moves_no_rate_beyond_its_uncertainty(tmp_path: Path) -> None:
    plant = Plant(sag_v=0.3)
    write_log(tmp_path / "log.csv", plant, 7, rotors=2)
    result = fit(tmp_path / "log.csv")

    assert np.abs(rates_off(result, plant, widest=0.05)).max() < 3


def test_a_sag_that_no_voltage_shows_is_in_the_uncertainty(tmp_path: Path) -> None:
    plant = Plant(sag_v=0.25)
    write_log(tmp_path / "log.csv", plant, 8, rotors=2, volts=False)
    result = fit(tmp_path / "log.csv")

    assert "lag-voltage-unknown" in codes(result, "warning")
    assert np.abs(rates_off(result, plant)).max() < 3


def test_speeds_rounded_to_coarse_steps_are_no_surer_than_these(tmp_path: Path) -> None:
    errors = []
    for seed in range(2):
        write_stand(tmp_path / "stand.csv", PLANT, seed, step=40.0, noise=0.05)
        errors += rates_off(fit(tmp_path / "stand.csv"), PLANT)
    assert np.abs(errors).max() < 3


def test_readings_that_rows_repeat_count_once(tmp_path: Path) -> None:
    write_stand(tmp_path / "stand.csv", PLANT, 9, repeat=5)
    result = fit(tmp_path / "stand.csv")

    assert "speeds-repeated" in codes(result)
    assert np.abs(rates_off(result, PLANT)).max() < 3
    assert abs(delay_off(result, PLANT)) < 2


def test_gaps_of_rows_and_blocks_of_their_own_rates_give_the_rotor(tmp_path: Path) -> None:
    """Twenty gaps of 150 ms, speeds in every second row, and the voltage in every fiftieth."""
    log = write_log(tmp_path / "log.csv", PLANT, 10, row_s=0.004)
    log.loc[log.index % 2 == 1, "rpm.m1"] = np.nan
    log.loc[log.index % 50 != 3, "pm.vbat"] = np.nan
    log = log[(log["t"] < 1) | (log["t"] % 0.7 > 0.15)]
    log.to_csv(tmp_path / "log.csv", index=False)
    result = fit(tmp_path / "log.csv")

    assert np.abs(rates_off(result, PLANT, widest=0.06)).max() < 3


def test_spikes_among_the_speeds_weigh_little(tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.csv", PLANT, 11)
    rng = np.random.default_rng(11)
    log.loc[rng.uniform(size=len(log)) < 0.01, "rpm.m1"] *= 1.7
    log.to_csv(tmp_path / "log.csv", index=False)

    assert np.abs(rates_off(fit(tmp_path / "log.csv"), PLANT, widest=0.05)).max() < 3


@pytest.fixture(scope="module")
def four(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a log of two rotors that follow, one whose sensor drops out, and one that shows only noise."""
    path = tmp_path_factory.mktemp("four") / "log.csv"
    log = write_log(path, PLANT, 12, rotors=4, row_s=0.01, volts=False)
    log.loc[::50, "rpm.m3"] = 0
    log["rpm.m4"] = 18000 + 2000 * np.random.default_rng(2).standard_normal(len(log))
    log.to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def of_four(four: Path) -> Result:
    return fit(four)


def test_a_bad_rotor_condemns_no_other(of_four: Result) -> None:
    result = of_four
    rows = result.quantities["dynamics.time_constant_s"].value

    assert result.accepted
    assert [row["accepted"] for row in rows if row["rising"]] == [True, True, True, False]
    assert np.abs(rates_off(result, PLANT)).max() < 3
    assert ("rotor 4",) in [one.where for one in result.findings if one.code == "rotor-model-misfit"]
    assert ("rotor 3",) in [one.where for one in result.findings if one.code == "speeds-missing"]
    # Rows are late for all rotors alike: no mean makes the delay surer than that.
    assert result.quantities["dynamics.delay_s"].std > 0.01 / math.sqrt(12)


def test_one_rotor_is_fitted_alone_and_one_that_is_not_there_is_refused(four: Path) -> None:
    rows = fit(four, rotor=2).quantities["dynamics.time_constant_s"].value
    assert [row["rotor"] for row in rows] == [2, 2]
    assert not fit(four, rotor=4).accepted
    log = pd.read_csv(four).drop(columns="rpm.m1")
    log.to_csv(four.parent / "three.csv", index=False)
    with pytest.raises(ConfigError):
        fit(four.parent / "three.csv", rotor=1)


def test_what_goes_one_way_alone_has_rates_of_that_way(tmp_path: Path) -> None:
    write_stand(tmp_path / "stand.csv", PLANT, 13, levels=[0.2, 0.35, 0.5, 0.65, 0.8, 0.95])
    result = fit(tmp_path / "stand.csv")

    assert WAYS[1] not in result.quantities
    assert result.accepted
    assert abs(rates_off(result, PLANT)[0]) < 3


def test_what_is_no_rotor_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "stand.csv"
    table = write_stand(path, PLANT, 14)
    table.assign(rpm=10000 + np.random.default_rng(1).normal(0, 800, len(table))).to_csv(path, index=False)
    assert set(codes(fit(path), "rejection")) == {"rotor-model-misfit"}


def test_commands_that_move_faster_than_they_were_logged_are_refused(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", PLANT, 15, row_s=0.06, hold_s=(0.01, 0.05), long_s=20.0)
    assert not fit(tmp_path / "log.csv").accepted


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (lambda table: table.assign(cmd=30000), FitError),
        (lambda table: table.assign(rpm=0), DataError),
        (lambda table: table.assign(t_s=np.floor(10 * table["t_s"]) / 10), DataError),
        (lambda table: table[:15], FitError),
    ],
)
def test_a_recording_without_steps_speeds_times_or_rows_is_refused(tmp_path: Path, change: Any, error: Any) -> None:
    change(write_stand(tmp_path / "stand.csv", PLANT, 16)).to_csv(tmp_path / "stand.csv", index=False)
    with pytest.raises(error):
        fit(tmp_path / "stand.csv")


def test_two_logs_whose_rows_take_turns_are_refused(tmp_path: Path) -> None:
    logs = [write_log(tmp_path / "log.csv", PLANT, seed, long_s=6.0) for seed in (17, 18)]
    pd.concat(logs).sort_values("t", kind="stable").to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(DataError):
        fit(tmp_path / "log.csv")


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (lambda u: 65535 - u, "map-not-monotone"),
        (lambda u: u / 65535, "commands-of-another-scale"),
    ],
)
def test_a_map_of_another_scale_or_that_falls_is_rejected_and_the_rates_are_not(
    tmp_path: Path, command: Any, code: str
) -> None:
    log = write_log(tmp_path / "log.csv", PLANT, 20)
    log.assign(**{"motor.m1": command(log["motor.m1"])}).to_csv(tmp_path / "log.csv", index=False)
    result = fit(tmp_path / "log.csv")

    assert result.accepted
    assert code in codes(result, "rejection")
    assert set(result.rejected) == {"motor.speed_poly"}
    assert np.abs(rates_off(result, PLANT)).max() < 3


def test_a_log_of_more_than_five_minutes_is_fitted_where_it_is_liveliest(tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.csv", PLANT, 21, row_s=0.02, long_s=20.0)
    quiet = pd.DataFrame({"t": np.arange(0, 400, 0.02), "motor.m1": 30000.0, "rpm.m1": 14000.0, "pm.vbat": 4.0})
    log["t"] += 400.02
    pd.concat([quiet, log]).to_csv(tmp_path / "log.csv", index=False)
    result = fit(tmp_path / "log.csv")

    assert "log-part-fitted" in codes(result)
    assert np.abs(rates_off(result, PLANT, widest=0.1)).max() < 3


def test_a_window_of_a_recording_is_fitted_and_an_empty_one_refused(tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.csv", PLANT, 22)
    log.loc[log["t"] > 10, "rpm.m1"] *= 2
    log.to_csv(tmp_path / "log.csv", index=False)

    assert np.abs(rates_off(fit(tmp_path / "log.csv", to_s=9.9), PLANT)).max() < 3
    with pytest.raises(ConfigError):
        fit(tmp_path / "log.csv", from_s=100.0)


def test_the_command_takes_a_log_a_run_of_it_and_a_stand(tmp_path: Path, cfid: Cfid) -> None:
    log = tmp_path / "log.csv"
    write_log(log, PLANT, 23, row_s=0.01)
    shown = cfid("fit", "dynamics", log, "--json")
    assert shown.returncode == 0, shown.stderr
    rising = json.loads(shown.stdout)["parameters"]["dynamics.rising"]["value"]

    new_campaign(tmp_path / "campaign")
    assert cfid("import", log, "--campaign", tmp_path / "campaign").returncode == 0
    (run,) = (tmp_path / "campaign" / "runs").iterdir()
    of_run = cfid("fit", "dynamics", run, "--json", "--campaign", tmp_path / "campaign")
    assert of_run.returncode == 0, of_run.stderr
    assert json.loads(of_run.stdout)["parameters"]["dynamics.rising"]["value"] == pytest.approx(rising, rel=1e-3)

    write_stand(tmp_path / "stand.csv", PLANT, 24)
    assert cfid("fit", "dynamics", "--table", tmp_path / "stand.csv").returncode == 0
    assert cfid("fit", "dynamics", tmp_path / "stand.csv", "--motor", "1").returncode == 2


def test_the_figure_shows_speeds_model_and_residual(of_four: Result) -> None:
    assert of_four.drawings is not None
    (page,) = of_four.drawings().values()
    panels = [axes for axes in page.axes if axes.lines]

    assert {line.get_label() for line in panels[0].lines} >= {"measured", "rotor model"}
    residual = np.asarray(panels[1].lines[0].get_ydata())
    assert np.std(residual) == pytest.approx(3.0, rel=0.2)
