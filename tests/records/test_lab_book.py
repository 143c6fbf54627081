"""The lab book: rig.toml's entries are noted in each run, notes override them, report and fleet show them."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from cfid.console.campaign import make_campaign
from cfid.records.files import RIG_FILE
from cfid.records.lab_book import entries, lines, summary
from cfid.records.rig_file import LabBook, RigFacts, load_rig
from cfid.records.run import DeviceRecord, Label, Run, read_run
from cfid.records.run_writer import create_run
from tests.lab import Cfid

BOOK = LabBook(operator="Kim", battery="B3", temperature_c=22.5)


def recorded(folder: Path, count: int = 3, book: LabBook = BOOK) -> list[Run]:
    runs = []
    for number in range(count):
        writer = create_run(
            folder / "runs",
            kind="swing",
            label=Label(axis="x"),
            devices={"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))},
            started=datetime(2026, 11, 1, tzinfo=UTC) + timedelta(minutes=number),
            cfid_version="0",
            facts=RigFacts(lab_book=book),
        )
        runs.append(writer.close("complete"))
    return runs


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
    assert "battery: B5 (1 run), B3 (2 runs)" in cfid("fleet", tmp_path, tmp_path, "--details").stdout


def test_the_report_shows_the_lab_book_as_text(cfid: Cfid, tmp_path: Path) -> None:
    make_campaign(tmp_path)
    recorded(tmp_path, book=LabBook(operator="<script>Kim</script>"))

    assert cfid("report", "--campaign", tmp_path).returncode == 0
    (page,) = tmp_path.rglob("*.html")

    assert "Lab book: operator: &lt;script&gt;Kim&lt;/script&gt; (3 runs)." in page.read_text()


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


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("new props; = x", "= x: has no key: write KEY=VALUE"),
        ("battery=", "battery=: has no value: write battery=VALUE."),
        ("new props; Battery = ", "Battery=: has no value"),
    ],
)
def test_an_entry_that_cannot_be_meant_so_is_refused(cfid: Cfid, tmp_path: Path, text: str, told: str) -> None:
    make_campaign(tmp_path)
    (run,) = recorded(tmp_path, 1, LabBook())
    ended = cfid("runs", "note", run.folder, text, "--campaign", tmp_path)

    assert ended.returncode == 2
    assert told in ended.stderr
    assert read_run(run.folder).header.label.note is None
