"""`cfid demo` makes a complete campaign with a known truth in its own folder, with correct intervals."""

import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest

from cfid.console.campaign import make_campaign
from cfid.demo import recordings as demo_recordings
from cfid.demo.fits import compared, covers, runs_by_kind
from cfid.demo.recordings import DROPS, SWINGS, Laboratory, experiments, winds
from cfid.demo.truth import demo_truth, true_values
from cfid.records.campaign import find_campaign, open_campaign
from cfid.records.fits import Fit, list_fits
from tests.fleet.test_refit import numbers as found_numbers
from tests.lab import Cfid, run_cfid, sections_at
from tests.report.chromium import BROWSER, look_at

SECTIONS = {
    "inertia",
    "friction",
    "testbody",
    "thrust",
    "torque",
    "speed",
    "rotor",
    "dynamics",
    "tf",
    "latency",
    "drag",
}
SEEDS = 12
OPTIONS = (
    "fit inertia --peaks 12 --mass-kg 0.028:0.0001",
    "fit speed --markers 2",
    "fit torque",
    "fit drag",
    "tf identify --shape first",
)


def command(*words: object) -> list[str]:
    return [sys.executable, "-m", "cfid.cli.main", "demo", *map(str, words)]


def numbers(folder: Path, seed: int) -> list[tuple[str, float, float, float | None]]:
    """Return the name, truth, estimate and standard uncertainty of each number that a demo found."""
    campaign = find_campaign(folder, start=folder)
    assert campaign is not None
    return list(compared(campaign.values(), true_values(demo_truth(seed), campaign.rig, seed=seed)))


def fitted_here(folder: Path, seed: int) -> list[tuple[str, float, float, float | None]]:
    """Return the numbers of a demo whose commands run in this process, since imports take most of a demo's time."""
    make_campaign(folder, kind="simulated")
    campaign = find_campaign(folder, start=folder)
    assert campaign is not None
    truth = demo_truth(seed)
    laboratory = Laboratory(campaign, truth, seed=seed)
    for recordings, fits in experiments(truth, seed=seed):
        for recording in recordings:
            laboratory.make(recording)
        for words in fits:
            said = run_cfid([*words.format(**runs_by_kind(campaign)).split(), "--no-figures"], folder)
            assert said.returncode == 0, said.stderr
    return numbers(folder, seed)


