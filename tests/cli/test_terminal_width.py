"""The output of cfid fits a terminal of 80 columns; pipes and files get whole sentences."""

import contextlib
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cfid.console.inputs import open_workplace
from cfid.console.messages import fault, note
from cfid.console.outcome import Delivery, deliver
from cfid.console.program import Program, running
from cfid.findings import warning
from cfid.records.parameters import Parameter
from cfid.records.result import Result
from cfid.records.run import Run, list_runs
from tests.terminal import COLUMNS, Terminal

LONG = "the waveform differs from a pendulum's by 2.4 % of the release angle (limit 0.16 %): a cable. " * 3


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


@pytest.mark.parametrize("said", [fault, note])
def test_an_error_and_a_note_fit_line_by_line(terminal: Terminal, said: Callable[[str], None]) -> None:
    lines = lines_of(terminal, lambda: said(f"{LONG.strip()}\nNot read either: a table\n  with a row"), err=True)

    assert all(len(line) <= COLUMNS for line in lines)
    assert all(line.startswith("      ") for line in lines[1:-2])
    assert lines[-2:] == ["Not read either: a table", "  with a row"]
    assert joined(lines[:-2]).endswith(LONG.strip())


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
    with running(Program(campaign=bodies, json=True)):
        deliver(result, Delivery(figures=False), open_workplace())
    kept = " ".join(path.read_text() for path in (bodies / "fits").rglob("*") if path.is_file())

    said = json.loads(capsys.readouterr().out)
    assert said["findings"][0]["text"] == f"{run.folder.name}/crossings.csv: was used."
    assert f"{run.folder.name}/crossings.csv: was used." in kept
    assert str(bodies.resolve()) not in kept
