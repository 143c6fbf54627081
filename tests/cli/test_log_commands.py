"""`cfid log` as an operator sees it: options, labels, where output goes, and the live line."""

import contextlib
import json
import os
import pty
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest

from cfid.console.screen import Screen
from cfid.records.files import RIG_FILE
from cfid.wire.netft import read_settings
from tests.lab import new_campaign, run_cfid
from tests.rig_in_a_folder import lab_in as served_lab_in
from tests.terminal import COLUMNS, Terminal
from tests.virtual_lab import Lab, lab_in

BOTH = pytest.mark.parametrize("device", ["encoder", "loadcell"])
LINE = r"\r +(\d+\.\d) s  (?:Fz +| *)-?[\d.]+ (?:deg|mN)  0 lost  [1-9]\d* Hz"


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with lab_in(tmp_path) as lab:
        yield lab


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    monkeypatch.setenv("TERM", "xterm")
    terminal = Terminal()
    yield terminal
    terminal.close()


# Arguments


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ("encoder --axis q", "--axis q"),
        ("encoder --axis y --body testbody", "--axis y"),
        ("encoder --axis x --weight 50", "--weight"),
        ("encoder --weight 0", "--weight 0"),
        ("loadcell --pull z --weight 5 --at-mm 1,2:3", "--at-mm 1,2:3"),
        ("encoder --for 0", "--for 0"),
        ("loadcell --for nan", "--for nan"),
        ("loadcell --rate-hz 0", "--rate-hz"),
    ],
)
def test_a_wrong_option_is_named_before_anything_is_opened(tmp_path: Path, words: str, option: str) -> None:
    new_campaign(tmp_path)
    ended = run_cfid(["log", *words.split()], tmp_path)

    assert ended.returncode == 2
    assert option in ended.stderr
    assert ended.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == [RIG_FILE]


@pytest.mark.parametrize(
    ("words", "number"),
    [
        ("encoder --axis x --for 20", "20"),
        ("gyro --axis x", ""),
        ("ping --count 200", "200"),
        ("thrust", "33"),
        ("scales", "17"),
        ("sine --hz 0.5,2", ""),
    ],
)
def test_a_dry_run_opens_nothing(tmp_path: Path, words: str, number: str) -> None:
    new_campaign(tmp_path)
    ended = run_cfid(["log", *words.split(), "--dry-run"], tmp_path)

    assert ended.returncode == 0
    assert number in ended.stdout
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("words", "lasts_s"),
    [
        ("encoder --axis x --for 20", 20.0),
        ("gyro --axis x", None),
        ("loadcell --for 3", 3.0),
        ("ping --count 200", 20.0),
        ("thrust --step 32000 --hold 2 --rest 1", 16.0),
        ("scales --step 32000 --hold 2 --rest 1", 16.0),
        ("speed --from 8000 --to 8000 --hold 2 --rest 1", 4.0),
        ("sine --hz 0.5 --for 4", 7.5),
        ("wind --commands 10000 --hold 2 --rest 1", 4.0),
        ("wind --wind 0 --commands 10000 --hold 2 --rest 1", 4.0),
    ],
)
def test_a_dry_run_prints_one_json_object_with_its_duration(tmp_path: Path, words: str, lasts_s: float | None) -> None:
    new_campaign(tmp_path)
    ended = run_cfid(["log", *words.split(), "--dry-run", "--json"], tmp_path)

    content = json.loads(ended.stdout)
    assert content["command"] == f"log {words.split(maxsplit=1)[0]}"
    assert content["dry_run"]
    assert content["lasts_s"] == lasts_s


# What the run states


@pytest.mark.parametrize(
    ("words", "kind", "label"),
    [
        ("encoder --axis x --note first", "swing", {"axis": "x", "body": "crazyflie", "note": "first"}),
        ("encoder --axis z --body testbody", "swing", {"axis": "z", "body": "testbody"}),
        ("encoder --weight 50:0.1", "drop", {"weight_g": 50.0, "weight_std_g": 0.1}),
        (
            "loadcell --pull -z --weight 50 --at-mm 46,0,0:0.3",
            "loadcell",
            {"weight_g": 50.0, "pull": "-z", "at_mm": (46.0, 0.0, 0.0), "at_std_mm": 0.3},
        ),
    ],
)
def test_labels_stand_in_the_run(lab: Lab, words: str, kind: str, label: dict[str, object]) -> None:
    said = lab.cfid("log", *words.split(), "--for", 0.3)
    header = lab.run().header

    assert said.code == 0
    assert header.kind == kind
    assert header.label.model_dump(exclude_none=True) == label
    assert header.simulated
    assert (header.state, header.reason) == ("complete", "")


