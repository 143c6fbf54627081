"""The code of the night: what counts as a figure, what is not repeated."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.lab import ROOT
from tests.nightly import night
from tests.nightly.fuzz import attack
from tests.nightly.night import Stage, figures, lines_of, run_stage
from tests.nightly.readers import READERS, Reader

OUTPUT = """
cfid fit inertia, six swings              1.130 s (median of 9)
ratio                                      2.10   (goal: at most 2)
buffered, core: 1.8 %  (goal: at most 2 %)
of 600 places missed beside 4 busy programs: 0.50 in 10 000  (goal: at most 1)
buffered, ratio to the peer, core: 0.22
run.toml: 1000 cases, nothing found
| speed map: ideal | slope | 200 | -0.002 % | 0.65 | 100 % (98 to 100) | 0 % | 0 % | 0 % |
.transfer: gain, 1 % lost                n   200  bias -0.009 %  ratio  0.92  cover  97.0 % (93.6 to 98.9)  rejected 0
sound: bias +0.0000 %, rms 0.0001 %, ratio 0.84, cover 0.990 (0.964 to 0.999), rejected 0
12 passed, 3 deselected in 34.56s
"""


def test_figures_are_read_from_what_commands_print() -> None:
    assert list(figures(OUTPUT)) == [
        ("ratio", "2.10 (goal: at most 2)"),
        ("buffered, core", "1.8 % (goal: at most 2 %)"),
        ("of 600 places missed beside 4 busy programs", "0.50 in 10 000 (goal: at most 1)"),
        ("buffered, ratio to the peer, core", "0.22"),
        ("run.toml", "1000 cases, nothing found"),
        ("speed map: ideal, slope, n = 200", "100 % (98 to 100)"),
        ("transfer: gain, 1 % lost, n = 200", "ratio 0.92 cover 97.0 % (93.6 to 98.9)"),
        ("sound", "ratio 0.84, cover 0.990 (0.964 to 0.999)"),
        ("tests", "12 passed, 3 deselected"),
    ]


def test_a_night_loads_compiled_modules_whatever_it_is_started_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    words = "python -c 'import sys; print(f\"ratio {int(sys.dont_write_bytecode)}\")'"
    monkeypatch.setitem(night.STAGES, "one", Stage((words,), "", "", 1.0))

    run_stage("one", tmp_path, small=True)

    assert ("ratio", "0") in [(line["figure"], line["value"]) for line in lines_of(tmp_path / "results.jsonl")]


def test_a_night_that_goes_on_repeats_nothing_and_keeps_failures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands = ("bash -c 'echo run >> {folder}/ran; echo ratio 3; exit {size}'", "python -c pass")
    monkeypatch.setitem(night.STAGES, "two", Stage(commands, "0", "4", 1.0))

    run_stage("two", tmp_path, small=True)
    run_stage("two", tmp_path, small=True)
    found = [(line["figure"], line["value"]) for line in lines_of(tmp_path / "results.jsonl")]

    assert (tmp_path / "ran").read_text() == "run\n"
    assert found == [("ratio", "3"), ("exit code", "4"), ("exit code", "0")]
    assert all(0 <= line["took_s"] < 60 for line in lines_of(tmp_path / "results.jsonl"))


def test_what_runs_at_the_end_of_its_stage_is_ended_and_begun_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = "bash -c 'echo ratio 3; [ -e {folder}/begun ] || { touch {folder}/begun; exec sleep 600; }'"
    monkeypatch.setitem(night.STAGES, "one", Stage((command,), "", "", 1 / 60))

    run_stage("one", tmp_path, small=True)
    after_the_first = lines_of(tmp_path / "results.jsonl")
    run_stage("one", tmp_path, small=True)

    assert after_the_first == []
    assert [line["value"] for line in lines_of(tmp_path / "results.jsonl")] == ["3", "0"]


def test_the_longest_command_begins_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(night, "LONGEST", ("long",))
    monkeypatch.setitem(night.STAGES, "two", Stage(("echo ratio short", "echo ratio long"), "", "", 1.0))

    run_stage("two", tmp_path, small=True)

    assert [line["command"].split()[-1] for line in lines_of(tmp_path / "results.jsonl")] == ["long", "short"]


def test_a_result_is_kept_while_a_command_that_was_begun_before_still_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits = "bash -c 'until grep -q second {folder}/results.jsonl; do sleep 0.05; done'"
    monkeypatch.setitem(night.STAGES, "two", Stage((waits, "echo second ratio 3"), "", "", 1.0, at_once=2))

    run_stage("two", tmp_path, small=True)
    found = [(line["figure"], line["value"]) for line in lines_of(tmp_path / "results.jsonl")]

    assert found == [("second ratio", "3"), ("exit code", "0"), ("exit code", "0")]


def test_of_what_runs_against_a_clock_one_runs_at_a_time_ahead_of_what_computes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = "bash -c 'set -e; mkdir {folder}/alone; sleep 0.5; rmdir {folder}/alone; cat /proc/$$/autogroup' test_%s.py"
    beside = "bash -c 'until [ -e {folder}/alone ]; do sleep 0.02; done; cat /proc/$$/autogroup'"
    commands = (alone % "guided_campaign", alone % "killed_runs", beside)
    monkeypatch.setitem(night.STAGES, "three", Stage(commands, "", "", 1.0, at_once=3))

    run_stage("three", tmp_path, small=True)

    assert [line["value"] for line in lines_of(tmp_path / "results.jsonl")] == ["0", "0", "0"]
    said = [path.read_text().rpartition("nice ")[2].strip() for path in sorted(tmp_path.glob("*.log"))]
    assert sorted(said) == (["-10", "-10", "0"] if os.geteuid() == 0 else ["0", "0", "0"])


def test_a_night_that_is_killed_ends_what_it_runs_and_goes_on_from_there(tmp_path: Path) -> None:
    first = "bash -c 'echo first >> {folder}/ran'"
    second = "bash -c 'echo second $$ >> {folder}/ran; [ -e {folder}/quick ] || exec sleep 600'"
    stages = f"{{'two': night.Stage(({first!r}, {second!r}), '', '', 1.0)}}"
    script = f"from tests.nightly import night; night.STAGES = {stages}; night.main()"
    ran = tmp_path / "ran"

    with subprocess.Popen([sys.executable, "-c", script, tmp_path], cwd=ROOT, stderr=subprocess.PIPE) as killed:
        while not ran.exists() or "second" not in ran.read_text():
            time.sleep(0.05)
        killed.terminate()
        said = killed.communicate()[1].decode()
    ended = int(ran.read_text().split()[-1])
    (tmp_path / "quick").touch()
    subprocess.run([sys.executable, "-c", script, tmp_path], cwd=ROOT, check=True)

    assert "the same words continue this night" in said
    with pytest.raises(ProcessLookupError):
        os.kill(ended, 0)
    assert [line.split()[0] for line in ran.read_text().splitlines()] == ["first", "second", "second"]
    assert [line["value"] for line in lines_of(tmp_path / "results.jsonl")] == ["0", "0"]


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_a_damaged_content_is_read_or_refused(reader: Reader) -> None:
    assert attack(reader, cases=20, seed=3) == ""


@pytest.mark.parametrize(
    ("read", "found"),
    [
        (lambda path: int("x"), "ValueError"),
        (lambda path: bytes(4 << 30), "MemoryError"),
        (lambda path: 7, "read as 7"),
    ],
)
def test_the_fuzzer_finds_tracebacks_memory_and_other_numbers(read: object, found: str) -> None:
    content = b"t,phi\n1,2\n"
    calls = [0]

    def late(path: Path) -> object:
        calls[0] += 1
        return None if calls[0] == 1 else read(path)  # type: ignore[operator]

    def fault(content: bytes, value: object) -> str:
        return "" if value is None else f"read as {value!r}"

    assert found in attack(Reader(name="bad", contents=(content,), read=late, fault=fault), cases=5, seed=1)
