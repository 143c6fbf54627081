"""The output of cfid fits a terminal of 80 columns; pipes and files get whole sentences."""

import contextlib
import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cfid.cli.rig import report_answers
from cfid.console.live import LiveLine
from cfid.console.log_summary import print_summary
from cfid.console.messages import fault, fitted, note
from cfid.console.options import Delivery
from cfid.console.outcome import deliver
from cfid.console.verdicts import judged
from cfid.errors import DataError, DeviceError
from cfid.findings import warning
from cfid.records.campaign import open_campaign
from cfid.records.parameters import Parameter
from cfid.records.result import Result
from cfid.records.run import Run, list_runs, read_run
from cfid.rig.check import DeviceAnswer
from tests.lab import Cfid
from tests.terminal import COLUMNS, Terminal
from tests.virtual_bench import bench_in
from tests.virtual_lab import lab_in

LONG = "the waveform differs from a pendulum's by 2.4 % of the release angle (limit 0.16 %): a cable. " * 3
ANSWER = DeviceAnswer("other lines", "fault", "0.12, 0.34, 1.2 mN; 0.012, 0.034 mNm, at 137 Hz", LONG.strip())


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    terminal = Terminal()
    yield terminal
    terminal.close()


def lines_of(terminal: Terminal, speak: Callable[[], object], *, err: bool = False) -> list[str]:
    """Return the lines that a function prints on a terminal, without colours."""
    with (contextlib.redirect_stderr if err else contextlib.redirect_stdout)(terminal.file):
        speak()
    return re.sub(r"\x1b\[\d+m", "", terminal.shown()).splitlines()


def first_run(folder: Path) -> Run:
    return next(run for run in list_runs(folder / "runs") if isinstance(run, Run))


def joined(lines: list[str]) -> str:
    return " ".join(" ".join(lines).split())


def check() -> None:
    with contextlib.suppress(DeviceError):
        report_answers("rig preflight", {"loadcell": [ANSWER]}, simulated=True, json=False)


def question() -> None:
    print(fitted(LONG, err=True), file=sys.stderr)


def message_above_a_live_line() -> None:
    live = LiveLine()
    live.tell(LONG)
    live.end()


def result() -> None:
    deliver(Result(command="tf latency", section="", method="default", quantities={}, lines=(LONG,)), Delivery(), None)


@pytest.mark.parametrize(
    ("speak", "err", "columns"),
    [
        (check, False, 40),
        (check, False, 80),
        (question, True, 80),
        (message_above_a_live_line, True, 80),
        (result, False, 80),
    ],
)
def test_what_is_said_fits_and_is_whole(terminal: Terminal, speak: Callable[[], None], err: bool, columns: int) -> None:
    terminal.resize(columns)
    frames = [frame for line in lines_of(terminal, speak, err=err) for frame in line.split("\r")]

    assert all(len(frame) <= columns for frame in frames)
    assert LONG.strip() in joined(frames)


def test_a_pipe_gets_a_line_as_it_is() -> None:
    assert fitted(LONG, indent=3) == LONG


def test_what_is_typed_is_seen_on_half_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    terminal = Terminal(40)
    words = ("log", "speed", "--from", 20000, "--to", 20000, "--step", 1, "--hold", 0.5, "--rest", 0.2, "--yes")
    with bench_in(tmp_path) as bench:
        pilot = bench.start(*words, terminal=True, stderr=terminal.file)
        pilot.wait_until_motors_run(3.0)
        pilot.type("228")
        pilot.go_on_for(1.0)
        pilot.request_end()
        pilot.end()
        frames = [frame.rstrip() for line in terminal.shown().split("\n") for frame in line.split("\r")]
    terminal.close()

    assert any(frame.endswith("command 20000 > 228") for frame in frames)
    assert all(len(frame) < 40 for frame in frames if "> " in frame)


@pytest.mark.parametrize("said", [fault, note])
def test_an_error_and_a_note_fit_line_by_line(terminal: Terminal, said: Callable[[str], None]) -> None:
    lines = lines_of(terminal, lambda: said(f"{LONG.strip()}\nNot read either: a table\n  with a row"), err=True)

    assert all(len(line) <= COLUMNS for line in lines)
    assert all(line.startswith("      ") for line in lines[1:-2])
    assert lines[-2:] == ["Not read either: a table", "  with a row"]
    assert joined(lines[:-2]).endswith(LONG.strip())


def test_the_end_of_input_at_next_and_a_silent_cell_are_said_within_80_columns(
    tmp_path: Path, terminal: Terminal
) -> None:
    with lab_in(tmp_path) as lab:
        lab.start("next", stderr=terminal.file).run_to_end()
        log = lab.start("log", "loadcell", stderr=terminal.file)
        log.wait_for_rows(20)
        lab.loadcell_suffers(silent_after_s=0)
        log.run_to_end()
        frames = re.sub(r"\x1b\[\d+m", "", terminal.shown()).replace("\n", "\r").split("\r")

    assert all(len(frame) <= COLUMNS for frame in frames if str(tmp_path) not in frame)
    assert "standard input ended" in joined(frames)
    assert "sent nothing more" in joined(frames)


@pytest.mark.parametrize(("columns", "is_a_table"), [(40, False), (60, True), (80, True)])
def test_a_table_that_would_break_words_has_its_rows_as_lines(
    cfid: Cfid, bodies: Path, monkeypatch: pytest.MonkeyPatch, columns: int, is_a_table: bool
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    status = cfid("status", "--kind", "inertia", "--campaign", bodies).stdout
    runs = cfid("runs", "--campaign", bodies, "--newest", 1).stdout

    assert ("fit: friction\n" in status) != is_a_table
    assert (" friction  " in status) == is_a_table
    assert first_run(bodies).folder.name[:10] in runs
    assert "state: complete" in runs or columns > 40


def test_a_verdict_is_wrapped_on_the_terminal_and_whole_in_the_run(bodies: Path, terminal: Terminal) -> None:
    def judge(run: Run) -> str:
        raise DataError(f"{run.folder / 'encoder.csv'}: {LONG.strip()}")

    run = judged(first_run(bodies), judge)
    kept = read_run(run.folder).header.verdict
    lines = lines_of(terminal, lambda: print_summary(run))

    assert all(len(line) <= COLUMNS for line in lines if str(run.folder) not in line)  # a path is one word
    assert kept is not None
    assert kept.text == f"{run.folder.name}/encoder.csv: {LONG.strip()}"


def test_a_finding_names_a_run_by_its_folder_alone(bodies: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = first_run(bodies)
    finding = warning("verification-reuses-run", f"{run.folder.resolve()}/crossings.csv: was used.", "tf.verify.*")
    result = Result(
        command="tf verify",
        section="tf verify",
        method="default",
        quantities={"tf.verify.l20.late_s": Parameter(value=0.0, std=0.1)},
        findings=(finding,),
    )
    deliver(result, Delivery(json=True, force=False, out=None, figures=False), open_campaign(bodies))
    kept = " ".join(path.read_text() for path in (bodies / "fits").rglob("*") if path.is_file())

    said = json.loads(capsys.readouterr().out)
    assert said["findings"][0]["text"] == f"{run.folder.name}/crossings.csv: was used."
    assert f"{run.folder.name}/crossings.csv: was used." in kept
    assert str(bodies.resolve()) not in kept