def test_a_load_cell_is_biased_when_asked_to(lab: Lab) -> None:
    said = lab.cfid("log", "loadcell", "--bias", "--for", 0.5)
    rows, facts = pd.read_csv(lab.run().device_file("loadcell")), lab.facts("loadcell")

    assert said.code == 0
    assert (facts["asked"], facts["biased"]) == ("buffered", True)
    assert abs(rows["Fz"].iloc[:20].mean()) < 5e5  # half a newton; the cell's own offset is 1.4 N
    assert facts["settings"]["bias"] == list(read_settings(lab.box.box.page()).bias)
    assert any(facts["settings"]["bias"])


def test_a_box_with_rdt_off_is_told_by_check_and_switched_on_by_log(lab: Lab) -> None:
    lab.box.get("/comm.cgi?comrdte=0")
    checked = json.loads(lab.cfid("rig", "check", "--json").out)["devices"]["loadcell"]

    assert "RDT, UDP" not in {answer["asked"] for answer in checked}
    assert lab.cfid("log", "loadcell", "--for", 0.3).code == 0
    assert read_settings(lab.box.box.page()).rdt_enabled


# Where output goes


@BOTH
def test_json_is_one_object_on_stdout(lab: Lab, device: str) -> None:
    said = lab.cfid("log", device, "--json", "--for", 0.3)
    content, header = json.loads(said.out), lab.run().header

    assert said.code == 0
    assert (content["run"], content["state"]) == (str(lab.run().folder), "complete")
    assert content["devices"][device]["rows"] == header.devices[device].rows
    assert content["devices"][device]["lost"] == 0
    assert "\r" not in said.err


@pytest.mark.usefixtures("in_time")
def test_output_that_nobody_takes_costs_words_and_no_rows(tmp_path: Path) -> None:
    with served_lab_in(tmp_path) as lab:
        closed = lab.start("log", "loadcell", "--for", 0.3, wrapper=("bash", "-c", 'exec "$@" >&- 2>&-', "closed"))
        assert closed.end().code == 0
        assert lab.run().header.state == "complete"
        reading, writing = os.pipe()
        left = lab.start("log", "loadcell", "--for", 0.3, stdout=writing)
        os.close(writing)
        os.close(reading)
        left.process.wait(60)
        screen, end = pty.openpty()
        hung_up = lab.start("log", "loadcell", stderr=end)
        os.close(end)
        hung_up.wait_for_rows(100)
        os.close(screen)
        hung_up.wait_for_rows(200)
        assert hung_up.ask_to_end().code == 0
        states = [run["state"] for run in json.loads(lab.cfid("runs", "--json").out)["runs"]]

    assert states == ["complete"] * 3


def test_a_reader_that_takes_nothing_holds_up_no_program() -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while os.write(writing, b"." * 4096):
            pass
    os.set_blocking(writing, True)
    with os.fdopen(writing, "w") as full, contextlib.redirect_stderr(full):
        screen, begun_s = Screen(), time.monotonic()
        for _ in range(2000):  # more than the screen keeps
            screen.write("lost\n")
        assert time.monotonic() - begun_s < 1.0
        os.set_blocking(reading, False)
        text = b""
        end_s = time.monotonic() + 10
        while b"lost" not in text and time.monotonic() < end_s:  # goes on with what was said meanwhile
            with contextlib.suppress(BlockingIOError):
                text += os.read(reading, 1 << 16)
        assert b"lost" in text
        os.close(reading)
        screen.finish()


# The live line


@pytest.mark.parametrize(("device", "columns"), [("loadcell", COLUMNS), ("encoder", 0)])
def test_a_terminal_shows_a_line_that_lives_and_never_wraps_in_80_columns_where_it_states_none(
    lab: Lab, terminal: Terminal, device: str, columns: int
) -> None:
    terminal.resize(columns)
    log = lab.start("log", device, stderr=terminal.file)
    log.go_on_for(4)
    said, shown = log.ask_to_end(), terminal.shown()
    times = [float(seconds) for seconds in re.findall(LINE + "  [▁-█]+", shown)]

    assert said.code == 0
    assert len(times) > 8
    assert times == sorted(times)
    for line in shown.split("\r\n"):
        if str(lab.folder) not in line:  # a path is one word
            assert all(len(frame) < COLUMNS for frame in line.split("\r"))
    assert shown.endswith("\r\a")
    assert shown.rstrip("\r\a").rpartition("\r")[2].strip() == ""  # the live line is erased


@pytest.mark.parametrize(("words", "bells"), [((), 1), (("--quiet",), 0)])
def test_the_line_counts_down_to_a_known_end_and_a_bell_calls_the_operator(
    lab: Lab, terminal: Terminal, words: tuple[str, ...], bells: int
) -> None:
    lab.start("log", "loadcell", "--for", 1.5, *words, stderr=terminal.file).end()
    left = [float(seconds) for seconds in re.findall(r"\r +(\d\.\d) s left  Fz", terminal.shown())]

    assert 1.5 >= left[0] > left[-1]
    assert left == sorted(left, reverse=True)
    assert terminal.shown().count("\a") == bells
