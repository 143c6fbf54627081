"""Many campaigns side by side: the same numbers by one process, by several, and on a cluster."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from cfid.console.campaign import make_campaign
from cfid.records.parameters import Parameter, Section, Source, store_section
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from tests.campaigns import Cfid

DAY_0 = datetime(2026, 11, 1, tzinfo=UTC)


def campaign(folder: Path, day: int, mass_kg: float, *, std: float | None = 1e-5, accepted: bool = True) -> Path:
    """Make a campaign that found one number from one run, recorded on a day and fitted much later."""
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
    import hashlib

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
    store_section(folder / "parameters.toml", "thing", section)
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
    printed = cfid("fleet", *folders).stdout
    assert "they differ by more than their uncertainties" in " ".join(printed.split())
    assert "drift 2e-05" in " ".join(printed.split())


def test_a_number_that_was_rejected_is_shown_and_does_not_count(cfid: Cfid, tmp_path: Path) -> None:
    good = [campaign(tmp_path / f"c{day}", day, 0.028) for day in range(2)]
    odd = campaign(tmp_path / "odd", 3, 5.0, accepted=False)
    found = compared(cfid, *good, odd)["parameters"]["thing.mass_kg"]

    assert found["values"] == [0.028, 0.028, 5.0]
    assert found["repeats"]["mean"] == pytest.approx(0.028, rel=1e-12)
    assert "rejected" in cfid("fleet", *good, odd).stdout


def test_recordings_that_changed_or_went_are_told(cfid: Cfid, tmp_path: Path) -> None:
    changed, gone = campaign(tmp_path / "changed", 0, 0.028), campaign(tmp_path / "gone", 1, 0.028)
    for folder in (changed, gone):
        file = next(folder.glob("runs/*/encoder.csv"))
        file.write_text("t,phi\n1,2\n") if folder == changed else file.unlink()
    ended = cfid("fleet", changed, gone)

    assert ended.returncode == 0
    assert "encoder.csv has changed since it was fitted." in ended.stderr
    assert "encoder.csv is missing." in ended.stderr


def test_a_folder_that_is_no_campaign_does_not_hide_the_others(cfid: Cfid, tmp_path: Path) -> None:
    one, nothing = campaign(tmp_path / "one", 0, 0.028), tmp_path / "nothing"
    nothing.mkdir()
    ended = cfid("fleet", one, nothing)

    assert ended.returncode == 0
    assert "thing.mass_kg" in ended.stdout
    assert "nothing/rig.toml: no such file" in ended.stderr
    assert cfid("fleet", nothing).returncode == 2


def noted(folder: Path, name: str, key: str, value: float, unit: str) -> None:
    one = Section(
        method="default",
        found=DAY_0,
        cfid_version="0",
        accepted=True,
        sources=(),
        parameters={key: Parameter(value=value, std=0.1, unit=unit)},
    )
    store_section(folder / "parameters.toml", name, one)


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
    folders = [campaign(tmp_path / f"c{day}", day, 0.028 + 1e-6 * day) for day in range(9)]

    assert compared(cfid, *folders, "--jobs", 3) == compared(cfid, *folders, "--jobs", 1)


def test_a_cluster_finds_the_same(cfid: Cfid, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install 'cfid[fleet]'")
    folders = [campaign(tmp_path / f"c{day}", day, 0.028 + 1e-6 * day) for day in range(3)]
    with distributed.LocalCluster(n_workers=2, processes=True, dashboard_address=None) as cluster:
        found = compared(cfid, *folders, "--scheduler", cluster.scheduler_address)

    assert found == compared(cfid, *folders)


def test_a_cluster_that_is_not_there_is_told(cfid: Cfid, tmp_path: Path) -> None:
    ended = cfid("fleet", campaign(tmp_path / "one", 0, 0.028), "--scheduler", "tcp://127.0.0.1:9")

    assert ended.returncode == 2
    assert "--scheduler" in ended.stderr
