"""`cfid fleet fit`: campaigns are refitted from their recordings into a separate folder."""

import json
import os
import shutil
import signal
import sys
import time
from datetime import datetime, timedelta
from pathlib import Path
from subprocess import DEVNULL
from typing import Any

import pytest

from cfid.console.campaign import make_campaign
from cfid.errors import DataError
from cfid.fleet import refit as refit_module
from cfid.fleet.refit import refit, refits, refitted
from cfid.records.campaign import open_campaign
from cfid.records.files import RIG_FILE, sha256_of
from cfid.records.parameters import Section, plain
from cfid.records.rig_file import new_rig_text
from cfid.version import __version__
from tests.campaigns import LONGEST_S, Once
from tests.fleet.work import die
from tests.lab import Cfid, run_cfid, sections_at
from tests.motors.stand_in_a_folder import climbed, write_run
from tests.motors.test_readings_and_resumed_runs import two_parts
from tests.offline.write import write_runs
from tests.processes import started

FITS = {"c1": ("friction", "testbody", "swing"), "c2": ("inertia", "swing"), "c3": ("swing",)}
OF_C1 = {"friction", "testbody", "swing x"}


@pytest.fixture(scope="session")
def campaigns(once: Once, recordings: list[Any]) -> Path:
    """Three campaigns with the same swings, drops and test body, of which commands fitted a different part in each."""

    def make(folder: Path) -> None:
        first = folder / "c1"
        make_campaign(first, kind="simulated")
        write_runs(open_campaign(first), recordings)
        for name in ("c2", "c3"):
            shutil.copytree(first, folder / name)
        swing = next((first / "runs").glob("*swing_x")).name
        for name, fits in FITS.items():
            for fit in fits:
                words = ["fit", fit, *([swing] if fit == "swing" else []), "--no-figures"]
                ended = run_cfid(words, folder / name)
                assert ended.returncode == 0, ended.stderr

    return once("fleet", make)


@pytest.fixture
def three(campaigns: Path, tmp_path: Path) -> Path:
    """A copy of the campaigns, for a test that changes them."""
    return Path(shutil.copytree(campaigns, tmp_path / "three"))


@pytest.fixture
def results(once: Once, campaigns: Path, tmp_path: Path) -> Path:
    """A copy of a folder of results with one campaign, for a test that continues from there."""

    def make(folder: Path) -> None:
        words = ["fleet", "fit", str(campaigns / "c3"), "--out", "results", "--jobs", "1"]
        ended = run_cfid(words, folder)
        assert ended.returncode == 0, ended.stderr

    return Path(shutil.copytree(once("refitted", make) / "results", tmp_path / "results"))


def numbers(sections: dict[str, Section]) -> dict[str, Any]:
    """Return everything that the fits found, to the last bit, without times and places."""
    return {
        name: [
            section.method,
            section.accepted,
            plain(dict(section.common)),
            plain([one.matrix for one in section.covariance]),
        ]
        + [(key, plain(one.value), plain(one.std), one.unit) for key, one in section.parameters.items()]
        for name, section in sections.items()
    }


def found_in(folder: Path) -> dict[str, Any]:
    return {each.name: numbers(sections_at(each)) for each in sorted(folder.iterdir()) if each.is_dir()}


def hashes(folder: Path) -> dict[Path, str]:
    return {path: sha256_of(path) for path in sorted(folder.rglob("*")) if path.is_file()}


def test_refitted_campaigns_have_the_numbers_of_their_commands_and_are_unchanged(
    cfid: Cfid, campaigns: Path, tmp_path: Path
) -> None:
    before = hashes(campaigns)
    ended = cfid("fleet", "fit", campaigns / "c*", "--out", tmp_path / "out", "--jobs", 2)

    assert ended.returncode == 0, ended.stderr
    assert found_in(tmp_path / "out") == found_in(campaigns)
    assert set(sections_at(tmp_path / "out" / "c1")) == OF_C1
    assert hashes(campaigns) == before
    assert [line.split() for line in ended.stdout.splitlines() if "swing x" in line] == [["swing", "x", *"3000"]]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["c1", "c2", "c3"]
    kept, made = (
        json.loads(cfid("fleet", f"./{each}", "--json", folder=folder).stdout)  # dates are those of the recordings
        for folder, each in ((campaigns, "c3"), (tmp_path / "out", "c3"))
    )
    assert made["campaigns"][0]["findings"] == []
    assert made["parameters"].keys() == kept["parameters"].keys()
    for key, number in made["parameters"].items():
        days = [datetime.fromisoformat(each["recorded"][0]) for each in (number, kept["parameters"][key])]
        assert abs(days[0] - days[1]) < timedelta(seconds=1)


