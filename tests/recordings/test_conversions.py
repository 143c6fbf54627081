"""Conversion: every value comes back from the format's own reader, and no file is overwritten or left incomplete."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import ConfigError
from cfid.recordings.convert import Format, convert
from cfid.recordings.read import read_recording
from tests.lab import Cfid, made_run
from tests.logs.usd_bytes import FIXED, POSE, bytes_of, rows, single, written

Columns = dict[str, npt.NDArray[np.float64]]
Reader = Callable[[Path, str], Columns]

ANGLE = np.random.default_rng(1).normal(size=1000)
COUNTS = np.arange(1000) * 4099 - 2000
TIME_S = 1_763_712_345.123457 + np.arange(1000) * 1e-3


def run(folder: Path) -> Path:
    devices: dict[str, dict[str, Any]] = {
        "encoder": {"t": TIME_S, "phi": COUNTS},
        "crazyflie": {"t": TIME_S[::10], "vehicle_ms": np.arange(100), "pm.vbat": ANGLE[::10]},
        "crossings": {"t": [], "thrust_rec": []},
    }
    return made_run(folder, "swing", devices, facts_of={"encoder": {"counts_per_turn": 4194304.0}}).folder


def from_csv(path: Path, series: str) -> Columns:
    with (path / f"{series}.csv" if path.is_dir() else path).open(newline="") as file:
        head, *body = csv.reader(file)
    return {name: np.array(column, dtype=float) for name, column in zip(head, zip(*body, strict=True), strict=True)}


def from_parquet(path: Path, series: str) -> Columns:
    parquet = pytest.importorskip("pyarrow.parquet", reason='pyarrow comes with pip install "cfid[parquet]"')
    table = parquet.read_table(path / f"{series}.parquet" if path.is_dir() else path)
    return {name: table[name].to_numpy() for name in table.column_names}


def from_mcap(path: Path, series: str) -> Columns:
    reader = pytest.importorskip("mcap.reader", reason='mcap comes with pip install "cfid[mcap]"')
    with path.open("rb") as file:
        found = [json.loads(message.data) for _, _, message in reader.make_reader(file).iter_messages(topics=[series])]
    return {name: np.array([float(row[name]) for row in found]) for name in found[0]}


READERS: dict[Format, Reader] = {"csv": from_csv, "parquet": from_parquet, "mcap": from_mcap}
LIBRARIES = {"parquet": "pyarrow", "mcap": "mcap"}


def needs_library(to: Format) -> None:
    if to in LIBRARIES:
        pytest.importorskip(LIBRARIES[to], reason=f'comes with pip install "cfid[{to}]"')


@pytest.mark.parametrize("to", READERS)
def test_every_value_of_a_run_comes_back(tmp_path: Path, to: Format) -> None:
    needs_library(to)
    recording = read_recording(run(tmp_path))
    convert(recording, to, tmp_path / "out")
    encoder = READERS[to](tmp_path / "out", "encoder")
    np.testing.assert_array_equal(encoder["t"], [float(f"{time:.6f}") for time in TIME_S])
    np.testing.assert_array_equal(encoder["phi"], COUNTS)
    np.testing.assert_array_equal(READERS[to](tmp_path / "out", "crazyflie")["pm.vbat"], ANGLE[::10])
    assert "crossings" not in recording.series


@pytest.mark.parametrize("to", READERS)
def test_every_value_of_a_log_comes_back(tmp_path: Path, to: Format) -> None:
    needs_library(to)
    records = [(event, at, (*values[:3], float("nan"))) for event, at, values in rows(500)]
    recording = read_recording(written(tmp_path, bytes_of([FIXED, POSE], records)))
    (path,) = convert(recording, to, tmp_path / "out")
    found = READERS[to](path, "fixedFrequency")
    np.testing.assert_array_equal(found["gyro.x"], np.arange(500) / 8)  # as the firmware logs it, in deg/s
    np.testing.assert_array_equal(found["t"], recording.series["fixedFrequency"].frame()["t"] + 5)
    assert np.isnan(found["acc.z"]).all()


def test_units_and_origin_are_in_the_file(tmp_path: Path) -> None:
    needs_library("parquet")
    from pyarrow import parquet

    (path,) = convert(read_recording(written(tmp_path, single())), "parquet", tmp_path / "out.parquet")
    schema = parquet.read_schema(path)
    units = [schema.field(name).metadata[b"unit"] for name in ("t", "gyro.x", "motor.m1", "pm.state", "acc.z")]
    assert units == [b"s", b"deg/s", b"1", b"", b"g"]
    assert len(schema.metadata[b"sha256"]) == 64
    assert b"uSD-card log" in schema.metadata[b"program"]


def test_a_table_has_the_units_in_its_header_that_its_names_do_not_state(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "t_s,gyro.x [rad/s],acc.z,Thrust (gf)\n" + "".join(f"{k},1,2,3\n" for k in range(40))
    )
    (path,) = convert(read_recording(tmp_path / "a.csv"), "csv", tmp_path / "out.csv")
    assert path.read_text().splitlines()[0] == "t,gyro.x [rad/s],acc.z,Thrust [gf]"


def test_a_file_that_is_there_is_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("precious")
    with pytest.raises(ConfigError, match="exists already"):
        convert(read_recording(written(tmp_path, single())), "csv", tmp_path / "out")
    with pytest.raises(ConfigError, match="exists already"):
        convert(read_recording(run(tmp_path)), "csv", tmp_path / "out")
    assert (tmp_path / "out").read_text() == "precious"


def test_a_failure_leaves_no_file(tmp_path: Path) -> None:
    recording = read_recording(written(tmp_path, single()))
    series = recording.series["fixedFrequency"]
    short = replace(series.columns[0], values=series.columns[0].values[:9])
    torn = replace(series, name="torn", columns=(*series.columns, short))
    with pytest.raises(ValueError, match="same length"):
        convert(replace(recording, series={"a": series, "b": torn}), "csv", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_command_converts_and_states_what_it_understood(cfid: Cfid, tmp_path: Path) -> None:
    ended = cfid("convert", written(tmp_path, single()), "--to", "csv", "--out", "a.csv")
    assert ended.returncode == 0
    assert "Crazyflie uSD-card log, version 2" in ended.stdout
    np.testing.assert_array_equal(from_csv(tmp_path / "a.csv", "")["motor.m1"], 60 * np.arange(100))
