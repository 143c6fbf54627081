"""`cfid show`: draw a recording as figures."""

from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.inputs import open_workplace
from cfid.console.options import Figures, Force, Geometry, Out
from cfid.console.outcome import Delivery, deliver
from cfid.findings import warning
from cfid.records.result import Result
from cfid.records.run import run_holding

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure


def show_run(
    run: Annotated[
        str, typer.Argument(metavar="RUN", help="A run folder, a run's name, or a file from another program.")
    ],
    *,
    geometry: Geometry = None,
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Plot a run, device by device.

    Figures show angle and speed, forces and their spectrum, commands, battery, crossings, pings.

    Example: cfid show runs/2026-11-21_083012_swing_x
    """
    from cfid.console.views import views_of

    workplace = open_workplace(geometry)
    views, faults = views_of(run, workplace)

    def drawings() -> "dict[str, Figure]":
        return {view.figure: view.draw() for view in views if view.figure}

    texts = [*_verdict(views[0].path), *(note for view in views for note in view.notes)]
    # The run and a device may share a note.
    notes = [text for text in texts if not any(other.endswith(f": {text}") for other in texts)]
    result = Result(
        command="show",
        prints_lines=True,
        method="",
        quantities={
            ".".join(["recording", *([view.device] if len(views) > 1 else []), name]): parameter
            for view in views
            for name, parameter in view.parameters.items()
        },
        findings=tuple(warning("recording", text) for text in dict.fromkeys((*notes, *faults))),
        sources=tuple(view.source for view in views),
        lines=tuple(line for view in views for line in view.lines),
        drawings=drawings,
        folder=views[0].path.parent,
    )
    deliver(result, Delivery(force, figures, out), workplace, keep=False)


def _verdict(path: "Path") -> list[str]:
    """Return the reason why a run is not usable, from its verdict; nothing for any other recording."""
    run = run_holding(path)
    verdict = None if run is None else run.header.verdict
    return [] if verdict is None or verdict.usable else [f"not usable: {verdict.text}"]
