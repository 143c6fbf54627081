"""`cfid runs`: list a campaign's runs, exclude them from fits, and write notes."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table
from rich.text import Text

from cfid.console.campaign import here
from cfid.console.messages import echo, print_json, printable
from cfid.console.messages import note as print_note
from cfid.console.program import program
from cfid.console.selection import name_other_folders, note_left_out, readable_runs
from cfid.errors import ConfigError, DataError
from cfid.records.choose import choose_one, is_glob, is_last, is_named, lasts
from cfid.records.files import RUN_FILE
from cfid.records.lab_book import check
from cfid.records.run import Run, amend_run, list_runs, read_run

RunWord = Annotated[str, typer.Argument(metavar="RUN", help="A run's name or folder, a glob, last, or 'last KIND'.")]


def show_runs(
    context: typer.Context,
) -> None:
    """List the campaign's runs: what, when, state, rows, losses.

    Example: cfid runs
    """
    if context.invoked_subcommand is None:
        folder = here().runs_folder
        _print_runs(list_runs(folder))
        name_other_folders(folder, ())


def exclude(
    run: RunWord,
    note: Annotated[str, typer.Option(metavar="TEXT", help="Reason for the exclusion.")] = "by the operator",
) -> None:
    """Exclude runs from fits that select their runs automatically. Nothing is deleted.

    Example: cfid runs exclude 2026-11-21_083012_swing_x --note "the cable touched"
    """
    reason = note or "by the operator"
    _amend(run, excluded=reason, message=f"is excluded: {reason}")


def include(run: RunWord) -> None:
    """Include excluded runs again.

    Example: cfid runs include 2026-11-21_083012_swing_x
    """
    _amend(run, excluded="", message="is included again")


def note(
    run: RunWord,
    text: Annotated[str, typer.Argument(metavar="TEXT", help="The note; an empty text removes all notes.")],
) -> None:
    """Add a note to runs, after their existing notes.

    A note of the form key=value is a lab book entry, which overrides that of rig.toml: operator, battery, propellers,
    temperature_c or a key of your own.

    Example: cfid runs note last battery=B4
    """
    check(text)
    _amend(run, note=text, message=f"note added: {text}" if text else "has no note any more")


def _amend(word: str, *, message: str, excluded: str | None = None, note: str | None = None) -> None:
    for run in _meant(word):
        if run.grows:
            raise ConfigError(f"{run.folder.name}: is still being recorded: wait until it has ended.")
        if excluded == "" and not run.header.excluded:
            print_note(f"{run.folder.name}: is not excluded.")
            continue
        amend_run(run, excluded=excluded, note=note)
        echo(printable(f"{run.folder.name}: {message}"))


def _meant(word: str) -> list[Run]:
    """Return the runs that a word names, for a name or a pattern in any state.

    Raises ConfigError when no run matches, and DataError for an unreadable run.
    """
    runs_folder = Path() if (Path(word) / RUN_FILE).is_file() else here().runs_folder
    if (runs_folder / word / RUN_FILE).is_file():
        return [read_run(runs_folder / word)]
    if is_last(word) or is_glob(word):
        name_other_folders(runs_folder, [word])
    if is_last(word):
        runs = list_runs(runs_folder)
        if runs and isinstance(runs[0], DataError):  # it may be the one that is meant
            raise runs[0]
        choice = choose_one(word, [run for run in runs if isinstance(run, Run)])
        note_left_out(word, choice)
        return choice.runs
    if named := [run for run in readable_runs(runs_folder) if is_named(run.folder, word)]:
        return named
    raise ConfigError(f"{word}: no run of this campaign matches: `cfid runs` lists them.")


def _print_runs(runs: list[Run | DataError]) -> None:
    rows = [(_row(run), run) for run in runs if not isinstance(run, DataError)]
    words = lasts([run for _, run in rows])
    broken = [str(run) for run in runs if isinstance(run, DataError)]
    if program().json:
        print_json({"command": "runs", "runs": [row for row, _ in rows], "warnings": broken})
        return
    if not rows and not broken:
        echo("no runs yet")
        return

    # A run's name is never shortened, since other commands take it as an argument.
    table = Table(box=SIMPLE, pad_edge=False)
    table.add_column("run", no_wrap=True, min_width=max((len(row["run"]) for row, _ in rows), default=0))
    for heading in ("state", "rows", "lost"):
        table.add_column(heading, justify="left" if heading == "state" else "right", no_wrap=True)
    table.add_column("note", overflow="fold")
    for row, run in rows:
        note = "; ".join(filter(None, [", ".join(words.get(run.folder.name, [])), row["note"]]))
        cells = (row["run"], run.outcome, row["rows"], row["lost"], note)
        table.add_row(*(Text(printable(str(cell))) for cell in cells))
    Console().print(table)
    for sentence in broken:
        print_note(sentence)


def _row(run: Run) -> dict[str, Any]:
    header, devices = run.header, run.header.devices.values()
    return {
        "run": run.folder.name,
        "what": run.what,
        "started": header.started.isoformat(),
        "state": run.outcome if run.cut else header.state,
        "usable": None if header.verdict is None else header.verdict.usable,
        "rows": "?" if run.rows is None else run.rows,
        "lost": "?" if header.lost is None else header.lost,
        "skipped": sum(device.skipped or 0 for device in devices),
        "simulated": header.simulated,
        "excluded": header.excluded,
        "note": _note(run),
    }


def _note(run: Run) -> str:
    header, verdict = run.header, run.header.verdict
    excluded = f"excluded: {header.excluded}" if header.excluded else ""
    slow = [f"{name}: {device.achieved}" for name, device in header.devices.items() if device.achieved]
    unusable = "" if verdict is None or verdict.usable else f"not usable: {verdict.text}"
    reason = "" if unusable and header.state == "failed" else header.reason  # the verdict contains it already
    return "; ".join(
        filter(None, ["simulated" * header.simulated, excluded, *slow, unusable, header.label.note, reason])
    )
