"""The output of cfid fits a terminal of 80 columns; pipes and files get whole sentences."""

import contextlib
import fcntl
import json
import os
import pty
import re
import struct
import subprocess
import termios
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

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
from cfid.motors.command import StaircaseOptions, announce, thrust_staircase
from cfid.records.campaign import open_campaign
from cfid.records.parameters import Parameter
from cfid.records.result import Result
from cfid.records.run import Run, list_runs, read_run
from cfid.rig.check import DeviceAnswer
from tests.campaigns import Cfid
from tests.rig.test_live_line import staircase
from tests.rig_in_a_folder import lab_in

COLUMNS, MARK = 80, "that was all"
LONG = "the waveform differs from a pendulum's by 2.4 % of the release angle (limit 0.16 %): a cable. " * 3


class Screen:
    """A terminal, usually 80 columns wide, which stdout writes to."""

    def __init__(self, columns: int = COLUMNS) -> None:
        self._master, slave = pty.openpty()
        self.file = os.fdopen(slave, "w", encoding="utf-8")
        self.resize(columns)

    def resize(self, columns: int) -> None:
        fcntl.ioctl(self.file, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))

    def lines(self, *, of: Callable[[], object]) -> list[str]:
        """Return the lines that a function prints."""
        with contextlib.redirect_stdout(self.file):
            of()
        print(MARK, file=self.file, flush=True)
        read = b""
        while MARK.encode() not in read:  # a terminal passes on output in pieces
            read += os.read(self._master, 100_000)
        return read.decode().splitlines()[:-1]

    def close(self) -> None:
        self.file.close()
        os.close(self._master)


@pytest.fixture
def screen() -> Iterator[Screen]:
    screen = Screen()
    yield screen
    screen.close()


def first_run(folder: Path) -> Run:
    return next(run for run in list_runs(folder / "runs") if isinstance(run, Run))


def reported(answer: DeviceAnswer) -> None:
    with pytest.raises(DeviceError, match="not ready: loadcell"):
        report_answers("rig preflight", {"loadcell": [answer]}, simulated=True, json=False)


def test_a_line_of_a_check_and_its_advice_fit_the_terminal(screen: Screen) -> None:
    axes = "0.12, 0.34, 1.2 mN; 0.012, 0.034, 0.12 mNm"
    answer = DeviceAnswer("other lines", "fault", f"{axes}, the clearest at 137 Hz", LONG.strip(), axes)
    lines = screen.lines(of=lambda: reported(answer))

    assert all(len(line) <= COLUMNS for line in lines)
    assert lines[0].startswith("loadcell  other lines     fault    0.12, 0.34, 1.2 mN")
    assert " ".join(" ".join(lines).split()).endswith(LONG.strip())


def test_a_line_of_a_check_and_its_advice_fit_half_a_terminal_too(screen: Screen) -> None:
    screen.resize(40)
    lines = screen.lines(of=lambda: reported(DeviceAnswer("other lines", "fault", "0.12, 0.34, 1.2 mN", LONG.strip())))

    assert all(len(line) <= 40 for line in lines)
    assert lines[0].startswith("loadcell  other lines     fault    0.12")
    assert " ".join(" ".join(lines).split()).endswith(LONG.strip())


@pytest.mark.parametrize(
    ("motors", "named"), [(None, "on motors 1, 3, 10 s each with 3 s of pause: 7:12 min"), (["1"], "on motor 1, 10 s")]
)
def test_what_a_staircase_would_do_fits_the_terminal(screen: Screen, motors: list[str] | None, named: str) -> None:
    lines = screen.lines(of=lambda: announce(thrust_staircase(StaircaseOptions(), motors)))

    assert all(len(line) <= COLUMNS for line in lines)
    assert named in " ".join(lines)


def test_a_pipe_gets_a_line_as_it_is() -> None:
    assert fitted(LONG, indent=3) == LONG


def test_a_question_on_stderr_is_wrapped_at_its_own_terminal(screen: Screen) -> None:
    with contextlib.redirect_stderr(screen.file):
        lines = fitted(LONG, err=True).splitlines()

    assert len(lines) > 1
    assert all(len(line) <= COLUMNS for line in lines)
    assert " ".join(lines) == LONG.strip()


def test_a_message_above_the_live_line_fits_the_terminal(screen: Screen) -> None:
    def speak() -> None:
        with contextlib.redirect_stderr(screen.file):
            live = LiveLine()
            live.tell("'abc' is not a reading: type a number, nothing where there is none, u to take the last back.")
            live.end()

    lines = [line.replace("\r", "").rstrip() for line in screen.lines(of=speak)]

    assert [line for line in lines if line] == [
        "'abc' is not a reading: type a number, nothing where there is none, u to take",
        "  the last back.",
    ]