def test_a_cluster_gives_the_same_to_the_last_bit(cfid: Cfid, campaigns: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install 'cfid[fleet]'")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as cluster:
        address = cluster.scheduler_address
        ended = cfid("fleet", "fit", campaigns / "c3", "--out", tmp_path / "out", "--scheduler", address)

    assert ended.returncode == 0, ended.stderr
    assert found_in(tmp_path / "out") == {"c3": found_in(campaigns)["c3"]}


def test_a_fleet_continues_where_it_was_interrupted(campaigns: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["fleet", "fit", campaigns / "c*", "--out", out, "--jobs", 2]
    with (tmp_path / "stderr").open("w+") as stderr:
        process = started(words, anew=True, cwd=tmp_path, env=os.environ, stdout=stderr, stderr=stderr)
        end_s = time.monotonic() + LONGEST_S
        while time.monotonic() < end_s and not list(out.glob("c*")):
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        assert process.wait(LONGEST_S) == 130
    kept = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert kept.keys() < {"c1", "c2", "c3"}  # nor is an incomplete folder left
    ended = run_cfid([*map(str, words)], tmp_path)

    assert ended.returncode == 0, ended.stderr
    assert found_in(out) == found_in(campaigns)
    assert {name: (out / name).stat().st_mtime_ns for name in kept} == kept


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are looked for in /proc")
def test_a_killed_command_leaves_no_process_and_the_next_removes_its_folder(campaigns: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["fleet", "fit", campaigns / "c*", "--out", out, "--jobs", 2]
    process = started(words, anew=True, cwd=tmp_path, env=os.environ, stdout=DEVNULL, stderr=DEVNULL)
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s and not list(out.glob(".incomplete-*/*")):
        time.sleep(0.02)
    workers = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.kill()
    process.wait(LONGEST_S)
    while time.monotonic() < end_s and any(Path("/proc", worker).exists() for worker in workers):
        time.sleep(0.02)
    assert len(workers) >= 2
    assert not any(Path("/proc", worker).exists() for worker in workers)
    assert [path.name[:12] for path in out.iterdir()] == [".incomplete-"]

    assert run_cfid(["fleet", "fit", str(campaigns / "c3"), "--out", str(out)], tmp_path).returncode == 0
    assert [path.name for path in out.iterdir()] == ["c3"]


def test_a_process_that_dies_is_the_fault_of_its_campaigns_alone(
    campaigns: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refit_module, "refit", die)
    waiting = {tmp_path / "out" / name: str(campaigns / name) for name in ("c1", "c2")}
    outcomes = dict(refits(waiting, tmp_path / "out", {}, jobs=2))

    assert [type(outcome) for outcome in outcomes.values()] == [DataError, DataError]
    assert list((tmp_path / "out").iterdir()) == []


def test_campaigns_of_one_name_have_numbered_folders_that_stay_theirs(campaigns: Path, tmp_path: Path) -> None:
    """Previously, with two processes, the folders of two vehicles were exchanged."""
    labs = [str(tmp_path / lab / "vehicle") for lab in ("a", "b", "c")]
    out = tmp_path / "out"
    for name, lab in (("vehicle", labs[1]), ("vehicle-2", labs[0])):
        (out / name).mkdir(parents=True)
        log = {"campaign": lab, "cfid_version": __version__, "changes": {}, "fits": []}
        (out / name / "refit.json").write_text(json.dumps(log))

    assert [made.name for _, made, _ in refitted(labs, out, {})] == ["vehicle-2", "vehicle", "vehicle-3"]
    assert [bool(outcome) for _, _, outcome in refitted(labs, out, {})] == [True, True, False]


def test_results_of_other_options_and_foreign_folders_are_not_touched(
    cfid: Cfid, campaigns: Path, results: Path, tmp_path: Path
) -> None:
    (tmp_path / "mine" / "c3").mkdir(parents=True)
    before = hashes(results)
    foreign = cfid("fleet", "fit", campaigns / "c3", "--out", tmp_path / "mine")
    other = cfid("fleet", "fit", campaigns / "c3", "--out", results, "--method", "thesis")

    assert (foreign.returncode, other.returncode) == (2, 2)
    assert hashes(results) == before
    assert list((tmp_path / "mine" / "c3").iterdir()) == []


def test_another_method_or_option_replaces_that_of_the_fits_that_have_it(
    cfid: Cfid, campaigns: Path, tmp_path: Path
) -> None:
    words = ("fleet", "fit", campaigns / "c3", "--out")
    thesis = cfid(*words, tmp_path / "thesis", "--method", "thesis", "--json")
    peaks = cfid(*words, tmp_path / "peaks", "--set", "peaks=5", "--set", "markers=3")

    assert (thesis.returncode, peaks.returncode) == (0, 0)
    assert sections_at(tmp_path / "thesis" / "c3")["swing x"].method == "thesis"
    assert json.loads(thesis.stdout)["campaigns"]["c3"]["fits"][0]["moved"] > 1
    (file,) = (tmp_path / "peaks" / "c3" / "fits").glob("*swing*.json")
    assert json.loads(file.read_text())["options"] == {"peaks": "5"}
    for wrong in ("peak=5", "peaks"):
        assert cfid(*words, tmp_path / "new", "--set", wrong).returncode == 2


OPTIONS = {
    "swing": {"from_s": 0.75, "to_s": 14.2, "mass_kg": "0.0301:0.0001", "min_angle_deg": 3.0},
    "friction": {"radius_mm": "2.05:0.01", "gravity_mps2": "9.8123:0.0001"},
}


@pytest.fixture
def fitted_with_options(once: Once, campaigns: Path, tmp_path: Path) -> Path:
    """A campaign whose last fits of a swing and of friction were made with options."""

    def make(folder: Path) -> None:
        campaign = Path(shutil.copytree(campaigns / "c1", folder / "c1"))
        swing = next((campaign / "runs").glob("*swing_x")).name
        for words in (
            f"swing {swing} --from 0.75 --to 14.2 --mass-kg 0.0301:0.0001 --min-angle-deg 3",
            "friction --radius-mm 2.05:0.01 --gravity-mps2 9.8123:0.0001",
        ):
            ended = run_cfid(["fit", *words.split(), "--no-figures"], campaign)
            assert ended.returncode == 0, ended.stderr

    return Path(shutil.copytree(once("fitted with options", make) / "c1", tmp_path / "options" / "c1"))


def last_fit(folder: Path, name: str) -> Path:
    return max((folder / "fits").glob(f"*{name}*.json"), key=lambda path: path.stat().st_mtime_ns)


def test_a_fit_with_options_is_repeated_with_them_to_the_last_bit(fitted_with_options: Path, tmp_path: Path) -> None:
    outcome = refit(str(fitted_with_options), tmp_path / "made")

    assert [fit["fault"] for fit in outcome["fits"]] == [""] * len(outcome["fits"])
    assert numbers(sections_at(tmp_path / "made")) == numbers(sections_at(fitted_with_options))
    for folder in (fitted_with_options, tmp_path / "made"):
        assert {name: json.loads(last_fit(folder, name).read_text())["options"] for name in OPTIONS} == OPTIONS


def faults(campaign: Path, made: Path) -> dict[str, str]:
    """Return why fits of a campaign were not repeated, by their names."""
    return {fit["name"]: fit["fault"] for fit in refit(str(campaign), made)["fits"] if fit["fault"]}


def test_labels_that_were_typed_are_repeated_and_those_of_other_runs_refused(three: Path, tmp_path: Path) -> None:
    campaign = three / "c1"
    drops = sorted(path.name for path in (campaign / "runs").glob("*drop*"))
    words = [f"{drop.rpartition('_')[2].removesuffix('g')}:0.2={drop}" for drop in drops]
    ended = run_cfid(["fit", "friction", *words, "--no-figures"], campaign)
    assert ended.returncode == 0, ended.stderr
    kept = numbers(sections_at(campaign))
    file = last_fit(campaign, "friction")
    content = json.loads(file.read_text())

    assert content["options"] == {"labels": words}
    assert faults(campaign, tmp_path / "made") == {}
    assert numbers(sections_at(tmp_path / "made"))["friction"] == kept["friction"]

    file.write_text(json.dumps(content | {"options": {"labels": ["20:0.2=another"]}}))
    assert faults(campaign, tmp_path / "again").keys() == {"friction"}


@pytest.mark.parametrize("options", [None, {"from_s": "soon"}, {"out": "/tmp"}, {"colour": 1}])
def test_a_fit_whose_options_are_unknown_or_not_its_commands_is_named(
    options: object, fitted_with_options: Path, tmp_path: Path
) -> None:
    file = last_fit(fitted_with_options, "swing")
    file.write_text(json.dumps(json.loads(file.read_text()) | {"options": options}))

    assert faults(fitted_with_options, tmp_path / "made").keys() == {"swing x"}
    assert set(sections_at(tmp_path / "made")) == OF_C1 - {"swing x"}


def test_a_map_is_verified_again_by_all_parts_of_its_scales(tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    steps = tuple(range(0, 64001, 8000))
    write_run(tmp_path, climbed(steps), steps=steps, motors=(1, 3), hold_s=2.0, rest_s=1.0)
    _, second = two_parts(tmp_path)
    words = ["fit", "thrust", "--verify", second.folder.name, "--no-figures"]
    ended = run_cfid(words, tmp_path)
    assert ended.returncode == 0, ended.stderr

    assert json.loads(last_fit(tmp_path, "thrust").read_text())["options"] == {"verify": [second.folder.name]}
    assert faults(tmp_path, tmp_path / "made") == {}
    assert "verification: 5 readings" in last_fit(tmp_path / "made", "thrust").read_text()


def test_campaigns_that_cannot_be_refitted_do_not_stop_the_others(cfid: Cfid, three: Path, tmp_path: Path) -> None:
    shutil.rmtree(three / "c1" / "fits")
    (three / "c2" / "rig.toml").write_text("no [rig")
    ended = cfid("fleet", "fit", three / "c*", "--out", tmp_path / "out", "--jobs", 1)

    assert ended.returncode == 4
    assert all(f"{three / name}/" in ended.stderr for name in ("c1", "c2"))
    assert list(found_in(tmp_path / "out")) == ["c3"]


def test_a_fit_of_files_outside_the_campaign_is_named(cfid: Cfid, three: Path, tmp_path: Path) -> None:
    kept = next((three / "c1" / "fits").glob("*friction*"))
    content = json.loads(kept.read_text())
    content["section"]["sources"][0]["path"] = "/elsewhere/drop.csv"
    kept.write_text(json.dumps(content))
    ended = cfid("fleet", "fit", three / "c1", "--out", "out", "--jobs", 1)

    assert ended.returncode == 5
    assert "c1: friction: was made from /elsewhere/drop.csv" in ended.stderr
    assert set(sections_at(tmp_path / "out" / "c1")) == OF_C1 - {"friction"}


def test_runs_that_were_excluded_since_are_left_out(cfid: Cfid, three: Path, tmp_path: Path) -> None:
    drops = open_campaign(three / "c1").runs(kind="drop")
    assert cfid("runs", "exclude", drops[0].folder.name, folder=three / "c1").returncode == 0
    outcome = refit(str(three / "c1"), tmp_path / "made")

    (notes,) = [fit["notes"] for fit in outcome["fits"] if fit["name"] == "friction"]
    assert len(notes) == 1
    assert drops[0].folder.name in notes[0]
    assert len(sections_at(tmp_path / "made")["friction"].sources) == len(drops) - 1


def test_a_folder_of_results_that_a_glob_matches_too_is_no_campaign(cfid: Cfid, three: Path) -> None:
    for name in ("c1", "c2"):
        shutil.rmtree(three / name)
    for _ in range(2):
        assert cfid("fleet", "fit", "*", "--out", "refitted", "--jobs", 1, folder=three).returncode == 0
