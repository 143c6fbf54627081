"""The view of each device in a recording, for `cfid show`: numbers, a curve for the terminal, and a figure."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from cfid.console.inputs import Workplace, find_recording, read_recording
from cfid.errors import DataError
from cfid.quantities.registry import unit_of
from cfid.records.parameters import Parameter, Source
from cfid.wire.supervisor import VehicleState

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cfid.recordings.wrench import WrenchRecord
    from cfid.records.logs.kinds import Kind
    from cfid.records.run import Run
    from cfid.records.tables.angle import AngleRecord
    from cfid.records.tables.schema import Foreign
    from cfid.records.tables.table import Array

_CURVE_POINTS = 400  # more than the dots across a terminal


class Curve(NamedTuple):
    """A value over time (n,), thinned to what a terminal can show, and the name of its axis."""

    time_s: "Array"
    value: "Array"
    name: str


@dataclass(frozen=True, kw_only=True)
class View:
    """One device's recording, ready to show; `lines` state how a file of another program was read.

    `drawn` is false for a view without a figure, of a log with too many series.
    """

    device: str
    name: str
    path: Path
    source: Source
    parameters: Mapping[str, Parameter]
    curve: Curve
    draw: "Callable[[], Figure]"
    notes: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()
    figure: str = ""
    drawn: bool = True

    @property
    def figure_name(self) -> str:
        """The name of the figure's file."""
        return f"{self.figure or self.path.stem}_recording"


def views_of(word: str, workplace: Workplace) -> tuple[list[View], tuple[str, ...]]:
    """Read a RUN; return a view of every readable device in it, and why the others could not be read.

    A file outside a run is identified by its columns. Raises DataError when nothing can be read, and ConfigError for a
    file that needs an option of `cfid import`.
    """
    from cfid.console.log_views import log_views, stand_view
    from cfid.recordings.read import read_recording as recording_at
    from cfid.recordings.wrench import LOADCELL, wrench_of
    from cfid.records.run import run_at
    from cfid.records.tables.angle import ENCODER
    from cfid.records.tables.schema import Foreign

    path = find_recording(word, workplace)
    readers: dict[str, Callable[[], View]] = {
        ENCODER: lambda: _angle_view(ENCODER, read_recording(str(path), workplace)),
        LOADCELL: lambda: _wrench_view(LOADCELL, wrench_of(recording_at(path))),
    }
    run = run_at(path)
    kind = None if run is not None else _kind_of(path, Foreign())
    if run is None:
        if kind == "flight":
            return log_views(path), ()
        if kind == "stand":
            return [stand_view(path)], ()
        return [readers[LOADCELL if kind == "wrench" else ENCODER]()], ()
    order = sorted(run.header.devices, key=lambda device: [*readers, device].index(device))
    wanted = [_reader_of(run, device, readers) for device in order]
    return _readable(wanted or [readers[ENCODER]])


def _kind_of(path: Path, reading: "Foreign") -> "Kind | None":
    """Return the kind of a file outside a run, None for no file; a file with only a known time column is a log."""
    from cfid.records.logs.kinds import has_times, kind_at

    kind = kind_at(path, reading) if path.is_file() else None
    return "flight" if kind is None and path.is_file() and has_times(path, reading) else kind


def _reader_of(run: "Run", device: str, readers: Mapping[str, Callable[[], View]]) -> Callable[[], View]:
    return readers.get(device) or (lambda: _device_view(run, device))


def _readable(readers: list[Callable[[], View]]) -> tuple[list[View], tuple[str, ...]]:
    """Read every device that can be read; a fault in one does not hide the others."""
    views: list[View] = []
    faults: list[DataError] = []
    for read in readers:
        try:
            views.append(read())
        except DataError as fault:
            faults.append(fault)
    if not views:
        raise faults[0]
    return views, tuple(str(fault) for fault in faults)


def _angle_view(device: str, record: "AngleRecord") -> View:
    import numpy as np

    from cfid.findings import texts

    def draw() -> "Figure":
        from cfid.drawing.angle import recording_figure

        return recording_figure(record, title=record.name)

    return View(
        device=device,
        name=record.name,
        path=record.path,
        source=record.source,
        notes=record.notes,
        lines=texts(record.findings, "note"),
        parameters=sampling(record.time_s)
        | {"range_rad": Parameter(value=float(np.ptp(record.angle_rad)), unit="rad")},
        curve=curve_of(record.time_s, record.angle_rad, "angle, degrees", factor=math.degrees(1.0)),
        draw=draw,
    )


