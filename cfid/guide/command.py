"""`cfid status` and `cfid next`: the state of a campaign, and its next step."""

import os
import shlex
import sys
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from cfid.console.campaign import here, note_unreadable_fits
from cfid.console.messages import ask, echo, fitted, note, print_json, printable
from cfid.console.program import cfid_command, program
from cfid.errors import ConfigError
from cfid.guide.certainty import percent
from cfid.guide.status import status_of
from cfid.records.files import RIG_FILE

if TYPE_CHECKING:
    from cfid.guide.plan import Assignment
    from cfid.guide.status import Status
    from cfid.records.campaign import Campaign
    from cfid.records.rig_file import CampaignKind

Kind = Annotated[
    Literal["full", "inertia", "motors", "afternoon", "owner"] | None,
    typer.Option(help="Kind of campaign, which sets what it should find; default: campaign.kind in rig.toml."),
]


def status(*, kind: Kind = None) -> None:
    """Show results and uncertainties, what is missing, and the next step.

    Example: cfid status --kind afternoon
    """
    state = _status(here(), kind)
    (_print_json if program().json else _print)(state)


def next_step(*, kind: Kind = None) -> None:
    """Print what to do at the rig for the next step, and do the step.

    With --yes it starts unasked; a command that turns motors asks all the same.

    Example: cfid next
    """
    opened = here()
    if remedy := opened.rig.unknown():
        raise ConfigError(f"{opened.folder / RIG_FILE}: {remedy}")
    step = _status(opened, kind).next
    echo(fitted(printable(step.why)))
    words = step.words if step.recording is None else _prepared(step.recording, opened)
    echo(f"next: cfid {shlex.join(words)}")
    if not program().yes and _answer("Start it? [Y/n]").lower() not in ("", "y", "yes"):
        note("nothing was started. Type `cfid next` again, or the command itself.")
        raise typer.Exit
    _run_instead(words, opened)


def _prepared(recording: "Assignment", campaign: "Campaign") -> tuple[str, ...]:
    """Print what to do at the rig; return the command's words, completed with the operator's answers."""
    from cfid.rig.hardware import present

    echo(fitted(printable(recording.reminder)))
    if present().devices(campaign.folder, campaign.rig)[1] and (set_up := _simulated(recording)):
        note(f"the rig is simulated: it has to run as `cfid rig sim {set_up}` for this.")
    answers: dict[str, str] = {}
    for name, question in (recording.questions or {}).items():
        answers[name] = _answer(f"{question}:")
        if not answers[name]:
            raise ConfigError(f"{question}: no answer, nothing was started. Type `cfid next` again.")
    return tuple(word.format(**answers) for word in recording.words)


def _simulated(recording: "Assignment") -> str:
    """Return the options that set up the simulated rig for a recording, or "" if it needs none."""
    label = recording.label
    if label.weight_g is not None:
        return f"--weight {label.weight_g:g}"
    return "" if label.axis is None else f"--axis {label.axis}"


def _answer(question: str) -> str:
    """Return the typed line. Ctrl-C ends the program by itself. Raises ConfigError when the input ends."""
    line = ask(question)  # reads no byte more, since the command that follows asks more questions
    if not line:
        raise ConfigError(
            f"{question} Standard input ended before an answer, nothing was started. Run `cfid next` in a terminal, "
            "or type its command yourself; `yes` leaves out the question whether to start."
        )
    return line.strip()


def _status(campaign: "Campaign", kind: "CampaignKind | None") -> "Status":
    """Return the state of a campaign; print a note on each run that cannot be read."""
    note_unreadable_fits(campaign)
    state = status_of(campaign, kind=kind)
    if remedy := campaign.rig.unknown():
        note(f"rig.toml: {remedy}")
    for error in state.unreadable:
        note(f"{error} The run does not count.")
    return state


def _run_instead(words: tuple[str, ...], campaign: "Campaign") -> None:
    """Replace this program with the command, which then has the signals, the terminal and the exit code."""
    sys.stdout.flush()
    os.execv(sys.executable, cfid_command(*words, "--campaign", str(campaign.folder)))


def _print(state: "Status") -> None:
    table = Table(box=SIMPLE, pad_edge=False)
    for heading in ("fit", "runs", "state", "how sure", "what for"):
        width = 5 if heading == "how sure" else None  # keeps "4.2 %" on one line
        table.add_column(heading, overflow="fold", min_width=width)
    for status in state.tasks:
        runs = f"{status.recorded} of {len(status.task.recordings)}"
        sure = "\n".join(percent(certainty.std) for certainty in status.found)
        purposes = "\n".join(f"{one.aim.purpose}: {percent(one.aim.std)}" for one in status.found)
        table.add_row(status.task.section, runs, status.state, sure, purposes)
    Console().print(table)
    for sentence in state.remarks:
        echo(fitted(printable(sentence), indent=6))
    if state.beside:
        others = f"fits that the plan does not need: {', '.join(state.beside)}. `cfid parameters` shows them."
        echo(fitted(printable(others), indent=6))
    echo(fitted(f"next: {printable(state.next.command)}\n      {printable(state.next.why)}", indent=6))


def _print_json(state: "Status") -> None:
    content = {
        "command": "status",
        "tasks": [
            {
                "fit": status.task.section,
                "runs": status.recorded,
                "runs_planned": len(status.task.recordings),
                "state": status.state,
                "reason": status.reason,
                "quantities": [
                    {"key": certainty.key, "relative_std": certainty.std, "wanted_relative_std": certainty.aim.std}
                    for certainty in status.found
                ],
            }
            for status in state.tasks
        ],
        "beside": list(state.beside),
        "next": {"command": list(state.next.words), "why": state.next.why},
    }
    print_json(content)