def test_what_is_typed_is_seen_on_half_a_terminal(screen: Screen) -> None:
    def speak() -> None:
        with contextlib.redirect_stderr(screen.file):
            live = LiveLine()
            live.left("12 steps left")
            live.ask("RPM at command 20000, Enter for none (u undoes 15069) > 22861")
            live.show(staircase())
            live.end()

    screen.resize(40)
    frames = [frame.rstrip() for line in screen.lines(of=speak) for frame in line.split("\r")]

    assert "… command 20000, Enter for none > 22861" in frames
    assert all(len(frame) < 40 for frame in frames)


@pytest.mark.parametrize("said", [fault, note])
def test_an_error_and_a_note_fit_the_terminal_line_by_line(screen: Screen, said: Callable[[str], None]) -> None:
    def speak() -> None:
        with contextlib.redirect_stderr(screen.file):
            said(f"{LONG.strip()}\nNot read either: a table\n  with a row")

    lines = [re.sub(r"\x1b\[\d+m", "", line) for line in screen.lines(of=speak)]

    assert all(len(line) <= COLUMNS for line in lines)
    assert all(line.startswith("      ") for line in lines[1:-2])
    assert lines[-2:] == ["Not read either: a table", "  with a row"]
    assert " ".join(" ".join(lines[:-2]).split()).endswith(LONG.strip())


def test_the_end_of_input_at_next_and_a_silent_cell_are_said_within_80_columns(tmp_path: Path, screen: Screen) -> None:
    with lab_in(tmp_path) as lab:
        lab.start("next", stdin=subprocess.DEVNULL, stderr=screen.file).process.wait(60)
        log = lab.start("log", "loadcell", stderr=screen.file)
        log.wait_for_rows(20)
        lab.loadcell_suffers(silent_after_s=0)
        log.process.wait(60)
        frames = [frame for line in screen.lines(of=lambda: None) for frame in line.split("\r")]
    said = " ".join(" ".join(frames).split())

    assert all(len(re.sub(r"\x1b\[\d+m", "", frame)) <= COLUMNS for frame in frames if str(tmp_path) not in frame)
    assert "standard input ended before an answer, nothing was started. Run `cfid next`" in said
    assert "sent nothing more for" in said
    assert "`cfid rig check` finds which." in said


def test_the_lines_of_a_result_fit_the_terminal_and_tables_stay(screen: Screen) -> None:
    row = "first      1.0000     2.0000"
    result = Result(command="tf latency", section="", method="default", quantities={}, lines=(row, LONG.strip()))
    lines = screen.lines(of=lambda: deliver(result, Delivery(), None))

    assert lines[0] == row
    assert all(len(line) <= COLUMNS for line in lines)
    assert " ".join(lines[1:]) == LONG.strip()


@pytest.mark.parametrize(("columns", "is_a_table"), [(40, False), (60, True), (80, True)])
def test_a_table_that_would_break_words_on_a_narrow_terminal_has_its_rows_as_lines(
    cfid: Cfid, bodies: Path, monkeypatch: pytest.MonkeyPatch, columns: int, is_a_table: bool
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    status = cfid("status", "--kind", "inertia", "--campaign", bodies).stdout
    runs = cfid("runs", "--campaign", bodies, "--newest", 1).stdout

    assert ("fit: friction\n" in status) != is_a_table
    assert ("what for: a rate controller's gains: 3 %\n" in status) != is_a_table
    assert (" friction  " in status) == is_a_table
    assert first_run(bodies).folder.name[:10] in runs
    assert "state: complete" in runs or columns > 40


def test_a_verdict_is_wrapped_on_the_terminal_and_whole_in_the_run(bodies: Path, screen: Screen) -> None:
    def judge(_: Run) -> str:
        raise DataError(LONG.strip())

    run = judged(first_run(bodies), judge)
    lines = screen.lines(of=lambda: print_summary(run))
    kept = read_run(run.folder).header.verdict

    assert all(len(line) <= COLUMNS for line in lines if str(run.folder) not in line)  # a path is one word
    assert kept is not None
    assert kept.text == LONG.strip()


def test_a_verdict_names_a_run_by_its_folder_alone(bodies: Path) -> None:
    run = first_run(bodies)

    def judge(run: Run) -> str:
        raise DataError(f"{run.folder / 'encoder.csv'}: the time goes back.")

    verdict = judged(run, judge).header.verdict

    assert verdict is not None
    assert verdict.text == f"{run.folder.name}/encoder.csv: the time goes back."


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
    options: dict[str, Any] = {"json": True, "force": False, "out": None, "figures": False}
    deliver(result, Delivery(**options), open_campaign(bodies))

    said = json.loads(capsys.readouterr().out)
    assert said["findings"][0]["text"] == f"{run.folder.name}/crossings.csv: was used."
    kept = " ".join(path.read_text() for path in (bodies / "fits").rglob("*") if path.is_file())
    assert f"{run.folder.name}/crossings.csv: was used." in kept
    assert str(bodies.resolve()) not in kept
