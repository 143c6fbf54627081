"""The lab book: rig.toml's entries are noted in each run, notes override them, report and fleet show them."""

import json
from datetime import timedelta
from pathlib import Path

import pytest

from cfid.console.campaign import make_campaign
from cfid.records.files import RIG_FILE
from cfid.records.lab_book import entries, lines, summary
from cfid.records.rig_file import LabBook, RigFacts, load_rig
from cfid.records.run import Label, Run, read_run
from tests.lab import STARTED, Cfid, made_run

BOOK = LabBook(operator="Kim", battery="B3", temperature_c=22.5)


def recorded(folder: Path, count: int = 3, book: LabBook = BOOK) -> list[Run]:
    columns: dict[str, dict[str, list[float]]] = {"encoder": {"t": [], "phi": []}}
    minutes = [STARTED + timedelta(minutes=number) for number in range(count)]
    return [made_run(folder, "swing", columns, started=at, facts=RigFacts(lab_book=book)) for at in minutes]


def test_a_note_overrides_what_rig_toml_stated(cfid: Cfid, tmp_path: Path) -> None:
    make_campaign(tmp_path)
    runs = recorded(tmp_path)
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
    make_campaign(tmp_path)
    path = tmp_path / RIG_FILE
    path.write_text(path.read_text() + '\n[lab_book]\npropellers = "47-17"\ntemperature_c = 21.0\n')

    book = load_rig(path).facts.lab_book
    (run,) = recorded(tmp_path, 1, book)

    assert entries(run.header) == {"propellers": "47-17", "temperature_c": "21"}
    assert lines(summary([run])) == ["propellers: 47-17 (1 run)", "temperature_c: 21 (1 run)"]


def test_a_note_that_is_a_sentence_is_no_entry(tmp_path: Path) -> None:
    (run,) = recorded(tmp_path, 1, LabBook())
    header = run.header.model_copy(update={"label": Label(note="the cable touched at 3 s; battery=B4; 2 + 2 = 4")})

    assert entries(header) == {"battery": "B4"}


@pytest.mark.parametrize("text", ["new props; = x", "battery=", "new props; Battery = "])
def test_an_entry_without_key_or_value_is_refused(cfid: Cfid, tmp_path: Path, text: str) -> None:
    make_campaign(tmp_path)
    (run,) = recorded(tmp_path, 1, LabBook())

    assert cfid("runs", "note", run.folder, text, "--campaign", tmp_path).returncode == 2
    assert read_run(run.folder).header.label.note is None
