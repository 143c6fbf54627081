"""A MATLAB file that cfid wrote is read as the recording it came from: names, units, series and fits are the same."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from cfid.interchange.convert import convert
from cfid.interchange.recording import recording_at
from cfid.records.logs.any_kind import read_log
from cfid.records.logs.kinds import kind_at
from cfid.records.tables.schema import Foreign
from cfid.records.tables.stand import read_stand_table
from tests.campaigns import Cfid
from tests.logs.usd_bytes import FIXED, POSE, bytes_of, rows, single, written

TIME_S = np.arange(400) / 100
ANGLE_RAD = 0.5 * np.exp(-TIME_S / 3) * np.cos(7 * TIME_S)
KILOGRAM_FORCE_N = 9.80665
STAND = "Time (s),Throttle (%),Thrust (kgf),Torque (N·m),Voltage (V),Rotation speed (rpm)"


def converted(path: Path, reading: Foreign | None = None) -> Path:
    made = path.with_name(f"{path.stem}.mat")
    convert(recording_at(path, reading or Foreign()), "mat", made)
    return made


def csv(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text)
    return path


def stand(folder: Path) -> Path:
    """Write settled points of five seconds each; the thrust in kgf is (row / 100)."""
    body = [f"{5 * at},{at},{at / 100},{at / 1e3},{12 - at / 100},{60 * at}" for at in range(100)]
    return csv(folder, "\n".join([STAND, *body, ""]))


def test_a_stands_table_keeps_its_names_and_units(tmp_path: Path) -> None:
    table = read_stand_table(converted(stand(tmp_path)))
    at = np.arange(100)
    assert np.asarray(table.thrust_n) == pytest.approx(KILOGRAM_FORCE_N * at / 100)
    assert np.asarray(table.torque_nm) == pytest.approx(at / 1e3)
    assert np.asarray(table.square_mean_speed_rad_s) == pytest.approx(2 * math.pi * at)
    assert table.command == pytest.approx(at * 655.35)


@pytest.mark.parametrize("named", ["thrust_n=3", "thrust_n=Thrust (kgf)"])
def test_an_option_does_not_override_the_unit_of_a_converted_column(tmp_path: Path, named: str) -> None:
    table = read_stand_table(converted(stand(tmp_path)), columns=(named,))
    assert np.asarray(table.thrust_n)[50] == pytest.approx(KILOGRAM_FORCE_N / 2)


def test_a_log_of_the_sd_card_keeps_its_channels_and_units(tmp_path: Path) -> None:
    path = written(tmp_path, single(300))
    original, again = read_log(path), read_log(converted(path))
    (series,), (found,) = original.series, again.series
    assert found.channels == series.channels
    np.testing.assert_array_equal(np.vstack(list(found.blocks())), np.vstack(list(series.blocks())))


def test_times_of_a_slow_log_stay_seconds(tmp_path: Path) -> None:
    path = csv(tmp_path, "".join(["time_s,level\n", *(f"{2.5 * at},{at}\n" for at in range(40))]))
    again = read_log(converted(path, Foreign(time_unit="s")))
    np.testing.assert_array_equal(again.series[0].time_s, 2.5 * np.arange(40))


def test_a_log_of_several_events_keeps_its_series_also_those_of_one_row(tmp_path: Path, cfid: Cfid) -> None:
    poses = [(3, 5_000_000 + 10_000 * at, (1, 0.5, at, -1, 2)) for at in range(20)]
    records = [*rows(300), *poses, (7, 5_100_500, ())]
    path = written(tmp_path, bytes_of([FIXED, POSE, (7, "landed", ())], records))
    made = converted(path)
    original, again = read_log(path), read_log(made)

    assert kind_at(made, Foreign()) == "flight"
    assert [one.name for one in again.series] == [one.name for one in original.series]
    for series, found in zip(original.series, again.series, strict=True):
        assert found.channels == series.channels
        np.testing.assert_array_equal(np.vstack(list(found.blocks())), np.vstack(list(series.blocks())))
    assert again.clock == original.clock

    campaign = tmp_path / "campaign"
    cfid("new", campaign)
    imported = cfid("import", made, "--campaign", campaign)
    assert imported.returncode == 0, imported.stderr
    assert "landed 1 rows" in " ".join(imported.stdout.split())


def test_a_variable_that_was_added_to_a_converted_file_is_a_column_beside_the_others(tmp_path: Path) -> None:
    made = converted(stand(tmp_path))
    content = {name: value for name, value in loadmat(made, simplify_cells=True).items() if not name.startswith("__")}
    savemat(made, content | {"filtered": np.arange(100.0)})
    table = read_stand_table(made)
    assert np.asarray(table.thrust_n)[50] == pytest.approx(KILOGRAM_FORCE_N / 2)
    assert any("not used: filtered." in finding.text for finding in table.findings)
