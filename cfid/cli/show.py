"""`cfid show`: a recording as a figure, or in the terminal."""

from typing import TYPE_CHECKING, Annotated

import typer

from cfid.cli.inputs import open_workplace, read_recording
from cfid.cli.options import Delivery, ReadingOptions, RigOptions, flat
from cfid.cli.outcome import Outcome, deliver
from cfid.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cfid.recording import AngleRecord

_TERMINAL_POINTS = 400


@flat
def show(
    *,
    run: Annotated[str, typer.Argument(metavar="RUN", help="A run folder, a run's name, or a CSV file.")],
    rig: RigOptions,
    reading: ReadingOptions,
    delivery: Delivery,
    terminal: Annotated[bool, typer.Option("--terminal", help="Draw in the terminal instead of a file.")] = False,
) -> None:
    """Plot an encoder recording: angle, speed and sampling.

    Example: [bold]cfid show runs/2026-11-21_083012_swing_x --terminal[/bold]
    """
    if terminal and delivery.json:
        raise ConfigError("--terminal draws where --json would print: give one of them.")
    workplace = open_workplace(rig)
    record = read_recording(run, reading.reading(), workplace)
    if terminal:
        _plot_in_terminal(record)
    deliver(_outcome(record, draws=not terminal), delivery, None)


def _outcome(record: "AngleRecord", *, draws: bool) -> Outcome:
    import numpy as np

    from cfid.parameters import Parameter

    def drawings() -> "dict[str, Figure]":
        from cfid.report.recording_figures import recording_figure

        return {f"{record.path.stem}_recording": recording_figure(record, title=record.name)}

    interval = np.diff(record.time_s)
    return Outcome(
        command="show",
        method="",
        parameters={
            "recording.samples": Parameter(value=len(record.time_s), unit="1"),
            "recording.duration_s": Parameter(value=float(record.time_s[-1]), unit="s"),
            "recording.median_interval_s": Parameter(value=float(np.median(interval)), unit="s"),
            "recording.longest_interval_s": Parameter(value=float(interval.max()), unit="s"),
            "recording.range_rad": Parameter(value=float(np.ptp(record.angle_rad)), unit="rad"),
        },
        quality={},
        warnings=record.notes,
        sources=(record.source,),
        drawings=drawings if draws else None,
        beside=record.path.parent,
    )


def _plot_in_terminal(record: "AngleRecord") -> None:
    import numpy as np
    import plotext

    chosen = np.linspace(0, len(record.time_s) - 1, min(_TERMINAL_POINTS, len(record.time_s))).astype(int)
    plotext.plot(record.time_s[chosen].tolist(), np.degrees(record.angle_rad[chosen]).tolist(), marker="braille")
    plotext.title(record.name)
    plotext.xlabel("time, s")
    plotext.ylabel("angle, degrees")
    plotext.plotsize(78, 22)
    plotext.theme("clear")
    typer.echo(plotext.uncolorize(plotext.build()))
