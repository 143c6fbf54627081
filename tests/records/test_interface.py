"""The Python interface of campaigns and tables, on a campaign of simulated swings."""

import json
import subprocess
import sys
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest

import cfid
from cfid.console.campaign import make_campaign
from cfid.errors import ConfigError, FitError
from cfid.findings import Finding, rejection, warning
from cfid.records.campaign import open_campaign
from cfid.records.files import RIG_FILE
from cfid.records.fits import Fit, list_fits
from cfid.records.lab_book import entries, lines, summary
from cfid.records.parameters import Parameter, Source
from cfid.records.result import Result
from cfid.records.rig_file import LabBook, RigFacts, load_rig
from cfid.records.run import Label, Run, amend_run, read_run
from tests.lab import STARTED, Cfid, made_run, new_campaign

MASS = Parameter(value=0.028, std=1e-5, unit="kg")
RADIUS = Parameter(value=0.023, std=1e-4, unit="m")


def result(*findings: Finding) -> Result:
    return Result(
        command="fit things",
        method="default",
        quantities={"things.mass_kg": MASS, "things.radius_m": RADIUS},
        wanted=("things.mass_kg",),
        findings=findings,
        sources=(Source("x.csv", "0" * 64),),
    )


def test_importing_cfid_imports_no_library() -> None:
    code = "import sys, cfid; print(*sorted({'numpy', 'scipy', 'pandas', 'pydantic', 'twisted'} & set(sys.modules)))"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert ended.stdout.strip() == ""


def test_runs_are_found_by_kind_name_pattern_and_as_the_last(bodies: Path) -> None:
    campaign = cfid.open_campaign(bodies)
    swings = campaign.runs(kind="swing")

    assert swings
    assert all(run.header.kind == "swing" for run in swings)
    assert campaign.run("last swing") == swings[-1]
    assert campaign.run("last") == campaign.runs()[-1]
    name = swings[0].folder.name
    assert campaign.run(name) == swings[0]
    assert campaign.run(f"{name[:-1]}?").folder.name == name
    for word in ("nothing", "*", "last nonsense"):
        with pytest.raises(ConfigError):
            campaign.run(word)