def _wrench_view(device: str, record: "WrenchRecord") -> View:
    from cfid.estimate.blocks import block_means

    def draw() -> "Figure":
        from cfid.drawing.wrench import wrench_figure

        return wrench_figure(record, title=record.name)

    # Draw means, since single samples of a vibration would alias into a false curve.
    length = -(-len(record.time_s) // _CURVE_POINTS)
    means = block_means(record.time_s, length=length), block_means(record.values_of(record.main_axis), length=length)
    return View(
        device=device,
        name=record.name,
        path=record.path,
        source=record.source,
        notes=record.notes,
        parameters=sampling(record.time_s) | _means(record),
        curve=Curve(*means, f"{record.main_axis}, {'N' if record.main_axis.startswith('F') else 'N m'}"),
        draw=draw,
    )


def _means(record: "WrenchRecord") -> dict[str, Parameter]:
    """Return means and scatter of forces and torques: as vectors, or axis by axis for a load cell with fewer axes."""
    from cfid.recordings.wrench import AXES

    if record.axes == AXES:
        return {
            "mean_n": Parameter(value=record.force_n.mean(axis=0), unit="N"),
            "std_n": Parameter(value=record.force_n.std(axis=0), unit="N"),
            "mean_nm": Parameter(value=record.torque_nm.mean(axis=0), unit="N m"),
            "std_nm": Parameter(value=record.torque_nm.std(axis=0), unit="N m"),
        }
    found = {}
    for axis in record.axes:
        values, unit = record.values_of(axis), "N" if axis.startswith("F") else "N m"
        found[f"mean.{axis}"] = Parameter(value=float(values.mean()), unit=unit)
        found[f"std.{axis}"] = Parameter(value=float(values.std()), unit=unit)
    return found


def _device_view(run: "Run", device: str) -> View:

    from cfid.drawing.device import groups
    from cfid.findings import texts
    from cfid.recordings.vehicle import SUPERVISOR, read_rows
    from cfid.records.run import losses

    rows = read_rows(run, device)
    since_s = rows.time_s - rows.time_s[0]
    lost = losses(run, run.header.devices[device], len(rows.time_s))
    notes = (*(found.sentence for found in lost), *texts(rows.findings))
    if device == SUPERVISOR:
        notes += (_states(since_s, rows.columns["state"]),)
    columns = shown_columns(rows.columns, len(rows.time_s))
    first = groups(list(columns))[0][0]

    def draw() -> "Figure":
        from cfid.drawing.device import device_figure

        return device_figure(rows.time_s, columns, title=f"{run.folder.name}, {device}", notes=notes)

    return View(
        device=device,
        name=run.folder.name,
        path=run.device_file(device),
        source=rows.source,
        notes=notes,
        parameters=sampling(since_s)
        | {
            f"mean.{name}": Parameter(value=float(column.mean()), unit=unit_of(f"recording.mean.{name}"))
            for name, column in rows.columns.items()
            if device != SUPERVISOR  # a word of bits has no mean
        },
        curve=curve_of(since_s, columns[first], first),
        draw=draw,
    )


def _states(since_s: "Array", words: "Array") -> str:
    """Return the vehicle's states in order, each with the time in seconds at which it began."""
    named = [(time_s, VehicleState.of(int(word)).name) for time_s, word in zip(since_s, words, strict=True)]
    changes = [named[0], *(after for before, after in pairwise(named) if after[1] != before[1])]
    return "vehicle: " + ", ".join(f"{name} at {time_s:.1f} s" for time_s, name in changes)


def shown_columns(columns: "Mapping[str, Array]", rows: int) -> "Mapping[str, Array]":
    """Return the columns (rows,) to draw; for events without variables, which are only times, a running count."""
    import numpy as np

    return columns or {"events": np.arange(1.0, rows + 1)}


def curve_of(time_s: "Array", value: "Array", name: str, *, factor: float = 1.0) -> Curve:
    """Return some of the values (n,) at times (n,), multiplied by a factor."""
    import numpy as np

    chosen = np.linspace(0, len(time_s) - 1, min(_CURVE_POINTS, len(time_s))).astype(int)
    return Curve(time_s[chosen], factor * value[chosen], name)


def sampling(time_s: "Array") -> dict[str, Parameter]:
    """Return the number of samples at times (n,) since the first, their duration and their intervals."""
    import numpy as np

    from cfid.large import differences, some_steps

    if len(time_s) < 2:
        return {"samples": Parameter(value=len(time_s), unit="1")}
    return {
        "samples": Parameter(value=len(time_s), unit="1"),
        "duration_s": Parameter(value=float(time_s[-1]), unit="s"),
        "median_interval_s": Parameter(value=float(np.median(some_steps(time_s))), unit="s"),
        "longest_interval_s": Parameter(value=max(float(step.max()) for _, step in differences(time_s)), unit="s"),
    }
