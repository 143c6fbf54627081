"""Many campaigns side by side: the same numbers with one process, with several, and on a cluster."""

import hashlib
import importlib.util
import json
import re
import shutil
import socket
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.console.campaign import make_campaign
from cfid.fleet.comparison import outliers
from cfid.records.parameters import Parameter, Section, Source
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from tests.lab import Cfid, keep

DAY_0 = datetime(2026, 11, 1, tzinfo=UTC)


def campaign(folder: Path, day: int, mass_kg: float, *, std: float | None = 1e-5, accepted: bool = True) -> Path:
    """Make a campaign that found one number from one run, which was recorded on the given day and fitted much later."""
    make_campaign(folder)
    writer = create_run(
        folder / "runs",
        kind="swing",
        label=Label(axis="x"),
        devices={"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))},
        started=DAY_0 + timedelta(days=day),
        cfid_version="0",
    )
    writer.close("complete")
    file = writer.folder / "encoder.csv"
    source = Source(str(file.relative_to(folder)), hashlib.sha256(file.read_bytes()).hexdigest())
    section = Section(
        method="default",
        found=datetime(2027, 1, 1, tzinfo=UTC),
        cfid_version="0",
        accepted=accepted,
        rejected={} if accepted else {"thing.mass_kg": "too heavy."},
        sources=(source,),
        parameters={"thing.mass_kg": Parameter(value=mass_kg, std=std, unit="kg")},
    )
    keep(folder, "thing", section)
    return folder


def compared(cfid: Cfid, *words: object) -> dict[str, Any]:
    ended = cfid("fleet", *words, "--json")
    assert ended.returncode == 0, ended.stderr
    content: dict[str, Any] = json.loads(ended.stdout)
    return content


def test_numbers_stand_side_by_side_with_mean_agreement_and_drift_by_day_of_recording(
    cfid: Cfid, tmp_path: Path
) -> None:
    folders = [campaign(tmp_path / f"c{day}", day, 0.028 + 2e-5 * day) for day in range(4)]
    found = compared(cfid, *folders)["parameters"]["thing.mass_kg"]

    assert found["values"] == pytest.approx([0.028, 0.02802, 0.02804, 0.02806])
    assert found["repeats"]["drift_per_day"] == pytest.approx(2e-5)
    assert not found["repeats"]["agree"]
    printed = " ".join(cfid("fleet", *folders).stdout.split())
    assert "1 of 1 numbers differ by more than their uncertainties" in printed
    assert "+2e-05 +-" in printed


def test_a_number_that_was_rejected_is_shown_and_does_not_count(cfid: Cfid, tmp_path: Path) -> None:
    good = [campaign(tmp_path / f"c{day}", day, 0.028) for day in range(2)]
    odd = campaign(tmp_path / "odd", 3, 5.0, accepted=False)
    found = compared(cfid, *good, odd)["parameters"]["thing.mass_kg"]

    assert found["values"] == [0.028, 0.028, 5.0]
    assert found["repeats"]["mean"] == pytest.approx(0.028, rel=1e-12)
    assert "1 rejected" in " ".join(cfid("fleet", *good, odd).stdout.split())
    assert "+- 1.0e-05 rejected" in " ".join(cfid("fleet", *good, odd, "--details").stdout.split())


def test_recordings_that_changed_or_went_are_told(cfid: Cfid, tmp_path: Path) -> None:
    changed, gone = campaign(tmp_path / "changed", 0, 0.028), campaign(tmp_path / "gone", 1, 0.028)
    for folder in (changed, gone):
        file = next(folder.glob("runs/*/encoder.csv"))
        file.write_text("t,phi\n1,2\n") if folder == changed else file.unlink()
    ended = cfid("fleet", changed, gone)

    assert ended.returncode == 0
    assert "encoder.csv has changed since it was fitted." in ended.stderr
    assert "encoder.csv is missing." in ended.stderr


def test_what_no_campaign_shows_is_empty_in_a_table_and_no_word(cfid: Cfid, tmp_path: Path) -> None:
    folders = [campaign(tmp_path / f"c{day}", day, 0.028) for day in range(2)]
    for suffix in ("html", "parquet", "csv"):
        assert cfid("fleet", *folders, "--out", tmp_path / f"fleet.{suffix}").returncode == 0

    assert "None" not in (tmp_path / "fleet.html").read_text()
    frame = pd.read_parquet(tmp_path / "fleet.parquet")
    assert frame["drift_per_day"].dtype == frame["scatter"].dtype == np.float64
    assert frame["drift_per_day"].isna().all()
    assert (frame["scatter"] == 0).all()  # equal values have no scatter, also if their mean is rounded


def test_runs_that_cannot_be_read_are_counted_and_named(cfid: Cfid, tmp_path: Path) -> None:
    folder = campaign(tmp_path / "one", 0, 0.028)
    (broken := folder / "runs" / "2026-01-01_080000_swing_x").mkdir()
    (broken / "run.toml").write_text("format = 99")
    ended = cfid("fleet", folder, "--details")

    assert ended.returncode == 0
    assert "2026-01-01_080000_swing_x" in ended.stderr
    assert "99" in ended.stderr
    assert "1 not complete" in ended.stdout


@pytest.mark.parametrize(("mass_kg", "std"), [(1e308, 1e-5), (0.028, 1e-320)])
def test_a_number_that_nobody_measured_is_named_and_stops_no_comparison(
    cfid: Cfid, tmp_path: Path, mass_kg: float, std: float
) -> None:
    """Previously, one edited number ended the command for the whole fleet in a traceback."""
    places = [campaign(tmp_path / f"c{day}", day, 0.028 + 1e-6 * day) for day in (1, 2, 3)]
    places.append(campaign(tmp_path / "edited", 4, mass_kg, std=std))
    ended = cfid("fleet", *places)
    assert ended.returncode == 0, ended.stderr
    assert "which nobody measured: it is left out" in ended.stderr
    assert "edited" in ended.stderr


def test_of_many_changed_recordings_one_is_named_unless_details_are_wanted(cfid: Cfid, tmp_path: Path) -> None:
    folders = [campaign(tmp_path / f"c{day}", day, 0.028) for day in range(5)]
    for folder in folders:
        next(folder.glob("runs/*/encoder.csv")).unlink()
    short, long = cfid("fleet", *folders), cfid("fleet", *folders, "--details")

    assert short.stderr.count("encoder.csv is missing") == 1
    assert "source-missing: 4 more, in 5 campaigns altogether" in short.stderr
    assert long.stderr.count("encoder.csv is missing") == 5


def test_campaigns_that_cannot_be_read_are_listed_and_do_not_hide_the_others(cfid: Cfid, tmp_path: Path) -> None:
    one, nothing, loop = campaign(tmp_path / "one", 0, 0.028), tmp_path / "nothing", tmp_path / "loop"
    nothing.mkdir()
    loop.symlink_to(loop)
    ended = cfid("fleet", one, nothing, loop)

    assert ended.returncode == 4
    assert "thing.mass_kg" in ended.stdout
    assert "2 of 3 campaigns cannot be read" in ended.stderr
    assert "nothing/rig.toml: no such file" in ended.stderr
    assert "loop/rig.toml: " in ended.stderr
    assert "loop/rig.toml: " in cfid("fleet", tmp_path / "[ol]*o*").stderr  # also if a glob finds it
    assert cfid("fleet", nothing).returncode == 4
    assert cfid("fleet").returncode == 2


def test_a_table_of_many_campaigns_has_one_row_a_number(cfid: Cfid, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    folders = [campaign(tmp_path / f"c{day}", day, 0.028 + 1e-5 * rng.standard_normal()) for day in range(40)]
    folders.append(campaign(tmp_path / "heavy", 41, 0.0285))
    printed = cfid("fleet", *folders).stdout

    assert len(printed.splitlines()) < 12
    row = next(line for line in printed.splitlines() if "thing.mass_kg" in line)
    assert "heavy" in row
    assert "c1" not in row


@pytest.mark.parametrize("columns", [40, 60, 80, 120])
def test_every_digit_of_a_table_has_its_place_however_narrow_the_terminal_is(
    cfid: Cfid, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, columns: int
) -> None:
    """Previously, a terminal of 80 columns showed `3e-09` as `3e-0`, and one of 40 lost most columns of the table."""
    monkeypatch.setenv("COLUMNS", str(columns))
    for day in range(6):
        folder = campaign(tmp_path / f"c{day}", day, 0.028 + 2e-5 * day)
        noted(folder, "friction", "friction.a_long_name_of_a_number.setup_inertia_kg_m2", 1.007e-5 + 1e-8 * day, "kg")
    printed = cfid("fleet", tmp_path / "c*").stdout

    if columns >= 60:  # what the longest name needs
        assert max(map(len, printed.splitlines())) <= columns
    words = printed.split()
    found = compared(cfid, tmp_path / "c*")["parameters"]["thing.mass_kg"]["repeats"]
    for figure in (f"{found['scatter']:.2g}", "1e-05", f"{found['drift_per_day']:+.2g}", "day"):
        assert figure in words


@pytest.mark.parametrize("std", [None, float("nan"), 0.0])
def test_a_value_without_uncertainty_takes_no_weight_and_no_others_agreement(
    cfid: Cfid, tmp_path: Path, std: float | None
) -> None:
    """Previously, one value at a bound took the weights of 60 campaigns, and the mean was fifty times too large."""
    stated = [campaign(tmp_path / f"c{day}", day, 0.028 + 2e-5 * day) for day in range(4)]
    unsure = campaign(tmp_path / "unsure", 5, 0.9, std=0.5)
    bound = campaign(tmp_path / "bound", 6, 0.028, std=std)
    found = compared(cfid, *stated, unsure)["parameters"]["thing.mass_kg"]["repeats"]
    beside = cfid("fleet", *stated, unsure, bound)

    assert compared(cfid, *stated, unsure, bound)["parameters"]["thing.mass_kg"]["repeats"] == found
    assert found["mean"] == pytest.approx(0.02803, abs=1e-7)
    assert "in 5; 1 without std" in " ".join(beside.stdout.split())
    assert "1 of 1 numbers differ by more than their uncertainties" in " ".join(beside.stdout.split())


@pytest.mark.parametrize("certain", [0, 1])
def test_how_many_values_have_no_uncertainty_is_stated_where_no_two_have_one(
    cfid: Cfid, tmp_path: Path, certain: int
) -> None:
    folders = [campaign(tmp_path / f"c{day}", day, 0.028, std=1e-5 if day < certain else None) for day in range(4)]
    printed = cfid("fleet", *folders).stdout
    cfid("fleet", *folders, "--out", tmp_path / "table.csv")

    assert f"{4 - certain} without std" in printed
    assert pd.read_csv(tmp_path / "table.csv")["without_std"][0].count("c") == 4 - certain


def test_a_copy_of_a_campaign_is_named(cfid: Cfid, tmp_path: Path) -> None:
    one, other = campaign(tmp_path / "one", 0, 0.028), campaign(tmp_path / "other", 1, 0.028)
    for folder in (one, other):
        next(folder.glob("runs/*/encoder.csv")).write_text(f"t,phi\n1,{len(folder.name)}\n")
        (fit,) = (folder / "fits").iterdir()
        digest = hashlib.sha256(next(folder.glob("runs/*/encoder.csv")).read_bytes()).hexdigest()
        fit.write_text(re.sub('"sha256": "[0-9a-f]*"', f'"sha256": "{digest}"', fit.read_text()))
    copy = shutil.copytree(one, tmp_path / "one-backup")

    assert "recordings of" not in cfid("fleet", one, other).stderr
    ended = cfid("fleet", one, other, copy)
    assert "note: one-backup: rests on recordings of one, and both count" in " ".join(ended.stderr.split())


def test_the_name_of_a_folder_makes_no_line_of_its_own(cfid: Cfid, tmp_path: Path) -> None:
    (tmp_path / "a\n  b: cannot").mkdir()
    ended = cfid("fleet", tmp_path / "a*")

    assert ended.returncode == 4
    assert not any(line.lstrip().startswith("b:") for line in ended.stderr.splitlines())


def test_normal_scatter_names_an_outlier_in_one_table_of_a_hundred() -> None:
    rng = np.random.default_rng(2)
    for count in (5, 8, 20, 200):
        tables = 4000 if count < 100 else 1000
        named = sum(bool(outliers(rng.standard_normal(count), np.full(count, 0.1))) for _ in range(tables))
        assert named / tables < 0.02


def test_a_value_within_its_own_uncertainty_is_no_outlier() -> None:
    value = np.append(np.tile([-1.0, 0.0, 1.0], 10), 20.0)

    assert outliers(value, np.full(31, 0.5)) == [30]
    assert outliers(value, np.append(np.full(30, 0.5), 10.0)) == []
    assert outliers(value[-4:], np.full(4, 0.5)) == []


@pytest.mark.parametrize("suffix", ["csv", "parquet", "html"])
def test_a_table_is_written_to_a_new_file(cfid: Cfid, tmp_path: Path, suffix: str) -> None:
    folders = [campaign(tmp_path / name, day, 0.028) for day, name in enumerate(["a", "b", "<i>c"])]
    path = tmp_path / f"table.{suffix}"
    ended = cfid("fleet", *folders, "--details", "--out", path)

    assert ended.returncode == 0, ended.stderr
    if suffix == "html":
        assert "&lt;i&gt;c" in path.read_text()
        assert "<i>" not in path.read_text()
        table = pd.read_html(path)[0] if importlib.util.find_spec("lxml") else None
    else:
        table = pd.read_csv(path) if suffix == "csv" else pd.read_parquet(path)
    if table is not None:
        assert list(table["value"]) == [0.028] * 3
        assert list(table["campaign"]) == ["a", "b", "<i>c"]
    again = cfid("fleet", *folders, "--out", path)
    assert again.returncode == 2
    assert "exists already" in again.stderr


def test_a_name_in_a_csv_file_is_no_formula_of_a_spreadsheet(cfid: Cfid, tmp_path: Path) -> None:
    folders = [campaign(tmp_path / name, day, 0.028) for day, name in enumerate(["=1+1", "@b", "c"])]
    cfid("fleet", *folders, "--details", "--out", tmp_path / "table.csv")
    assert list(pd.read_csv(tmp_path / "table.csv")["campaign"]) == ["'=1+1", "'@b", "c"]


def test_a_table_without_details_has_a_row_a_number(cfid: Cfid, tmp_path: Path) -> None:
    folders = [campaign(tmp_path / f"c{day}", day, 0.028) for day in range(3)]
    cfid("fleet", *folders, "--out", tmp_path / "table.csv")
    table = pd.read_csv(tmp_path / "table.csv")

    assert list(table["number"]) == ["thing.mass_kg"]
    assert table["expected_scatter"][0] == pytest.approx(1e-5)
    assert table["used"][0] == 3


def test_globs_and_an_index_name_campaigns(cfid: Cfid, tmp_path: Path) -> None:
    folders = [campaign(tmp_path / f"c{day}", day, 0.028) for day in range(3)]
    (tmp_path / "list.txt").write_text("# first week\nc0\n\nc[12]\n")
    listed = compared(cfid, "--index", tmp_path / "list.txt")

    assert listed == compared(cfid, tmp_path / "c*") == compared(cfid, *folders)
    ended = cfid("fleet", tmp_path / "d*", tmp_path / "e*")
    assert ended.returncode == 2
    assert [name for name in ("d*", "e*") if f"{name}: no folder matches." in ended.stderr] == ["d*", "e*"]


def test_a_glob_that_matches_nothing_hides_no_other_campaign(cfid: Cfid, tmp_path: Path) -> None:
    folder = campaign(tmp_path / "c0", 0, 0.028)
    ended = cfid("fleet", folder, tmp_path / "d*")

    assert ended.returncode == 4
    assert "thing.mass_kg" in ended.stdout
    assert "1 of 2 campaigns cannot be read:" in ended.stderr
    assert "d*: no folder matches" in ended.stderr


@pytest.mark.parametrize("glob", ["nowhere://lab/*", "x" * 5000 + "*"])
def test_a_glob_that_cannot_be_followed_hides_no_other_campaign(cfid: Cfid, tmp_path: Path, glob: str) -> None:
    ended = cfid("fleet", campaign(tmp_path / "c0", 0, 0.028), glob)

    assert ended.returncode == 4
    assert "thing.mass_kg" in ended.stdout
    assert "1 of 2 campaigns cannot be read:" in ended.stderr


def test_campaigns_without_a_number_have_a_sentence_in_place_of_a_table(cfid: Cfid, tmp_path: Path) -> None:
    ended = cfid("fleet", campaign(tmp_path / "c0", 0, 0.028), "--only", "inertia")

    assert "none has the name asked for" in ended.stdout
    assert "scatter" not in ended.stdout


def test_campaigns_of_one_name_are_told_apart_by_their_paths(cfid: Cfid, tmp_path: Path) -> None:
    folders = [campaign(tmp_path / lab / "day-1", 0, 0.028) for lab in ("a", "b")]
    cfid("fleet", *folders, "--details", "--out", tmp_path / "table.csv")

    assert list(pd.read_csv(tmp_path / "table.csv")["campaign"]) == [str(folder) for folder in folders]


def noted(folder: Path, name: str, key: str, value: float, unit: str) -> None:
    one = Section(
        method="default",
        found=DAY_0,
        cfid_version="0",
        accepted=True,
        sources=(),
        parameters={key: Parameter(value=value, std=0.1, unit=unit)},
    )
    keep(folder, name, one)


def test_swings_about_two_axes_are_two_numbers(cfid: Cfid, tmp_path: Path) -> None:
    one, other = campaign(tmp_path / "one", 0, 0.028), campaign(tmp_path / "other", 1, 0.028)
    noted(one, "swing x", "swing.zero_rad", 1.0, "rad")
    noted(one, "swing z", "swing.zero_rad", 2.0, "rad")
    noted(other, "swing x", "swing.zero_rad", 3.0, "rad")
    found = compared(cfid, one, other)["parameters"]

    assert found["swing.zero_rad (x)"]["values"] == [1.0, 3.0]
    assert found["swing.zero_rad (z)"]["values"] == [2.0, None]


def test_numbers_of_different_units_are_not_compared(cfid: Cfid, tmp_path: Path) -> None:
    one, other = campaign(tmp_path / "one", 0, 0.028), campaign(tmp_path / "other", 1, 0.028)
    noted(one, "set", "thing", 46.0, "mm")
    noted(other, "set", "thing", 0.046, "m")
    found = compared(cfid, one, other)["parameters"]

    assert found["thing, mm"]["values"] == [46.0, None]
    assert found["thing, m"]["values"] == [None, 0.046]


def test_a_campaign_that_is_named_twice_counts_once(cfid: Cfid, tmp_path: Path) -> None:
    one = campaign(tmp_path / "one", 0, 0.028)

    assert compared(cfid, one, tmp_path / "." / "one")["parameters"]["thing.mass_kg"]["repeats"] is None


def test_several_processes_find_the_same(cfid: Cfid, tmp_path: Path) -> None:
    folders = [campaign(tmp_path / f"c{day}", day, 0.028 + 1e-6 * day) for day in range(33)]

    assert compared(cfid, *folders, "--jobs", 3) == compared(cfid, *folders, "--jobs", 1)


def test_a_cluster_finds_the_same(cfid: Cfid, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install 'cfid[fleet]'")
    folders = [campaign(tmp_path / f"c{day}", day, 0.028 + 1e-6 * day) for day in range(3)]
    with distributed.LocalCluster(n_workers=2, processes=True, dashboard_address=":0") as cluster:
        found = compared(cfid, *folders, "--scheduler", cluster.scheduler_address)

    assert found == compared(cfid, *folders)


def test_a_cluster_that_is_not_there_is_told(cfid: Cfid, tmp_path: Path) -> None:
    ended = cfid("fleet", campaign(tmp_path / "one", 0, 0.028), "--scheduler", "tcp://127.0.0.1:9")

    assert ended.returncode == 2
    assert "--scheduler" in ended.stderr


def test_a_fleet_is_told_that_addresses_are_for_refits(cfid: Cfid) -> None:
    ended = cfid("fleet", "memory://c1")
    assert ended.returncode == 4
    assert "only `cfid fleet fit` takes addresses" in ended.stderr


def test_a_fleet_asks_no_server_whose_address_it_refuses(cfid: Cfid, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        address = f"http://127.0.0.1:{server.getsockname()[1]}/*"
        ended = cfid("fleet", campaign(tmp_path / "c0", 0, 0.028), address)
        with pytest.raises(BlockingIOError):
            server.accept()

    assert ended.returncode == 4
    assert "only `cfid fleet fit` takes addresses" in ended.stderr
