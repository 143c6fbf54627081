"""Drag from runs of `cfid log wind`, as their files tell it."""

import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from cfid.console.inputs import open_workplace
from cfid.console.options import LoadCellOptions, ReadingOptions, RigOptions
from cfid.drag.data import WindEvidence, WindInputs, read_wind_evidence
from cfid.drag.selection import DragChoices, fit_models
from cfid.drag.wind.plan import WindSetting
from cfid.errors import DataError, FitError
from cfid.records.campaign import RIG_FILE, new_rig_text
from cfid.records.facts import NONE_STATED, LoadCellMount, RigFacts, Tachometer, WindStand
from cfid.records.run import DeviceRecord, Label, Run
from cfid.records.run_writer import create_run
from cfid.sim.battery import BatteryTruth
from cfid.sim.rotors import RotorTruth
from cfid.sim.wind import WindTruth
from tests.motors.stand_in_a_folder import BEGIN_S, COLUMNS, climbed, write_run

COMMANDS = (20000, 40000)
WINDS = (
    WindTruth(),
    WindTruth(angle_deg=0.0, speed_mps=3.1),
    WindTruth(angle_deg=48.4, speed_mps=2.9),
    WindTruth(angle_deg=77.9, speed_mps=3.6),
)
DEVICES = {
    "commands": DeviceRecord(file="commands.csv", columns=("t", "m1", "m2", "m3", "m4")),
    "loadcell": DeviceRecord.model_validate(
        {"file": "loadcell.csv", "columns": COLUMNS, "counts_per_n": 1e6, "counts_per_nm": 1e6}
    ),
    "crazyflie": DeviceRecord(file="crazyflie.csv", columns=("t", "vehicle_ms", "pm.vbat")),
    "readings": DeviceRecord(file="readings.csv", columns=("t", "command", "rpm")),
}


def shown_rpm(command: int) -> float:
    return float(2 * 60 / (2 * np.pi) * RotorTruth().steady_rad_per_s(np.array(command), volts=3.7))


def blown(
    folder: Path,
    wind: WindTruth,
    *,
    volts: float = 3.7,
    typed: int = 2,
    rate_hz: float = 1000.0,
    seed: int = 3,
    facts: RigFacts = NONE_STATED,
) -> Run:
    """Write what `cfid log wind` records in a wind that was read within 2 %."""
    record = climbed(COMMANDS, motors=(1, 2, 3, 4), battery=BatteryTruth(volts=volts), rate_hz=rate_hz, seed=seed)
    speed_sum = np.interp(record.time_s, record.tick_s, record.speed_rad_per_s.sum(axis=1))
    record.wrench[:, :3] += speed_sum[:, np.newaxis] * wind.drag_ns_per_rad + wind.body_n
    windy = wind.speed_mps > 0
    low, high = 0.98 * wind.speed_mps, 1.02 * wind.speed_mps
    setting = WindSetting(angle_deg=wind.angle_deg if windy else None, fan_v=8.0, min_mps=low, max_mps=high)
    run = create_run(
        folder / "runs",
        kind="wind",
        label=Label(),
        devices=DEVICES,
        started=datetime(2026, 11, 21, 8, int(10 * wind.speed_mps), tzinfo=UTC),
        cfid_version="0",
        facts=facts,
        asked={"steps": COMMANDS, "motors": (1, 2, 3, 4), "hold_s": 2.0, "rest_s": 1.0, **setting.asked},
    )
    number, ms = np.arange(1, len(speed_sum) + 1), np.rint(1e3 * record.tick_s).astype(np.int64)
    counts = np.rint(record.wrench * 1e6).astype(np.int64)
    run.append("commands", (BEGIN_S + record.command_time_s, *record.commands.astype(np.int64).T))
    run.append("loadcell", (BEGIN_S + record.time_s, *counts.T, number, 7 * number, record.status.astype(np.int64)))
    run.append("crazyflie", (BEGIN_S + record.tick_s, ms, np.round(record.volts, 3)))
    if windy and typed:
        at_s = np.array([2.9, 5.9])
        columns = (BEGIN_S + at_s, np.array(COMMANDS), np.array([shown_rpm(c) for c in COMMANDS]))
        run.append("readings", tuple(column[:typed] for column in columns))
    return run.close("complete")


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    return tmp_path


def read(folder: Path, *words: object) -> WindEvidence:
    workplace = open_workplace(RigOptions(campaign=folder))
    named = [str(word) for word in words]
    return read_wind_evidence(named, WindInputs(), ReadingOptions(), LoadCellOptions(), workplace, method="default")


def test_all_runs_of_a_campaign_give_the_coefficients_that_act(campaign: Path) -> None:
    for seed, wind in enumerate(WINDS):
        blown(campaign, wind, seed=seed)
    found = read(campaign)
    result = fit_models(found.experiments, DragChoices())

    true = np.array(WINDS[0].kg_per_rad)
    assert len(found.experiments.command) == 6
    assert np.all(np.abs(result.simple_kg_per_rad - true) < 3 * result.simple_std_kg_per_rad)
    assert np.all(result.simple_std_kg_per_rad < 0.1 * np.abs(true))
    assert not any("battery" in warning for warning in found.warnings)