def test_a_result_is_kept_and_its_numbers_stand_in_a_frame(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    campaign.keep(result(warning("a-code", "a cable.")))
    frame = campaign.quantities().set_index("quantity")

    assert frame.loc["things.mass_kg", "value"] == 0.028
    assert frame.loc["things.mass_kg", "std"] == 1e-5
    assert frame.loc["things.mass_kg", "accepted"]
    (fit,) = list_fits(campaign.fits_folder)
    assert isinstance(fit, Fit)
    assert [finding.code for finding in fit.findings] == ["a-code"]


def test_a_rejection_takes_its_quantity_and_leaves_the_others(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    found = result(rejection("a-code", "no calliper.", "things.radius_m"))
    campaign.keep(found)

    assert found.accepted
    assert set(campaign.values().sections()["things"].parameters) == {"things.mass_kg"}
    assert campaign.values().sections()["things"].rejected == {"things.radius_m": "no calliper."}


def test_what_a_result_is_for_is_kept_by_force_alone_and_marked(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    found = result(rejection("a-code", "the scales stick.", "things.mass*"))
    with pytest.raises(FitError, match="the scales stick"):
        campaign.keep(found)
    assert "things" not in campaign.values().sections()
    campaign.keep(found, force=True)

    assert not found.accepted
    assert set(campaign.values().sections()["things"].rejected) == {"things.mass_kg"}
    assert not campaign.quantities().set_index("quantity").loc["things.mass_kg", "accepted"]


def test_a_finding_that_names_nothing_rejects_the_whole_result() -> None:
    found = result(rejection("a-code", "noise."))

    assert not found.accepted
    assert set(found.rejected) == {"things.mass_kg", "things.radius_m"}
    assert not found.without_rejected().quantities


def test_a_recording_has_a_frame_for_each_device(bodies: Path) -> None:
    run = cfid.open_campaign(bodies).run("last swing")
    recording = cfid.read_recording(run.folder)

    frame = recording.series["encoder"].frame()
    assert list(frame.columns[:2]) == ["t", "phi"]
    assert frame["t"].iloc[0] == 0
    assert recording.series["encoder"].column("phi").unit == "counts"
    assert recording.facts.label == run.header.label


# The lab book


BOOK = LabBook(operator="Kim", battery="B3", temperature_c=22.5)


def noted_runs(folder: Path, count: int = 3, book: LabBook = BOOK) -> list[Run]:
    columns: dict[str, dict[str, list[float]]] = {"encoder": {"t": [], "phi": []}}
    minutes = [STARTED + timedelta(minutes=number) for number in range(count)]
    return [made_run(folder, "swing", columns, started=at, facts=RigFacts(lab_book=book)) for at in minutes]


def test_a_note_overrides_what_rig_toml_stated(cfid: Cfid, tmp_path: Path) -> None:
    make_campaign(tmp_path, kind="simulated")
    runs = noted_runs(tmp_path)
    for text in ("new propellers", "Battery = B4; gust=a door opened", "battery=B5"):
        assert cfid("runs", "note", runs[0].folder, text, "--campaign", tmp_path).returncode == 0

    ended = cfid("fleet", tmp_path, tmp_path, "--json")
    book = json.loads(ended.stdout)["campaigns"][0]["lab_book"]

    assert book == {
        "operator": {"Kim": 3},
        "battery": {"B5": 1, "B3": 2},
        "temperature_c": {"22.5": 3},
        "gust": {"a door opened": 1},
    }


def test_rig_toml_states_it_for_every_run(tmp_path: Path) -> None:
    make_campaign(tmp_path, kind="simulated")
    path = tmp_path / RIG_FILE
    path.write_text(path.read_text() + '\n[lab_book]\npropellers = "47-17"\ntemperature_c = 21.0\n')

    book = load_rig(path).facts.lab_book
    (run,) = noted_runs(tmp_path, 1, book)

    assert entries(run.header) == {"propellers": "47-17", "temperature_c": "21"}
    assert lines(summary([run])) == ["propellers: 47-17 (1 run)", "temperature_c: 21 (1 run)"]


def test_a_note_that_is_a_sentence_is_no_entry(tmp_path: Path) -> None:
    (run,) = noted_runs(tmp_path, 1, LabBook())
    header = run.header.model_copy(update={"label": Label(note="the cable touched at 3 s; battery=B4; 2 + 2 = 4")})

    assert entries(header) == {"battery": "B4"}


@pytest.mark.parametrize("text", ["new props; = x", "battery=", "new props; Battery = "])
def test_an_entry_without_key_or_value_is_refused(cfid: Cfid, tmp_path: Path, text: str) -> None:
    make_campaign(tmp_path, kind="simulated")
    (run,) = noted_runs(tmp_path, 1, LabBook())

    assert cfid("runs", "note", run.folder, text, "--campaign", tmp_path).returncode == 2
    assert read_run(run.folder).header.label.note is None


def test_a_fit_of_another_campaigns_simulated_run_says_so(tmp_path: Path) -> None:
    new_campaign(tmp_path / "other")
    run = made_run(tmp_path / "other", "swing", {"encoder": {"t": [0.0], "phi": [0.0]}}, simulated=True)
    new_campaign(tmp_path / "mine")
    mine = open_campaign(tmp_path / "mine")
    mine.keep(replace(result(), command="fit swing", sources=(Source(str(run.device_file("encoder")), "0" * 64),)))

    (kept,) = mine.fits()
    assert kept.section.simulated
    assert "SIMULATED" in mine.parameters_file.read_text()


def test_a_note_leaves_what_a_fit_takes_from_a_run_without_any_other_label(tmp_path: Path) -> None:
    run = made_run(tmp_path, "speed", {"readings": {"t": [0.0], "command": [1], "rpm": [1.0]}})
    noted = amend_run(run, note="battery=B7")

    assert noted.header.stated_sha256 == run.header.stated_sha256
    assert noted.header.label.note == "battery=B7"
