"""Many campaigns side by side: means, scatter, outliers and drift, from folders, globs and an index."""

import hashlib
import json
import shutil
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
    make_campaign(folder, kind="simulated")
    writer = create_run(
        folder / "runs",
        kind="swing",
        label=Label(axis="x"),
        devices={"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))},
        started=DAY_0 + timedelta(days=day),
        cfid_version="0",
    )
    writer.append("encoder", ([float(day)], [len(folder.name)]))
    writer.close("complete")
    file = writer.folder / "encoder.csv"
    source = Source(str(file.relative_to(folder)), hashlib.sha256(file.read_bytes()).hexdigest())
    fitted(folder, "thing", {"thing.mass_kg": mass_kg}, std=std, accepted=accepted, sources=(source,))
    return folder


def fitted(folder: Path, name: str, values: dict[str, float], *, unit: str = "kg", **more: Any) -> None:
    std, accepted, sources = more.get("std", 0.1), more.get("accepted", True), more.get("sources", ())
    section = Section(
        method="default",
        found=datetime(2027, 1, 1, tzinfo=UTC),
        cfid_version="0",
        accepted=accepted,
        rejected={} if accepted else dict.fromkeys(values, "too heavy."),
        sources=sources,
        parameters={key: Parameter(value=value, std=std, unit=unit) for key, value in values.items()},
    )
    keep(folder, name, section)


def compared(cfid: Cfid, *words: object) -> dict[str, Any]:
    ended = cfid("fleet", *words, "--json")
    assert ended.returncode == 0, ended.stderr
    content: dict[str, Any] = json.loads(ended.stdout)
    return content


def test_values_have_a_mean_a_scatter_and_a_drift_by_the_days_of_their_recordings(cfid: Cfid, tmp_path: Path) -> None:
    folders = [campaign(tmp_path / f"c{day}", day, 0.028 + 2e-5 * day) for day in range(4)]
    number = compared(cfid, *folders)["parameters"]["thing.mass_kg"]

    assert number["values"] == pytest.approx([0.028, 0.02802, 0.02804, 0.02806])
    assert number["expected_scatter"] == pytest.approx(1e-5)
    assert number["scatter"] == pytest.approx(np.std(number["values"], ddof=1))
    assert number["drift_per_day"] == pytest.approx(2e-5)
    assert number["probability"] < 0.01
    assert "+2e-05 +-" in cfid("fleet", *folders).stdout


@pytest.mark.parametrize("std", [None, float("nan"), 0.0])
def test_a_value_without_uncertainty_has_no_weight(cfid: Cfid, tmp_path: Path, std: float | None) -> None:
    """Previously, one value at a bound took the weights of 60 campaigns, and the mean was fifty times too large."""
    stated = [campaign(tmp_path / f"c{day}", day, 0.028 + 2e-5 * day) for day in range(4)]
    uncertain = campaign(tmp_path / "uncertain", 5, 0.9, std=0.5)
    bound = campaign(tmp_path / "bound", 6, 0.028, std=std)
    without, beside = (
        compared(cfid, *stated, uncertain, *more)["parameters"]["thing.mass_kg"] for more in ((), (bound,))
    )

    assert all(beside[key] == without[key] for key in ("mean", "mean_std", "scatter", "probability", "used"))
    assert beside["without_std"] == ["bound"]
    assert beside["mean"] == pytest.approx(0.02803, abs=1e-7)


def test_recordings_that_changed_went_cannot_be_read_or_are_copies_are_findings(cfid: Cfid, tmp_path: Path) -> None:
    changed, gone, broken = (campaign(tmp_path / name, day, 0.028) for day, name in enumerate(("changed", "gone", "c")))
    copy = shutil.copytree(broken, tmp_path / "copy")
    next(changed.glob("runs/*/encoder.csv")).write_text("t,phi\n1,2\n")
    next(gone.glob("runs/*/encoder.csv")).unlink()
    (run := broken / "runs" / "2026-01-01_080000_swing_x").mkdir()
    (run / "run.toml").write_text("format = 99")
    campaigns = compared(cfid, changed, gone, broken, copy)["campaigns"]

    assert [[finding["code"] for finding in each["findings"]] for each in campaigns] == [
        ["fit-outdated"], ["source-missing"], ["run-unreadable"], ["recordings-shared"],
    ]  # fmt: skip
    assert (campaigns[2]["complete_runs"], campaigns[2]["other_runs"]) == (1, 1)
    assert run.name in campaigns[2]["findings"][0]["text"]


def test_unreadable_campaigns_are_listed_after_the_others(cfid: Cfid, tmp_path: Path) -> None:
    folder, nothing = campaign(tmp_path / "c", 0, 0.028), tmp_path / "nothing"
    nothing.mkdir()
    (loop := tmp_path / "loop").symlink_to(loop)
    ended = cfid("fleet", folder, nothing, loop, tmp_path / "d*", "a\0b*")

    assert ended.returncode == 4
    assert "thing.mass_kg" in ended.stdout
    assert len(ended.stderr.splitlines()) == 1 + 4
    assert all(name in ended.stderr for name in ("nothing/rig.toml", "loop/rig.toml", "d*"))
    assert cfid("fleet", nothing).returncode == 4
    assert cfid("fleet", tmp_path / "d*").returncode == cfid("fleet").returncode == 2


def test_many_campaigns_of_many_numbers_fit_a_screen(
    cfid: Cfid, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    rng = np.random.default_rng(1)
    for place in range(32):
        folder = campaign(tmp_path / f"c{place}", place, 0.028 + 1e-5 * rng.standard_normal())
        speeds = {f"rotor{key:02d}.speed_rad_s": 100 + 0.1 * rng.standard_normal() for key in range(50)}
        if place == 7:
            speeds["rotor49.speed_rad_s"] = 102.0
        fitted(folder, "rotors", speeds, unit="rad/s")
    lines = cfid("fleet", tmp_path / "c*", "--jobs", 2).stdout.splitlines()

    assert len(lines) <= 40
    assert max(map(len, lines)) <= 100
    assert [line.split()[0] for line in lines if "c7" in line] == ["rotor49.speed_rad_s"]


def test_a_value_twenty_standard_uncertainties_off_among_five_is_an_outlier() -> None:
    assert outliers(np.array([1.00, 1.01, 0.99, 1.005, 1.20]), np.full(5, 0.01)) == [4]
    assert outliers(np.array([1.00, 1.01, 0.99, 1.005, 1.20]), np.array([0.01, 0.01, 0.01, 0.01, 0.1])) == []
    assert outliers(np.array([1.00, 1.01, 0.99, 1.20]), np.full(4, 0.01)) == []  # too few to tell
    two = np.append(np.random.default_rng(3).standard_normal(20), [15.0, 30.0])
    assert outliers(two, np.ones(22)) == [21, 20]  # the farthest first


@pytest.mark.parametrize("count", [5, 12])
@pytest.mark.parametrize("between", [0.0, 1.0, 3.0])
def test_outliers_are_named_as_promised(count: int, between: float) -> None:
    """One in a hundred numbers without an outlier names one, whatever the scatter between campaigns; few miss one."""
    rng, tables = np.random.default_rng(2), 500
    scatter = np.hypot(1.0, between)
    value = scatter * rng.standard_normal((tables, count))
    false = np.mean([bool(outliers(row, np.ones(count))) for row in value])
    value[:, 0] += 20 * scatter
    named = np.mean([0 in outliers(row, np.ones(count)) for row in value])

    assert false < 0.01 + 3 * np.sqrt(0.01 * 0.99 / tables)
    assert named > 0.9


@pytest.mark.parametrize("suffix", ["csv", "parquet", "html"])
def test_a_table_in_a_file_has_a_row_for_each_number(cfid: Cfid, tmp_path: Path, suffix: str) -> None:
    folders = [campaign(tmp_path / name, 0, 0.028, accepted=name != "<i>c") for name in ("a", "b", "<i>c")]
    path = tmp_path / f"table.{suffix}"
    assert cfid("fleet", *folders, "--out", path).returncode == 0

    if suffix == "html":
        assert "&lt;i&gt;c" in path.read_text()
        assert "None" not in path.read_text()
    else:
        table = pd.read_csv(path) if suffix == "csv" else pd.read_parquet(path)
        assert list(table["number"]) == ["thing.mass_kg"]
        assert list(table["rejected"]) == ["<i>c"]
        assert (table["mean"][0], table["used"][0]) == (pytest.approx(0.028), 2)
        assert table["drift_per_day"].dtype == np.float64
        assert table["drift_per_day"].isna().all()
    before = path.read_bytes()
    assert cfid("fleet", *folders, "--out", path).returncode == 2
    assert path.read_bytes() == before


def test_globs_and_an_index_name_campaigns_each_once(cfid: Cfid, tmp_path: Path) -> None:
    folders = [campaign(tmp_path / f"c{day}", day, 0.028) for day in range(3)]
    (tmp_path / "list.txt").write_text("# first week\nc0\n\nc[12]\n")

    assert compared(cfid, "--index", tmp_path / "list.txt") == compared(cfid, tmp_path / "c*", tmp_path / "." / "c0")
    assert len(compared(cfid, *folders, folders[0])["campaigns"]) == 3


def test_axes_units_and_folders_of_one_name_are_kept_apart(cfid: Cfid, tmp_path: Path) -> None:
    first, second = (campaign(tmp_path / lab / "day-1", 0, 0.028) for lab in ("a", "b"))
    for folder, axis, value in ((first, "x", 1.0), (first, "z", 2.0), (second, "x", 3.0)):
        fitted(folder, f"swing {axis}", {"swing.zero_rad": value}, unit="rad")
    fitted(first, "set", {"thing": 46.0}, unit="mm")
    fitted(second, "set", {"thing": 0.046}, unit="m")
    content = compared(cfid, first, second)

    assert [each["name"] for each in content["campaigns"]] == [str(first), str(second)]
    assert {name: number["values"] for name, number in content["parameters"].items() if name != "thing.mass_kg"} == {
        "swing.zero_rad (x)": [1.0, 3.0],
        "swing.zero_rad (z)": [2.0, None],
        "thing, mm": [46.0, None],
        "thing, m": [None, 0.046],
    }