@pytest.mark.slow  # the tutorial, which also runs as a test, starts with a demo too
def test_a_demo_measures_everything_hands_it_on_and_is_never_mixed_with_another(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    done = subprocess.run(command(folder, "--no-figures"), capture_output=True, text=True, check=False)

    assert done.returncode == 0, done.stderr
    fits = [fit for fit in list_fits(folder / "fits") if isinstance(fit, Fit)]
    assert {fit.name.split()[0] for fit in fits} == SECTIONS
    assert {path.name for path in folder.iterdir()} >= {"report.html", "exports", "runs", "fits", "parameters.toml"}
    found = numbers(folder, seed=1)
    assert len(found) == 25
    far = [name for name, true, value, std in found if std is None or abs(value - true) > 3 * std]
    assert far == []
    assert f"{sum(covers(*row[1:]) for row in found)} of 25 true values lie in the 95 % intervals" in done.stdout
    assert len((done.stdout + done.stderr).splitlines()) <= 40
    assert "cfid fit inertia" in (folder / "demo.txt").read_text()

    if BROWSER is not None:
        report = (folder / "report.html").read_text()
        seen = look_at(report, tmp_path, widths_px=(1280,), dark=False)[1280]
        assert seen.cut == ()

    before = (folder / "parameters.toml").read_bytes()
    again = subprocess.run(command(folder, "--seed", 2), capture_output=True, text=True, check=False)
    assert again.returncode == 2
    assert "delete it, or give another folder" in again.stderr
    assert (folder / "parameters.toml").read_bytes() == before


def test_a_truth_that_is_none_makes_no_folder(cfid: Cfid, tmp_path: Path) -> None:
    (tmp_path / "truth.toml").write_text("[rotors]\nnonsense = 1\n")
    said = cfid("demo", tmp_path / "demo", "--truth", tmp_path / "truth.toml")

    assert said.returncode == 2
    assert "rotors.nonsense: there is no such key" in said.stderr
    assert not (tmp_path / "demo").exists()


def test_a_seed_makes_the_same_recordings_on_any_day(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = []
    for now in (datetime(2026, 3, 1, 12, 0, 0, 123456, UTC), datetime(2026, 11, 30, 7, 0, 0, 654321, UTC)):
        monkeypatch.setattr(demo_recordings, "datetime", SimpleNamespace(now=lambda _, now=now: now))
        make_campaign(tmp_path / str(now.month), seed=1, kind="simulated")
        campaign = open_campaign(tmp_path / str(now.month))
        Laboratory(campaign, demo_truth(1), seed=1).make(SWINGS[0])
        (run,) = campaign.runs()
        table = pd.read_csv(run.device_file("encoder"))
        recorded.append(table.assign(t=table.t - table.t[0]))

    assert recorded[0].equals(recorded[1])


@pytest.mark.slow
def test_the_truth_lies_within_the_interval_of_nineteen_in_twenty_parameters(tmp_path: Path) -> None:
    inside: dict[str, list[bool]] = {}
    for seed in range(SEEDS):
        for name, true, value, std in fitted_here(tmp_path / f"demo{seed}", seed):
            inside.setdefault(name, []).append(covers(true, value, std))
    every = np.concatenate(list(inside.values()))
    low, high = binomtest(int(every.sum()), every.size).proportion_ci()
    print(
        f"\n{100 * every.mean():.1f} % ({100 * low:.1f} to {100 * high:.1f}) of {every.size} numbers of {SEEDS} demos"
    )

    assert low <= 0.95 <= high
    assert {name: np.mean(held) for name, held in inside.items() if np.mean(held) <= 0.85} == {}


@pytest.mark.slow
def test_a_fleet_repeats_every_fit_with_its_options_to_the_last_bit(cfid: Cfid, tmp_path: Path) -> None:
    fitted_here(tmp_path / "demo", 1)
    for words in OPTIONS:
        ended = run_cfid([*words.split(), "--no-figures"], tmp_path / "demo")
        assert ended.returncode == 0, ended.stderr
    ended = cfid("fleet", "fit", tmp_path / "demo", "--out", tmp_path / "again", "--jobs", 1)

    assert ended.returncode == 0, ended.stderr
    kept, made = (sections_at(tmp_path / one) for one in ("demo", "again/demo"))
    assert set(kept) >= SECTIONS
    assert found_numbers(made) == found_numbers(kept)


def test_a_demo_records_what_an_operator_would_and_the_same_again(tmp_path: Path) -> None:
    made = []
    for name in ("one", "two"):
        make_campaign(tmp_path / name, kind="simulated")
        campaign = find_campaign(tmp_path / name, start=tmp_path)
        assert campaign is not None
        laboratory = Laboratory(campaign, demo_truth(3), seed=3)
        for recording in (SWINGS[0], DROPS[-1], winds(demo_truth(3), seed=3)[1]):
            laboratory.make(recording)
        made.append([run for run in campaign.runs() if run.header.simulated])
    kinds = [run.header.kind for run in made[0]]
    wind = made[0][-1]

    assert kinds == ["swing", "drop", "wind"]
    assert set(wind.header.devices) == {"commands", "loadcell", "crazyflie", "supervisor", "readings"}
    assert wind.header.devices["readings"].rows == 5
    for first, second in zip(*made, strict=True):
        for device, record in first.header.devices.items():
            rows, again = (pd.read_csv(run.device_file(device)).drop(columns="t") for run in (first, second))
            assert record.rows, device
            assert rows.equals(again), device


@pytest.mark.parametrize("left", ["parameters.toml", "fits", "runs/2026-11-21_083012_swing_x"])
def test_a_demo_does_not_mix_with_what_another_left(cfid: Cfid, tmp_path: Path, left: str) -> None:
    (tmp_path / left).mkdir(parents=True)
    said = cfid("demo", tmp_path)

    assert said.returncode == 2
    assert not (tmp_path / "rig.toml").exists()