def test_runs_keep_yaw_azimuth_markers_and_sign_whatever_rig_toml_says_later(campaign: Path) -> None:
    facts = RigFacts(
        loadcell=LoadCellMount(yaw_deg=10.0, flip_fz=True),
        tachometer=Tachometer(markers=4),
        wind=WindStand(azimuth_deg=-60.0),
    )
    mounted = WindTruth(angle_deg=77.9, speed_mps=3.6, azimuth_deg=-60.0, yaw_deg=10.0)
    usual: list[str] = []
    own: list[str] = []
    for into, stated, wind in ((own, facts, mounted), (usual, NONE_STATED, WINDS[3])):
        into += [blown(campaign, WINDS[0], facts=stated).folder.name, blown(campaign, wind, facts=stated).folder.name]
    found, assumed = read(campaign, *own), read(campaign, *usual)

    velocity, force = (np.mean(each, axis=0) for each in (found.experiments.velocity_mps, found.experiments.force_n))
    assert math.degrees(math.atan2(-velocity[1], velocity[0])) == pytest.approx(-60)
    assert -force[:2] @ velocity[:2] / np.linalg.norm(force[:2]) / np.linalg.norm(velocity[:2]) > 0.98
    assert found.experiments.speed_sum_rad_s * 2 == pytest.approx(assumed.experiments.speed_sum_rad_s)
    assert force[2] > 0 > assumed.experiments.force_n[:, 2].mean()
    assert not any("assumed" in warning for warning in found.warnings)
    told = [warning for warning in assumed.warnings if "assumed" in warning]
    assert len(told) == 3
    assert any(
        "2 recordings: a yaw of 45 degrees on the load cell is assumed, as in version 0.1" in said for said in told
    )
    assert any("an azimuth of 28.46 degrees is assumed" in said for said in told)
    assert any("2 markers of the tachometer are assumed" in said for said in told)


def test_a_reading_that_was_not_typed_is_heard(campaign: Path) -> None:
    still, windy = blown(campaign, WINDS[0]), blown(campaign, WINDS[2], typed=0, rate_hz=2000.0)
    found = read(campaign, still.folder.name, windy.folder.name)

    assert any("heard in the vibration" in warning for warning in found.warnings)
    true = [4 * RotorTruth().steady_rad_per_s(np.array(command), volts=3.7) for command in COMMANDS]
    assert found.experiments.speed_sum_rad_s == pytest.approx(true, rel=0.005)


def test_what_is_sampled_too_slowly_to_be_heard_is_asked_for(campaign: Path) -> None:
    blown(campaign, WINDS[0])
    blown(campaign, WINDS[2], typed=0)
    with pytest.raises(FitError, match="sampled at 1000 Hz: 2000 are needed"):
        read(campaign)


def test_a_command_without_a_reading_is_left_out_beside_one_that_has_it(campaign: Path) -> None:
    blown(campaign, WINDS[0])
    blown(campaign, WINDS[2], typed=1)
    found = read(campaign)

    assert found.experiments.command.tolist() == [20000]
    assert any("command 40000: no tachometer reading" in said and "It is left out." in said for said in found.warnings)


def test_a_battery_below_that_of_the_reference_is_told(campaign: Path) -> None:
    blown(campaign, WINDS[0])
    blown(campaign, WINDS[2], volts=3.65)
    (warning,) = (said for said in read(campaign).warnings if "battery" in said)

    assert "2 run(s) had another battery voltage than their reference" in warning
    assert "by -1.4 %" in warning


def test_a_run_of_something_else_is_no_run_in_wind(campaign: Path) -> None:
    other = write_run(campaign, climbed(COMMANDS), steps=COMMANDS)
    with pytest.raises(DataError, match="is no run of `cfid log wind` that says its wind"):
        read(campaign, other.folder)


def test_a_file_is_no_run(campaign: Path) -> None:
    (campaign / "some.csv").write_text("t,Fx\n")
    with pytest.raises(DataError, match="no run folder; recordings of others are named in an --index FILE"):
        read(campaign, campaign / "some.csv")


def test_a_run_that_is_named_twice_is_told(campaign: Path) -> None:
    still, windy = blown(campaign, WINDS[0]), blown(campaign, WINDS[2])
    with pytest.raises(DataError, match=r"the same recording as .*: name each once"):
        read(campaign, still.folder.name, windy.folder.name, windy.folder)


def test_wind_without_any_reference_is_told(campaign: Path) -> None:
    blown(campaign, WINDS[2])
    with pytest.raises(DataError, match="no run without wind at command 20000, 40000"):
        read(campaign)


def test_one_wind_is_fitted_and_not_judged(campaign: Path) -> None:
    blown(campaign, WINDS[0])
    blown(campaign, WINDS[2])
    result = fit_models(read(campaign).experiments, DragChoices())

    assert result.comparison is None
    assert result.chosen is result.simple
    assert any("too few to leave one out" in warning for warning in result.warnings)
